"""JointLimits: the interval of velocities from which every joint can always stop within all its bounds.

The command is a stream of positions q_k, dt apart, with q_{k+1} = q_k + v dt. From (q_k, v_k) a velocity v is accepted
for joint i only if

    |v| ≤ v_max,   |v − v_k| ≤ a_max dt,   q_k + v dt + v²/(2 a_max) ≤ q_max   (and the mirror of it at q_min).

v²/(2a) is the braking distance in continuous time; braking in steps of a·dt needs less, whatever dt, so from an
accepted state the command v − a·dt is accepted too: the interval never becomes empty. Solved for v, the last one is
v ≤ a (√(dt² + 2 (q_max − q_k)/a) − dt). A joint that starts outside its bounds may hold or move inward.

Where the scale on accelerations is lowered while a joint moves towards its bound, the scaled acceleration may no longer
stop it in time: then, and only then, it brakes with as much of the model's own limit as that takes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.kernel import velocity_interval
from ik_controller.control.status import Limit
from ik_controller.kinematics.model import RobotModel

Array = NDArray[np.float64]


class JointLimits:
    """Velocity intervals `low`, `high` (n,) [rad/s or m/s] for the next cycle; call `update` first.

    Both sides stand in one array, upward first, downward negated behind it, so that they are worked out at once.
    """

    def __init__(self, model: RobotModel, velocity_scale: float = 1.0, acceleration_scale: float = 1.0) -> None:
        """Take limits from the model; the scales multiply speed and acceleration."""
        self.velocity: Array = model.velocity_limit * velocity_scale
        self.acceleration: Array = model.acceleration_limit * acceleration_scale
        self.bounds = np.concatenate((model.upper, -model.lower))
        self.velocity_twice = np.concatenate((self.velocity, self.velocity))
        self.acceleration_twice = np.concatenate((self.acceleration, self.acceleration))
        self.reserve = acceleration_scale < 1.0  # does the scale hold back some of the model's own acceleration?
        self._all_acceleration = np.concatenate((model.acceleration_limit, model.acceleration_limit))
        self._any_velocity = np.full(2 * model.n, np.inf)
        self._n = model.n
        self.low = -self.velocity
        self.high = self.velocity.copy()

    def update(self, q: Array, v: Array, dt: float, bounds: Array) -> None:
        """Set `low` and `high` for the cycle that starts at the commanded q (n,) with velocity v (n,), dt [s] long.

        `bounds` (2n,): `self.bounds`, or narrower ones of `bounds_around`.
        """
        reach = velocity_interval(q, v, dt, bounds, self.velocity_twice, self.acceleration_twice)
        self.take(self.stop_in_time(reach, q, v, dt) if self.reserve else reach)

    def stop_in_time(self, reach: Array, q: Array, v: Array, dt: float) -> Array:
        """Return `reach` (2n,) moved to where braking with the reserve still stops within the joints' bounds."""
        latest: Array = velocity_interval(q, v, dt, self.bounds, self._any_velocity, self._all_acceleration)
        opposite = -np.concatenate((latest[self._n :], latest[: self._n]))
        result: Array = np.minimum(np.maximum(reach, opposite), latest)
        return result

    def take(self, reach: Array) -> None:
        """Set `low` and `high` from a result (2n,) of `velocity_interval`."""
        self.high = reach[: self._n]
        self.low = -reach[self._n :]

    def bounds_around(self, q: Array, deviation: float) -> Array:
        """Return bounds (2n,) that also keep within `deviation` of q (n,); they move, so braking may overrun them."""
        result: Array = np.fmin(self.bounds, np.concatenate((q + deviation, deviation - q)))
        return result

    def which(self, joint: int, wanted: float, v: Array, dt: float) -> Limit:
        """Return which limit of `joint` keeps it from the `wanted` velocity; for the status."""
        up = wanted > 0.5 * (self.high.item(joint) + self.low.item(joint))
        bound = self.high.item(joint) if up else self.low.item(joint)
        if abs(abs(bound - v.item(joint)) - self.acceleration.item(joint) * dt) < 1e-9 * self.acceleration.item(joint):
            return Limit.ACCELERATION
        if abs(abs(bound) - self.velocity.item(joint)) < 1e-9 * self.velocity.item(joint):
            return Limit.VELOCITY
        return Limit.POSITION
