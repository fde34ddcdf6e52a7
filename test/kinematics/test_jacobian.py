"""Basic Jacobian three ways and against the explicit forms of 002 and 004; singularities; statics (N1, N2, N14)."""

from __future__ import annotations

import math

import arms
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import finite_vectors

from ik_controller.errors import ArgumentError, ModelError
from ik_controller.kinematics.jacobian import (
    analyse,
    basic_jacobian,
    displacement_jacobian,
    geometric_jacobian,
    joint_torques,
    manipulability,
)
from ik_controller.kinematics.model import RobotModel


def model_of(text):
    return RobotModel.from_urdf(text, "tool")


ARMS = {
    arm.__name__: model_of(arm())
    for arm in (arms.planar_2r, arms.planar_3r, arms.stanford, arms.puma, arms.scara, arms.skewed_7)
}
# A finger-like arm: joint 3 follows joint 2 at −0.5 times its angle.
MIMIC = arms.planar_3r().replace(
    '<joint name="joint3" type="revolute">',
    '<joint name="joint3" type="revolute"><mimic joint="joint2" multiplier="-0.5" offset="0.3"/>',
)


@pytest.mark.parametrize("name", [*ARMS, "mimic"])
@given(data=st.data())
def test_three_ways_agree(name, data):
    model = model_of(MIMIC) if name == "mimic" else ARMS[name]
    q = data.draw(finite_vectors(model.n))
    J = basic_jacobian(model, q)
    assert J.shape == (6, model.n)
    np.testing.assert_allclose(geometric_jacobian(model, q), J, atol=1e-12)
    np.testing.assert_allclose(displacement_jacobian(model, q), J, atol=1e-6)


@given(q=finite_vectors(3))
def test_planar_3r_is_the_explicit_form_of_002(q):
    l1, l2, l3 = 1.0, 0.8, 0.5
    a, b, c = np.cumsum(q)
    s = [l1 * math.sin(a), l2 * math.sin(b), l3 * math.sin(c)]
    k = [l1 * math.cos(a), l2 * math.cos(b), l3 * math.cos(c)]
    zero = [0.0, 0.0, 0.0]
    expected = [
        [-s[0] - s[1] - s[2], -s[1] - s[2], -s[2]],
        [k[0] + k[1] + k[2], k[1] + k[2], k[2]],
        *[zero] * 3,
        [1.0, 1.0, 1.0],
    ]
    np.testing.assert_allclose(basic_jacobian(ARMS["planar_3r"], q), expected, atol=1e-13)
    np.testing.assert_allclose(ARMS["planar_3r"].forward(q).translation, [sum(k), sum(s), 0], atol=1e-13)


@given(q=finite_vectors(6))
def test_stanford_arm_is_the_printed_matrix_of_004_p38(q):
    """Every one of the 36 printed entries is right: p. 38 has no misprint."""
    d2, d3 = 0.154, q[2]
    (c1, c2, _, c4, c5, _), (s1, s2, _, s4, s5, _) = np.cos(q), np.sin(q)
    printed = [
        [-c1 * d2 - s1 * s2 * d3, c1 * c2 * d3, c1 * s2, 0, 0, 0],
        [-s1 * d2 + c1 * s2 * d3, s1 * c2 * d3, s1 * s2, 0, 0, 0],
        [0, -s2 * d3, c2, 0, 0, 0],
        [0, -s1, 0, c1 * s2, -c1 * c2 * s4 - s1 * c4, c1 * c2 * c4 * s5 - s1 * s4 * s5 + c1 * s2 * c5],
        [0, c1, 0, s1 * s2, -s1 * c2 * s4 + c1 * c4, s1 * c2 * c4 * s5 + c1 * s4 * s5 + s1 * s2 * c5],
        [1, 0, 0, c2, s2 * s4, -s2 * c4 * s5 + c5 * c2],
    ]
    np.testing.assert_allclose(basic_jacobian(ARMS["stanford"], q), printed, atol=1e-13)


@given(q=finite_vectors(2))
def test_planar_2r_manipulability_is_l1_l2_sin_q2(q):
    J = basic_jacobian(ARMS["planar_2r"], q)[:2]
    assert manipulability(J) == pytest.approx(abs(math.sin(q[1])), abs=1e-12)
    assert manipulability(J) == pytest.approx(abs(J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]), abs=1e-12)


def test_a_straight_2r_arm_cannot_move_outward():
    report = analyse(basic_jacobian(ARMS["planar_2r"], [0.0, 0.0])[:2])
    assert report.singular
    assert report.rank == 1
    assert report.condition_number > 1e15
    np.testing.assert_allclose(np.abs(report.lost_directions), [[1, 0]], atol=1e-12)
    # (2, 1) q̇ᵀ = 0 for the row that is left: joint 2 turns back twice as fast as joint 1.
    np.testing.assert_allclose(report.joint_motions[0] / report.joint_motions[0, 0], [1, -2], atol=1e-12)
    assert report.describe(["shoulder", "elbow"], ["vx", "vy"]) in (
        "singular: no motion along +1.00 vx (joints shoulder, elbow)",
        "singular: no motion along -1.00 vx (joints shoulder, elbow)",
    )


