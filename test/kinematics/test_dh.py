"""DH tables against transforms multiplied out, the notes' matrices, and arms built from geometry (N14)."""

from __future__ import annotations

import math

import arms
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import finite_vectors

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.dh import DHJoint, dh_forward, dh_model, dh_transform, dh_urdf
from ik_controller.kinematics.model import RobotModel

HALF = math.pi / 2
# 004 p. 37 as a table: modified DH of the Stanford Scheinman arm.
STANFORD = [
    DHJoint(),
    DHJoint(alpha=-HALF, d=0.154),
    DHJoint(alpha=HALF, prismatic=True, lower=0.1, upper=1.2),
    DHJoint(),
    DHJoint(alpha=-HALF),
    DHJoint(alpha=HALF),
]
# 002: classic DH of the anthropomorphic arm.
PUMA_ARM = [DHJoint(alpha=HALF), DHJoint(a=0.432), DHJoint(a=0.433)]

NUMBERS = st.floats(-2.0, 2.0)
JOINTS = st.builds(DHJoint, a=NUMBERS, alpha=NUMBERS, d=NUMBERS, theta=NUMBERS, prismatic=st.booleans())


def screw(axis, angle, along):
    """Rotation about and translation along x (0) or z (2), as (4, 4)."""
    T = np.eye(4)
    c, s = math.cos(angle), math.sin(angle)
    i, j = (1, 2) if axis == 0 else (0, 1)
    T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
    T[axis, 3] = along
    return T


@given(joint=JOINTS, q=NUMBERS)
def test_transform_is_the_two_screws(joint, q):
    theta, d = (joint.theta, joint.d + q) if joint.prismatic else (joint.theta + q, joint.d)
    x, z = screw(0, joint.alpha, joint.a), screw(2, theta, d)
    np.testing.assert_allclose(dh_transform(joint, q, "modified"), x @ z, atol=1e-14)
    np.testing.assert_allclose(dh_transform(joint, q, "classic"), z @ x, atol=1e-14)


@given(alpha=NUMBERS, a=NUMBERS, theta=NUMBERS, rho=NUMBERS)
def test_modified_is_the_printed_matrix_of_004_p10(alpha, a, theta, rho):
    ct, st_, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    printed = [
        [ct, -st_, 0, a],
        [st_ * ca, ct * ca, -sa, -rho * sa],
        [st_ * sa, ct * sa, ca, rho * ca],
        [0, 0, 0, 1],
    ]
    np.testing.assert_allclose(dh_transform(DHJoint(a=a, alpha=alpha, d=rho), theta), printed, atol=1e-14)


@given(q=finite_vectors(3))
def test_classic_is_the_printed_T_0_3_of_002(q):
    (c1, c2, _), (s1, s2, _) = np.cos(q), np.sin(q)
    c23, s23, a2, a3 = math.cos(q[1] + q[2]), math.sin(q[1] + q[2]), 0.432, 0.433
    printed = [
        [c1 * c23, -c1 * s23, s1, c1 * (a2 * c2 + a3 * c23)],
        [s1 * c23, -s1 * s23, -c1, s1 * (a2 * c2 + a3 * c23)],
        [s23, c23, 0, a2 * s2 + a3 * s23],
        [0, 0, 0, 1],
    ]
    np.testing.assert_allclose(dh_forward(PUMA_ARM, q, "classic"), printed, atol=1e-14)
    # The slide before prints T_2^1 with a2 c1 and a2 s1; the product above needs a2 c2 and a2 s2.
    T = dh_transform(PUMA_ARM[1], q[1], "classic")
    np.testing.assert_allclose(T[:2, 3], [a2 * c2, a2 * s2], atol=1e-14)


@pytest.mark.parametrize("convention", ["modified", "classic"])
@given(joints=st.lists(JOINTS, min_size=1, max_size=7), data=st.data())
def test_the_model_of_a_table_has_its_forward_kinematics(convention, joints, data):
    q = data.draw(finite_vectors(len(joints)))
    model = dh_model(joints, convention)
    assert model.prismatic.tolist() == [joint.prismatic for joint in joints]
    np.testing.assert_allclose(model.forward(q).homogeneous, dh_forward(joints, q, convention), atol=1e-12)


@given(q=finite_vectors(6))
def test_the_stanford_table_is_the_arm_built_from_geometry(q):
    by_geometry = RobotModel.from_urdf(arms.stanford(), "tool")
    by_table = dh_model(STANFORD)
    np.testing.assert_allclose(by_table.forward(q).homogeneous, by_geometry.forward(q).homogeneous, atol=1e-12)
    np.testing.assert_allclose(by_table.jacobian(q), by_geometry.jacobian(q), atol=1e-12)


def test_limits_and_names_reach_the_model():
    joints = [DHJoint(a=1, lower=-1, upper=2, velocity=0.5, name="shoulder & more"), DHJoint(prismatic=True, upper=0.3)]
    model = dh_model(joints, "classic", "my <arm>")
    assert model.joint_names == ("shoulder & more", "joint2")
    assert (model.lower.tolist(), model.upper.tolist()) == ([-1.0, -math.pi], [2.0, 0.3])
    assert model.velocity_limit.tolist() == [0.5, 1.0]
    assert model.robot_name == "my <arm>"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: dh_forward([], []), "joints: an empty chain"),
        (lambda: dh_urdf([]), "joints: an empty chain"),
        (lambda: dh_model([DHJoint(), DHJoint(alpha=math.nan)]), r"joints\[1\].alpha: every value must be finite"),
        (lambda: dh_model([DHJoint(lower=1.0, upper=1.0)]), r"joints\[0\]: lower 1.0 is not below upper 1.0"),
        (lambda: dh_model([DHJoint()], "craig"), "convention 'craig' is unknown; legal: modified, classic"),
        (lambda: dh_forward([DHJoint()], [1, 2]), r"q: need shape \(1,\), got \(2,\)"),
        (lambda: dh_transform(DHJoint(), math.inf), "q: every value must be finite"),
    ],
)
def test_bad_input_is_one_line_that_names_the_argument(call, message):
    with pytest.raises(ArgumentError, match=message):
        call()
