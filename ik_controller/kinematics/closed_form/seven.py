"""Seven joints, shoulder–elbow–wrist, in closed form with the swivel angle (N9; Tolani, Goswami & Badler 2000).

Axes 1-3 meet in the shoulder S, axes 5-7 in the wrist W, joint 4 is the elbow. |W − S| gives θ₄ twice; the elbow may
then turn about the line S-W by the swivel angle φ without moving the hand. Given φ, the shoulder's rotation is known,
and shoulder and wrist are solved as spherical wrists, twice each: 8 solutions for any φ.

φ [rad] is the angle about the line from S to W from the reference direction, base z across that line (base x where the
line is within 1e-6 of vertical), to the elbow E, the point of axis 4 nearest to S; where E lies on the line, to axis 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.closed_form.base import ClosedForm
from ik_controller.kinematics.closed_form.geometry import VANISHING, across, angle_about, cross, solve_distance
from ik_controller.kinematics.closed_form.wrist import solve_wrist

Array = NDArray[np.float64]

IN_LINE = 1e-6  # [m] an elbow nearer to the line from shoulder to wrist is on it


@dataclass(frozen=True)
class Swivel(ClosedForm):
    """Shoulder–elbow–wrist arm: 2 elbow × 2 shoulder × 2 wrist solutions at `swivel`, None: that of the reference."""

    swivel: float | None = None

    name = "7-joint shoulder-elbow-wrist arm"
    count = 8

    @property
    def points(self) -> tuple[Array, Array, Array]:
        """Shoulder, elbow and wrist (3,) at q = 0 [m]."""
        screws = self.screws
        shoulder, wrist = screws.meeting_point(0, 1, 2), screws.meeting_point(4, 5, 6)
        if shoulder is None or wrist is None:
            raise ArgumentError(f"model: not a {self.name}")
        elbow = screws.point[3] + (screws.axis[3] @ (shoulder - screws.point[3])) * screws.axis[3]
        return shoulder, elbow, wrist

    def angle(self, q: Array) -> float:
        """Return the swivel angle [rad] at q (7,); 0 where the wrist lies in the shoulder."""
        shoulder, elbow, wrist = self.points
        for joint in (3, 2, 1, 0):
            wrist = self.screws.move(joint, float(q[joint]), wrist)
            elbow = self.screws.move(joint, float(q[joint]), elbow)
        line = wrist - shoulder
        if float(np.linalg.norm(line)) < VANISHING:
            return 0.0
        turn = np.eye(3)
        for joint in range(4):
            turn = turn @ self.screws.rotation(joint, float(q[joint]))
        side = _side(n_of(line), elbow - shoulder, turn @ self.screws.axis[3])
        return angle_about(n_of(line), _reference(n_of(line)), side) or 0.0

    def candidates(self, target: Any, reference: Array, free: set[str]) -> Iterator[Sequence[float]]:
        screws = self.screws
        shoulder, elbow, wrist = self.points
        moved = target * screws.home.inverse()
        goal = moved.act(wrist) - shoulder
        length = float(np.linalg.norm(goal))
        joint = screws.point[3]
        bent = solve_distance(screws.axis[3], wrist - joint, shoulder - joint, length * length)
        if length < VANISHING:
            free.add("elbow folded: the wrist lies in the shoulder, joints 1 to 3 are free and kept")
        else:
            n = goal / length
            swivel = self.angle(reference) if self.swivel is None else self.swivel
            toward = _frame(n, pin.exp3(n * swivel) @ _reference(n))
        for theta4 in bent or ():
            v = screws.move(3, theta4, wrist) - shoulder
            if length < VANISHING:
                turned = screws.rotation(0, reference[0]) @ screws.rotation(1, reference[1])
                turned = turned @ screws.rotation(2, reference[2])
            else:
                if _in_line(n_of(v), elbow - shoulder):
                    free.add("elbow stretched: shoulder, elbow and wrist in line, joints 3 and 5 can turn together")
                turned = toward @ _frame(n_of(v), _side(n_of(v), elbow - shoulder, screws.axis[3])).T
            rest = (turned @ screws.rotation(3, theta4)).T @ moved.rotation
            for upper in solve_wrist(screws, (0, 1, 2), turned, float(reference[0]), free):
                for lower in solve_wrist(screws, (4, 5, 6), rest, float(reference[4]), free):
                    yield *upper, theta4, *lower


def n_of(v: Array) -> Array:
    """Return v (3,) scaled to length 1."""
    unit: Array = v / math.sqrt(float(v @ v))
    return unit


def _in_line(n: Array, elbow: Array) -> bool:
    return float(np.linalg.norm(cross(elbow, n))) < IN_LINE


def _side(n: Array, elbow: Array, axis: Array) -> Array:
    """Return what the swivel angle points to: the elbow, or axis 4 where the elbow lies on the line."""
    return axis if _in_line(n, elbow) else elbow


def _reference(n: Array) -> Array:
    """Return the direction (3,) from which the swivel angle about the unit vector n counts."""
    up = across(n, np.array([0.0, 0.0, 1.0]))
    return up if float(up @ up) > 1e-12 else across(n, np.array([1.0, 0.0, 0.0]))


def _frame(n: Array, beside: Array) -> Array:
    """Return the rotation (3, 3) with columns n, the direction of `beside` across n, and their cross product."""
    x = n_of(across(n, beside))
    return np.column_stack((n, x, cross(n, x)))
