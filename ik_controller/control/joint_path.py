"""JointPath: timed joint positions with velocities, cubic Hermite between them.

Where a point has no velocity, it gets the mean of the slopes on both sides, weighted by nearness, and the first and
last points get zero.
"""

from __future__ import annotations

import bisect
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class JointPath:
    """Joint positions over time; holds its first point before, its last one after."""

    def __init__(self, times: list[int], positions: Array, velocities: Array) -> None:
        """`times` (k) [ns], rising; `positions`, `velocities` (k, n), NaN where a point has no velocity."""
        self.times = times
        self.positions = positions
        self.velocities = _filled(times, positions, velocities)

    def at(self, time: float) -> Array:
        """Return the positions (n,) at `time` [ns]."""
        times = self.times
        index = bisect.bisect_right(times, time)
        if index in (0, len(times)):
            held: Array = self.positions[max(index - 1, 0)]
            return held
        h = (times[index] - times[index - 1]) * 1e-9
        s = (time - times[index - 1]) * 1e-9 / h
        p0, p1 = self.positions[index - 1], self.positions[index]
        r0, r1 = h * self.velocities[index - 1], h * self.velocities[index]
        change = p1 - p0
        value: Array = p0 + s * (r0 + s * ((3.0 * change - 2.0 * r0 - r1) + s * (r0 + r1 - 2.0 * change)))
        return value

    def over(self, time: int, dt: float) -> tuple[Array, Array]:
        """Return the positions (n,) at `time` [ns] and the mean velocity (n,) over the next dt [s]."""
        now = self.at(time)
        return now, (self.at(time + dt * 1e9) - now) / dt

    def before(self, time: int) -> tuple[list[int], Array, Array]:
        """Return the times, positions and velocities of the points before `time` [ns]."""
        count = bisect.bisect_left(self.times, time)
        return self.times[:count], self.positions[:count], self.velocities[:count]

    def state(self) -> list[Any]:
        """Return all as JSON types, for `of`."""
        return [self.times, self.positions.tolist(), self.velocities.tolist()]

    @classmethod
    def of(cls, state: list[Any]) -> JointPath:
        """Return the path of a `state`."""
        return cls(list(state[0]), np.array(state[1]), np.array(state[2]))


def _filled(times: list[int], positions: Array, velocities: Array) -> Array:
    result = np.array(velocities, dtype=float)
    last = len(times) - 1
    for index in range(last + 1):
        if not np.isnan(result[index]).any():
            continue
        if index in (0, last):
            result[index] = 0.0
            continue
        before, after = (times[index] - times[index - 1]) * 1e-9, (times[index + 1] - times[index]) * 1e-9
        slope_before = (positions[index] - positions[index - 1]) / before
        slope_after = (positions[index + 1] - positions[index]) / after
        result[index] = (slope_before * after + slope_after * before) / (before + after)
    return result
