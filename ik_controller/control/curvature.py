"""The way to a target that may be out of reach: Newton's step, where Gauss and Newton's would be thrown about.

J⁺ K e goes down ½|e|² as if the tool's way were straight. Where e stays large and J is near singular that is all
wrong: at the stretched arm J⁺ K e changes sign faster than joints can brake, and the arm goes through the singularity
again and again. The bend of the way is known from J itself: with columns (v_j, ω_j), for i ≤ j

    ∂v_j/∂q_i = ω_i × v_j,    ∂ω_j/∂q_i = ω_i × ω_j,

so ½|e|² has the second derivatives JᵀJ + C, C_ij = −e·(∂J_j/∂q_i), made symmetric. With |C|, the same with all
eigenvalues made positive, M = JᵀJ + |C| + λ²I is nowhere below them: a step M⁻¹Jᵀe never goes beyond the valley, and is
Newton's own along it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.scratch import scratch, scratch_table
from ik_controller.kinematics.small import inverse_spd, spectrum, times, transposed_times

Array = NDArray[np.float64]

_LITTLE = 0.1  # of λ²
_IN_FULL = 4.0  # a quarter of the second derivative is enough to take the step with M in full


@compiled
def bend(jacobian: Array, error: Array, result: Array) -> Array:
    """Write C (n, n) to `result` and return that, for the tool's `jacobian` (6, n) and `error` e (6,) [m, rad]."""
    n = jacobian.shape[1]
    ex, ey, ez, rx, ry, rz = error[0], error[1], error[2], 0.5 * error[3], 0.5 * error[4], 0.5 * error[5]
    for i in range(n):
        x, y, z = jacobian[3, i], jacobian[4, i], jacobian[5, i]
        # −e·(ω_i × v_j) = −(e × ω_i)·v_j
        a, b, c = ez * y - ey * z, ex * z - ez * x, ey * x - ex * y
        d, e, f = rz * y - ry * z, rx * z - rz * x, ry * x - rx * y
        for j in range(i, n):
            value = a * jacobian[0, j] + b * jacobian[1, j] + c * jacobian[2, j]
            if j > i:
                value += d * jacobian[3, j] + e * jacobian[4, j] + f * jacobian[5, j]
            result[i, j] = result[j, i] = value
    return result


@compiled
def curved_squares(rows: Array, bent: Array, damping: float, result: Array) -> Array:
    """Write M (n, n) to `result` and return that, for the task's `rows` J (m, n), `bent` C (n, n) and `damping` λ."""
    m, n = rows.shape
    values, axes = spectrum(bent)
    for i in range(n):
        for j in range(i + 1):
            total = damping * damping if i == j else 0.0
            for k in range(m):
                total += rows[k, i] * rows[k, j]
            for k in range(n):
                total += axes[i, k] * abs(values[k]) * axes[j, k]
            result[i, j] = result[j, i] = total
    return result


@compiled
def nearness(jacobian: Array, error: Array, sigma: float, damping: float, threshold: float) -> float:
    """Return how much a singularity matters to an error (6,): 0 while σ_min is above 4 ε, 1 below 2 ε, and less where
    the bend, |e| times the tool's largest lever at most, is below λ²: a small error is followed as ever.
    """
    if sigma >= 4.0 * threshold:
        return 0.0
    square, lever = 0.0, 0.0
    for i in range(6):
        square += error[i] * error[i]
    for j in range(jacobian.shape[1]):
        column = 0.0
        for i in range(6):
            column += jacobian[i, j] * jacobian[i, j]
        lever = max(lever, column)
    most = math.sqrt(square * lever)
    if not 0.0 < most < math.inf:
        return 0.0
    return min(2.0 - 0.5 * sigma / threshold, 1.0) * most / (most + damping * damping)


@compiled
def follow_bend(
    approach: Array, rows: Array, jacobian: Array, feedback: Array, error: Array, near: float, damping: float
) -> None:
    """Lead the velocity `approach` d = J⁺K e (n,), in place, over to M⁻¹JᵀK e, as far as a singularity is `near` and
    the way along d bends away from the target: the more, the more of dᵀ(JᵀJ + C) d comes of C.

    `rows` J (m, n) and `feedback` K e (m,) of the task; `jacobian` (6, n) and `error` (6,) of the tool.
    """
    m, n = rows.shape
    bent = bend(jacobian, error, scratch_table(n, n))
    moved, image = times(bent, approach, scratch(n)), times(rows, approach, scratch(m))
    curved, straight = 0.0, 0.0
    for j in range(approach.shape[0]):
        # A little more than C, so that M decides where the tool hardly moves along d at all.
        curved += approach[j] * (moved[j] + _LITTLE * damping * damping * approach[j])
    for i in range(image.shape[0]):
        straight += image[i] * image[i]
    if not curved > 0.0:
        return
    share = near * min(_IN_FULL * curved / (curved + straight), 1.0)
    squares = curved_squares(rows, bent, damping, scratch_table(n, n))
    pull, step = transposed_times(rows, feedback, scratch(n)), scratch(n)
    times(inverse_spd(squares, scratch_table(n, n)), pull, step)
    for j in range(approach.shape[0]):
        approach[j] += share * (step[j] - approach[j])
