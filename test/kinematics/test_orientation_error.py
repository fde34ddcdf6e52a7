"""Orientation errors: gradient, zeros, range, agreement, behaviour near π, and what each does in a loop (N4)."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import angles, rotation_vectors, rotations, unit_vectors

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.orientation_error import ORIENTATION_ERRORS, orientation_error
from ik_controller.kinematics.representations import ROTATIONS
from ik_controller.kinematics.rotation import rot_y, rot_z, rotation_from_euler_zxz, rotation_from_euler_zyx

ERRORS = list(ORIENTATION_ERRORS.values())
FULL_RANGE = [error for error in ERRORS if error.valid_angle == math.pi]
every_error = pytest.mark.parametrize("error", ERRORS, ids=lambda e: e.name)

# For Euler differences: the representation whose singularity R must keep away from, and its measure.
ANGLES = {"euler_difference_zyx": "euler_zyx", "euler_difference_xyz": "fixed_xyz", "euler_difference_zxz": "euler_zxz"}


def distance_to_singularity(error, R):
    """Angle [rad] from R to the nearest singularity of the error's angles; π/2 where it has none of its own."""
    if error.name not in ANGLES:
        return math.pi / 2
    representation = ROTATIONS[ANGLES[error.name]]
    return math.asin(min(1.0, representation.singularity(representation.coordinates(R)).measure))


@st.composite
def rotations_for(draw, error, room):
    """Rotations at least `room` [rad] away from the singularity of the error's angles."""
    if error.name not in ANGLES:
        return draw(rotations())
    outer = st.floats(-math.pi, math.pi)
    middle = draw(st.floats(room - math.pi / 2, math.pi / 2 - room)) + (math.pi / 2 if error.name[-3:] == "zxz" else 0)
    return ROTATIONS[ANGLES[error.name]].part([draw(outer), middle, draw(outer)])


def command(error, R_desired, R):
    return error.angular_velocity(error(R_desired, R), R)


@every_error
@given(data=st.data())
def test_is_zero_at_zero_rotation_and_its_gradient_is_the_identity(error, data):
    R = data.draw(rotations_for(error, 0.3))
    np.testing.assert_allclose(error(R, R), 0, atol=1e-12)
    h = 1e-5
    columns = [
        (command(error, pin.exp3(h * axis) @ R, R) - command(error, pin.exp3(-h * axis) @ R, R)) / (2 * h)
        for axis in np.eye(3)
    ]
    np.testing.assert_allclose(np.column_stack(columns), np.eye(3), atol=1e-7)


@every_error
@given(data=st.data(), axis=unit_vectors(), share=st.floats(1e-8, 1.0 - 1e-6))
def test_is_zero_only_at_zero_rotation_and_the_command_shrinks_the_angle_in_its_range(error, data, axis, share):
    R = data.draw(rotations_for(error, 0.02))
    angle = share * (error.valid_angle - (math.pi / 2 - distance_to_singularity(error, R)))
    R_desired = pin.exp3(axis * angle) @ R
    assert np.linalg.norm(error(R_desired, R)) > 0.1 * angle
    assert command(error, R_desired, R) @ axis > 0.0


@every_error
@given(data=st.data(), axis=unit_vectors(), angle=angles(0.01))
def test_all_agree_to_first_order(error, data, axis, angle):
    R = data.draw(rotations_for(error, 0.3))
    omega = command(error, pin.exp3(axis * angle) @ R, R)
    np.testing.assert_allclose(omega, axis * angle, atol=10 * angle**2 + 1e-12)


@pytest.mark.parametrize("error", FULL_RANGE, ids=lambda e: e.name)
@given(R=rotations(), axis=unit_vectors(), past=angles(0.5))
def test_near_pi_is_finite_and_the_short_way(error, R, axis, past):
    for angle in (math.pi - past, math.pi + past):
        R_desired = pin.exp3(axis * angle) @ R
        omega = command(error, R_desired, R)
        length = math.pi - past if error.name.startswith("exponential") else 2 * math.sin((math.pi - past) / 2)
        assert np.linalg.norm(omega) == pytest.approx(length, abs=1e-6)
        if past > 1e-6:  # beyond π the short way is about −axis
            assert omega @ axis * (math.pi - angle) > 0.0


@given(R=rotations(), axis=unit_vectors(), angle=angles(math.pi - 1e-6))
def test_lengths_are_those_of_the_table(R, axis, angle):
    R_desired = pin.exp3(axis * angle) @ R
    lengths = {"exponential_base": angle, "quaternion": 2 * math.sin(angle / 2), "instantaneous": math.sin(angle)}
    for name, length in lengths.items():
        np.testing.assert_allclose(orientation_error(name)(R_desired, R), length * axis, atol=1e-8)


