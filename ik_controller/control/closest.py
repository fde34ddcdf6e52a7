"""The closest approach to a target that lies beyond a joint's position bound: sliding along the bound.

Where a joint stands at its bound, the wanted velocity leads it further, and redundancy cannot help, the tool cannot
move in the wanted direction at all: s = 0. Then, and only then, and only towards a pose, the direction is given up for

    minimize  ‖J q̇ − (ẋ_d + K e)‖² + c ‖D q̇‖²   subject to the joints' speed and position bounds.

q̇ = 0 solves that exactly where no joint within its bounds can bring the tool nearer to the target (in metres and
radians, weighted by K), so the arm comes to rest there; on the way the error only falls. It leaves as soon as the
wanted velocity leads inward again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.kernel import braking_factor
from ik_controller.control.least_distance import least_distance
from ik_controller.control.reach import ENDLESS

Array = NDArray[np.float64]

_WEIGHT = 1e-6  # c
_TOLERANCE = 1e-12
_AT_BOUND = 1e-9  # of the speed limit


def blocked(jacobian: Array, task_velocity: Array, low: Array, high: Array, speed: Array) -> int:
    """Return the joint at its bound that `task_velocity` (6,) would lead further, −1 where there is none.

    `jacobian` J (6, n); `low`, `high` (n,): the velocities that the joints may take; `speed` (n,): their limits.
    """
    wanted = np.linalg.pinv(jacobian, rcond=1e-6) @ task_velocity
    further = np.where(wanted > 0.0, high <= _AT_BOUND * speed, low >= -_AT_BOUND * speed) & (wanted != 0.0)
    return int(np.argmax(np.where(further, np.abs(wanted) / speed, -1.0))) if further.any() else -1


def slide(
    jacobian: Array, task_velocity: Array, room: Array, speed: Array, braking: Array, fastest: float, dt: float
) -> Array:
    """Return the velocity (n,) of the closest approach, before accelerations are looked at.

    J (6, n); `task_velocity` ẋ_d + K e (6,); `room` (2n,): way to the upper bounds, then to the lower ones; `speed`,
    `braking`: velocity limits (n,), and the table of `braking_factor`; `fastest`: largest rate of K.
    """
    n = speed.size
    twice = np.concatenate((braking[0], braking[0]))
    room = np.clip(room, 0.0, ENDLESS)
    stoppable = 2.0 * room / (np.sqrt(dt * dt + 2.0 * room / twice) + dt)  # as in `kernel.fastest_stoppable`
    stoppable = np.fmin(stoppable, room / dt)
    most = np.fmin(stoppable / np.concatenate((speed, speed)), 1.0)
    task = jacobian * speed
    factor = np.linalg.inv(np.linalg.cholesky(task.T @ task + _WEIGHT * np.eye(n)))
    free = factor.T @ (factor @ (task.T @ task_velocity))
    rest = np.zeros(n)
    if not least_distance(
        np.ascontiguousarray(factor.T), -most[n:] - free, most[:n] - free, _TOLERANCE * (1.0 + abs(free).max()), rest
    ):
        return np.zeros(n)
    velocity: Array = np.clip(free + factor.T @ rest, -most[n:], most[:n]) * speed
    return velocity * braking_factor(velocity, fastest, braking)
