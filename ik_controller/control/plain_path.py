"""The bounded problem without Numba, as saturated cycles mostly pose it: `bounded.bounded_velocity` on Python floats.

Six or seven joints, no jerk limits, no joint near its bounds, and the tool's direction can be held: y = s y_wanted +
z N, with one vector N (n,) that does not move the tool, zero for six joints. All velocities are shares of the joints'
limits. The formulas are those of `bounded`; a test holds them together.
"""

from __future__ import annotations

import math
from operator import mul

import daqp
import eigenpy
import numpy as np
from numpy.typing import NDArray

from ik_controller.control.bounded import _CURVE_SHARE, _SLOWING_SHARE, _TOLERANCE, SCALE_WEIGHT
from ik_controller.control.kernel import BY_ACCELERATION, BY_VELOCITY, FREE

Array = NDArray[np.float64]
Floats = list[float]

MOST_JOINTS = 7
_OMEGA = math.sqrt(SCALE_WEIGHT)
_SAME = 1e-6  # share of a step of the velocity by which a bound is told from another
_SOLVED = 1


class PlainPath:
    """The path q̇ = s q̇_wanted + null space of one arm with one set of limits."""

    def __init__(self, limit: Array, step: Array) -> None:
        """`limit` (n,): the velocity limits; `step` (n,): by how much a velocity may change in a cycle."""
        n = limit.shape[0]
        self._limit, self._shares = limit, 1.0 / limit
        self._cholesky = eigenpy.LLT(6)
        self._step, self._one = step / limit, np.ones(n)
        self._steps: Floats = self._step.tolist()
        self._both, self._reach = np.empty((2, n)), np.empty((2, n))  # y_wanted and the last y; bounds, lower and upper
        # Of the program in (√W (most − s), z): a row for each joint, and one for s itself.
        self._rows, self._ends = np.zeros((n + 1, 2)), np.empty((2, n + 1))
        self._rows[n, 0] = 1.0 / _OMEGA
        self._fixed = np.eye(2), np.zeros(2), np.zeros(n + 1, dtype=np.int32)

    def velocity(self, wanted: Array, v: Array, jacobian: Array, last: Array) -> tuple[Array, float, int, int] | None:
        """Return (q̇ (n,), s, joint, limit) nearest to `wanted` (n,) after `v` (n,), `last` ẋ_last (6,); None where it
        does not lie on the path. J (6, n) of full rank.
        """
        (goal, start), (lower, upper) = self._both, self._reach
        np.multiply(wanted, self._shares, goal)
        np.multiply(v, self._shares, start)
        np.maximum(start - self._step, -self._one, lower)
        np.minimum(start + self._step, self._one, upper)
        (aim, speeds), (low, high) = self._both.tolist(), self._reach.tolist()
        joint, limit = self._held(aim, low, high, speeds)
        if joint < 0:
            return wanted, 1.0, joint, limit
        moving, before = self._split(jacobian, last)
        null = _null(moving)
        scale, z = 1.0, nearest_null(aim, null, low, high)
        if z is None:
            most = self._most(aim, speeds, moving, before.tolist())
            found = self._slowed(aim, null, most)
            if found is None:
                return None
            scale, z = found
        path = [
            min(max(scale * goal + z * idle, least), most)
            for goal, idle, least, most in zip(aim, null, low, high, strict=True)
        ]
        return np.array(path) * self._limit, min(max(scale, 0.0), 1.0), joint, limit

    def _held(self, aim: Floats, low: Floats, high: Floats, speeds: Floats) -> tuple[int, int]:
        """Return the joint that is furthest beyond its bounds, −1 for none, and which of its limits it is."""
        excess = [max(goal - most, least - goal) for goal, least, most in zip(aim, low, high, strict=True)]
        largest = max(excess)
        if not largest > 0.0:
            return -1, FREE
        joint = excess.index(largest)
        change = (high if aim[joint] > 0.5 * (low[joint] + high[joint]) else low)[joint] - speeds[joint]
        step = self._steps[joint]
        return joint, BY_ACCELERATION if abs(abs(change) - step) < _SAME * step else BY_VELOCITY

    def _split(self, jacobian: Array, last: Array) -> tuple[Array, Array]:
        """Return the projector (n, n) onto what moves the tool, and the shortest that moves it by `last` (6,)."""
        task = jacobian * self._limit
        inverse = self._cholesky.compute(task.dot(task.T)).solve(task)  # the transpose of task⁺
        return task.T.dot(inverse), last.dot(inverse)

    def _most(self, aim: Floats, speeds: Floats, moving: Array, before: Floats) -> float:
        """Return the share of the path's speed to ask for: the less of `bounded._most_at_ease` and `_most_ahead`."""
        part, slow = self._both.dot(moving).tolist()
        turn = [b - s for b, s in zip(before, slow, strict=True)]
        square = sum(map(mul, part, part))
        if not square > 0.0:
            return 1.0
        last = sum(map(mul, part, before)) / square
        least, ease, hardest, curve = -math.inf, 1.0, math.inf, 0.0
        for goal, own, start, change, step in zip(aim, part, before, turn, self._steps, strict=True):
            start += last * (goal - own)
            if goal != 0.0:
                middle, room = start / goal, step / abs(goal)
                # max and min would cost three times as much
                if middle - room > least:
                    least = middle - room
                if middle + room < ease:
                    ease = middle + room
                if room < hardest:
                    hardest = room
            if abs(change) > curve * step:
                curve = abs(change) / step
        if not (least <= ease and ease > 0.0):
            ease = 1.0
        if not last > 0.0:
            return ease
        fastest = last * math.sqrt(_CURVE_SHARE / curve) if curve > _CURVE_SHARE else math.inf
        for change, speed in zip(turn, speeds, strict=True):
            if change * speed > 0.0:
                room = _CURVE_SHARE * hardest / abs(change)
                fastest = min(fastest, (room * last * last) ** (1.0 / 3.0) + room * max(1.0 - abs(speed), 0.0))
        ahead = max(fastest, last - _SLOWING_SHARE * hardest)
        return min(ease, ahead) if ahead > 0.0 else ease

    def _slowed(self, aim: Floats, null: Floats, most: float) -> tuple[float, float] | None:
        """Return (s, z) within the bounds, 0 ≤ s ≤ 1, where W (`most` − s)² + z² is smallest; None for none."""
        rows, ends, (identity, zero, sense) = self._rows, self._ends, self._fixed
        goal = self._both[0]
        np.multiply(goal, -1.0 / _OMEGA, rows[:-1, 0])
        rows[:-1, 1] = null
        np.subtract(self._reach, most * goal, ends[:, :-1])
        ends[0, -1], ends[1, -1] = most - 1.0, most
        tolerance = _TOLERANCE * max(1.0, max(aim), -min(aim))
        x, _, flag, _ = daqp.solve(identity, zero, rows, ends[1], ends[0], sense, primal_tol=tolerance)
        if flag != _SOLVED:
            return None
        t, z = x.tolist()
        return most - t / _OMEGA, z


def _null(moving: Array) -> Floats:
    """Return the vector of length 1 (n,) beside the projector `moving` (n, n), 0 for six joints.

    It is what is left of an axis: of that which moves the tool least.
    """
    n = moving.shape[0]
    if n == 6:
        return [0.0] * n
    shares = moving.diagonal().tolist()
    axis = shares.index(min(shares))
    null: Floats = moving[axis].tolist()
    null[axis] -= 1.0
    size = math.hypot(*null)
    return [value / size for value in null]


def nearest_null(aim: Floats, null: Floats, low: Floats, high: Floats) -> float | None:
    """Return the z nearest to 0 with `low` ≤ aim + z N ≤ `high`, (n,) each; None where there is none."""
    least, most = -math.inf, math.inf
    for goal, idle, lower, upper in zip(aim, null, low, high, strict=True):
        if idle == 0.0:
            if not lower <= goal <= upper:
                return None
            continue
        one, other = (lower - goal) / idle, (upper - goal) / idle
        if idle < 0.0:
            one, other = other, one
        if one > least:
            least = one
        if other < most:
            most = other
        if least > most:
            return None
    return min(max(0.0, least), most)
