"""Planar 2R and 3R arms: parallel revolute axes (N8).

2R: the law of cosines gives θ₂ = ± acos((x² + y² − l₁² − l₂²) / 2l₁l₂), and θ₁ the rest. 3R: the tool's angle is
θ₁ + θ₂ + θ₃, so joint 3 lies a known way back from the tool point, and a 2R arm reaches it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.closed_form.base import ClosedForm
from ik_controller.kinematics.closed_form.geometry import Screws, across, angle_about, solve_distance
from ik_controller.kinematics.task import Task

Array = NDArray[np.float64]


def solve_pair(
    screws: Screws, first: int, second: int, x: Array, y: Array, reference: float, free: set[str]
) -> Iterator[tuple[float, float]]:
    """Yield (θ₁, θ₂) of two parallel revolute joints that move the point x (3,) onto y, in the plane across them."""
    axis = screws.axis[first]
    base, elbow = screws.point[first], screws.point[second]
    goal = across(axis, y - base)
    bent = solve_distance(screws.axis[second], across(axis, x - elbow), across(axis, base - elbow), float(goal @ goal))
    for theta2 in bent or ():
        reached = screws.move(second, theta2, x) - base
        theta1 = angle_about(axis, reached, goal)
        if theta1 is None:
            theta1 = reference
            free.add(f"elbow folded: the point lies on the axis of joint {first + 1}, which is free and kept")
        yield theta1, theta2


class _Planar(ClosedForm):
    turns = False

    def require(self, task: Task) -> None:
        axis = self.screws.axis[0]
        in_plane = np.linalg.svd(np.eye(3) - np.outer(axis, axis))[0][:, :2]

        def counted(mask: Array, vector: Array) -> bool:
            inside = mask * (task.axes_frame.T @ vector)
            return bool(np.linalg.norm(inside) > 1.0 - 1e-6)

        missing = not all(counted(task.mask[:3], in_plane[:, i]) for i in range(2))
        if self.turns:
            missing = missing or not counted(task.mask[3:], axis)
        if missing:
            angle = " and the angle about its normal" if self.turns else ""
            raise ArgumentError(f"axes: the closed form for the {self.name} needs the position in its plane{angle}")


class Planar2R(_Planar):
    """Two parallel revolute joints: 2 solutions, elbow up and down."""

    name = "planar 2R arm"
    count = 2

    def candidates(self, target: Any, reference: Array, free: set[str]) -> Iterator[Sequence[float]]:
        yield from solve_pair(
            self.screws, 0, 1, self.screws.home.translation, target.translation, float(reference[0]), free
        )


class Planar3R(_Planar):
    """Three parallel revolute joints, position and angle in the plane: 2 solutions."""

    name = "planar 3R arm"
    count = 2
    turns = True

    def candidates(self, target: Any, reference: Array, free: set[str]) -> Iterator[Sequence[float]]:
        screws, axis = self.screws, self.screws.axis[0]
        moved = target * screws.home.inverse()
        yield from solve_triple(screws, (0, 1, 2), moved.rotation, moved.act(screws.point[2]), axis, reference, free)


def solve_triple(
    screws: Screws,
    joints: tuple[int, int, int],
    rotation: Array,
    third: Array,
    axis: Array,
    reference: Array,
    free: set[str],
) -> Iterator[tuple[float, float, float]]:
    """Yield (θ₁, θ₂, θ₃) of three parallel joints for a rotation about `axis` and the place of the third axis."""
    first, second, last = joints
    beside = across(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    total = angle_about(axis, beside, rotation @ beside)
    if total is None:
        return
    signs = [float(np.sign(axis @ screws.axis[j])) for j in joints]
    pairs = solve_pair(screws, first, second, screws.point[last], third, float(reference[first]), free)
    for theta1, theta2 in pairs:
        yield theta1, theta2, signs[2] * (total - signs[0] * theta1 - signs[1] * theta2)
