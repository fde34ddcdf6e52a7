"""The velocities that a joint with a jerk limit may take next, so that it can always stop within all its bounds.

The command is a stream of samples, dt apart: q_{k+1} = q_k + v_{k+1} dt, v_{k+1} = v_k + a_{k+1} dt, with |v| ≤ V,
|a| ≤ A and |a_{k+1} − a_k| ≤ J dt. Velocities are counted in units of J dt², positions in J dt³ here, so that
dt = J = 1. With x = −a, the braking, one *stop* belongs to every state:

    x' = h(v) clipped to [−A, A], and to [x − 1, x + 1].

h, the `landing`, is odd and the inverse of g(y) = y (y + 1)/2 at whole y ≥ 0, linear in between: from v = g(y) the
steps y, y − 1, y − 2, … bring the joint to rest, exactly. So the stop brakes ever harder until it has to let go to land
at v = 0 with a = 0. Three facts, each tested against brute force, make it a limit that always leaves a joint a way:

* The rest of a stop is the stop of the state that it has reached.
* Stops keep their order: of two next velocities the larger has the larger velocity at every later time. So those whose
  stop stays within all bounds are an interval, and where the present stop does, its own next velocity is one of them.
* Of all ways to come to rest from v ≥ 0 without turning back, no other is shorter.

A velocity is accepted where its stop is within the bounds.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import compiled

Array = NDArray[np.float64]

# Share of a jerk limit that rounding may take when a stop lets go.
_ROUNDING = 1e-11
_FAR = 1e15  # units beyond which no digit of a distance counts
_SEARCH = 24  # steps of the search for the highest velocity
_EXACT = 1e-10  # and the distance to a bound, of what is left, at which it ends


@compiled
def ramp_sum(y: float) -> float:
    """Return g(y), y ≥ 0: y (y + 1)/2 at whole y, linear in between."""
    whole = math.floor(y)
    return 0.5 * whole * (whole + 1.0) + (y - whole) * (whole + 1.0)


@compiled
def landing(v: float) -> float:
    """Return h(v), the hardest braking after which v can still land: the odd inverse of `ramp_sum`."""
    size = abs(v)
    if size <= 1.0:
        return v
    whole = math.floor(0.5 * (math.sqrt(8.0 * size + 1.0) - 1.0))
    hardest = whole + (size - 0.5 * whole * (whole + 1.0)) / (whole + 1.0)
    return hardest if v > 0.0 else -hardest


@compiled
def clip(value: float, low: float, high: float) -> float:
    """Return the value within [low, high]; `high` where they cross."""
    return min(max(value, low), high)


@compiled
def stop_braking(v: float, x: float, most: float) -> float:
    """Return the next braking x' of the stop from v, braking x before; `most` A. All in units of J and dt."""
    slack = 1.0 + _ROUNDING
    wanted = clip(landing(v), x - slack, x + slack)
    # Above A, after A has been lowered, the jerk limit still holds.
    return clip(wanted, min(-most, x + slack), max(most, x - slack))


@compiled
def stop_distance(v: float, x: float, most: float) -> float:
    """Return Σ v_i of the stop from v with braking x before, for a state that has not braked too hard to land above.

    Three phases: braking grows by 1 a step, stays at A, and is let go. Closed form but for the correction of the first
    phase's length, which the parabola y (y + 1)/2 below g gives to one step.
    """
    peak = min(math.sqrt(max(v + 0.5 * x * (x + 1.0), 0.0)), most)
    n = max(math.floor(peak - x), 0.0)
    while n > 0.0 and landing(v - (n - 1.0) * x - 0.5 * n * (n - 1.0)) < x + n - _ROUNDING * (1.0 + n):
        n -= 1.0
    total = n * (v - 0.5 * (n + 1.0) * x - (n + 1.0) * (n + 2.0) / 6.0)
    v -= n * (x + 0.5 * (n + 1.0))
    if v > most and landing(v) > most:
        held = math.floor((v - ramp_sum(most)) / most) + 1.0
        total += held * (v - 0.5 * (held + 1.0) * most)
        v -= held * most
    size = abs(v)
    whole = math.floor(0.5 * (math.sqrt(8.0 * size + 1.0) - 1.0))
    rest = (size - 0.5 * whole * (whole + 1.0)) / (whole + 1.0)
    let_go = 0.5 * whole * (whole + 1.0) * (rest + (whole - 1.0) / 3.0)
    return total + let_go if v > 0.0 else total - let_go


