"""The numbers of one cycle: functions of arrays alone, compiled by Numba where it is installed; one source.

n joints; J (6, n); arrays are float64. The formulas are explained where they belong: the law in `law`, the interval in
`limits`, the damping in `damped_inverse`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.damped_inverse import damped_gram_inverse
from ik_controller.kinematics.levenberg_marquardt import kinematics, rotation_log
from ik_controller.kinematics.rotation_exp import rotation_exp
from ik_controller.kinematics.small import gram, times, transposed_times

Array = NDArray[np.float64]

ENDLESS = 1e18  # room ahead of a joint without bounds [rad or m]
# Near a singularity the feedback K e is slowed as a whole to these speeds of the tool along any axis.
FASTEST_APPROACH = 1.5  # [m/s]
FASTEST_TURN = 3.0  # [rad/s]


@compiled
def velocity_interval(q: Array, v: Array, dt: float, bounds: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the velocities (2n,) that each joint may reach upward (first n) and downward (last n, negated).

    q, v (n,): the commanded state; dt [s]; `bounds` (2n,): upper limits, then negated lower ones; `velocity`,
    `acceleration` (2n,): the limits, twice.
    """
    n = q.shape[0]
    reach = np.empty(2 * n)
    for i in range(2 * n):
        sign, joint = (1.0, i) if i < n else (-1.0, i - n)
        speed, a = sign * v[joint], acceleration[i]
        room = min(max(bounds[i] - sign * q[joint], 0.0), ENDLESS)
        # a (√(dt² + 2 room/a) − dt) in the form that loses no digits near the bound and serves an infinite a too.
        far = (2.0 * room) / (math.sqrt(dt * dt + (2.0 * room) / a) + dt)
        # Rounding may ask for a little more than the room: never step over the bound.
        far = min(min(far, room * (1.0 / dt)), velocity[i])
        # Acceleration comes last: it always holds; the others do as long as they held before (or shrink to it).
        step = a * dt
        reach[i] = min(max(far, speed - step), speed + step)
    return reach


@compiled
def within(wanted: Array, reach: Array) -> bool:
    """Tell whether a velocity (n,) is in a `velocity_interval` (2n,); one that is not finite never is."""
    n = wanted.shape[0]
    for i in range(n):  # noqa: SIM110 (Numba compiles no generators)
        if not (wanted[i] <= reach[i] and -wanted[i] <= reach[n + i]):
            return False
    return True


@compiled
def braking_factor(approach: Array, fastest: float, acceleration: Array) -> float:
    """Return β ≤ 1 for the feedback velocity (n,): with r = max K |q̇|/a, √(2r − 1)/r where r > 1."""
    ratio = 0.0
    for i in range(approach.shape[0]):
        ratio = max(ratio, fastest * abs(approach[i]) / acceleration[i])
    if ratio > 1.0:
        return math.sqrt(2.0 * ratio - 1.0) / ratio
    return 1.0


@compiled
def unhurried(feedback: Array, sigma: float, threshold: float) -> Array:
    """Return K e (6,), slowed while σ_min is below 4 ε, and in full below 2 ε.

    A target beyond reach has a large e for good: J⁺ K e then changes sign at the stretched arm faster than the joints
    can brake, and throws the arm through the singularity again and again.
    """
    if sigma >= 4.0 * threshold:
        return feedback
    near = min(2.0 - 0.5 * sigma / threshold, 1.0)
    haste = max(np.max(np.abs(feedback[:3])) / FASTEST_APPROACH, np.max(np.abs(feedback[3:])) / FASTEST_TURN, 1.0)
    slowed: Array = feedback / (1.0 + near * (haste - 1.0))
    return slowed


