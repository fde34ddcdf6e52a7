"""The notes' iterations, θ ← θ + Λ J⁺(θ) e and θ ← θ + Λ Jᵀ(θ) e, as they are printed (N7, from 000/003, 001, 002).

`newton` takes any inverse of N5 by name in the place of J⁺: damped ones pass a singularity with bounded steps (N12).
`transpose` is steepest descent of ½ |e|², slower, and needs no inverse. Either may get its step clamped, and its joints
kept within their limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.chain import PinocchioChain, model_kinematics
from ik_controller.kinematics.inverses import inverse
from ik_controller.kinematics.levenberg_marquardt import CONVERGED, SLOW, STATIONARY, into_limits
from ik_controller.kinematics.solution import Iterate
from ik_controller.kinematics.task import Task

Array = NDArray[np.float64]


def newton(name: str, options: Mapping[str, Any]) -> Callable[[Array, Array], Array]:
    """Return the step rule J# e by the name and options of an inverse (N5)."""

    def rule(jacobian: Array, error: Array) -> Array:
        move: Array = inverse(jacobian, name, **options) @ error
        return move

    return rule


def transpose(jacobian: Array, error: Array) -> Array:
    """Return the step Jᵀ e (n,)."""
    move: Array = jacobian.T @ error
    return move


def iterate(
    chain: PinocchioChain,
    task: Task,
    rule: Callable[[Array, Array], Array],
    q: Array,
    *,
    step: Callable[[int], Array],
    clamp: float,
    tolerance: tuple[float, float],
    iterations: int,
    lower: Array,
    upper: Array,
    history: list[Iterate] | None = None,
    attempt: int = 0,
) -> tuple[int, int, float, float]:
    """Iterate from q (n,), in place; return how it ended, iterations, position error [m], orientation error [rad].

    Where it does not converge, q is the iterate nearest to the pose, not the last.
    `step(k)` gives Λ's diagonal at iteration k; `clamp` [rad or m] is the most a joint moves in an iteration. The
    tolerances hold for the two parts of the task's own error e, as in the notes, and for the pose itself.
    """
    model = chain.model
    rotation, position, jacobian = np.empty((3, 3)), np.empty(3), np.empty((6, model.n))
    rows = task.mask > 0.0
    into_limits(q, lower, upper, model.prismatic)
    best, ended = (math.inf, q.copy(), (math.inf, math.inf)), SLOW
    for k in range(iterations + 1):
        model_kinematics(chain, q, rotation, position, jacobian)
        error, task_jacobian = task.error_and_jacobian(rotation, position, jacobian)
        pose_error = task.pose_error(rotation, position)
        if math.hypot(*pose_error) < best[0]:
            best = (math.hypot(*pose_error), q.copy(), pose_error)
        if history is not None:
            history.append(Iterate(attempt, k, q.copy(), *pose_error))
        small = np.linalg.norm(error[:3]) <= tolerance[0] and np.linalg.norm(error[3:]) <= tolerance[1]
        # A space twist carries the lever arm to the base, and some orientation errors vanish at π too.
        if small and pose_error[0] <= tolerance[0] and pose_error[1] <= tolerance[1]:
            return CONVERGED, k, *pose_error
        gradient = task_jacobian.T @ error
        free = ~(((q <= lower) & (gradient < 0.0)) | ((q >= upper) & (gradient > 0.0)))
        if np.linalg.norm(gradient[free]) <= 1e-9 * np.linalg.norm(error):
            ended = STATIONARY
            break
        if k == iterations:
            break
        move = step(k) * rule(task_jacobian[rows], error[rows])
        most = float(np.abs(move).max())
        if not math.isfinite(most):
            break
        q += move if most <= clamp else move * (clamp / most)
        into_limits(q, lower, upper, model.prismatic)
    q[:] = best[1]
    return ended, k, *best[2]
