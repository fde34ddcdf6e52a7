"""Levenberg–Marquardt descent to a pose within joint limits: the iteration of the solver's "damped" method (N7, N12).

It minimizes F(q) = ½ |e|², e = (p_d − p, log(R_d Rᵀ)), metres and radians alike, by

    Δq = (JᵀJ + λ I)⁻¹ Jᵀe,    λ = σ · (c F + ε),

damping that fades with the error (Chan and Lawrence 1988; Sugihara 2011): strong far away, gone at the solution, so
that the last steps are Newton's and a singular goal is still reached. σ is 1; where `careful`, a step that does not
lower F is taken back and σ raised, which finds the closest point to a pose out of reach. A joint at its limit that
would move beyond it is left out of the step; one that steps over a limit goes a full turn back where that is within its
limits, and else stays at the limit.

One source runs compiled by Numba or as Python; three primitives of the loop are then Pinocchio's and NumPy's.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import HAS_NUMBA, compiled
from ik_controller.kinematics.chain import (
    PinocchioChain,
    chain_kinematics,
    chain_pose,
    model_kinematics,
    model_pose,
    table_of,
)
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.scratch import borrowed, scratch, scratch_table

Array = NDArray[np.float64]

DAMPING = 0.1  # c, by trial on arms of 6 and 7 joints: 0.03 to 0.3 serve as well
DAMPING_FLOOR = 1e-9  # ε: keeps the matrix positive definite at a singular goal
PATIENCE = 5  # an attempt that does not halve F in so many iterations is given up
CAREFUL_PATIENCE = 40

# How an attempt ended.
CONVERGED, STATIONARY, SLOW = 0, 1, 2


@compiled
def rotation_log_kernel(desired: Array, rotation: Array, out: Array) -> None:
    """Write log(R_d Rᵀ) (3,) [rad], the rotation vector in base axes from R to R_d, finite and shortest near π."""
    d = scratch_table(3, 3)
    for i in range(3):
        for j in range(3):
            d[i, j] = desired[i, 0] * rotation[j, 0] + desired[i, 1] * rotation[j, 1] + desired[i, 2] * rotation[j, 2]
    x, y, z = 0.5 * (d[2, 1] - d[1, 2]), 0.5 * (d[0, 2] - d[2, 0]), 0.5 * (d[1, 0] - d[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(sine, 0.5 * (d[0, 0] + d[1, 1] + d[2, 2] - 1.0))
    if angle < 3.1:
        scale = 1.0 if sine < 1e-12 else angle / sine
        out[0], out[1], out[2] = scale * x, scale * y, scale * z
        return
    # Near π the sine is lost in round-off; the axis a is a column of ½(D + Dᵀ) − cos·I = (1 − cos) aaᵀ.
    largest = 0
    for i in range(1, 3):
        if d[i, i] > d[largest, largest]:
            largest = i
    cosine = math.cos(angle)
    norm = 0.0
    for i in range(3):
        out[i] = 0.5 * (d[i, largest] + d[largest, i]) - (cosine if i == largest else 0.0)
        norm += out[i] * out[i]
    scale = angle / math.sqrt(norm)
    if out[0] * x + out[1] * y + out[2] * z < 0.0:
        scale = -scale
    for i in range(3):
        out[i] *= scale


@compiled
def damped_step_kernel(jacobian: Array, gradient: Array, free: NDArray[np.bool_], damping: float, step: Array) -> None:
    """Write (JᵀJ + λI)⁻¹ Jᵀe over the free joints, 0 for the others, by Cholesky; `gradient` is Jᵀe (n,)."""
    rows, n = jacobian.shape
    a = scratch_table(n, n)
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            if free[i] and free[j]:
                for row in range(rows):
                    total += jacobian[row, i] * jacobian[row, j]
            a[i, j] = total
        a[i, i] = a[i, i] + damping if free[i] else 1.0
    for j in range(n):
        total = a[j, j]
        for k in range(j):
            total -= a[j, k] * a[j, k]
        a[j, j] = math.sqrt(total)
        for i in range(j + 1, n):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = total / a[j, j]
    for i in range(n):
        total = gradient[i] if free[i] else 0.0
        for k in range(i):
            total -= a[i, k] * step[k]
        step[i] = total / a[i, i]
    for i in range(n - 1, -1, -1):
        total = step[i]
        for k in range(i + 1, n):
            total -= a[k, i] * step[k]
        step[i] = total / a[i, i]


def rotation_log_pinocchio(desired: Array, rotation: Array, out: Array) -> None:
    """Write the same as `rotation_log_kernel`, by Pinocchio."""
    out[:] = pin.log3(desired @ rotation.T)


def damped_step_numpy(jacobian: Array, gradient: Array, free: NDArray[np.bool_], damping: float, step: Array) -> None:
    """Write the same as `damped_step_kernel`, by LAPACK."""
    active = jacobian * free
    normal = active.T @ active
    normal[np.diag_indices_from(normal)] += np.where(free, damping, 1.0)
    step[:] = np.linalg.solve(normal, gradient * free)


if HAS_NUMBA:
    kinematics, rotation_log, damped_step = chain_kinematics, rotation_log_kernel, damped_step_kernel
    kinematics_pose = chain_pose
else:
    kinematics, rotation_log, damped_step = model_kinematics, rotation_log_pinocchio, damped_step_numpy  # type: ignore[assignment]
    kinematics_pose = model_pose  # type: ignore[assignment]


def solver_chain(model: RobotModel) -> Any:
    """Return what `descend` takes as its chain: a table where it is compiled, else a Pinocchio model."""
    return table_of(model) if HAS_NUMBA else PinocchioChain(model)


@compiled
def select_axes(frame: Array, axes: Array, error: Array, jacobian: Array) -> None:
    """Turn error (6,) and Jacobian (6, n) into `frame` (3, 3) and clear the rows whose entry of `axes` (6,) is 0.

    The rows of a rotation vector φ of which some are cleared need its exact rate −J_r⁻¹(φ) ω, not only ω.
    """
    n = jacobian.shape[1]
    rotation_axes = axes[3] + axes[4] + axes[5]
    if 0.0 < rotation_axes < 3.0:
        x, y, z = error[3], error[4], error[5]
        angle2 = x * x + y * y + z * z
        angle = math.sqrt(angle2)
        k = 1.0 / 12.0 if angle < 1e-4 else (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / angle2
        rest = 1.0 - k * angle2
        for j in range(n):
            # J_r⁻¹(φ) ω = ω + ½ φ×ω + k φ×(φ×ω), and φ×(φ×ω) = φ(φ·ω) − φ²ω
            a, b, c = jacobian[3, j], jacobian[4, j], jacobian[5, j]
            along = k * (x * a + y * b + z * c)
            jacobian[3, j] = rest * a + 0.5 * (y * c - z * b) + x * along
            jacobian[4, j] = rest * b + 0.5 * (z * a - x * c) + y * along
            jacobian[5, j] = rest * c + 0.5 * (x * b - y * a) + z * along
    for top in (0, 3):
        x, y, z = error[top], error[top + 1], error[top + 2]
        for i in range(3):
            error[top + i] = axes[top + i] * (frame[0, i] * x + frame[1, i] * y + frame[2, i] * z)
        for j in range(n):
            a, b, c = jacobian[top, j], jacobian[top + 1, j], jacobian[top + 2, j]
            for i in range(3):
                jacobian[top + i, j] = axes[top + i] * (frame[0, i] * a + frame[1, i] * b + frame[2, i] * c)


@compiled
def into_limits(q: Array, lower: Array, upper: Array, prismatic: NDArray[np.bool_]) -> None:
    """Bring q (n,) within its limits: by a full turn where that does it, else to the nearest limit."""
    turn = 2.0 * math.pi
    for i in range(q.shape[0]):
        value = q[i]
        if value > upper[i]:
            shifted = value - turn * math.ceil((value - upper[i]) / turn)
            q[i] = shifted if shifted >= lower[i] and not prismatic[i] else upper[i]
        elif value < lower[i]:
            shifted = value + turn * math.ceil((lower[i] - value) / turn)
            q[i] = shifted if shifted <= upper[i] and not prismatic[i] else lower[i]


@compiled
def descend(
    chain: Any,
    rotation_d: Array,
    position_d: Array,
    axes: Array,
    frame: Array,
    lower: Array,
    upper: Array,
    prismatic: NDArray[np.bool_],
    step_size: Array,
    clamp: float,
    position_tolerance: float,
    orientation_tolerance: float,
    iterations: int,
    careful: bool,
    q: Array,
    history: Array,
) -> tuple[int, int, float, float]:
    """Descend from q (n,), in place; return how it ended, iterations, position error [m], orientation error [rad].

    `axes` (6,) 1 or 0 for each of x y z and the rotations about them, along the columns of `frame` (3, 3);
    `step_size` (n,) scales Δq and `clamp` [rad or m] is the most a joint moves in an iteration; `history`
    (iterations + 1 or 0, n + 2) takes q and the two errors of every iteration.
    """
    chain, rotation_d, position_d, axes, frame, lower, upper, prismatic, step_size, q, history = borrowed(
        (chain, rotation_d, position_d, axes, frame, lower, upper, prismatic, step_size, q, history)
    )
    n = q.shape[0]
    rotation, position, jacobian = scratch_table(3, 3), scratch(3), scratch_table(6, n)
    error, step, gradient = scratch(6), scratch(n), scratch(n)
    free = np.ones(n, dtype=np.bool_)
    q_before, jacobian_before = scratch(n), scratch_table(6, n)
    all_axes = axes[0] + axes[1] + axes[2] + axes[3] + axes[4] + axes[5] == 6.0
    into_limits(q, lower, upper, prismatic)
    cost_before, position_error, orientation_error = math.inf, math.inf, math.inf
    sigma = 1.0
    milestone, milestone_k = math.inf, 0
    for k in range(iterations + 1):
        kinematics(chain, q, rotation, position, jacobian)
        for i in range(3):
            error[i] = position_d[i] - position[i]
        rotation_log(rotation_d, rotation, error[3:])
        if not all_axes:
            select_axes(frame, axes, error, jacobian)
        linear = error[0] * error[0] + error[1] * error[1] + error[2] * error[2]
        angular = error[3] * error[3] + error[4] * error[4] + error[5] * error[5]
        cost = 0.5 * (linear + angular)
        if careful and cost >= cost_before:  # take the step back
            sigma *= 8.0
            q[:] = q_before
        else:
            sigma = max(0.25 * sigma, 1e-3) if careful else 1.0
            position_error, orientation_error, cost_before = math.sqrt(linear), math.sqrt(angular), cost
            q_before[:] = q
            jacobian_before[:] = jacobian
            for i in range(n):
                gradient[i] = 0.0
                for row in range(6):
                    gradient[i] += jacobian[row, i] * error[row]
        if history.shape[0] > 0:
            history[k, :n] = q
            history[k, n], history[k, n + 1] = position_error, orientation_error
        if position_error <= position_tolerance and orientation_error <= orientation_tolerance:
            return CONVERGED, k, position_error, orientation_error
        slope = 0.0
        for i in range(n):
            outward = (q[i] <= lower[i] and gradient[i] < 0.0) or (q[i] >= upper[i] and gradient[i] > 0.0)
            free[i] = not outward
            if not outward:
                slope += gradient[i] * gradient[i]
        if slope <= 2e-18 * cost_before or sigma > 1e12:
            return STATIONARY, k, position_error, orientation_error
        if cost_before < 0.5 * milestone or (careful and cost_before < (1.0 - 1e-9) * milestone):
            milestone, milestone_k = cost_before, k
        elif k - milestone_k >= (CAREFUL_PATIENCE if careful else PATIENCE):
            return SLOW, k, position_error, orientation_error
        if k == iterations:
            break
        damped_step(jacobian_before, gradient, free, sigma * (DAMPING * cost_before + DAMPING_FLOOR), step)
        most = 0.0
        for i in range(n):
            step[i] *= step_size[i]
            most = max(most, abs(step[i]))
        scale = clamp / most if most > clamp else 1.0
        for i in range(n):
            q[i] += scale * step[i]
        into_limits(q, lower, upper, prismatic)
    return SLOW, iterations, position_error, orientation_error
