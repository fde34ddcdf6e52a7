"""Integration of q̇ = J⁺(ẋ_d + K e) over time: Euler, midpoint, RK4, open and closed loop (notes N10, N13; 000, 004).

In open loop (no gain) the steps' errors add up: the tool drifts away from the reference, the slower the higher the
order of the method. Feedback K e with the pose error e takes the drift back at the rate K. With ẋ_d = 0 and K = 1/dt
one Euler step is Whitney's resolved motion rate, q⁺ = q + J⁻¹ δx.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.checks import Array, check_array, check_choice, check_number
from ik_controller.kinematics.inverses import inverse as inverse_by_name
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.orientation_error import orientation_error

Velocity = Callable[[float, Array], Array]
"""A joint velocity (n,) of time [s] and q (n,)."""

Inverse = Callable[[Array], Array]
"""An inverse (n, m) of a Jacobian (m, n)."""


def euler(f: Velocity, t: float, q: Array, dt: float) -> Array:
    """Return q (n,) after one explicit Euler step: order 1 (000)."""
    return q + dt * f(t, q)


def midpoint(f: Velocity, t: float, q: Array, dt: float) -> Array:
    """Return q (n,) after one midpoint (RK2) step: order 2."""
    return q + dt * f(t + 0.5 * dt, q + 0.5 * dt * f(t, q))


def rk4(f: Velocity, t: float, q: Array, dt: float) -> Array:
    """Return q (n,) after one classical Runge-Kutta step: order 4."""
    k1 = f(t, q)
    k2 = f(t + 0.5 * dt, q + 0.5 * dt * k1)
    k3 = f(t + 0.5 * dt, q + 0.5 * dt * k2)
    k4 = f(t + dt, q + dt * k3)
    return q + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


METHODS = {"euler": euler, "midpoint": midpoint, "rk4": rk4}


@dataclass(frozen=True)
class Motion:
    """An integrated motion of k steps: `t` (k+1,) [s], `q` (k+1, n) [rad or m], `error` (k+1, 6) [m, rad] or None."""

    t: Array
    q: Array
    error: Array | None


def pose_error(model: RobotModel, q: ArrayLike, target: Any, orientation: str = "exponential_base") -> Array:
    """Return e (6,) = target − tool pose at q (n,): position [m] and orientation error [rad] by name (000).

    `target`: `pin.SE3` in the base frame. Raises ArgumentError: q of another shape, unknown error name.
    """
    here = model.forward(check_array(q, "q", (model.n,)))
    error = orientation_error(orientation)
    return np.concatenate((target.translation - here.translation, error(target.rotation, here.rotation)))


def joint_velocity(
    model: RobotModel,
    twist: Callable[[float], ArrayLike] | None = None,
    reference: Callable[[float], Any] | None = None,
    *,
    gain: ArrayLike = 0.0,
    inverse: str | Inverse = "pseudo",
    orientation: str = "exponential_base",
) -> Velocity:
    """Return f(t, q) = J#(q) (ẋ_d(t) + K e(t, q)) (n,), the law N11 in continuous time, without null-space term.

    `twist`: ẋ_d(t) (6,) = (v, ω) [m/s, rad/s] in the base frame, none for 0. `reference`: the pose at t as `pin.SE3`,
    needed for a gain. `gain` K [1/s]: a number, 6 values or (6, 6), positive definite or 0 for open loop. `inverse`: a
    name of `INVERSES` or a function J (6, n) → J# (n, 6). `orientation`: a name of `ORIENTATION_ERRORS`; its E⁺ or R is
    applied to K e. Raises ArgumentError: K not positive definite, a gain without a reference, unknown names.
    """
    K = _gain(gain)
    if K is not None and reference is None:
        raise ArgumentError("gain: feedback needs a reference pose")
    error = orientation_error(orientation)
    invert: Inverse = inverse if callable(inverse) else lambda J: inverse_by_name(J, inverse)

    def velocity(t: float, q: Array) -> Array:
        xdot = np.zeros(6) if twist is None else check_array(twist(t), "twist(t)", (6,)).copy()
        if K is not None and reference is not None:
            correction = K @ pose_error(model, q, reference(t), orientation)
            xdot[:3] += correction[:3]
            xdot[3:] += error.to_angular_velocity(correction[3:], model.forward(q).rotation)
        qdot: Array = invert(model.jacobian(q)) @ xdot
        return qdot

    return velocity


def integrate(f: Velocity, q0: ArrayLike, duration: float, dt: float, method: str = "euler") -> tuple[Array, Array]:
    """Return times (k+1,) [s] and q (k+1, n) of q̇ = f(t, q) from q0 (n,) over `duration` in equal steps near `dt` [s].

    `method`: "euler", "midpoint" or "rk4". Raises ArgumentError: unknown method, duration or dt not positive.
    """
    step = METHODS[check_choice(method, "integration method", METHODS)]
    total = check_number(duration, "duration", minimum=0.0, exclusive=True)
    steps = max(1, round(total / check_number(dt, "dt", minimum=0.0, exclusive=True)))
    h = total / steps
    q = np.empty((steps + 1, len(check_array(q0, "q0", (None,)))))
    q[0] = np.asarray(q0, dtype=float)
    t: Array = np.arange(steps + 1, dtype=np.float64) * h
    for k in range(steps):
        q[k + 1] = step(f, float(t[k]), q[k], h)
    return t, q


def follow(
    model: RobotModel,
    q0: ArrayLike,
    duration: float,
    dt: float,
    *,
    twist: Callable[[float], ArrayLike] | None = None,
    reference: Callable[[float], Any] | None = None,
    gain: ArrayLike = 0.0,
    method: str = "euler",
    inverse: str | Inverse = "pseudo",
    orientation: str = "exponential_base",
) -> Motion:
    """Return the motion from q0 (n,) that follows a twist, a reference or both: open loop with gain 0, else closed.

    Arguments as in `joint_velocity` and `integrate`; `Motion.error` is there where a reference is. (N10, 000)
    """
    f = joint_velocity(model, twist, reference, gain=gain, inverse=inverse, orientation=orientation)
    t, q = integrate(f, check_array(q0, "q0", (model.n,)), duration, dt, method)
    if reference is None:
        return Motion(t, q, None)
    error = [pose_error(model, qk, reference(float(tk))) for tk, qk in zip(t, q, strict=True)]
    return Motion(t, q, np.array(error))


def resolved_rate_step(model: RobotModel, q: ArrayLike, dx: ArrayLike, inverse: str | Inverse = "pseudo") -> Array:
    """Return q⁺ = q + J#(q) δx (n,): Whitney's resolved motion rate (N13, 004 p. 41).

    `q` (n,); `dx` (6,): small displacement of the tool, translation [m] and rotation [rad] in the base frame.
    """
    values = check_array(q, "q", (model.n,))
    J = model.jacobian(values)
    J_sharp = inverse(J) if callable(inverse) else inverse_by_name(J, inverse)
    moved: Array = values + J_sharp @ check_array(dx, "dx", (6,))
    return moved


def resolved_rate(
    model: RobotModel, q0: ArrayLike, target: Any, steps: int = 10, inverse: str | Inverse = "pseudo"
) -> Array:
    """Return q (steps+1, n) that takes the tool straight from its pose at q0 (n,) to `target` (`pin.SE3`) (N13).

    Each step takes an equal share of what is left, so that the errors of earlier steps are made up for. Raises
    ArgumentError: steps < 1.
    """
    if steps < 1:
        raise ArgumentError(f"steps: need at least 1, got {steps}")
    q = [check_array(q0, "q0", (model.n,))]
    for left in range(steps, 0, -1):
        q.append(resolved_rate_step(model, q[-1], pose_error(model, q[-1], target) / left, inverse))
    return np.array(q)


def _gain(gain: ArrayLike) -> Array | None:
    """Return K (6, 6), or None for open loop."""
    values = np.asarray(gain, dtype=float)
    if not np.isfinite(values).all() or values.shape not in ((), (6,), (6, 6)):
        raise ArgumentError("gain: need a finite number, 6 values or a (6, 6) matrix")
    if not values.any():
        return None
    K: Array = values if values.ndim == 2 else np.diag(np.broadcast_to(values, 6))
    if np.linalg.eigvalsh(0.5 * (K + K.T))[0] <= 0.0:
        raise ArgumentError("gain: must be positive definite")
    return K
