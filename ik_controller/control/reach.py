"""The velocities that each joint may take next: the table of limits, and the interval of `limits` worked out.

Compiled it is a loop over the joints; without Numba the same formulas run on all joints at once.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.interval import jerk_interval
from ik_controller.kinematics.accelerate import HAS_NUMBA, compiled

Array = NDArray[np.float64]

NEAR = 0.2  # share of the speed limit that a joint near its bound may have towards it, or less
ENDLESS = 1e18  # room ahead of a joint without bounds [rad or m]

# Rows of the table of limits (7, 2n); each holds its values upward (first n) and downward (last n).
BOUNDS = 0  # upper limits, then negated lower ones: those of this cycle [rad or m]
VELOCITY = 1
ACCELERATION = 2
JOINT_BOUNDS = 3  # the model's own
FULL_ACCELERATION = 4  # the model's own
JERK = 5  # first n, inf for a joint without one; last n: the model's own
LAST = 6  # first n: the last accelerations; last n: the model's own velocity limits


@compiled
def interval_by_loops(q: Array, v: Array, dt: float, limits: Array, reserve: bool, reach: Array) -> None:
    """Write the velocities (2n,) that each joint may reach upward (first n) and downward (last n, negated).

    q, v (n,): the commanded state; dt [s]; `limits` (7, 2n). With `reserve`, an acceleration or jerk limit below
    the model's own is left where only the model's own still stops a joint before its bound.
    """
    n = q.shape[0]
    for i in range(2 * n):
        sign, joint = (1.0, i) if i < n else (-1.0, i - n)
        reach[i] = fastest_stoppable(
            sign * q[joint], sign * v[joint], dt, limits[BOUNDS, i], limits[VELOCITY, i], limits[ACCELERATION, i]
        )
    if reserve:
        for i in range(n):
            up, down = limits[JOINT_BOUNDS, i], limits[JOINT_BOUNDS, n + i]
            highest = fastest_stoppable(q[i], v[i], dt, up, math.inf, limits[FULL_ACCELERATION, i])
            lowest = -fastest_stoppable(-q[i], -v[i], dt, down, math.inf, limits[FULL_ACCELERATION, n + i])
            reach[i] = min(max(reach[i], lowest), highest)
            reach[n + i] = min(max(reach[n + i], -highest), -lowest)
    if limits.shape[0] > JERK:
        apply_jerk(q, v, dt, limits, reserve, reach)


@compiled
def apply_jerk(q: Array, v: Array, dt: float, limits: Array, reserve: bool, reach: Array) -> None:
    """Overwrite the `velocity_interval` (2n,) of the joints that have a jerk limit."""
    n = q.shape[0]
    for i in range(n):
        jerk, full_jerk, a = limits[JERK, i], limits[JERK, n + i], limits[LAST, i]
        if not jerk < math.inf:
            continue
        up, down = limits[BOUNDS, i] - q[i], limits[BOUNDS, n + i] + q[i]
        speed_up, speed_down = limits[VELOCITY, i], limits[VELOCITY, n + i]
        lowest, highest = jerk_interval(v[i], a, dt, up, down, speed_up, speed_down, limits[ACCELERATION, i], jerk)
        if reserve:
            up, down = limits[JOINT_BOUNDS, i] - q[i], limits[JOINT_BOUNDS, n + i] + q[i]
            speed, acceleration = limits[LAST, n + i], limits[FULL_ACCELERATION, i]
            least, most = jerk_interval(v[i], a, dt, up, down, speed, speed, acceleration, full_jerk)
            lowest, highest = min(max(lowest, least), most), min(max(highest, least), most)
        reach[i], reach[n + i] = highest, -lowest


@compiled
def near_bound(q: Array, limits: Array) -> bool:
    """Tell whether a joint of q (n,) is so near a bound that it must be slow towards it."""
    n = q.shape[0]
    for i in range(2 * n):
        room = limits[BOUNDS, i] - (q[i] if i < n else -q[i - n])
        slow = NEAR * limits[VELOCITY, i]
        if room * limits[ACCELERATION, i] < slow * slow:
            return True
    return False


@compiled
def fastest_stoppable(q: float, v: float, dt: float, bound: float, velocity: float, acceleration: float) -> float:
    """Return the largest velocity from which a joint at q, v still stops at its upper bound (see `limits`)."""
    room = min(max(bound - q, 0.0), ENDLESS)
    # a (√(dt² + 2 room/a) − dt) in the form that loses no digits near the bound and serves an infinite a too.
    far = (2.0 * room) / (math.sqrt(dt * dt + (2.0 * room) / acceleration) + dt)
    # Rounding may ask for a little more than the room: never step over the bound.
    far = min(min(far, room * (1.0 / dt)), velocity)
    # Acceleration comes last: it always holds; the others do as long as they held before (or shrink to it).
    step = acceleration * dt
    return min(max(far, v - step), v + step)


@compiled
def within_by_loops(wanted: Array, reach: Array) -> bool:
    """Tell whether a velocity (n,) is in a `velocity_interval` (2n,); one that is not finite never is."""
    n = wanted.shape[0]
    for i in range(n):  # noqa: SIM110 (Numba compiles no generators)
        if not (wanted[i] <= reach[i] and -wanted[i] <= reach[n + i]):
            return False
    return True


def interval_by_numpy(q: Array, v: Array, dt: float, limits: Array, reserve: bool, reach: Array) -> None:
    """Write the same as `interval_by_loops`, by NumPy."""
    n = q.shape[0]
    both = np.concatenate((q, -q, v, -v))
    at, speed = both[: 2 * n], both[2 * n :]
    reach[:] = _fastest(at, speed, dt, limits[BOUNDS], limits[VELOCITY], limits[ACCELERATION])
    if reserve:
        most = _fastest(at, speed, dt, limits[JOINT_BOUNDS], math.inf, limits[FULL_ACCELERATION])
        least = -np.concatenate((most[n:], most[:n]))
        reach[:] = np.fmin(np.fmax(reach, least), most)
    if limits.shape[0] > JERK:
        apply_jerk(q, v, dt, limits, reserve, reach)


def _fastest(q: Array, v: Array, dt: float, bound: Array, velocity: Array | float, acceleration: Array) -> Array:
    """Return what `fastest_stoppable` does, of arrays."""
    room = np.fmin(np.fmax(bound - q, 0.0), ENDLESS)
    far = 2.0 * room
    far /= np.sqrt(dt * dt + far / acceleration) + dt
    far = np.fmin(np.fmin(far, room * (1.0 / dt)), velocity)
    step = acceleration * dt
    result: Array = np.fmin(np.fmax(far, v - step), v + step)
    return result


def within_by_numpy(wanted: Array, reach: Array) -> bool:
    """Tell the same as `within_by_loops`."""
    n = wanted.shape[0]
    return bool((wanted <= reach[:n]).all() and (-wanted <= reach[n:]).all())


velocity_interval = interval_by_loops if HAS_NUMBA else interval_by_numpy
within = within_by_loops if HAS_NUMBA else within_by_numpy
