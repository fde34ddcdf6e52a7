"""The numbers of one cycle: functions of arrays alone, compiled by Numba where it is installed; one source.

n joints; J (6, n); arrays are float64. The formulas are explained where they belong: the law in `law`, the
intervals in `limits` and `reach`, the damping in `damped_inverse`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.bounded import bounded_velocity
from ik_controller.control.curvature import follow_bend, nearness
from ik_controller.control.interval import lets_go
from ik_controller.control.reach import ACCELERATION, JERK, LAST, VELOCITY, velocity_interval, within
from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.damped_inverse import damped_gram_inverse
from ik_controller.kinematics.levenberg_marquardt import kinematics, kinematics_pose, rotation_log
from ik_controller.kinematics.scratch import borrowed, scratch, scratch_table
from ik_controller.kinematics.small import gram, times, transposed_times

Array = NDArray[np.float64]

# From so many ε on, σ_min lets the path's speed be planned ahead: closer, what J does next is not what it did last.
AHEAD = 1.5
# Share of the acceleration limits that the approach to a target plans its braking with; the rest is for the moving
# reference, the turning of J and the posture.
BRAKING_SHARE = 0.7


# Rows of the table of the law (11, max(n, 9)): K (6, 6), scalars, and what is given for each joint.
SCALARS = 6  # largest eigenvalue of K, gain of the posture, λ, ε, number of directions the arm can move in, and
TOOL_SPEED, TOOL_ACCELERATION = 5, 7  # the tool's bounds: columns of that row, linear and angular, inf for none
BRAKING = 7  # accelerations a that the approach plans its braking with, and below them a²/2J
POSTURE = 9
SEEK_LIMIT = 10  # at most so fast towards the posture

# Why a velocity was not reached: codes of `status.Limit` in its order.
FREE, BY_VELOCITY, BY_ACCELERATION, BY_POSITION, BY_JERK, BY_TOOL_SPEED, BY_TOOL_ACCELERATION = range(7)
# At rest: a share of the speed limits; away: an error of the tool [m, rad].
_REST, _AWAY = 1e-3, 1e-6

# How the velocity was found: 0 to 2 as in `bounded`, with s = 1 where no limit was met.
NOT_FINITE = -1


@compiled
def held_by(joint: int, wanted: float, v: Array, dt: float, limits: Array, reach: Array) -> int:
    """Return which limit of `joint` keeps it from the `wanted` velocity."""
    n = v.shape[0]
    up = wanted > 0.5 * (reach[joint] - reach[n + joint])
    bound = reach[joint] if up else -reach[n + joint]
    acceleration, velocity = limits[ACCELERATION, joint], limits[VELOCITY, joint]
    change = bound - v[joint]
    if abs(abs(change) - acceleration * dt) < 1e-9 * acceleration:
        return BY_ACCELERATION
    if abs(abs(bound) - velocity) < 1e-9 * velocity:
        return BY_VELOCITY
    if limits[JERK, joint] < math.inf:
        jolt = limits[JERK, joint] * dt * dt
        if abs(abs(change - limits[LAST, joint] * dt) - jolt) < 1e-6 * jolt:
            return BY_JERK
        if velocity > 0.0 and lets_go(abs(bound), abs(change), velocity, jolt):
            return BY_VELOCITY
    return BY_POSITION


@compiled
def braking_factor(approach: Array, fastest: float, braking: Array) -> float:
    """Return β ≤ 1 for the feedback velocity (n,), with which no joint is faster than it can brake to the target.

    `braking` (2, n): a and c = a²/2J, 0 without a jerk limit. From v, a joint stops in v²/2a + v c/a, time to take up
    the braking included. So far from the target v = √(c² + 2a (d − d₀)) − c for the distance d = |q̇|/K; near it, where
    that brakes no harder, v = K d, for v < a/K − c; d₀ joins the two.
    """
    beta = 1.0
    for i in range(approach.shape[0]):
        ratio = fastest * abs(approach[i]) / braking[0, i]
        lag = fastest * braking[1, i] / braking[0, i]
        start = max(1.0 - lag, 0.0)
        if ratio > start:
            beta = min(beta, (math.sqrt(lag * lag + 2.0 * ratio - start * start) - lag) / ratio)
    return beta


@compiled
def rests_away(v: Array, error: Array, speeds: Array) -> bool:
    """Tell whether an arm at v (n,) is as good as at rest while there is an error (6,) that it would follow if it
    could; `speeds` (n,): its limits.
    """
    for i in range(v.shape[0]):
        if not abs(v[i]) <= _REST * speeds[i]:
            return False
    for i in range(6):  # noqa: SIM110 (Numba compiles no generators)
        if abs(error[i]) > _AWAY:
            return True
    return False


@compiled
def tool_is_free(law: Array) -> bool:
    """Tell whether the tool itself has no bounds."""
    bound = law[SCALARS]
    for k in range(TOOL_SPEED, TOOL_ACCELERATION + 2):  # noqa: SIM110 (Numba compiles no generators)
        if bound[k] < math.inf:
            return False
    return True


@compiled
def longer(vector: Array, linear: float, angular: float) -> float:
    """Return by how much a twist (6,) is above two bounds: max(|v|/linear, |ω|/angular)."""
    v = math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    w = math.sqrt(vector[3] * vector[3] + vector[4] * vector[4] + vector[5] * vector[5])
    excess: float = max(v / linear, w / angular)
    return excess


@compiled
def stoppable_share(feedback: Array, law: Array) -> float:
    """Return β ≤ 1 for K e (6,) as `braking_factor` does for the joints, with the accelerations of the tool."""
    scalars = law[SCALARS]
    ratio: float = (
        scalars[0] * longer(feedback, scalars[TOOL_ACCELERATION], scalars[TOOL_ACCELERATION + 1]) / BRAKING_SHARE
    )
    if ratio > 1.0:
        return math.sqrt(2.0 * ratio - 1.0) / ratio
    return 1.0


@compiled
def bound_tool(
    wanted: Array, jacobian: Array, inverse: Array, last: Array, v: Array, law: Array, dt: float
) -> tuple[float, int]:
    """Bring the velocity `wanted` (n,), in place, within the tool's bounds; return (s, limit).

    With ẋ = J q̇ slowed as a whole to the tool's speeds, and Δ = ẋ − ẋ_last, the tool takes ẋ_last + σ Δ, so far as its
    accelerations allow; `last` ẋ_last (6,). J⁺ẋ_last is v + Jᵀ · `inverse` · (ẋ_last − J v), v (n,) the last velocity.
    """
    n, bound = wanted.shape[0], law[SCALARS]
    speed, limit = times(jacobian, wanted, scratch(6)), FREE
    slower = 1.0 / max(longer(speed, bound[TOOL_SPEED], bound[TOOL_SPEED + 1]), 1.0)
    if slower < 1.0:
        limit = BY_TOOL_SPEED
        for j in range(n):
            wanted[j] *= slower
    change, rest = scratch(6), times(jacobian, v, scratch(6))
    for i in range(6):
        change[i], rest[i] = slower * speed[i] - last[i], last[i] - rest[i]
    share = longer(change, bound[TOOL_ACCELERATION] * dt, bound[TOOL_ACCELERATION + 1] * dt)
    if not share > 1.0:
        return slower, limit
    share = 1.0 / share
    before = transposed_times(jacobian, times(inverse, rest, scratch(6)), scratch(n))
    for j in range(n):
        wanted[j] = share * wanted[j] + (1.0 - share) * (v[j] + before[j])
    along, square = 0.0, 0.0
    for i in range(6):
        along += (last[i] + share * change[i]) * speed[i]
        square += speed[i] * speed[i]
    return min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0, BY_TOOL_ACCELERATION


@compiled
def task_velocity(
    jacobian: Array,
    inverse: Array,
    feed_forward: Array,
    approach: Array,
    share: float,
    law: Array,
    at: Array,
    wanted: Array,
) -> None:
    """Write J⁺(ẋ_d + β K e) + (I − J⁺J) q̇₀ (n,), with J⁺ = Jᵀ · `inverse`.

    `feed_forward` ẋ_d (6,), `approach` J⁺K e (n,), of which `share` is followed; `law` as above; q̇₀ leads from `at`
    (n,) to the posture, slowed as a whole to its limits.
    """
    m, n = jacobian.shape
    gain, ratio, seek, steady = law[SCALARS, 1], 1.0, scratch(n), scratch(m)
    for j in range(n):
        seek[j] = gain * (law[POSTURE, j] - at[j])
        ratio = max(ratio, abs(seek[j]) / law[SEEK_LIMIT, j])
    for i in range(m):
        steady[i] = feed_forward[i]
        for j in range(n):
            steady[i] -= jacobian[i, j] * (seek[j] / ratio)
    beta = share * braking_factor(approach, share * law[SCALARS, 0], law[BRAKING : BRAKING + 2])
    transposed_times(jacobian, times(inverse, steady, scratch(m)), wanted)
    for j in range(n):
        wanted[j] += seek[j] / ratio + beta * approach[j]


@compiled
def tool_cycle(
    chain: Any,
    law: Array,
    limits: Array,
    state: Array,
    at: Array,
    position: Array,
    rotation: Array,
    twist: Array,
    feedback: Array,
    measure: bool,
    reserve: bool,
    dt: float,
    out: Array,
    detail: Array,
) -> tuple[int, float, int, int, float]:
    """Write one cycle towards a tool reference to `out` and return (how, s, joint, limit, σ_min).

    `state` (2n + 6,): q, v and the tool's velocity of the last cycle; `out` (2n + 12,): the same after this cycle, and
    the error e. Where `measure`, e and K e are worked out against `position` (3,) and `rotation` (3, 3), else K e is
    `feedback` (6,). `at` (n,): where e and J are taken; `twist` ẋ_d (6,). `detail` (7, n) is written for who wants to
    know more: the law's velocity before any limit of joints, and J. Few arrays, because Numba takes 0.1 µs or more to
    take in each.
    """
    n = at.shape[0]
    chain, law, limits, state, at, position, rotation, twist, feedback, out, detail = borrowed(
        (chain, law, limits, state, at, position, rotation, twist, feedback, out, detail)
    )
    wanted, jacobian = detail[0], detail[1:]
    sigma, slower, by_tool = tool_velocity(
        chain, law, state, limits[LAST], at, position, rotation, twist, feedback, measure, dt, out[2 * n + 6 :],
        jacobian, wanted,
    )  # fmt: skip
    how, scale, joint, limit = bounded_cycle(
        wanted, jacobian, limits, state, reserve, sigma >= AHEAD * law[SCALARS, 3], dt, out
    )
    return how, slower * scale, joint, by_tool if limit == FREE else limit, sigma


@compiled
def tool_velocity(
    chain: Any,
    law: Array,
    state: Array,
    acceleration: Array,
    at: Array,
    position: Array,
    rotation: Array,
    twist: Array,
    feedback: Array,
    measure: bool,
    dt: float,
    error: Array,
    jacobian: Array,
    wanted: Array,
) -> tuple[float, float, int]:
    """Write the law's velocity `wanted` (n,) within the tool's bounds, before any limit of joints, and the J (6, n)
    that it takes; return (σ_min, s, limit) with the tool's bound as the limit.

    `acceleration` (n, and more): the last ones. `error` e (6,) is written where `measure`; the rest as in `tool_cycle`.
    """
    n = at.shape[0]
    middle, tool, turn, pull = scratch(n), scratch(3), scratch_table(3, 3), scratch(6)
    if measure:
        kinematics_pose(chain, at, turn, tool)
        for i in range(3):
            error[i] = position[i] - tool[i]
        rotation_log(rotation, turn, error[3:])
        feedback = times(law[:6, :6], error, scratch(6))
    for j in range(n):
        middle[j] = at[j] + 0.5 * dt * (state[n + j] + dt * acceleration[j])  # as if the acceleration stayed
    kinematics(chain, middle, turn, tool, jacobian)
    threshold = law[SCALARS, 3]
    squares, inverse = gram(jacobian, scratch_table(6, 6)), scratch_table(6, 6)
    sigma = damped_gram_inverse(squares, law[SCALARS, 2], threshold, inverse, int(law[SCALARS, 4]))
    approach = transposed_times(jacobian, times(inverse, feedback, scratch(6)), scratch(n))
    if sigma < 4.0 * threshold:
        for i in range(6):
            pull[i] = feedback[i] / law[SCALARS, 0]
        near = nearness(jacobian, pull, sigma, law[SCALARS, 2], threshold)
        if near > 0.0:
            follow_bend(approach, jacobian, jacobian, feedback, pull, near, law[SCALARS, 2])
    bounded = not tool_is_free(law)
    share = stoppable_share(feedback, law) if bounded else 1.0
    task_velocity(jacobian, inverse, twist, approach, share, law, at, wanted)
    slower, limit = 1.0, FREE
    if bounded:
        slower, limit = bound_tool(wanted, jacobian, inverse, state[2 * n :], state[n : 2 * n], law, dt)
    return sigma, slower, limit


@compiled
def bounded_cycle(
    wanted: Array,
    jacobian: Array,
    limits: Array,
    state: Array,
    reserve: bool,
    ahead: bool,
    dt: float,
    out: Array,
    task: Any = None,
    last: Any = None,
    own: Any = None,
    secondary: Any = None,
    weights: Any = None,
) -> tuple[int, float, int, int]:
    """Write the state (2n + 6,) that `wanted` (n,) leads to within the limits; return (how, s, joint, limit).

    J (6, n); the rest as in `tool_cycle`. A `task` (m, n) other than J with its rates of the `last` cycle (m,) is what
    keeps its direction; `own`, `secondary`, `weights` and `ahead` as in `bounded_velocity`.
    """
    n = wanted.shape[0]
    q, v = state[:n], state[n : 2 * n]
    how, scale, joint, limit = 0, 1.0, -1, FREE
    reach = scratch(2 * n)
    velocity_interval(q, v, dt, limits, reserve, reach)
    velocity = wanted
    if not within(wanted, reach):
        excess, speeds, low = 0.0, scratch(n), scratch(n)
        for j in range(n):
            if not math.isfinite(wanted[j]):
                return NOT_FINITE, 0.0, j, FREE
            speeds[j] = max(limits[VELOCITY, j], limits[VELOCITY, n + j])  # one is 0 for a joint outside its bounds
            over = max(wanted[j] - reach[j], -wanted[j] - reach[n + j]) / speeds[j]
            if over > excess:
                excess, joint = over, j
        if excess > 0.0:
            limit = held_by(joint, wanted[joint], v, dt, limits, reach)
        velocity, step, motion = scratch(n), scratch(n), scratch_table(3, n)
        for j in range(n):
            low[j] = -reach[n + j]
            step[j] = limits[ACCELERATION, j] * dt
            motion[0, j], motion[1, j], motion[2, j] = v[j], limits[LAST, j] * dt, limits[JERK, j] * dt * dt
        rows, bounds = scratch_table(0, n), scratch(0)  # obstacles have a problem of their own
        if task is None:
            scale, how = bounded_velocity(
                wanted, jacobian, state[2 * n :], low, reach[:n], speeds, step, rows, bounds, velocity, None, None,
                None, motion, ahead,
            )  # fmt: skip
        else:
            scale, how = bounded_velocity(
                wanted, task, last, low, reach[:n], speeds, step, rows, bounds, velocity, own, secondary, weights,
                motion, ahead,
            )  # fmt: skip
    for j in range(n):
        out[j] = q[j] + dt * velocity[j]
        out[n + j] = velocity[j]
    for i in range(6):
        total = 0.0
        for j in range(n):
            total += jacobian[i, j] * velocity[j]
        out[2 * n + i] = total
    return how, scale, joint, limit
