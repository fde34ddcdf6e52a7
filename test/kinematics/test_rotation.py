"""Round trips of all rotation forms, near and at their singularities, and against numpy-only definitions (N14)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import angles, finite_vectors, rotation_vectors, rotations, unit_vectors

from ik_controller.errors import ArgumentError
from ik_controller.kinematics import rotation as rot

ANGLES = st.floats(-math.pi, math.pi)


@pytest.mark.parametrize("form", ["euler_zyx", "fixed_xyz", "euler_zxz", "quaternion", "euler_parameters"])
@given(R=rotations())
def test_every_form_gives_the_rotation_back(form, R):
    x = getattr(rot, f"{form}_from_rotation")(R)
    np.testing.assert_allclose(getattr(rot, f"rotation_from_{form}")(x), R, atol=3e-12)


@given(R=rotations())
def test_exp_of_log_is_the_rotation_and_the_angle_is_at_most_pi(R):
    w = rot.log_rotation(R)
    np.testing.assert_allclose(rot.exp_rotation(w), R, atol=1e-10)
    assert np.linalg.norm(w) <= math.pi + 1e-12


@given(w=rotation_vectors(math.pi - 1e-6))
def test_log_of_exp_is_the_vector_below_pi(w):
    np.testing.assert_allclose(rot.log_rotation(rot.exp_rotation(w)), w, atol=1e-9)


@given(axis=unit_vectors(), angle=angles())
def test_exp_is_rodrigues_formula(axis, angle):
    hat = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    R = np.eye(3) + math.sin(angle) * hat + (1 - math.cos(angle)) * hat @ hat
    np.testing.assert_allclose(rot.exp_rotation(axis * angle), R, atol=1e-14)
    half = np.concatenate(([math.cos(angle / 2)], math.sin(angle / 2) * axis))
    np.testing.assert_allclose(rot.rotation_from_euler_parameters(half), R, atol=1e-14)
    assert rot.rotation_angle(R) == pytest.approx(angle, abs=1e-7)


@given(a=ANGLES, b=st.floats(-1.5, 1.5), c=ANGLES)
def test_euler_angles_are_the_products_of_the_notes(a, b, c):
    x, y, z = rot.rot_x, rot.rot_y, rot.rot_z
    np.testing.assert_allclose(rot.rotation_from_euler_zyx((a, b, c)), z(a) @ y(b) @ x(c))
    np.testing.assert_allclose(rot.rotation_from_fixed_xyz((c, b, a)), z(a) @ y(b) @ x(c))
    np.testing.assert_allclose(rot.rotation_from_euler_zxz((a, b, c)), z(a) @ x(b) @ z(c))
    found = rot.euler_zyx_from_rotation(z(a) @ y(b) @ x(c))
    np.testing.assert_allclose(np.cos(found - (a, b, c)), 1.0, atol=1e-12)


@pytest.mark.parametrize(("axis", "turn"), [(0, rot.rot_x), (1, rot.rot_y), (2, rot.rot_z)])
def test_elementary_rotations_turn_by_the_right_hand_rule(axis, turn):
    a, b = (axis + 1) % 3, (axis + 2) % 3
    np.testing.assert_allclose(turn(math.pi / 2)[:, a], np.eye(3)[b], atol=1e-15)


@given(v=finite_vectors(3), a=finite_vectors(3))
def test_skew_is_the_cross_product(v, a):
    np.testing.assert_allclose(rot.skew(v) @ a, np.cross(v, a), atol=1e-12)


@given(R=rotations())
def test_one_euler_parameter_is_at_least_a_half(R):
    assert np.abs(rot.euler_parameters_from_rotation(R)).max() >= 0.5 - 1e-12


@settings(max_examples=30)
@given(axis=unit_vectors(), start=rotations())
def test_euler_parameters_are_continuous_over_two_turns(axis, start):
    previous = rot.euler_parameters_from_rotation(start)
    first = previous
    for k in range(1, 201):
        R = rot.exp_rotation(axis * (4 * math.pi * k / 200)) @ start
        current = rot.euler_parameters_from_rotation(R, previous)
        assert np.linalg.norm(current - previous) < 0.04
        previous = current
        if k == 100:  # one turn: the same rotation, the other sign
            np.testing.assert_allclose(current, -first, atol=1e-9)
    np.testing.assert_allclose(previous, first, atol=1e-9)


def test_quaternion_order_is_x_y_z_w_and_continues_the_given_sign():
    R = rot.rot_z(math.pi / 2)
    expected = np.array([0, 0, math.sqrt(0.5), math.sqrt(0.5)])
    np.testing.assert_allclose(rot.quaternion_from_rotation(R), expected, atol=1e-15)
    np.testing.assert_allclose(rot.quaternion_from_rotation(R, -expected), -expected, atol=1e-15)


def test_a_quaternion_within_tolerance_is_normalized():
    quaternion = rot.check_quaternion([0, 0, 0, 1.0009])
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: rot.rotation_from_quaternion([0, 0, 0, 0]), "quaternion: norm is 0"),
        (lambda: rot.rotation_from_quaternion([0, 0, 0, 1.01]), "quaternion: norm is 1.01, need 1 within 0.001"),
        (lambda: rot.rotation_from_quaternion([0, 0, 1]), r"quaternion: need shape \(4,\)"),
        (lambda: rot.rotation_from_quaternion([0, 0, math.nan, 1]), "quaternion: every value must be finite"),
        (lambda: rot.rotation_from_euler_parameters([2, 0, 0, 0]), "euler_parameters: norm is 2"),
        (lambda: rot.euler_parameters_from_rotation(np.eye(3), [0, 0, 0, 0]), "previous: norm is 0"),
        (lambda: rot.log_rotation(2 * np.eye(3)), "R: not a rotation matrix"),
        (lambda: rot.log_rotation(-np.eye(3)), "R: a reflection"),
        (lambda: rot.log_rotation(np.eye(4)), r"R: need shape \(3, 3\)"),
        (lambda: rot.log_rotation(np.full((3, 3), math.nan)), "R: every value must be finite"),
        (lambda: rot.log_rotation("upright"), "R: need an array of numbers"),
        (lambda: rot.exp_rotation([math.inf, 0, 0]), "rotation_vector: every value must be finite"),
    ],
)
def test_bad_input_is_one_line_that_names_the_argument(call, message):
    with pytest.raises(ArgumentError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
