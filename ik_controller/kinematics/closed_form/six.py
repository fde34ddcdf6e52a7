"""Arms of six joints: PUMA type 6R, Stanford type RRPRRR, three parallel axes (UR type) (N8).

All begin alike. Joints 2 … keep the wrist point W in a plane across the axis h of joint 2, so h · e^{−S₁θ₁} p_W is
known and gives θ₁ twice: for the arm of the notes, θ₁ = atan2(p_Wy, p_Wx) and that + π. Where p_Wx = p_Wy = 0, any θ₁
does: it is taken from the reference and reported.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.errors import ArgumentError, choices
from ik_controller.kinematics.closed_form.base import ClosedForm
from ik_controller.kinematics.closed_form.geometry import (
    OVERSHOOT,
    Screws,
    angle_about,
    solve_projection,
    solve_tilt,
)
from ik_controller.kinematics.closed_form.planar import solve_pair, solve_triple
from ik_controller.kinematics.closed_form.wrist import solve_wrist

Array = NDArray[np.float64]


def solve_first(screws: Screws, wrist: Array, p: Array, reference: float, free: set[str]) -> tuple[float, ...]:
    """Return θ₁ with h · e^{−S₁θ₁} p = h · wrist, h the axis of joint 2: what joints 2 … cannot change."""
    h, base = screws.axis[1], screws.point[0]
    # h · R(k, −θ) u is h · R(−k, θ) u
    angles = solve_projection(-screws.axis[0], p - base, h, float(h @ (wrist - base)))
    if angles is None:
        free.add("shoulder singularity: the wrist point lies on the axis of joint 1, which is free and kept")
        return (reference,)
    return angles


def meeting(screws: Screws, *joints: int) -> Array:
    """Return the point (3,) where axes meet. Raises ArgumentError where they do not: the arm is not of this form."""
    point = screws.meeting_point(*joints)
    if point is None:
        raise ArgumentError(f"model: axes {choices(str(joint + 1) for joint in joints)} do not meet")
    return point


class _WithWrist(ClosedForm):
    """An arm of three joints that carries a spherical wrist."""

    def candidates(self, target: Any, reference: Array, free: set[str]) -> Iterator[Sequence[float]]:
        screws = self.screws
        wrist = meeting(screws, 3, 4, 5)
        moved = target * screws.home.inverse()
        p = moved.act(wrist)
        for theta1 in solve_first(screws, wrist, p, float(reference[0]), free):
            y = screws.move(0, -theta1, p)
            for theta2, q3 in self.reach(wrist, y, reference, free):
                turned = screws.rotation(0, theta1) @ screws.rotation(1, theta2)
                if not screws.prismatic[2]:
                    turned = turned @ screws.rotation(2, q3)
                for last in solve_wrist(screws, (3, 4, 5), turned.T @ moved.rotation, float(reference[3]), free):
                    yield theta1, theta2, q3, *last

    def reach(self, wrist: Array, y: Array, reference: Array, free: set[str]) -> Iterator[tuple[float, float]]:
        """Yield joints 2 and 3 that bring the wrist point to y (3,), joint 1 taken out."""
        raise NotImplementedError


class Puma(_WithWrist):
    """PUMA type: axis 2 parallel to axis 3, spherical wrist; 4 arm × 2 wrist. Shoulder and elbow offsets as they are.

    θ₃ from the distance |W − joint 2| (c₃ = (p² − a₂² − a₃²) / 2a₂a₃ in the notes), then θ₂.
    """

    name = "PUMA type 6R arm"
    count = 8

    def reach(self, wrist: Array, y: Array, reference: Array, free: set[str]) -> Iterator[tuple[float, float]]:
        yield from solve_pair(self.screws, 1, 2, wrist, y, float(reference[1]), free)


class Stanford(_WithWrist):
    """Stanford type: joint 3 slides across axis 2, spherical wrist; 2 arm × 2 wrist, twice that if the arm could reach
    backwards through its shoulder.

    |W + q₃ d − joint 2|² is known: (θ₃ + a₂)² = r² + s² in the notes, which take the positive root.
    """

    name = "Stanford type RRPRRR arm"
    count = 8

    def reach(self, wrist: Array, y: Array, reference: Array, free: set[str]) -> Iterator[tuple[float, float]]:
        screws, h, d = self.screws, self.screws.axis[1], self.screws.axis[2]
        base = screws.point[1]
        start, goal = wrist - base, y - base
        # h · start = h · goal already, so distances in space may be compared: q² + 2q d·start + |start|² − |goal|² = 0
        half = float(d @ start)
        square = half * half - float(start @ start) + float(goal @ goal)
        if square < -OVERSHOOT * float(goal @ goal):
            return
        root = math.sqrt(max(square, 0.0))
        for q3 in (root - half, -root - half):
            theta2 = angle_about(h, start + q3 * d, goal)
            if theta2 is None:
                theta2 = float(reference[1])
                free.add("shoulder singularity: the wrist point lies on the axis of joint 2, which is free and kept")
            yield theta2, q3


class ThreeParallel(ClosedForm):
    """Axes 2, 3 and 4 parallel, axes 5 and 6 meeting, as in Universal Robots' arms: 8 solutions.

    θ₁ as above for the point W where axes 5 and 6 meet; h · R₁ᵀ R k₆ = h · R₅ k₆ gives θ₅ twice; θ₆ turns what is left
    of h; joints 2, 3 and 4 are then a planar 3R arm.
    """

    name = "6R arm with three parallel axes (UR type)"
    count = 8

    def candidates(self, target: Any, reference: Array, free: set[str]) -> Iterator[Sequence[float]]:
        screws = self.screws
        h, k5, k6 = screws.axis[1], screws.axis[4], screws.axis[5]
        wrist = meeting(screws, 4, 5)
        moved = target * screws.home.inverse()
        p = moved.act(wrist)
        for theta1 in solve_first(screws, wrist, p, float(reference[0]), free):
            rotation = screws.rotation(0, theta1).T @ moved.rotation
            for theta5 in solve_tilt(k5, k6, h, rotation @ k6):
                turn5 = screws.rotation(4, theta5)
                # R₂₃₄ leaves h as it is: hᵀ rotation = hᵀ R₅ R₆
                theta6 = angle_about(k6, rotation.T @ h, turn5.T @ h)
                if theta6 is None:
                    theta6 = float(reference[5])
                    free.add("wrist singularity: axis 6 is parallel to axes 2, 3 and 4, joint 6 is free and kept")
                turn = rotation @ (turn5 @ screws.rotation(5, theta6)).T
                # Where joints 2, 3 and 4 must carry the axis of joint 4: W less the way from there.
                y = screws.move(0, -theta1, p)
                third = y - turn @ (wrist - screws.point[3])
                for theta2, theta3, theta4 in solve_triple(screws, (1, 2, 3), turn, third, h, reference, free):
                    yield theta1, theta2, theta3, theta4, theta5, theta6
