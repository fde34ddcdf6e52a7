"""JointLimits: the interval of velocities from which every joint can always stop within all its bounds.

The command is a stream of positions q_k, dt apart, with q_{k+1} = q_k + v dt. From (q_k, v_k) a velocity v is accepted
for joint i only if

    |v| ≤ v_max,   |v − v_k| ≤ a_max dt,   q_k + v dt + v²/(2 a_max) ≤ q_max   (and the mirror of it at q_min).

v²/(2a) is the braking distance in continuous time; braking in steps of a·dt needs less, whatever dt, so from an accepted
state the command v − a·dt is accepted too: the interval never becomes empty. Solved for v, the last one is
v ≤ a (√(dt² + 2 (q_max − q_k)/a) − dt). A joint that starts outside its bounds may hold or move inward.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.status import Limit
from ik_controller.kinematics.model import RobotModel

Array = NDArray[np.float64]


class JointLimits:
    """Velocity intervals `low`, `high` (n,) [rad/s or m/s] for the next cycle; call `update` first."""

    def __init__(self, model: RobotModel, velocity_scale: float = 1.0, acceleration_scale: float = 1.0) -> None:
        """Take limits from the model; the scales multiply speed and acceleration."""
        n = model.n
        self.velocity: Array = model.velocity_limit * velocity_scale
        self.acceleration: Array = model.acceleration_limit * acceleration_scale
        self.lower, self.upper = model.lower, model.upper
        # Both sides in one array: the first n rows look up, the last n look down (mirrored).
        self._position = np.concatenate((self.upper, -self.lower))
        self._velocity2 = np.concatenate((self.velocity, self.velocity))
        self._acceleration2 = np.concatenate((self.acceleration, self.acceleration))
        self._two_over_a = 2.0 / self._acceleration2
        self._room = np.empty(2 * n)
        self._brake = np.empty(2 * n)
        self._floor = np.empty(2 * n)
        self._n = n
        self.low = -self.velocity
        self.high = self.velocity.copy()

    def update(self, q: Array, v: Array, dt: float, lower: Array | None = None, upper: Array | None = None) -> None:
        """Set `low` and `high` for the cycle that starts at the commanded q (n,) with velocity v (n,), dt [s] long.

        `lower`, `upper` (n,): narrower position bounds for this cycle; they may move, so braking may overrun them.
        """
        n, room, brake, floor = self._n, self._room, self._brake, self._floor
        position = self._position
        if lower is not None and upper is not None:
            position = np.concatenate((np.fmin(self.upper, upper), -np.fmax(self.lower, lower)))
        room[:n] = q
        np.negative(q, room[n:])
        np.subtract(position, room, room)
        np.fmax(room, 0.0, room)
        # a (√(dt² + 2 room/a) − dt); infinite room stays infinite and velocity takes over.
        np.multiply(room, self._two_over_a, brake)
        np.add(brake, dt * dt, brake)
        np.sqrt(brake, brake)
        np.subtract(brake, dt, brake)
        np.multiply(brake, self._acceleration2, brake)
        # Rounding in the square root may ask for a little more than the room: never step over the bound.
        np.multiply(room, 1.0 / dt, room)
        np.fmin(brake, room, brake)
        np.fmin(brake, self._velocity2, brake)
        # Acceleration comes last: it always holds; the others do as long as they held before (or shrink to it).
        floor[:n] = v
        np.negative(v, floor[n:])
        step = self._acceleration2 * dt
        np.subtract(floor, step, room)
        np.fmax(brake, room, brake)
        np.add(floor, step, room)
        np.fmin(brake, room, brake)
        self.high = brake[:n]
        self.low = -brake[n:]

    def which(self, joint: int, wanted: float, q: Array, v: Array, dt: float) -> Limit:
        """Return which limit of `joint` keeps it from the `wanted` velocity; for the status."""
        up = wanted > 0.5 * (self.high.item(joint) + self.low.item(joint))
        bound = self.high.item(joint) if up else self.low.item(joint)
        if abs(abs(bound - v.item(joint)) - self.acceleration.item(joint) * dt) < 1e-9 * self.acceleration.item(joint):
            return Limit.ACCELERATION
        if abs(abs(bound) - self.velocity.item(joint)) < 1e-9 * self.velocity.item(joint):
            return Limit.VELOCITY
        return Limit.POSITION
