"""Gradients of the objectives, and the rows of the swivel angle, against finite differences of their definitions."""

from __future__ import annotations

import math

import arms
import arms_closed_form
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from motions import bundled

from ik_controller import ControllerParameters, RobotModel
from ik_controller.control.objectives import (
    MARGIN,
    NEAREST,
    add_centring,
    add_manipulability,
    add_repulsion,
    manipulability,
)
from ik_controller.control.secondary import secondary_rows
from ik_controller.control.tasks import TaskStack
from ik_controller.kinematics.closed_form import swivel_angle
from ik_controller.kinematics.jacobian import analyse
from ik_controller.kinematics.small import product

MODELS = {
    "panda": lambda: bundled("panda").model,
    "skewed": lambda: RobotModel.from_urdf(arms.skewed_7(), "tool"),
    "stanford": lambda: RobotModel.from_urdf(arms.stanford(), "tool"),
}
SEEDS = st.integers(0, 2**32 - 1)


def gradient(function, q, h=1e-6) -> np.ndarray:
    return np.array([(function(q + h * e) - function(q - h * e)) / (2.0 * h) for e in np.eye(q.size)])


def drawn(name: str, seed: int):
    rng = np.random.default_rng(seed)
    model = MODELS[name]()
    low, high = np.maximum(model.lower, -3.0), np.minimum(model.upper, 3.0)
    return model, low + rng.uniform(0.02, 0.98, model.n) * (high - low), rng


@given(st.sampled_from(sorted(MODELS)), SEEDS)
def test_joint_centring(name, seed):
    model, q, _ = drawn(name, seed)
    half = 0.5 * (model.upper - model.lower)
    found = np.zeros(model.n)
    add_centring(q, model.lower, model.upper, 3.0, found)
    expected = gradient(lambda x: -1.5 * float(np.sum(((x - model.lower - half) / half) ** 2)), q)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@given(st.sampled_from(sorted(MODELS)), SEEDS)
def test_limit_repulsion(name, seed):
    model, q, _ = drawn(name, seed)
    span = model.upper - model.lower

    def height(x) -> float:
        d = np.minimum(np.concatenate((x - model.lower, model.upper - x)) / (MARGIN * np.tile(span, 2)), 1.0)
        return 3.0 * float(np.sum(np.log(d) - d + 1.0))

    room = np.minimum(q - model.lower, model.upper - q) / (MARGIN * span)
    assume(room.min() > 2.0 * NEAREST)
    found = np.zeros(model.n)
    add_repulsion(q, model.lower, model.upper, 3.0, found)
    np.testing.assert_allclose(found, gradient(height, q, 1e-7), rtol=1e-4, atol=1e-5)


def test_joints_without_bounds_and_joints_at_them():
    lower, upper = np.array([-math.inf, -1.0, -1.0]), np.array([math.inf, 1.0, 1.0])
    found = np.zeros(3)
    add_centring(np.array([50.0, 0.0, 1.0]), lower, upper, 1.0, found)
    np.testing.assert_allclose(found, [0.0, 0.0, -1.0])
    found = np.zeros(3)
    add_repulsion(np.array([50.0, -1.0, 1.5]), lower, upper, 1.0, found)
    assert found[0] == 0.0
    assert 0.0 < found[1] == -found[2] < math.inf  # away from the bound, and finite at and beyond it


@given(st.sampled_from(sorted(MODELS)), SEEDS, st.booleans())
def test_manipulability(name, seed, few):
    """Of all axes, and of three in a turned frame; the height itself against the library's."""
    model, q, rng = drawn(name, seed)
    selection = np.eye(6)
    if few:
        selection = np.ascontiguousarray(np.linalg.qr(rng.normal(size=(6, 6)))[0][:3])

    def height(x) -> float:
        rows = selection @ model.jacobian(x)
        return float(np.prod(np.linalg.svd(rows, compute_uv=False)))

    J = np.ascontiguousarray(model.jacobian(q))
    assert manipulability(product(selection, J, np.empty((len(selection), J.shape[1])))) == pytest.approx(
        height(q), abs=1e-9
    )
    assume(height(q) > 1e-3)
    found = np.zeros(model.n)
    add_manipulability(J, selection, 2.0, found)
    np.testing.assert_allclose(found, 2.0 * gradient(height, q), atol=1e-6)


def test_manipulability_is_that_of_the_analysis(panda):
    J = np.ascontiguousarray(panda.model.jacobian(panda.home))
    assert manipulability(J) == pytest.approx(analyse(J).manipulability, rel=1e-9)
    assert manipulability(np.zeros((2, 3))) == 0.0


@given(st.sampled_from(["seven", "seven_offset"]), SEEDS)
def test_swivel_rows_are_the_rates_of_the_closed_forms_angle(name, seed):
    """Row over row's factor is ∂φ/∂q, rate over the same factor is k (φ_d − φ), the short way round."""
    text = arms_closed_form.CLOSED_FORMS[name][0]
    model = RobotModel.from_urdf(text, "tool")
    rng = np.random.default_rng(seed)
    q, wanted = rng.uniform(-2.5, 2.5, 7), float(rng.uniform(-3.0, 3.0))
    stack = TaskStack(model, ControllerParameters(secondary_tasks=("swivel",), secondary_targets=(wanted,)))
    rows, rates = np.zeros((3, 7)), np.zeros(3)
    assert secondary_rows(stack.levels[0], stack.chains[0], q, q, rows, rates) == 1

    def rate(x) -> float:
        return swivel_angle(model, x)

    angles = [[rate(q + h * e) for h in (1e-6, -1e-6)] for e in np.eye(7)]
    slope = np.array([math.remainder(a - b, 2.0 * math.pi) for a, b in angles]) / 2e-6
    assume(np.linalg.norm(slope) < 50.0)
    factor = float(rows[0] @ slope) / float(slope @ slope)
    assert factor > 0.0
    np.testing.assert_allclose(rows[0], factor * slope, atol=1e-6)
    off = math.remainder(wanted - swivel_angle(model, q), 2.0 * math.pi)
    assume(abs(off) < 3.1)
    assert rates[0] == pytest.approx(2.0 * factor * off, rel=1e-5, abs=1e-9)


def test_a_swivel_angle_that_is_none_asks_for_nothing():
    """The stretched arm: the elbow is in line, or the line upright."""
    model = RobotModel.from_urdf(arms_closed_form.CLOSED_FORMS["seven"][0], "tool")
    stack = TaskStack(model, ControllerParameters(secondary_tasks=("swivel",), secondary_targets=(1.0,)))
    rows, rates = np.ones((3, 7)), np.ones(3)
    secondary_rows(stack.levels[0], stack.chains[0], np.zeros(7), np.zeros(7), rows, rates)
    assert not rows[0].any()
    assert rates[0] == 0.0
