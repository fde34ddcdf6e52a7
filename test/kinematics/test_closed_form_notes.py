"""The formulas as the notes print them, written out again here, against the closed forms found from the axes (N8)."""

from __future__ import annotations

import math
from itertools import product

import arms
import numpy as np
import pytest
from arms_closed_form import wrist_zyx
from test_closed_form_solutions import configuration, distance

from ik_controller.kinematics.closed_form import recognise
from ik_controller.kinematics.closed_form.base import solutions_of
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.task import Task

A2, A3, D6 = 0.432, 0.433, 0.1
STANFORD_D2, STANFORD_D1, STANFORD_TOOL = 0.0, 0.4, 0.1


def closed_form_solutions(model, pose, axes="xyzrpy"):
    solutions, _ = solutions_of(
        recognise(model), model, Task.create(pose, axes, "base"), pose, model.middle(), (1e-10, 1e-10)
    )
    return solutions


def same_sets(one, other):
    assert len(one) == len(other)
    for solution in one:
        assert min(distance(solution, counterpart) for counterpart in other) < 1e-7


def puma_by_the_notes(pose):
    """000/003 and 002, arm with θ₃ = ± acos, ±r, θ₁; wrist of `arms.puma`, axes x, -y, x at q = 0."""
    p = pose.translation - D6 * pose.rotation[:, 0]
    c3 = (p @ p - A2**2 - A3**2) / (2.0 * A2 * A3)
    for sign3, sign_r in product((1.0, -1.0), (1.0, -1.0)):
        s3 = sign3 * math.sqrt(1.0 - c3**2)
        r = sign_r * math.hypot(p[0], p[1])
        square = A2**2 + A3**2 + 2.0 * A2 * A3 * c3
        c2 = (r * (A2 + A3 * c3) + p[2] * A3 * s3) / square
        s2 = (p[2] * (A2 + A3 * c3) - r * A3 * s3) / square
        theta1 = math.atan2(sign_r * p[1], sign_r * p[0])
        theta2, theta3 = math.atan2(s2, c2), math.atan2(s3, c3)
        c1, s1 = math.cos(theta1), math.sin(theta1)
        c23, s23 = math.cos(theta2 + theta3), math.sin(theta2 + theta3)
        # Forearm frame: x along the forearm, y along axis 1's left, z up from it.
        forearm = np.array([[c1 * c23, -s1, -c1 * s23], [s1 * c23, c1, -s1 * s23], [s23, 0.0, c23]])
        rest = forearm.T @ pose.rotation  # Rx(θ₄) R₋y(θ₅) Rx(θ₆)
        for sign5 in (1.0, -1.0):
            a = sign5 * rest[1:, 0]  # sin θ₅ · (−sin θ₄, cos θ₄)
            theta4 = math.atan2(-a[0], a[1])
            theta5 = sign5 * math.hypot(rest[1, 0], rest[2, 0])
            theta5 = math.atan2(theta5, rest[0, 0])
            b = sign5 * rest[0, 1:]  # (−sin θ₆ … cos θ₆) · −sin θ₅
            theta6 = math.atan2(-b[0], -b[1])
            yield np.array([theta1, theta2, theta3, theta4, theta5, theta6])


def test_puma_as_printed():
    model = RobotModel.from_urdf(arms.puma(A2, A3, 0.0, D6), "tool")
    rng = np.random.default_rng(11)
    for _ in range(100):
        pose = model.forward(configuration(model, rng))
        same_sets(list(puma_by_the_notes(pose)), closed_form_solutions(model, pose))


def test_stanford_as_printed():
    """000/003, example 2: θ₁, θ₂ and their turn by π, θ₃ = √(r² + s²) − a₂; the print measures θ₂ from the horizontal.

    Within the slide's stroke the arm cannot reach back through the shoulder: the notes' 2 × 2 solutions remain.
    """
    model = RobotModel.from_urdf(arms.stanford(STANFORD_D2, STANFORD_D1, STANFORD_TOOL), "tool")
    rng = np.random.default_rng(12)
    for _ in range(100):
        pose = model.forward(configuration(model, rng))
        p = pose.translation - STANFORD_TOOL * pose.rotation[:, 2]
        r, s = math.hypot(p[0], p[1]), p[2] - STANFORD_D1
        theta1, elevation = math.atan2(p[1], p[0]), math.atan2(s, r)
        printed = [
            (theta1, math.pi / 2 - elevation, math.hypot(r, s)),
            (theta1 + math.pi, elevation - math.pi / 2, math.hypot(r, s)),
        ]
        found = [q for q in closed_form_solutions(model, pose) if q[2] > 0.0]
        assert len(found) == 4
        for arm_joints in printed:
            matches = [q for q in found if distance(q[:3], np.array(arm_joints)) < 1e-9]
            assert len(matches) == 2
        assert len(closed_form_solutions(model, pose)) == 8  # with the four that reach backwards


def test_wrist_is_the_zyx_euler_angles():
    model = RobotModel.from_urdf(wrist_zyx(), "tool")
    rng = np.random.default_rng(13)
    for _ in range(100):
        pose = model.forward(configuration(model, rng))
        rotation = pose.rotation
        printed = []
        for sign in (1.0, -1.0):
            cosine = sign * math.hypot(rotation[0, 0], rotation[1, 0])
            printed.append(
                np.array(
                    [
                        math.atan2(sign * rotation[1, 0], sign * rotation[0, 0]),
                        math.atan2(-rotation[2, 0], cosine),
                        math.atan2(sign * rotation[2, 1], sign * rotation[2, 2]),
                    ]
                )
            )
        same_sets(printed, closed_form_solutions(model, pose, "rpy"))


@pytest.mark.parametrize("lengths", [(1.0, 1.0), (1.0, 0.4)])
def test_planar_2r_as_printed(lengths):
    l1, l2 = lengths
    model = RobotModel.from_urdf(arms.planar_2r(l1, l2), "tool")
    rng = np.random.default_rng(14)
    for _ in range(100):
        pose = model.forward(configuration(model, rng))
        x, y = pose.translation[:2]
        printed = []
        for sign in (1.0, -1.0):
            theta2 = sign * math.acos((x * x + y * y - l1 * l1 - l2 * l2) / (2.0 * l1 * l2))
            theta1 = math.atan2(y, x) - math.atan2(l2 * math.sin(theta2), l1 + l2 * math.cos(theta2))
            printed.append(np.array([theta1, theta2]))
        same_sets(printed, closed_form_solutions(model, pose, "xy"))


def test_the_notes_example_has_a_misprint():
    """The notes give θ₂ = 0.7062 for x_d = (0.2, 1.3); it is 1.7062."""
    model = RobotModel.from_urdf(arms.planar_2r(), "tool")
    pose = np.array([0.2, 1.3, 0.0, 0.0, 0.0, 0.0, 1.0])
    solutions = closed_form_solutions(model, Task.create(pose, "xy", "base") and model.forward([0.5650, 1.7062]), "xy")
    assert min(distance(np.array([0.5650, 1.7062]), q) for q in solutions) < 1e-6
    assert np.linalg.norm(model.forward([0.5650, 1.7062]).translation - pose[:3]) < 1e-4
    assert np.linalg.norm(model.forward([0.5650, 0.7062]).translation - pose[:3]) > 0.5
