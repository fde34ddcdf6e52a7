"""Spherical wrist: three revolute axes that meet in a point, solved for a rotation (N8).

With R = R(k₁, θ₁) R(k₂, θ₂) R(k₃, θ₃): k₁ᵀ R k₃ = k₁ᵀ R(k₂, θ₂) k₃ gives θ₂ twice; θ₁ turns R(k₂, θ₂) k₃ onto R k₃;
θ₃ is what remains. For axes z, y, x these are the ZYX Euler angles of the notes, for z, y, z the formulas of 002.
Where k₁ and R k₃ are in line, only θ₁ ± θ₃ is given: θ₁ is taken from the reference and the case reported.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.closed_form.geometry import (
    VANISHING,
    Screws,
    across,
    angle_about,
    cross,
    solve_tilt,
)

Array = NDArray[np.float64]


def solve_wrist(
    screws: Screws, joints: tuple[int, int, int], rotation: Array, reference: float, free: set[str]
) -> Iterator[tuple[float, float, float]]:
    """Yield the angles of three joints that compose to `rotation` (3, 3): two sets, or one at a singularity.

    `reference` [rad] is the first joint's angle where the wrist is singular; `free` then gets a sentence.
    """
    first, second, third = joints
    k1, k3 = screws.axis[first], screws.axis[third]
    target = rotation @ k3
    # A vector across k3, to read the last angle from.
    beside = across(k3, np.eye(3)[int(np.argmin(np.abs(k3)))])
    middle = solve_tilt(screws.axis[second], k3, k1, target)
    singular = float(np.linalg.norm(cross(k1, target))) < VANISHING
    if singular:
        middle = middle[:1]  # two solutions fall together
        free.add(f"wrist singularity: joints {first + 1} and {third + 1} turn about one line, joint {first + 1} kept")
    for theta2 in middle:
        turned = screws.rotation(second, theta2)
        theta1 = reference if singular else angle_about(k1, turned @ k3, target)
        if theta1 is None:
            theta1 = reference
        rest = (screws.rotation(first, theta1) @ turned).T @ rotation
        theta3 = angle_about(k3, beside, rest @ beside)
        if theta3 is not None:
            yield theta1, theta2, theta3
