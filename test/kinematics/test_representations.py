"""E against finite differences along motions, E⁺E = I, round trips, singularities, misprints of 004 (N3)."""

from __future__ import annotations

import itertools
import math

import arms
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import finite_vectors, rotations

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.representations import POSITIONS, ROTATIONS, pose_representation

ALL = [*POSITIONS.values(), *ROTATIONS.values()]
PAIRS = list(itertools.product(POSITIONS, ROTATIONS))
MODEL = RobotModel.from_urdf(arms.skewed_7(), "tool")


def part_strategy(representation):
    return finite_vectors(3) if representation.kind == "position" else rotations()


def moved(representation, part, velocity, h):
    """The position or rotation after moving for h at (linear or angular) velocity, in base axes."""
    return part + h * velocity if representation.kind == "position" else pin.exp3(h * velocity) @ part


@pytest.mark.parametrize("representation", ALL, ids=lambda r: r.name)
@given(data=st.data())
def test_round_trip(representation, data):
    part = data.draw(part_strategy(representation))
    x = representation.coordinates(part)
    assert x.shape == (representation.size,)
    np.testing.assert_allclose(representation.part(x), part, atol=1e-11)


@pytest.mark.parametrize("representation", ALL, ids=lambda r: r.name)
@given(data=st.data())
def test_E_is_the_derivative_of_x_and_E_inverse_its_left_inverse(representation, data):
    part = data.draw(part_strategy(representation))
    velocity = data.draw(finite_vectors(3, 1.0))
    x = representation.coordinates(part)
    # E and the third derivative of x grow as 1/measure and its cube: keep the differences' error below 1e-6.
    assume(representation.singularity(x).measure > 0.1)
    h = 1e-5
    ahead = representation.coordinates(moved(representation, part, velocity, h), x)
    behind = representation.coordinates(moved(representation, part, velocity, -h), x)
    E = representation.E(x)
    np.testing.assert_allclose(E @ velocity, representation.difference(ahead, behind) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(representation.E_inverse(x) @ E, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(("position", "rotation"), PAIRS)
def test_J_is_the_derivative_of_x_along_motions_of_an_arm(position, rotation):
    representation = pose_representation(position, rotation)
    rng = np.random.default_rng(7)
    checked = 0
    while checked < 10:
        q, dq = rng.uniform(MODEL.lower, MODEL.upper), rng.uniform(-1, 1, MODEL.n)
        x = representation.coordinates(MODEL.forward(q))
        if representation.singularity(x).measure < 0.2:
            continue
        h = 1e-5
        ahead = representation.coordinates(MODEL.forward(q + h * dq), x)
        behind = representation.coordinates(MODEL.forward(q - h * dq), x)
        xdot = representation.difference(ahead, behind) / (2 * h)
        np.testing.assert_allclose(representation.jacobian(MODEL, q, x) @ dq, xdot, atol=1e-6)
        np.testing.assert_allclose(representation.E_inverse(x) @ xdot, MODEL.jacobian(q) @ dq, atol=1e-6)
        pose = representation.pose(x)
        np.testing.assert_allclose(pose.homogeneous, MODEL.forward(q).homogeneous, atol=1e-12)
        checked += 1


def test_direction_cosines_have_half_their_transpose_as_left_inverse():
    representation = ROTATIONS["direction_cosines"]
    E = representation.E(representation.coordinates(pin.exp3(np.array([0.3, -1.0, 2.0]))))
    np.testing.assert_allclose(E.T @ E, 2 * np.eye(3), atol=1e-14)  # 004 p. 69


def test_zxz_is_the_printed_E_of_004_p27():
    a, b, g = 0.7, 1.1, -0.4
    sa, ca, sb, cb = math.sin(a), math.cos(a), math.sin(b), math.cos(b)
    printed = np.array([[-sa * cb / sb, ca * cb / sb, 1], [ca, sa, 0], [sa / sb, -ca / sb, 0]])
    np.testing.assert_allclose(ROTATIONS["euler_zxz"].E([a, b, g]), printed, atol=1e-15)
    inverse = np.array([[0, ca, sa * sb], [0, sa, -ca * sb], [1, 0, cb]])  # p. 76, ψ, θ there
    np.testing.assert_allclose(ROTATIONS["euler_zxz"].E_inverse([a, b, g]), inverse, atol=1e-15)


def test_the_misprints_of_004_are_misprints():
    rho, t, p = 1.3, 0.7, 0.9
    s, c, sp, cp = math.sin(t), math.cos(t), math.sin(p), math.cos(p)
    printed_65 = np.array([[c, -rho * s, 0], [-s, rho * c, 0], [0, 0, 1]])
    printed_67 = np.array(
        [[c * sp, rho * s * sp, rho * c * cp], [-s * sp, rho * c * sp, rho * s * cp], [cp, 0, -rho * sp]]
    )
    printed_66 = np.array(
        [[c * sp, s * sp, c], [-s / (rho * sp), c / (rho * sp), 0], [c * cp / rho, s * cp / rho, -sp / rho]]
    )
    cylindrical, spherical = POSITIONS["cylindrical"], POSITIONS["spherical"]
    x, y = np.array([rho, t, 0.2]), np.array([rho, t, p])
    wrong = printed_65 != pytest.approx(cylindrical.E_inverse(x), abs=1e-12)
    assert wrong
    assert np.argwhere(~np.isclose(printed_65, cylindrical.E_inverse(x))).tolist() == [[1, 0]]
    assert np.argwhere(~np.isclose(printed_67, spherical.E_inverse(y))).tolist() == [[0, 1], [1, 0]]
    assert np.argwhere(~np.isclose(printed_66, spherical.E(y))).tolist() == [[0, 2]]


@pytest.mark.parametrize(
    ("representation", "x", "condition"),
    [
        (POSITIONS["cylindrical"], [0, 1, 2], "rho = 0"),
        (POSITIONS["spherical"], [0, 1, 2], "rho sin"),
        (POSITIONS["spherical"], [1, 1, math.pi], "rho sin"),
        (ROTATIONS["euler_zyx"], [1, math.pi / 2, 2], "beta = ±pi/2"),
        (ROTATIONS["fixed_xyz"], [1, -math.pi / 2, 2], "beta = ±pi/2"),
        (ROTATIONS["euler_zxz"], [1, 0, 2], "beta = 0 or pi"),
    ],
)
def test_a_singularity_is_reported_and_not_divided_by(representation, x, condition):
    report = representation.singularity(x)
    assert report.singular
    assert report.measure < 1e-12
    assert condition in report.condition
    with np.errstate(all="raise"), pytest.raises(ArgumentError, match="singular at"):
        representation.E(x)
    assert np.isfinite(representation.E_inverse(x)).all()
    assert np.linalg.matrix_rank(representation.E_inverse(x), tol=1e-9) < 3
    # The coordinates of what x stands for are finite and stand for it too, even here.
    again = representation.coordinates(representation.part(x))
    np.testing.assert_allclose(representation.part(again), representation.part(x), atol=1e-12)


@pytest.mark.parametrize("name", ["direction_cosines", "euler_parameters"])
@given(R=rotations())
def test_redundant_representations_have_no_singularity(name, R):
    x = ROTATIONS[name].coordinates(R)
    report = ROTATIONS[name].singularity(x)
    assert (report.singular, report.measure, report.condition) == (False, math.inf, "")
    assert np.linalg.svd(ROTATIONS[name].E(x), compute_uv=False).min() > 0.4


def test_the_nearer_singularity_of_a_pair_is_reported():
    pair = pose_representation("cylindrical", "euler_zyx")
    assert "rho" in pair.singularity([1e-8, 0, 0, 0, 0.5, 0]).condition
    assert "beta" in pair.singularity([1.0, 0, 0, 0, math.pi / 2, 0]).condition


def test_differences_of_angles_go_the_short_way():
    zyx = ROTATIONS["euler_zyx"]
    np.testing.assert_allclose(
        zyx.difference([3.1, 0, -3.1], [-3.1, 0, 3.1]), [6.2 - 2 * math.pi, 0, 2 * math.pi - 6.2]
    )
    assert zyx.difference([1e-20, 0, 0], [0, 0, 0])[0] == 1e-20
    cylindrical = POSITIONS["cylindrical"]
    np.testing.assert_allclose(cylindrical.difference([7, 3, 7], [0, -3, 0]), [7, 6 - 2 * math.pi, 7])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: pose_representation("polar"), "position representation 'polar' is unknown; legal: cartesian, cyl"),
        (lambda: pose_representation(rotation="rpy"), "rotation representation 'rpy' is unknown; legal: direction_cos"),
        (lambda: ROTATIONS["euler_parameters"].E([1, 1, 0, 0]), r"x \(euler_parameters\): norm is 1.41"),
        (lambda: ROTATIONS["direction_cosines"].E(np.ones(9)), r"x \(direction_cosines\): not a rotation"),
        (lambda: ROTATIONS["euler_zyx"].E([0, 0]), r"x \(euler_zyx\): need shape \(3,\), got \(2,\)"),
        (lambda: POSITIONS["spherical"].coordinates([0, math.nan, 0]), "position: every value must be finite"),
        (lambda: ROTATIONS["euler_zyx"].coordinates(np.ones((3, 3))), "rotation: not a rotation matrix"),
        (lambda: ROTATIONS["euler_zyx"].singularity([0, 0, 0], -1), "tolerance: need a value ≥ 0"),
        (lambda: pose_representation().E(np.zeros(7)), r"x: need shape \(6,\), got \(7,\)"),
        (lambda: pose_representation().jacobian(MODEL, [0.0]), r"q: need shape \(7,\), got \(1,\)"),
    ],
)
def test_bad_input_is_one_line_that_names_the_argument(call, message):
    with pytest.raises(ArgumentError, match=message):
        call()