@given(R=rotations(), w=rotation_vectors(3.0))
def test_tool_and_base_forms_are_the_same_vector(R, w):
    R_desired = pin.exp3(w) @ R
    base, tool = orientation_error("exponential_base"), orientation_error("exponential_tool")
    np.testing.assert_allclose(base(R_desired, R), R @ tool(R_desired, R), atol=1e-9)
    # 000 (3): the unit quaternion of R_bd has its vector in the tool frame.
    np.testing.assert_allclose(
        orientation_error("quaternion")(R_desired, R),
        2 * R @ (pin.Quaternion(R.T @ R_desired).coeffs()[:3] * math.copysign(1, pin.Quaternion(R.T @ R_desired).w)),
        atol=1e-9,
    )


@given(R=rotations(), w=rotation_vectors(3.0))
def test_instantaneous_is_minus_the_printed_sum(R, w):
    R_desired = pin.exp3(w) @ R
    printed = -0.5 * sum(np.cross(R[:, i], R_desired[:, i]) for i in range(3))  # 004 p. 73: current − desired
    np.testing.assert_allclose(orientation_error("instantaneous")(R_desired, R), -printed, atol=1e-12)


def test_instantaneous_fails_at_pi_and_shrinks_from_half_pi_on():
    error = orientation_error("instantaneous")
    np.testing.assert_allclose(error(rot_z(math.pi), np.eye(3)), 0, atol=1e-15)
    assert error(rot_z(2.5), np.eye(3))[2] < error(rot_z(math.pi / 2), np.eye(3))[2]


def test_euler_relative_points_the_wrong_way_somewhere_beyond_half_pi():
    error = orientation_error("euler_relative_tool")
    rng = np.random.default_rng(3)
    axes = rng.normal(size=(2000, 3))
    vectors = axes / np.linalg.norm(axes, axis=1, keepdims=True) * rng.uniform(math.pi / 2, math.pi, (2000, 1))
    wrong = [np.linalg.norm(w) for w in vectors if error(pin.exp3(w), np.eye(3)) @ w < 0.0]
    assert len(wrong) > 20


@pytest.mark.parametrize("name", list(ANGLES))
def test_an_euler_difference_maps_through_E_inverse(name):
    representation = ROTATIONS[ANGLES[name]]
    phi, phi_d = np.array([0.5, 0.7, -0.2]), np.array([0.9, 0.4, 0.3])
    error = orientation_error(name)
    R, R_desired = representation.part(phi), representation.part(phi_d)
    np.testing.assert_allclose(error(R_desired, R), phi_d - phi, atol=1e-12)
    K = np.diag([1.0, 2.0, 3.0])
    expected = representation.E_inverse(phi) @ K @ (phi_d - phi)
    np.testing.assert_allclose(error.angular_velocity(K @ error(R_desired, R), R), expected, atol=1e-12)


def test_an_euler_difference_jumps_at_its_singularity():
    error = orientation_error("euler_difference_zyx")
    R = rotation_from_euler_zyx([0.0, math.pi / 2 - 1e-4, 0.0])
    over = rot_y(2e-4) @ R  # across the singularity, 2e-4 rad away
    assert np.linalg.norm(error(over, R)) > 3.0
    R = rotation_from_euler_zxz([0.0, 1e-4, 0.0])
    assert np.linalg.norm(orientation_error("euler_difference_zxz")(pin.exp3(np.array([-2e-4, 0, 0])) @ R, R)) > 3.0


@every_error
def test_one_step_of_the_law_shrinks_the_error_and_a_loop_removes_it(error):
    R = rotation_from_euler_zxz([0.3, math.pi / 2 - 0.2, 0.4])
    if distance_to_singularity(error, R) < 0.8:
        R = rotation_from_euler_zyx([0.3, 0.1, 0.4])
    R_desired = pin.exp3(np.array([0.3, -0.4, 0.2])) @ R
    angle = np.linalg.norm(pin.log3(R_desired @ R.T))
    for _ in range(400):
        R = pin.exp3(0.1 * command(error, R_desired, R)) @ R
        now = np.linalg.norm(pin.log3(R_desired @ R.T))
        assert now < angle or now < 1e-12
        angle = now
    assert angle < 1e-12


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: orientation_error("euler"), "orientation error 'euler' is unknown; legal: exponential_base, exp"),
        (lambda: orientation_error()(np.full((3, 3), math.nan), np.eye(3)), "R_desired: every value must be finite"),
        (lambda: orientation_error()(np.eye(3), 1.1 * np.eye(3)), "R: not a rotation matrix"),
        (lambda: orientation_error().angular_velocity([1, 2], np.eye(3)), r"e: need shape \(3,\)"),
    ],
)
def test_bad_input_is_one_line_that_names_the_argument(call, message):
    with pytest.raises(ArgumentError, match=message):
        call()
