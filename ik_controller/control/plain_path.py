"""The bounded problem without Numba, as saturated cycles mostly pose it: `bounded.bounded_velocity` on Python floats.

Six or seven joints, no jerk limits, no joint near its bounds, and the tool's direction can be held: y = s y_wanted +
z N, with one vector N (n,) that does not move the tool, zero for six joints. All velocities are shares of the joints'
limits. The formulas are those of `bounded`; a test holds them together.
"""

from __future__ import annotations

import math
from operator import mul

import eigenpy
import numpy as np
from numpy.typing import NDArray

from ik_controller.control.bounded import CURVE_SHARE, SCALE_WEIGHT, SLOWING_SHARE, TOLERANCE
from ik_controller.control.kernel import BY_ACCELERATION, BY_VELOCITY, FREE

Array = NDArray[np.float64]
Floats = list[float]
Row = tuple[float, float, float, float]

MOST_JOINTS = 7
_OMEGA = math.sqrt(SCALE_WEIGHT)
_SAME = 1e-6  # share of a step of the velocity by which a bound is told from another


class PlainPath:
    """The path q̇ = s q̇_wanted + null space of one arm with one set of limits."""

    def __init__(self, limit: Array, step: Array) -> None:
        """`limit` (n,): the velocity limits; `step` (n,): by how much a velocity may change in a cycle."""
        self._limit = limit
        self._limits: Floats = limit.tolist()
        self._steps: Floats = (step / limit).tolist()
        self._cholesky = eigenpy.LLT(6)

    def velocity(self, wanted: Floats, v: Floats, jacobian: Array, last: Array) -> tuple[Array, float, int, int] | None:
        """Return (q̇ (n,), s, joint, limit) nearest to `wanted` (n,) after `v` (n,), `last` ẋ_last (6,); None where it
        does not lie on the path. J (6, n) of full rank.
        """
        aim = [velocity / limit for velocity, limit in zip(wanted, self._limits, strict=True)]
        speeds = [velocity / limit for velocity, limit in zip(v, self._limits, strict=True)]
        low = [max(speed - step, -1.0) for speed, step in zip(speeds, self._steps, strict=True)]
        high = [min(speed + step, 1.0) for speed, step in zip(speeds, self._steps, strict=True)]
        joint, limit = self._held(aim, low, high, speeds)
        if joint < 0:
            return np.array(wanted), 1.0, joint, limit
        null, before = self._split(jacobian, last)
        tolerance = TOLERANCE * max(1.0, max(aim), -min(aim))
        rows = [
            (0.0, idle, least - goal, most - goal) for goal, idle, least, most in zip(aim, null, low, high, strict=True)
        ]
        scale, found = 1.0, shortest(rows, tolerance)
        if found is None:
            # Of (√W (most − s), z): a row for each joint, and one for s itself.
            ask = self._most(aim, speeds, null, before)
            rows = [
                (-goal / _OMEGA, idle, least - ask * goal, most - ask * goal)
                for goal, idle, least, most in zip(aim, null, low, high, strict=True)
            ]
            found = shortest([*rows, (1.0 / _OMEGA, 0.0, ask - 1.0, ask)], tolerance)
            if found is None:
                return None
            scale = min(max(ask - found[0] / _OMEGA, 0.0), 1.0)
        path = [
            min(max(scale * goal + found[1] * idle, least), most)
            for goal, idle, least, most in zip(aim, null, low, high, strict=True)
        ]
        return np.array(path) * self._limit, scale, joint, limit

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

    def _split(self, jacobian: Array, last: Array) -> tuple[Floats, Floats]:
        """Return (N, b), (n,) each: what does not move the tool, and the shortest that moves it by `last` ẋ (6,)."""
        n, task = len(self._limits), jacobian * self._limit
        inverse = self._cholesky.compute(task.dot(task.T)).solve(task)  # the transpose of task⁺
        before: Floats = last.dot(inverse).tolist()
        if n == 6:
            return [0.0] * n, before
        moving = task.T.dot(inverse)  # projects onto what moves the tool; of the axis that does so least, the rest is N
        shares = moving.diagonal().tolist()
        axis = shares.index(min(shares))
        rest: Floats = moving[axis].tolist()
        rest[axis] -= 1.0
        size = math.hypot(*rest)
        return [value / size for value in rest], before

    def _most(self, aim: Floats, speeds: Floats, null: Floats, before: Floats) -> float:
        """Return the share of the path's speed to ask for: the less of `bounded._most_at_ease` and `_most_ahead`."""
        idle, own = sum(map(mul, aim, null)), sum(map(mul, speeds, null))
        part = [goal - idle * share for goal, share in zip(aim, null, strict=True)]
        turn = [b - (s - own * share) for b, s, share in zip(before, speeds, null, strict=True)]
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
        fastest = last * math.sqrt(CURVE_SHARE / curve) if curve > CURVE_SHARE else math.inf
        for change, speed in zip(turn, speeds, strict=True):
            if change * speed > 0.0:
                room = CURVE_SHARE * hardest / abs(change)
                fastest = min(fastest, (room * last * last) ** (1.0 / 3.0) + room * max(1.0 - abs(speed), 0.0))
        ahead = max(fastest, last - SLOWING_SHARE * hardest)
        return min(ease, ahead) if ahead > 0.0 else ease


def shortest(rows: list[Row], tolerance: float) -> tuple[float, float] | None:
    """Return the shortest x (2,) with lower ≤ a x₀ + b x₁ ≤ upper for each row (a, b, lower, upper), None for none.

    Row by row (Seidel 1991): where the shortest within the rows before is beyond one, the shortest lies on its edge.
    """
    x, y = 0.0, 0.0
    for count, (a, b, lower, upper) in enumerate(rows):
        value, square = a * x + b * y, a * a + b * b
        if lower - tolerance <= value <= upper + tolerance:
            continue
        if square == 0.0:
            return None
        bound = upper if value > upper else lower
        foot_x, foot_y, least, most = a * bound / square, b * bound / square, -math.inf, math.inf
        for c, d, low, high in rows[:count]:
            rest, along = c * foot_x + d * foot_y, d * a - c * b
            if along == 0.0:
                if not low - tolerance <= rest <= high + tolerance:
                    return None
                continue
            one, other = (low - rest) / along, (high - rest) / along
            if along < 0.0:
                one, other = other, one
            # max and min would cost three times as much
            if one > least:
                least = one
            if other < most:
                most = other
            if least > most + tolerance / abs(along):
                return None
        way = min(max(0.0, least), most)
        x, y = foot_x - way * b, foot_y + way * a
    return x, y