@compiled
def task_velocity(
    jacobian: Array,
    inverse: Array,
    feed_forward: Array,
    feedback: Array,
    fastest: float,
    braking: Array,
    seek: Array,
    seek_limit: Array,
) -> Array:
    """Return J⁺(ẋ_d + β K e) + (I − J⁺J) q̇₀ (n,), with J⁺ = Jᵀ · `inverse`.

    `feed_forward` ẋ_d and `feedback` K e (6,); `fastest` the largest eigenvalue of K; `braking` (n,) the accelerations
    that β plans with; `seek` (n,) = q̇₀, slowed as a whole to stay below `seek_limit` (n,).
    """
    approach = transposed_times(jacobian, times(inverse, feedback))
    null = seek / max(np.max(np.abs(seek) / seek_limit), 1.0)
    steady = null + transposed_times(jacobian, times(inverse, feed_forward - times(jacobian, null)))
    return steady + braking_factor(approach, fastest, braking) * approach


@compiled
def tool_cycle(
    chain: Any,
    at: Array,
    pose: tuple[Array, Array],
    measure: bool,
    feedback: Array,
    feed_forward: Array,
    law: tuple[Array, float, Array, Array, float, Array, float, float],
    q: Array,
    v: Array,
    dt: float,
    limits: tuple[Array, Array, Array],
    work: tuple[Array, Array],
    error: Array,
    command: Array,
) -> tuple[bool, float]:
    """Write one cycle towards a tool reference; return (fits, σ_min).

    `command` (2, n): the law's velocity, and the position it leads to; `fits`: that velocity is in the
    `velocity_interval`, the second of `work`, J (6, n) and (2n,). `error` e (6,) and K e are worked out where
    `measure`, else K e is `feedback`. `chain` as `kinematics` takes it; `at` (n,): where e and J are taken; `pose`
    (position (3,), rotation (3, 3)) of the reference; `law`: K (6, 6), its largest eigenvalue, braking accelerations
    (n,), posture (n,), its gain, seek limits (n,), λ, ε; `limits`: bounds, velocities, accelerations, (2n,) each. What
    is written is passed in because Numba takes an array in ten times faster than it gives one back.
    """
    gain, fastest, braking, posture, posture_gain, seek_limit, damping, threshold = law
    jacobian, reach = work
    rotation, position = np.empty((3, 3)), np.empty(3)
    if measure:
        kinematics(chain, at, rotation, position, jacobian)
        error[:3] = pose[0] - position
        rotation_log(pose[1], rotation, error[3:])
        feedback = times(gain, error)
    kinematics(chain, at + (0.5 * dt) * v, rotation, position, jacobian)
    inverse, sigma = damped_gram_inverse(gram(jacobian), damping, threshold)
    feedback = unhurried(feedback, sigma, threshold)
    seek = posture_gain * (posture - at)
    wanted = task_velocity(jacobian, inverse, feed_forward, feedback, fastest, braking, seek, seek_limit)
    reach[:] = velocity_interval(q, v, dt, limits[0], limits[1], limits[2])
    command[0] = wanted
    command[1] = q + dt * wanted
    return within(wanted, reach), sigma


@compiled
def carry_on(
    position: Array, rotation: Array, twist: Array, rate: Array, ahead: float, dt: float, pose: Array, mean: Array
) -> None:
    """Write where a pose is after `ahead` [s] of a twist (6,) that changes at `rate` (6,), and its mean over the next
    dt.

    `pose` (4, 3): rotation over position; `mean` (6,).
    """
    way = ahead * twist + (0.5 * ahead * ahead) * rate
    rotation_exp(way[3:], rotation, pose)
    pose[3] = position + way[:3]
    mean[:] = twist + (ahead + 0.5 * dt) * rate


@compiled
def agreed_rate(v0: Array, v1: Array, v2: Array, dt1: float, dt2: float) -> Array:
    """Return the rate (6,) of three twists, dt1 and dt2 [s] apart: by component the smaller of the two differences, 0
    where they disagree in sign (minmod).
    """
    rate = np.zeros(6)
    for i in range(6):
        older, newer = (v1[i] - v0[i]) / dt1, (v2[i] - v1[i]) / dt2
        if older * newer > 0.0:
            rate[i] = older if abs(older) < abs(newer) else newer
    return rate
