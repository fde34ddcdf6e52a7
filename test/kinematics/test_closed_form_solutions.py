"""Closed forms over random poses: every solution maps back, the generating one is there, none is missing (N8, N9)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from arms_closed_form import CLOSED_FORMS

from ik_controller.kinematics.closed_form import recognise
from ik_controller.kinematics.closed_form.base import solutions_of
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.solve import solve_ik
from ik_controller.kinematics.task import Task

TOLERANCE = 1e-10
ALL = pytest.mark.parametrize("name", CLOSED_FORMS)


def arm(name):
    urdf, axes, _ = CLOSED_FORMS[name]
    model = RobotModel.from_urdf(urdf, "tool")
    return model, recognise(model), axes


def distance(one, other):
    """Return the largest joint difference, whole turns not counted."""
    return float(np.abs((one - other + math.pi) % (2.0 * math.pi) - math.pi).max())


def configuration(model, rng):
    return rng.uniform(np.maximum(model.lower, -math.pi), np.minimum(model.upper, math.pi))


def solve_all(model, form, axes, q):
    """Return all solutions for the pose at q, with q as reference, and the sentences on free joints."""
    pose = model.forward(q)
    if model.n == 7:
        form = replace(form, swivel=form.angle(q))
    task = Task.create(pose, axes, "base")
    solutions, free = solutions_of(form, model, task, pose, q, (TOLERANCE, TOLERANCE))
    for solution in solutions:
        back = model.forward(solution)
        assert max(task.pose_error(back.rotation, back.translation)) < TOLERANCE
        if model.n == 7:
            turn = form.angle(solution) - form.swivel
            assert abs(math.remainder(turn, 2.0 * math.pi)) < 1e-6
    return solutions, free


def within_reach(model, form, q):
    """Return the number of solutions by reach alone: which of the two θ₁ lets the remaining arm reach its point.

    An independent count for the arms with offsets, where the number changes over the workspace: by the triangle
    inequality in the plane of joints 2 and 3, not by solving.
    """
    screws = form.screws
    pose = model.forward(q) * screws.home.inverse()
    h, base = screws.axis[1], screws.point[1]
    point = screws.meeting_point(3, 4, 5) if "PUMA" in form.name else screws.meeting_point(4, 5)
    p = pose.act(point)
    # θ₁: h · (e^{-S₁θ₁} p − point) is a cos θ₁ + b sin θ₁ + c by three samples, and quadratic in t = tan θ₁/2.
    at_0, at_half_pi, at_pi = (h @ (screws.move(0, -t, p) - point) for t in (0.0, math.pi / 2, math.pi))
    c = 0.5 * (at_0 + at_pi)
    a, b = at_0 - c, at_half_pi - c
    count = 0
    for root in np.roots([c - a, 2.0 * b, c + a]):
        if abs(root.imag) > 0.0:
            continue
        theta1 = 2.0 * math.atan(root.real)
        y = screws.move(0, -theta1, p)
        flat = np.eye(3) - np.outer(h, h)
        if "PUMA" in form.name:
            targets = [y, y]  # two wrists each
            last = point
        else:
            rotation = screws.rotation(0, theta1).T @ pose.rotation
            cosine = np.clip(h @ rotation @ screws.axis[5], -1.0, 1.0)
            targets, last = [], screws.point[3]
            for theta5 in (math.acos(cosine), -math.acos(cosine)):
                # h · R(k₅, θ₅) k₆ = cos θ₅ for this arm: k₆ = h at zero, k₅ across it
                tilted = screws.rotation(4, theta5).T @ h
                theta6 = math.atan2(
                    screws.axis[5] @ np.cross(rotation.T @ h, tilted), (rotation.T @ h) @ (flat @ tilted)
                )
                turn = rotation @ (screws.rotation(4, theta5) @ screws.rotation(5, theta6)).T
                targets.append(y - turn @ (point - screws.point[3]))
        upper = np.linalg.norm(flat @ (screws.point[2] - base))
        fore = np.linalg.norm(flat @ (last - screws.point[2]))
        for target in targets:
            if abs(upper - fore) < np.linalg.norm(flat @ (target - base)) < upper + fore:
                count += 2
    return count


def check_random(name, poses, seed):
    model, form, axes = arm(name)
    assert form is not None
    assert form.name == CLOSED_FORMS[name][2]
    rng = np.random.default_rng(seed)
    for _ in range(poses):
        q = configuration(model, rng)
        solutions, free = solve_all(model, form, axes, q)
        assert not free
        assert min(distance(q, solution) for solution in solutions) < 1e-6, q
        for k, one in enumerate(solutions):
            assert all(distance(one, other) > 1e-6 for other in solutions[:k])
        expected = within_reach(model, form, q) if name in ("puma_560", "ur5e") else form.count
        if name == "seven_offset" and len(solutions) != form.count:
            # with an elbow offset the elbow bends the other way only for a wrist near enough to the shoulder
            expected = form.count // 2
        assert len(solutions) == expected, q


@ALL
def test_random_poses(name):
    check_random(name, 60, seed=1)


@pytest.mark.soak
@ALL
def test_ten_thousand_random_poses(name):
    check_random(name, 10_000, seed=2)


@ALL
def test_no_root_that_iteration_finds_is_missing(name):
    """Completeness by brute force: Newton's roots from random starts are all in the closed form's set."""
    model, form, axes = arm(name)
    if model.n == 7:
        pytest.skip("infinitely many solutions: the set for a swivel angle is compared below")
    rng = np.random.default_rng(3)
    for _ in range(3):
        q = configuration(model, rng)
        solutions, _ = solve_all(model, form, axes, q)
        found = solve_ik(
            model, model.forward(q), q, axes=axes, restarts=60, all_solutions=True, respect_limits=False,
            position_tolerance=1e-9, orientation_tolerance=1e-9,
        )  # fmt: skip
        assert len(found.solutions) > len(solutions) / 2
        for root in found.solutions:
            assert min(distance(root, solution) for solution in solutions) < 1e-5


@pytest.mark.parametrize("name", ["seven", "seven_offset"])
def test_seven_joints_any_root_is_found_at_its_swivel_angle(name):
    model, form, axes = arm(name)
    rng = np.random.default_rng(4)
    pose = model.forward(configuration(model, rng))
    for _ in range(30):
        root = solve_ik(model, pose, rng.uniform(-3.0, 3.0, 7), respect_limits=False, position_tolerance=1e-10,
                        orientation_tolerance=1e-10)  # fmt: skip
        solutions, _ = solve_all(model, form, axes, root.q)
        assert min(distance(root.q, solution) for solution in solutions) < 1e-6


@pytest.mark.parametrize("name", ["seven", "seven_offset"])
def test_any_swivel_angle_gives_the_same_hand_pose(name):
    model, form, _ = arm(name)
    q = np.array([0.3, 0.7, -0.4, 1.1, 0.5, -0.8, 0.2])
    pose = model.forward(q)
    elbows = []
    for swivel in np.linspace(-3.0, 3.0, 13):
        solution = solve_ik(model, pose, q, "analytic", swivel=float(swivel), respect_limits=False, all_solutions=True)
        assert len(solution.solutions) == 8
        for one in solution.solutions:
            assert np.linalg.norm(pin.log6(model.forward(one).actInv(pose)).vector) < TOLERANCE
            assert abs(math.remainder(form.angle(one) - swivel, 2.0 * math.pi)) < 1e-9
        elbow = form.screws.point[3]
        for joint in (2, 1, 0):
            elbow = form.screws.move(joint, solution.q[joint], elbow)
        elbows.append(elbow)
    assert np.ptp(np.array(elbows), axis=0).max() > 0.1  # the elbow did move
