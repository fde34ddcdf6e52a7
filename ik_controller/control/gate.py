"""Gate: the last look at every command before it is published; it knows nothing of how the command came about.

Each command is held against the ones published before it and the arm's own limits:

    q, v finite,   q = q_before + v dt,   |v| ≤ V,   |v − v_before| ≤ A dt,   |v − v_before − a_before dt| ≤ J dt²,
    q within the position bounds, or no further outside than before,

each within 1e-9 of the limit plus the rounding of the numbers themselves. Scales are not looked at: they may be lowered
while the arm moves faster.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.interval import stop_braking
from ik_controller.control.plain import PlainCheck
from ik_controller.kinematics.accelerate import HAS_NUMBA, compiled
from ik_controller.kinematics.model import RobotModel

Array = NDArray[np.float64]

_SHARE = 1e-9  # of a limit that a command may be beyond it
_EPSILON = 4.5e-16  # two units in the last place of 1

_PASSED = 0
_REASONS = (
    "",
    "the command of joint '{}' is not finite",
    "the commanded position of joint '{}' does not follow from its velocity",
    "joint '{}' would exceed its velocity limit",
    "joint '{}' would exceed its acceleration limit",
    "joint '{}' would exceed its jerk limit",
    "joint '{}' would leave its position bounds",
)


class Gate:
    """Re-checks commands; `passes` for each one, `braking` for what to command where one did not.

    `memory` (3, n): position, velocity and acceleration of the last command that passed; `limits` (5, n): lower and
    upper bounds, velocity, acceleration and jerk.
    """

    def __init__(self, model: RobotModel) -> None:
        self.limits = np.array(
            [model.lower, model.upper, model.velocity_limit, model.acceleration_limit, model.jerk_limit]
        )
        self._check = check if HAS_NUMBA else PlainCheck(self.limits, check)
        self._names = model.joint_names
        self.memory = np.zeros((3, model.n))

    @property
    def acceleration(self) -> Array:
        """That of the last command that passed (n,)."""
        acceleration: Array = self.memory[2]
        return acceleration

    def start(self, q: Array) -> None:
        """Start at rest at q (n,), the measured position: the first command is exactly that."""
        self.memory[:] = 0.0
        self.memory[0] = q

    def passes(self, q: Array, v: Array, dt: float) -> str:
        """Return "" where a command (n,), (n,), dt [s] after the last one, is fit to publish, and remember it; else why
        it is not.
        """
        verdict = self._check(self.memory, self.limits, q, v, dt)
        if verdict == _PASSED:
            return ""
        joint, reason = divmod(verdict, len(_REASONS))
        return _REASONS[reason].format(self._names[joint])

    def braking(self, dt: float) -> tuple[Array, Array]:
        """Return the command (position (n,), velocity (n,)) that brakes each joint as hard as its limits allow; where
        even that is unfit, the last position, at rest.
        """
        q, v = brake(self.memory, self.limits, dt)
        if check(self.memory, self.limits, q, v, dt) != _PASSED:
            self.start(self.memory[0].copy())
            return self.memory[0].copy(), np.zeros_like(v)
        return q, v


@compiled
def check(memory: Array, limits: Array, q: Array, v: Array, dt: float) -> int:
    """Return 0 and remember the command, or reason + 7 · joint of the first joint that fails; arrays as in `Gate`."""
    n = q.shape[0]
    over, steps = 1.0 + _SHARE, 1.0 / dt
    for i in range(n):
        before, speed = memory[0, i], memory[1, i]
        size = _EPSILON * (abs(q[i]) + abs(before))
        change = v[i] - speed
        jolt = change - memory[2, i] * dt
        fast = _EPSILON * (abs(v[i]) + abs(speed))
        reason = 0
        # Every comparison is written so that one that is not finite fails it.
        if not (abs(q[i]) < np.inf and abs(v[i]) < np.inf):
            reason = 1
        elif not abs(q[i] - before - dt * v[i]) <= _SHARE * dt * abs(v[i]) + size:
            reason = 2
        elif not abs(v[i]) <= limits[2, i] * over:
            reason = 3
        elif not abs(change) <= limits[3, i] * dt * over + fast:
            reason = 4
        elif not abs(jolt) <= limits[4, i] * dt * dt * over + 4.0 * fast:
            reason = 5
        else:
            margin = _SHARE * max(abs(q[i]), 1.0)
            low, high = limits[0, i] - margin, limits[1, i] + margin
            if q[i] > (high if before <= high else before + size) or q[i] < (low if before >= low else before - size):
                reason = 6
        if reason != 0:
            return reason + 7 * i
    for i in range(n):
        memory[2, i] = (v[i] - memory[1, i]) * steps
        memory[0, i], memory[1, i] = q[i], v[i]
    return 0


@compiled
def brake(memory: Array, limits: Array, dt: float) -> tuple[Array, Array]:
    """Return the next command (position (n,), velocity (n,)) of a stop; arrays as in `Gate`."""
    n = memory.shape[1]
    q, v = np.empty(n), np.empty(n)
    for i in range(n):
        speed, unit = memory[1, i], limits[4, i] * dt * dt
        if unit < np.inf:
            most = limits[3, i] * dt / unit
            v[i] = speed - unit * stop_braking(speed / unit, -memory[2, i] * dt / unit, most)
        else:
            step = limits[3, i] * dt
            v[i] = 0.0 if abs(speed) <= step else speed - step if speed > 0.0 else speed + step
        q[i] = memory[0, i] + dt * v[i]
    return q, v