@compiled
def highest(v: float, w: float, most: float, fastest: float, room: float) -> float:
    """Return the highest next velocity: v now, w the last acceleration, A, V, `room` to the bound; all in units.

    The stop of the result ends within the room and stays below V, wherever the present one does; if it does not, the
    result is the stop's own next velocity, or what comes down to V as fast.
    """
    top = v + max(min(w + 1.0, most), w - 1.0)
    below = fastest - v
    if below < 0.5 * (most + 1.0) * (most + 2.0):
        top = min(top, v - stop_braking(-below, -w, most))
    # A plain bound of the distance: at the peak's velocity for longer than the stop takes.
    peak = max(top + ramp_sum(max(top - v, 0.0)), 0.0)
    if room > _FAR or peak * (peak / most + most + max(most, top - v) + 4.0) <= room:
        return top
    stop = v - stop_braking(v, -w, most)
    if not top > stop:
        return stop
    high_miss = top + stop_distance(top, v - top, most) - room
    if high_miss <= 0.0:
        return top
    low, high = stop, top
    low_miss = low + stop_distance(low, v - low, most) - room
    if low_miss >= 0.0:
        return stop
    # Regula falsi, Illinois' way; `low` is always a velocity that has been found good.
    enough = _EXACT * room
    side = 0
    for _ in range(_SEARCH):
        middle = low + (high - low) * (low_miss / (low_miss - high_miss))
        miss = middle + stop_distance(middle, v - middle, most) - room
        if miss <= 0.0:
            low, low_miss = middle, miss
            if side < 0:
                high_miss *= 0.5
            side = -1
            if miss > -enough:
                break
        else:
            high, high_miss = middle, miss
            if side > 0:
                low_miss *= 0.5
            side = 1
    return low


@compiled
def jerk_interval(
    v: float,
    a: float,
    dt: float,
    up: float,
    down: float,
    fastest_up: float,
    fastest_down: float,
    acceleration: float,
    jerk: float,
) -> tuple[float, float]:
    """Return the lowest and the highest next velocity of a joint.

    v, a: its velocity and last acceleration; dt [s]; `up`, `down`: the room to its bounds; `fastest_…`, `acceleration`,
    `jerk` (finite): its limits.
    """
    unit = jerk * dt * dt
    speed, last, most = v / unit, a * dt / unit, acceleration * dt / unit
    high = unit * highest(speed, last, most, fastest_up / unit, max(up, 0.0) / (unit * dt))
    low = -unit * highest(-speed, -last, most, fastest_down / unit, max(down, 0.0) / (unit * dt))
    if low > high:  # rounding: there is one way left
        low = high = unit * (speed - stop_braking(speed, -last, most))
    return low, high


@compiled
def lets_go(v: float, change: float, fastest: float, unit: float) -> bool:
    """Tell whether a joint that goes at v, faster by `change` than a cycle before, ends at `fastest` when it takes its
    acceleration away, by `unit` J dt² a cycle.
    """
    return v + unit * ramp_sum(max(change / unit - 1.0, 0.0)) > fastest - 1e-6 * unit


@compiled
def stop_together(v: Array, a: Array, dt: float, acceleration: Array, jerk: Array) -> Array:
    """Return the next velocities (n,) of joints that brake as one, along their joint-space direction.

    v, a (n,): velocity and last acceleration; `acceleration`, `jerk` (n,): the limits, some of the latter finite. The
    stop is that of one joint s at 1, q̇ = s v, whose limits are those of the joint that has the least for its speed.
    What of `a` is not along v is not seen here: the caller's intervals take it in.
    """
    n = v.shape[0]
    most, jerk_limit, along, weight = np.inf, np.inf, 0.0, 0.0
    for i in range(n):
        speed = abs(v[i])
        if speed > 0.0:
            most, jerk_limit = min(most, acceleration[i] / speed), min(jerk_limit, jerk[i] / speed)
        along += a[i] * v[i] / (jerk[i] * jerk[i])
        weight += v[i] * v[i] / (jerk[i] * jerk[i])
    result = np.zeros(n)
    if weight > 0.0:
        unit = jerk_limit * dt * dt
        share = stop_braking(1.0 / unit, -(along / weight) * dt / unit, most * dt / unit) * unit
        for i in range(n):
            result[i] = v[i] - share * v[i]
    else:  # only joints without a jerk limit move
        share = min(most * dt, 1.0)
        for i in range(n):
            result[i] = v[i] - share * v[i]
    return result