def test_a_wrist_singularity_concerns_its_two_parallel_axes_alone():
    q = np.array([0.3, -0.5, 0.6, 0.4, 0.0, -0.7])  # Stanford arm, axes 4 and 6 in line
    report = analyse(basic_jacobian(ARMS["stanford"], q))
    assert report.rank == 5
    assert report.joints() == (3, 5)
    # What is lost needs a rotation about the normal to axes 4 and 5.
    J = basic_jacobian(ARMS["stanford"], q)
    normal = np.cross(J[3:, 3], J[3:, 4])
    rotation = report.lost_directions[0, 3:]
    assert abs(rotation @ normal) / np.linalg.norm(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(report.lost_directions @ J, 0, atol=1e-12)
    assert "joint4, joint6" in report.describe(ARMS["stanford"].joint_names)


def test_a_regular_configuration_is_said_to_be_one():
    report = analyse(basic_jacobian(ARMS["stanford"], [0.1, 0.9, 0.5, 0.3, 0.8, 0.2]))
    assert not report.singular
    assert report.rank == 6
    assert report.joints() == ()
    assert report.condition_number == pytest.approx(report.singular_values[0] / report.smallest_singular_value)
    assert report.manipulability == pytest.approx(np.prod(report.singular_values))
    assert report.describe(ARMS["stanford"].joint_names).startswith("not singular")


def test_length_scales_the_rows_of_rotation():
    J = basic_jacobian(ARMS["puma"], [0.1, 0.5, 0.7, 0.3, 0.8, 0.2])
    scaled = J.copy()
    scaled[3:] *= 0.2
    expected = np.linalg.svd(scaled, compute_uv=False)
    np.testing.assert_allclose(analyse(J, length=0.2).singular_values, expected)


@given(q=finite_vectors(7), dq=finite_vectors(7), F=finite_vectors(6))
def test_power_is_the_same_in_joints_and_at_the_tool(q, dq, F):
    J = basic_jacobian(ARMS["skewed_7"], q)
    assert joint_torques(J, F) @ dq == pytest.approx(F @ (J @ dq), abs=1e-10)


def test_a_weight_on_a_stretched_arm_is_held_by_force_times_lever():
    tau = joint_torques(basic_jacobian(ARMS["puma"], np.zeros(6)), [0, 0, 10.0, 0, 0, 0])
    # Pushing up 10 N at the tool, 0.965 m from the shoulder, 0.533 m from the elbow, 0.1 m from the wrist.
    np.testing.assert_allclose(tau, [0, 9.65, 5.33, 0, 1.0, 0], atol=1e-12)


def test_jacobian_of_a_moved_tool_point():
    model = RobotModel.from_urdf(arms.skewed_7(), "tool", tool_offset=[0.1, 0.2, 0.3, 0, 0, 0, 1])
    q = np.linspace(-1, 1, 7)
    J, at_tip = basic_jacobian(model, q), basic_jacobian(ARMS["skewed_7"], q)
    lever = model.forward(q).translation - ARMS["skewed_7"].forward(q).translation
    np.testing.assert_allclose(J[:3], at_tip[:3] - pin.skew(lever) @ at_tip[3:], atol=1e-12)
    np.testing.assert_allclose(geometric_jacobian(model, q), J, atol=1e-12)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: basic_jacobian(ARMS["planar_2r"], [1.0]), ArgumentError, r"q: need shape \(2,\), got \(1,\)"),
        (lambda: geometric_jacobian(ARMS["planar_2r"], [1.0, math.nan]), ArgumentError, "q: every value must be fin"),
        (lambda: displacement_jacobian(ARMS["planar_2r"], [0, 0], 0), ArgumentError, "step: need a value > 0, got 0"),
        (lambda: joint_torques(np.eye(6), [1.0]), ArgumentError, r"wrench: need shape \(6,\), got \(1,\)"),
        (lambda: manipulability(np.zeros((0, 3))), ArgumentError, r"J: need shape \(\*, \*\), got \(0, 3\)"),
        (lambda: analyse(np.eye(2), -1.0), ArgumentError, "tolerance: need a value ≥ 0, got -1"),
        (lambda: analyse(np.eye(6), length=0.0), ArgumentError, "length: need a value > 0, got 0"),
        (lambda: model_of(arms.urdf("stick", [])), ModelError, "no movable joint between 'base' and 'tool'"),
    ],
)
def test_bad_input_is_one_line_that_names_the_argument(call, error, message):
    with pytest.raises(error, match=message):
        call()
