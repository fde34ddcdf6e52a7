"""The basic Jacobian (v, ω) = J₀(q) q̇ three ways, what it says of singularities, and τ = JᵀF (N1, N2, N14; 002, 004).

J₀ is (6, n), v the velocity of the tool point, v and ω in the base frame: column i is (z × (p − pᵢ), z) for a revolute
joint about z through pᵢ, (z, 0) for a prismatic one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ik_controller.kinematics.checks import Array, check_array, check_number
from ik_controller.kinematics.model import RobotModel

TASK_AXES = ("vx", "vy", "vz", "wx", "wy", "wz")


def basic_jacobian(model: RobotModel, q: ArrayLike) -> Array:
    """Return J₀ (6, n) at q (n,) by Pinocchio. Raises ArgumentError if q is of another shape or not finite."""
    return model.jacobian(check_array(q, "q", (model.n,)))


def geometric_jacobian(model: RobotModel, q: ArrayLike) -> Array:
    """Return J₀ (6, n) at q (n,) axis by axis, from the joints' poses alone (002 method 2, 004 p. 33).

    Raises ArgumentError if q is of another shape or not finite.
    """
    values = check_array(q, "q", (model.n,))
    tool = np.asarray(model.forward(values).translation)
    data = model.pin_model.createData()
    pin.forwardKinematics(model.pin_model, data, model.expand(values))
    columns = []
    for joint, pose in zip(model.pin_model.joints[1:], data.oMi[1:], strict=True):
        subspace = joint.createData().S.ravel()  # the joint's axis, linear then angular, in its own frame
        slide, turn = pose.rotation @ subspace[:3], pose.rotation @ subspace[3:]
        columns.append(np.concatenate((slide + np.cross(turn, tool - pose.translation), turn)))
    J: Array = np.column_stack(columns)
    return J if model.expansion is None else J @ model.expansion


def displacement_jacobian(model: RobotModel, q: ArrayLike, step: float = 1e-5) -> Array:
    """Return J₀ (6, n) at q (n,) by moving each joint by ± `step` [rad or m] (002 method 3); error about step².

    Raises ArgumentError if q is of another shape or not finite, or step not positive.
    """
    values = check_array(q, "q", (model.n,))
    h = check_number(step, "step", minimum=0.0, exclusive=True)
    J = np.empty((6, model.n))
    for i in range(model.n):
        moved = values.copy()
        moved[i] += h
        ahead = model.forward(moved)
        moved[i] = values[i] - h
        behind = model.forward(moved)
        J[:3, i] = (ahead.translation - behind.translation) / (2.0 * h)
        J[3:, i] = pin.log3(ahead.rotation @ behind.rotation.T) / (2.0 * h)
    return J


def joint_torques(J: ArrayLike, wrench: ArrayLike) -> Array:
    """Return τ = JᵀF (n,) [N m, N for prismatic joints] that holds a wrench F (m,) = (force, moment) (004 p. 39).

    `J` (m, n), F at the tool point in the base frame. Raises ArgumentError where shapes do not match.
    """
    matrix = check_array(J, "J", (None, None))
    tau: Array = matrix.T @ check_array(wrench, "wrench", (matrix.shape[0],))
    return tau


def manipulability(J: ArrayLike) -> float:
    """Return Yoshikawa's w = √det(J Jᵀ), the product of J's min(m, n) singular values; J (m, n)."""
    return float(np.prod(np.linalg.svd(check_array(J, "J", (None, None)), compute_uv=False)))


@dataclass(frozen=True)
class JacobianAnalysis:
    """What the singular values of a Jacobian (m, n) say of a configuration; `analyse` makes it.

    `singular_values` (min(m, n),) falling; `manipulability` their product; `condition_number` (inf where singular);
    `smallest_singular_value`; `rank`. For every singular value below the tolerance, k of them:
    `lost_directions` (k, m), unit task directions the tool cannot be driven along, and `joint_motions` (k, n), unit
    joint motions that move the tool (almost) nowhere and would have to run away to force it along that direction.
    """

    singular_values: Array
    manipulability: float
    condition_number: float
    smallest_singular_value: float
    rank: int
    lost_directions: Array
    joint_motions: Array

    @property
    def singular(self) -> bool:
        """Whether a singular value is below the tolerance."""
        return len(self.lost_directions) > 0

    def joints(self, share: float = 0.1) -> tuple[int, ...]:
        """Return the indices of the joints that take part in `joint_motions` with at least `share` (0 to 1)."""
        part = np.linalg.norm(self.joint_motions, axis=0)
        return tuple(int(i) for i in np.flatnonzero(part >= share))

    def describe(self, joint_names: Sequence[str], axes: Sequence[str] = TASK_AXES) -> str:
        """Return one line for people: the directions lost and the joints concerned."""
        if not self.singular:
            return f"not singular, smallest singular value {self.smallest_singular_value:.3g}"
        lost = [
            " ".join(f"{part:+.2f} {axis}" for part, axis in zip(direction, axes, strict=False) if abs(part) > 0.05)
            for direction in self.lost_directions
        ]
        names = ", ".join(joint_names[i] for i in self.joints())
        return f"singular: no motion along {'; '.join(lost)} (joints {names})"


def analyse(J: ArrayLike, tolerance: float = 1e-6, length: float = 1.0) -> JacobianAnalysis:
    """Return what the singular values of J (m, n) say (notes N2; Yoshikawa 1985 for the manipulability).

    `tolerance`: singular values at or below it count as lost. `length` [m]: what a radian is worth; the last three rows
    of a J with six are multiplied by it, so that rows compare. With n > m at an exact singularity `joint_motions` may
    hold a share of the arm's own null motion. Raises ArgumentError: J empty or not finite, tolerance < 0, length ≤ 0.
    """
    matrix = check_array(J, "J", (None, None))
    limit = check_number(tolerance, "tolerance", minimum=0.0)
    scale = check_number(length, "length", minimum=0.0, exclusive=True)
    if matrix.shape[0] == 6:
        matrix = matrix * np.array([1.0, 1.0, 1.0, scale, scale, scale])[:, None]
    u, sigma, vt = np.linalg.svd(matrix, full_matrices=False)
    lost = sigma <= limit
    smallest = float(sigma[-1])
    return JacobianAnalysis(
        singular_values=sigma,
        manipulability=float(np.prod(sigma)),
        condition_number=float(sigma[0]) / smallest if smallest > 0.0 else math.inf,
        smallest_singular_value=smallest,
        rank=int(np.count_nonzero(~lost)),
        lost_directions=u.T[lost],
        joint_motions=vt[lost],
    )
