"""Segment: the motion between two timed poses with known twists, cubic in position and in exponential coordinates.

With h the duration and s ∈ [0, 1]: p(s) and φ(s) are the cubic Hermite polynomials that meet position, velocity and
φ(0) = 0, φ(1) = log(R₁ R₀ᵀ), φ̇ = J_l⁻¹(φ) ω at both ends; R(s) = exp(φ(s)) R₀. The error is O(h⁴).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Segment:
    """The motion from (position, rotation, twist) at time 0 to another at `duration` [s]; twists (6,) in the base
    frame.
    """

    def __init__(
        self,
        duration: float,
        start: tuple[Array, Array, Array],
        end: tuple[Array, Array, Array],
    ) -> None:
        self.duration = duration
        position, self._rotation, twist = start
        end_position, end_rotation, end_twist = end
        turn = pin.log3(end_rotation @ self._rotation.T)
        change = np.concatenate((end_position - position, turn))
        rate_0 = duration * twist
        # The left Jacobian of SO(3): Pinocchio's Jexp3 is the right one, J_l(φ) = J_r(−φ).
        rate_1 = duration * np.concatenate((end_twist[:3], np.linalg.solve(pin.Jexp3(-turn), end_twist[3:])))
        origin = np.concatenate((position, np.zeros(3)))
        self._coefficients = (
            origin,
            rate_0,
            3.0 * change - 2.0 * rate_0 - rate_1,
            rate_0 + rate_1 - 2.0 * change,
        )

    def at(self, time: float) -> tuple[Array, Array]:
        """Return (position (3,), rotation (3, 3)) at `time` [s] after the start."""
        s = time / self.duration
        c0, c1, c2, c3 = self._coefficients
        value = c0 + s * (c1 + s * (c2 + s * c3))
        return value[:3], pin.exp3(value[3:]) @ self._rotation
