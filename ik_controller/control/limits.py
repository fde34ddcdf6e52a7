"""JointLimits: the interval of velocities from which every joint can always stop within all its bounds.

The command is a stream of positions q_k, dt apart, with q_{k+1} = q_k + v dt. From (q_k, v_k) a velocity v is accepted
for joint i only if

    |v| ≤ v_max,   |v − v_k| ≤ a_max dt,   q_k + v dt + v²/(2 a_max) ≤ q_max   (and the mirror of it at q_min).

v²/(2a) is the braking distance in continuous time; braking in steps of a·dt needs less, whatever dt, so from an
accepted state the command v − a·dt is accepted too: the interval never becomes empty. Solved for v, the last one is
v ≤ a (√(dt² + 2 (q_max − q_k)/a) − dt). A joint that starts outside its bounds may hold or move inward.

A joint with a jerk limit has its own exact form of all this, in `interval`.

Where the scale on accelerations or jerks is lowered while a joint moves towards its bound, the scaled limit may no
longer stop it in time: then, and only then, it brakes with as much of the model's own limit as that takes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.interval import stop_together
from ik_controller.control.kernel import held_by
from ik_controller.control.reach import BOUNDS, JOINT_BOUNDS, VELOCITY, velocity_interval
from ik_controller.control.status import LIMITS, Limit
from ik_controller.kinematics.model import RobotModel

Array = NDArray[np.float64]

# A joint beyond its bound by more than this share of it (or of 1) is outside: it comes back at this share of its speed.
_OUTSIDE = 1e-9
_RETURN_SPEED = 0.1


class JointLimits:
    """Velocity intervals `low`, `high` (n,) [rad/s or m/s] for the next cycle; call `update` first.

    Both sides stand in one array, upward first, downward negated behind it, so that they are worked out at once.
    """

    def __init__(
        self,
        model: RobotModel,
        velocity_scale: float = 1.0,
        acceleration_scale: float = 1.0,
        jerk_scale: float = 1.0,
    ) -> None:
        """Take limits from the model; the scales multiply speed, acceleration and jerk."""
        self.velocity: Array = model.velocity_limit * velocity_scale
        self.acceleration: Array = model.acceleration_limit * acceleration_scale
        self.jerk: Array = model.jerk_limit * jerk_scale
        self.jerky = bool(np.isfinite(self.jerk).any())
        own = np.concatenate((model.upper, -model.lower))
        # Rows as `kernel` numbers them.
        rows = [
            own,
            np.tile(self.velocity, 2),
            np.tile(self.acceleration, 2),
            own,
            np.tile(model.acceleration_limit, 2),
            np.concatenate((self.jerk, model.jerk_limit)),
            np.concatenate((np.zeros(model.n), model.velocity_limit)),
        ]
        self.table = np.vstack(rows)
        # Do the scales hold back some of the model's own acceleration or jerk?
        self.reserve = acceleration_scale < 1.0 or (self.jerky and jerk_scale < 1.0)
        self._outside_by = _OUTSIDE * np.fmax(np.abs(own), 1.0)
        self._n = model.n
        self._reach = np.concatenate((self.velocity, self.velocity))
        self._used = self.table
        self.low = -self.velocity
        self.high = self.velocity.copy()

    def update(self, q: Array, v: Array, dt: float, table: Array) -> None:
        """Set `low` and `high` for the cycle that starts at the commanded q (n,) with velocity v (n,), dt [s] long.

        `table`: `self.table`, or a narrower one of `table_around`.
        """
        velocity_interval(q, v, dt, table, self.reserve, self._reach)
        self._used = table
        self.high = self._reach[: self._n]
        self.low = -self._reach[self._n :]

    def table_around(self, q: Array, deviation: float) -> Array:
        """Return a table whose bounds also keep within `deviation` of q (n,); they move, so braking may overrun
        them.
        """
        table: Array = self.table.copy()
        table[BOUNDS] = np.fmin(table[BOUNDS], np.concatenate((q + deviation, deviation - q)))
        return table

    def outside(self, q: Array) -> Array:
        """Return which of q (n,) are beyond their upper bounds (first n) and beyond their lower ones (last n)."""
        result: Array = np.concatenate((q, -q)) - self.table[JOINT_BOUNDS] > self._outside_by
        return result

    def table_returning(self, table: Array, outside: Array) -> Array:
        """Return a table in which joints `outside` (2n,) have no speed outward, and a slow one inward."""
        inward = np.concatenate((outside[self._n :], outside[: self._n]))
        slowed: Array = table.copy()
        slowed[VELOCITY] *= np.where(outside, 0.0, np.where(inward, _RETURN_SPEED, 1.0))
        return slowed

    def stop(self, v: Array, a: Array, dt: float) -> Array:
        """Return the velocities (n,) that brake all joints as one, in their joint-space direction, after `update`.

        v, a (n,): velocity and last acceleration.
        """
        if self.jerky:
            slower = stop_together(v, a, dt, self.acceleration, self.jerk)
        else:
            cycles = float((np.abs(v) / self.acceleration).max()) / dt
            slower = (max(1.0 - 1.0 / cycles, 0.0) if cycles > 0.0 else 0.0) * v
        result: Array = np.fmin(np.fmax(slower, self.low), self.high)
        return result

    def may_hold(self, a: Array, dt: float) -> bool:
        """Tell whether a joint at rest, its last acceleration a (n,), may stay so."""
        return not self.jerky or bool((np.abs(a) <= self.jerk * dt * (1.0 + 1e-9)).all())

    def part_way(self, start: Array, end: Array, share: float) -> Array:
        """Return the velocity (n,) that share of the way from `start` to `end`, which is within this cycle's limits; it
        goes further where they ask for that.
        """
        before, after = (np.concatenate((v - self.high, self.low - v)) for v in (start, end))
        over = before > 0.0
        needed = before[over] / np.fmax(before[over] - after[over], before[over])
        velocity: Array = start + max(share, needed.max(initial=0.0)) * (end - start)
        np.clip(velocity, self.low, self.high, out=velocity)
        return velocity

    def which(self, joint: int, wanted: float, v: Array, dt: float) -> Limit:
        """Return which limit of `joint` keeps it from the `wanted` velocity; for the status."""
        return LIMITS[held_by(joint, wanted, v, dt, self._used, self._reach)]
