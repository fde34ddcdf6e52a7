"""The arm as screw axes, and the few equations that every closed form here is made of (N8).

A pose is T(q) = e^{S₁q₁} ⋯ e^{Sₙqₙ} M (000/003), with the axes and M taken at q = 0 in the base frame. So nothing
depends on how a URDF or a DH table places its frames; the notes' formulas are the special case of their figures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.kinematics.chain import chain_of
from ik_controller.kinematics.model import RobotModel

Array = NDArray[np.float64]

# Axes that deviate from parallel [rad] or from meeting [m] by less count as doing so; the final Newton step
# makes up for it.
ALIGNED = 1e-5
# Below this, a projection has no direction left: the angle that would be read from it is free.
VANISHING = 1e-9
# A cosine this near to ±1 is on the boundary: the angle, known to √ε only, is taken as exactly 0 or π.
BOUNDARY = 1e-14
# How far beyond ±1 a cosine may be (a pose on the boundary, or out of reach by less than a tolerance).
OVERSHOOT = 1e-5


@dataclass(frozen=True)
class Screws:
    """Joint axes at q = 0 in the base frame: `axis` (n, 3), `point` (n, 3) on it [m], `prismatic` (n,); `home` is M."""

    axis: Array
    point: Array
    prismatic: NDArray[np.bool_]
    home: Any

    @property
    def n(self) -> int:
        """The number of joints."""
        return len(self.axis)

    @classmethod
    def of(cls, model: RobotModel) -> Screws | None:
        """Return the model's screws, or None where joints mimic others, which no closed form here covers."""
        if model.expansion is not None:
            return None
        chain = chain_of(model)
        rotation, position = np.eye(3), np.zeros(3)
        axis, point = np.empty((model.n, 3)), np.empty((model.n, 3))
        for k in range(model.n):
            position = position + rotation @ chain.translation[k]
            rotation = rotation @ chain.rotation[k]
            axis[k], point[k] = rotation[:, 2], position
        home = pin.SE3(rotation @ chain.rotation[-1], position + rotation @ chain.translation[-1])
        return cls(axis, point, model.prismatic, home)

    def rotation(self, joint: int, angle: float) -> Array:
        """Return the rotation (3, 3) of a joint by an angle [rad]."""
        turned: Array = pin.exp3(self.axis[joint] * angle)
        return turned

    def move(self, joint: int, value: float, x: Array) -> Array:
        """Return the point x (3,) moved by a joint's value [rad or m]."""
        if self.prismatic[joint]:
            slid: Array = x + value * self.axis[joint]
            return slid
        moved: Array = self.point[joint] + self.rotation(joint, value) @ (x - self.point[joint])
        return moved

    def parallel(self, *joints: int) -> bool:
        """Return whether the axes of all these joints are parallel or opposite."""
        first = self.axis[joints[0]]
        return all(float(np.linalg.norm(cross(first, self.axis[j]))) < ALIGNED for j in joints[1:])

    def coincide(self, one: int, other: int) -> bool:
        """Return whether two joints turn about the same line."""
        off = self.point[other] - self.point[one]
        return self.parallel(one, other) and float(np.linalg.norm(cross(self.axis[one], off))) < ALIGNED

    def meeting_point(self, *joints: int) -> Array | None:
        """Return the one point (3,) where these axes meet, or None where they do not or are all parallel."""
        projectors = [np.eye(3) - np.outer(self.axis[j], self.axis[j]) for j in joints]
        total = np.sum(projectors, axis=0)
        if np.linalg.eigvalsh(total)[0] < 1e-6:
            return None
        meeting: Array = np.linalg.solve(
            total, np.sum([p @ self.point[j] for p, j in zip(projectors, joints, strict=True)], axis=0)
        )
        off = max(float(np.linalg.norm(p @ (meeting - self.point[j]))) for p, j in zip(projectors, joints, strict=True))
        return meeting if off < ALIGNED else None


def cross(a: Array, b: Array) -> Array:
    """Return a × b; numpy's own takes ten times as long for two vectors."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def across(axis: Array, x: Array) -> Array:
    """Return the part of x (3,) across a unit axis."""
    part: Array = x - (axis @ x) * axis
    return part


def angle_about(axis: Array, a: Array, b: Array) -> float | None:
    """Return the angle [rad] about a unit axis that turns a's projection onto b's, or None where one vanishes."""
    a, b = across(axis, a), across(axis, b)
    if min(float(a @ a), float(b @ b)) < VANISHING**2:
        return None
    return math.atan2(float(axis @ cross(a, b)), float(a @ b))


def solve_circle(a: float, b: float, c: float) -> tuple[float, ...] | None:
    """Return the angles θ with a cos θ + b sin θ = c: two, one on the boundary, none; None where any θ does.

    θ = atan2(b, a) ± acos(c/ρ), ρ = √(a² + b²), the ± √(1 − cos²) of the notes.
    """
    rho = math.hypot(a, b)
    if rho < VANISHING:
        return None if abs(c) < OVERSHOOT else ()
    ratio = c / rho
    if abs(ratio) > 1.0 + OVERSHOOT:
        return ()
    middle = math.atan2(b, a)
    if abs(ratio) >= 1.0 - BOUNDARY:
        return (middle if ratio > 0.0 else middle + math.pi,)
    half = math.acos(ratio)
    return middle + half, middle - half


def solve_projection(axis: Array, v: Array, h: Array, c: float) -> tuple[float, ...] | None:
    """Return the angles θ with h · R(axis, θ) v = c, as `solve_circle`."""
    return solve_circle(float(h @ across(axis, v)), float(h @ cross(axis, v)), c - float(h @ axis) * float(axis @ v))


def solve_tilt(axis: Array, v: Array, h: Array, target: Array) -> tuple[float, ...]:
    """Return the angles θ for which R(axis, θ) v makes the same angle with h as `target` does, all unit vectors.

    Where v and h lie across the axis, sine and cosine of that angle are both at hand, and θ is exact to the boundary.
    """
    cosine = float(h @ target)
    if abs(float(axis @ v)) > ALIGNED or abs(float(axis @ h)) > ALIGNED:
        return solve_projection(axis, v, h, cosine) or ()
    middle, half = angle_about(axis, v, h) or 0.0, math.atan2(float(np.linalg.norm(cross(h, target))), cosine)
    return middle + half, middle - half


def solve_distance(axis: Array, v: Array, b: Array, d2: float) -> tuple[float, ...] | None:
    """Return the angles θ with |R(axis, θ) v − b|² = d2, as `solve_circle`: the law of cosines."""
    return solve_projection(axis, v, b, 0.5 * (float(v @ v) + float(b @ b) - d2))


def wrap(angle: float) -> float:
    """Return the angle in (−π, π]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)
