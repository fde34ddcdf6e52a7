"""The bend of the tool's way: second derivatives against differences, and the step's matrix never below them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motions import arm

from ik_controller import RobotModel
from ik_controller.control.curvature import bend, curved_squares

SEEDS = st.integers(0, 2**32 - 1)


def error_of(model: RobotModel, target: pin.SE3, q: np.ndarray) -> np.ndarray:
    tool = model.forward(q)
    return np.concatenate((target.translation - tool.translation, pin.log3(target.rotation @ tool.rotation.T)))


@pytest.mark.parametrize("name", ["panda", "ur5e", "scara", "skewed_7"])
@settings(max_examples=20, deadline=None)
@given(seed=SEEDS)
def test_jacobian_and_bend_are_the_second_derivatives_of_half_the_squared_error(name: str, seed: int) -> None:
    model, random = arm(name).model, np.random.default_rng(seed)
    q = random.uniform(np.fmax(model.lower, -2.0), np.fmin(model.upper, 2.0))
    tool = model.forward(q)
    # The error of rotation bends a little itself: by |e_R|²/12 of what is here.
    target = pin.SE3(pin.exp3(random.uniform(-0.02, 0.02, 3)) @ tool.rotation, tool.translation + random.normal(size=3))

    def gradient(at: np.ndarray) -> np.ndarray:
        return -model.jacobian(at).T @ error_of(model, target, at)

    step = 1e-6
    columns = [(gradient(q + step * unit) - gradient(q - step * unit)) / (2.0 * step) for unit in np.eye(model.n)]
    differences = np.array(columns)
    jacobian = np.ascontiguousarray(model.jacobian(q))
    second = jacobian.T @ jacobian + bend(jacobian, error_of(model, target, q), np.empty((model.n, model.n)))
    np.testing.assert_allclose(second, 0.5 * (differences + differences.T), atol=1e-3)


@settings(max_examples=100, deadline=None)
@given(seed=SEEDS, damping=st.floats(1e-3, 0.1))
def test_the_steps_matrix_is_nowhere_below_the_second_derivatives(seed: int, damping: float) -> None:
    random = np.random.default_rng(seed)
    jacobian, error = random.normal(size=(6, 7)), random.normal(size=6)
    jacobian[:, 3] = jacobian[:, 2]  # singular too
    bent = bend(jacobian, error, np.empty((7, 7)))
    rows = np.ascontiguousarray(jacobian[: random.integers(1, 7)])
    squares = curved_squares(rows, bent, damping, np.empty((7, 7)))
    least = damping * damping * (1.0 - 1e-6)
    assert np.linalg.eigvalsh(squares).min() >= least - 1e-10
    assert np.linalg.eigvalsh(squares - rows.T @ rows - bent).min() >= least - 1e-10
