"""Segment: the motion between two timed poses with known twists, cubic in position and in exponential coordinates.

With h the duration and s ∈ [0, 1]: p(s) and φ(s) are the cubic Hermite polynomials that meet position, velocity and
φ(0) = 0, φ(1) = log(R₁ R₀ᵀ), φ̇ = J_l⁻¹(φ) ω at both ends; R(s) = exp(φ(s)) R₀. The error is O(h⁴).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import compiled

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
        self._cubic = np.stack((origin, rate_0, 3.0 * change - 2.0 * rate_0 - rate_1, rate_0 + rate_1 - 2.0 * change))

    def references(self, times: Array, dt: float, poses: Array, twists: Array) -> None:
        """Write the poses (k, 4, 3), rotation over position, at `times` (k,) [s], and the twists (k, 6) that lead to
        those dt [s] later, or at the segment's end: the next one starts there with the same twist.
        """
        turns, spans = np.empty((times.size, 2, 3)), np.empty(times.size)
        _follow(self._cubic, self.duration, times, dt, poses, twists, turns, spans)
        for pose, twist, (start, end), span in zip(poses, twists, turns, spans, strict=True):
            rotation = pin.exp3(start) @ self._rotation
            pose[:3] = rotation
            twist[3:] = pin.log3(pin.exp3(end) @ self._rotation @ rotation.T) / span


@compiled
def _follow(
    cubic: Array, duration: float, times: Array, dt: float, poses: Array, twists: Array, turns: Array, spans: Array
) -> None:
    """Write all of the references but rotations: positions, velocities, φ at both ends of each step (k, 2, 3), and how
    long the steps are (k,) [s]; `cubic` (4, 6): coefficients of p and φ.
    """
    for k in range(times.shape[0]):
        spans[k] = min(dt, max(duration - times[k], 1e-9))
        s0, s1 = times[k] / duration, (times[k] + spans[k]) / duration
        start = cubic[0] + s0 * (cubic[1] + s0 * (cubic[2] + s0 * cubic[3]))
        end = cubic[0] + s1 * (cubic[1] + s1 * (cubic[2] + s1 * cubic[3]))
        poses[k, 3], twists[k, :3] = start[:3], (end[:3] - start[:3]) / spans[k]
        turns[k, 0], turns[k, 1] = start[3:], end[3:]
