"""The closest approach to a target that lies beyond joints' position bounds: sliding along the bounds.

Where joints stand at their bounds, those that are left may be as good as singular for the wanted direction: the tool
then creeps along it or not at all while they race. There, and only towards a pose, the direction is given up for

    minimize  ½ q̇ᵀM q̇ − q̇ᵀJᵀ(ẋ_d + K e)   subject to the joints' speed and position bounds,

M as in `curvature`. q̇ = 0 solves that exactly where no joint within its bounds can bring the tool nearer to the target
(in metres and radians, weighted by K), so the arm comes to rest there; on the way the error only falls. By the smallest
singular value σ of what the free joints can do, the direction leads over to this: not at all above 4 ε, in full below
2 ε. It is left as soon as the target leads inward again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.curvature import bend, curved_squares, nearness
from ik_controller.control.kernel import BRAKING, SCALARS, braking_factor
from ik_controller.control.least_distance import least_distance
from ik_controller.control.reach import ENDLESS, NEAR

Array = NDArray[np.float64]

_DAMPING = 1e-3  # λ
_TOLERANCE = 1e-12


def slide(
    axes: Array,
    jacobian: Array,
    task_velocity: Array,
    wanted: Array,
    room: Array,
    speed: Array,
    law: Array,
    dt: float,
) -> tuple[Array, float, int]:
    """Return the velocity (n,) of the closest approach before accelerations are looked at, the share in which it is to
    be taken, and the joint at its bound that keeps the tool back most, −1 where none does.

    J (6, n); `axes` (m, 6) of the tool that are to move, at `task_velocity` ẋ_d + K e (m,); `wanted` (n,): the
    velocity that keeps the direction; `room` (2n,): way to the upper bounds, then to the lower ones; `speed`: velocity
    limits (n,); `law`: its table.
    """
    n = speed.size
    task, braking = axes @ jacobian, law[BRAKING : BRAKING + 2, :n]
    fastest, damping, threshold, rank = law[SCALARS, [0, 2, 3, 4]]
    room = np.clip(room, 0.0, ENDLESS)
    twice = np.concatenate((braking[0], braking[0]))
    stoppable = 2.0 * room / (np.sqrt(dt * dt + 2.0 * room / twice) + dt)  # as in `kernel.fastest_stoppable`
    stoppable = np.fmin(stoppable, room / dt)
    most = np.fmin(stoppable / np.concatenate((speed, speed)), 1.0)
    if not (most < NEAR).any():
        return np.zeros(n), 0.0, -1
    error = axes.T @ task_velocity / fastest
    squares = curved_squares(task, bend(jacobian, error, np.empty((n, n))), _DAMPING, np.empty((n, n)))
    factor = np.linalg.inv(np.linalg.cholesky(squares * np.outer(speed, speed)))
    free = factor.T @ (factor @ (speed * (task.T @ task_velocity)))
    rest = np.zeros(n)
    if not least_distance(
        np.ascontiguousarray(factor.T), -most[n:] - free, most[:n] - free, _TOLERANCE * (1.0 + abs(free).max()), rest
    ):
        return np.zeros(n), 1.0, int(most.argmin()) % n
    velocity: Array = np.clip(free + factor.T @ rest, -most[n:], most[:n])
    # A joint counts the less the nearer it stands to a bound that the direction leads it to.
    lead = wanted / speed
    lead = lead / max(float(np.abs(lead).max()), 1e-300)
    outward = np.fmin(most[:n] + np.fmax(-lead, 0.0), most[n:] + np.fmax(lead, 0.0))
    freedom = np.fmin(outward / NEAR, 1.0)
    values = np.linalg.svd(task * freedom, compute_uv=False)
    directions = int(min(rank, len(task)))
    sigma = values.item(directions - 1) if values.size >= directions else 0.0
    share = nearness(jacobian, error, sigma, damping, threshold)
    velocity = velocity * speed
    return velocity * braking_factor(velocity, float(fastest), braking), share, int(outward.argmin())
