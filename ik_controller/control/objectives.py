"""Objectives H(q) to climb with the motion that the tasks leave: q̇₀ = Σ k ∇H, k in rad²/s (notes N6; Nakamura 1991).

    joint_centring    H = −½ Σ ((q − q_mid)/h)²          h half the joint's range: stay in the middle
    limit_repulsion   H = Σ ln d − d + 1 where d < 1     d: distance to a limit as a share of a tenth of the range
    manipulability    H = √det(A Aᵀ)                     A: the Jacobian of the axes of the task's axes (Yoshikawa 1985)

Joints without bounds are left out of the first two. The barrier ln d is cut at d = 0.02, so that it is finite. For the
third the derivative of a Jacobian's column j to coordinate k follows from the columns (v, ω) themselves,

    ∂(v, ω)_j/∂q_k = (ω_k × v_j, ω_k × ω_j)  for k ≤ j,    (ω_j × v_k, 0)  for k > j,

and ∂H/∂q_k = H tr((A Aᵀ)⁻¹ ∂A/∂q_k Aᵀ), with the axes' frame held.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.scratch import scratch_table
from ik_controller.kinematics.small import gram, inverse_spd, product

Array = NDArray[np.float64]

OBJECTIVES = ("joint_centring", "limit_repulsion", "manipulability")
CENTRING, REPULSION, MANIPULABILITY = 0, 1, 2

MARGIN = 0.1  # of a joint's range, at each end: where limits repel
NEAREST = 0.02  # share of the margin at which the barrier is cut


@compiled
def add_centring(q: Array, lower: Array, upper: Array, gain: float, velocity: Array) -> None:
    """Add k ∇H of the joints' distance from the middle of their ranges to `velocity` (n,)."""
    for i in range(q.shape[0]):
        half = 0.5 * (upper[i] - lower[i])
        if half < math.inf:
            velocity[i] += gain * (lower[i] + half - q[i]) / (half * half)


@compiled
def add_repulsion(q: Array, lower: Array, upper: Array, gain: float, velocity: Array) -> None:
    """Add k ∇H of the barriers at the joints' limits to `velocity` (n,)."""
    for i in range(q.shape[0]):
        span = upper[i] - lower[i]
        margin = MARGIN * span if span < math.inf else MARGIN * 2.0 * math.pi
        for end in range(2):
            room = q[i] - lower[i] if end == 0 else upper[i] - q[i]
            d = max(room / margin, NEAREST)
            if d < 1.0:
                push = gain * (1.0 / d - 1.0) / margin
                velocity[i] += push if end == 0 else -push


@compiled
def manipulability(rows: Array) -> float:
    """Return √det(A Aᵀ) of A (m, n), the product of its singular values: of the pivots of its Cholesky factor."""
    m = rows.shape[0]
    low, result = gram(rows, scratch_table(m, m)), 1.0
    for j in range(m):
        for i in range(j, m):
            total = low[i, j]
            for k in range(j):
                total -= low[i, k] * low[j, k]
            if i == j:
                if not total > 0.0:
                    return 0.0
                low[j, j] = math.sqrt(total)
                result *= low[j, j]
            else:
                low[i, j] = total / low[j, j]
    return result


@compiled
def add_manipulability(jacobian: Array, selection: Array, gain: float, velocity: Array) -> None:
    """Add k ∇H of the manipulability of A = `selection` (m, 6) · J (6, n) to `velocity` (n,); nothing at H = 0."""
    m, n = selection.shape[0], jacobian.shape[1]
    rows = product(selection, jacobian, scratch_table(m, n))
    inverse = inverse_spd(gram(rows, scratch_table(m, m)), scratch_table(m, m))
    height = manipulability(rows)
    if selection.shape[0] == 0 or not inverse[0, 0] > 0.0:
        return
    # ∂H/∂q_k = H Σ_j g_j · ∂J_j/∂q_k with the columns g_j of selectionᵀ (A Aᵀ)⁻¹ A.
    slope = product(selection.T.copy(), product(inverse, rows, scratch_table(m, n)), scratch_table(6, n))
    for k in range(n):
        total = 0.0
        for j in range(n):
            one, other = (k, j) if k <= j else (j, k)
            # (ω_k × v_j, ω_k × ω_j), or (ω_j × v_k, 0)
            x, y, z = jacobian[3, one], jacobian[4, one], jacobian[5, one]
            for top in range(0, 6 if k <= j else 3, 3):
                a, b, c = jacobian[top, other], jacobian[top + 1, other], jacobian[top + 2, other]
                total += slope[top, j] * (y * c - z * b)
                total += slope[top + 1, j] * (z * a - x * c)
                total += slope[top + 2, j] * (x * b - y * a)
        velocity[k] += gain * height * total
