"""rotation_exp: exp([φ]) R for inner loops, compiled or by Pinocchio."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import HAS_NUMBA, compiled

Array = NDArray[np.float64]


@compiled
def rotation_exp_kernel(vector: Array, rotation: Array, out: Array) -> None:
    """Write exp([φ]) R into the first three rows of `out`, for a rotation vector φ (3,) [rad] in base axes
    (Rodrigues).
    """
    x, y, z = vector[0], vector[1], vector[2]
    angle2 = x * x + y * y + z * z
    angle = math.sqrt(angle2)
    if angle > 1e-4:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    else:
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    for j in range(3):
        u, v, w = rotation[0, j], rotation[1, j], rotation[2, j]
        # exp([φ]) r = r + a φ × r + b φ × (φ × r)
        cx, cy, cz = y * w - z * v, z * u - x * w, x * v - y * u
        out[0, j] = u + a * cx + b * (y * cz - z * cy)
        out[1, j] = v + a * cy + b * (z * cx - x * cz)
        out[2, j] = w + a * cz + b * (x * cy - y * cx)


def rotation_exp_pinocchio(vector: Array, rotation: Array, out: Array) -> None:
    """Write the same as `rotation_exp_kernel`, by Pinocchio."""
    out[:3] = pin.exp3(vector).dot(rotation)


rotation_exp = rotation_exp_kernel if HAS_NUMBA else rotation_exp_pinocchio
