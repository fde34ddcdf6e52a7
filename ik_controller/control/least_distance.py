"""The shortest vector within linear bounds: the quadratic program that all bounded problems of the law come down to.

    minimize  ½ ‖x‖²   subject to   lower ≤ C x ≤ upper

by the dual active set of Goldfarb and Idnani (1983): x starts at 0, the optimum without bounds, and the bound that is
violated most is taken in, one after the other, while the multipliers u of those taken in stay ≥ 0. The held normals are
kept as N = Q₁ R with Q orthogonal, so that the problem is never squared. It starts afresh at every call, and the same
numbers give the same bits.
"""

from __future__ import annotations

import math

import daqp
import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import HAS_NUMBA, compiled
from ik_controller.kinematics.scratch import scratch_integers, scratch_table

Array = NDArray[np.float64]

_PARALLEL = 1e-26  # share of a normal's square off the held ones, below which it depends on them


@compiled
def active_set(rows: Array, lower: Array, upper: Array, tolerance: float, x: Array) -> bool:
    """Write the shortest x (p,) with lower ≤ `rows` x ≤ upper, (k,) each; return False where there is none.

    A bound counts as kept within `tolerance`. Infinite bounds are none.
    """
    k, p = rows.shape
    if p <= 1:
        return nearest_number(rows, lower, upper, tolerance, x)
    basis, r, vectors = scratch_table(p, p), scratch_table(p, p), scratch_table(3, p)  # Q; R in the upper left corner
    multiplier, change, normal = vectors[0], vectors[1], vectors[2]
    index, holds, held = scratch_integers(p), scratch_integers(k), 0  # the rows of the held bounds; is each row held?
    for i in range(k):
        holds[i] = 0
    for i in range(p):
        for j in range(p):
            basis[i, j] = 1.0 if i == j else 0.0
        x[i] = 0.0
    for _ in range(10 * (k + p)):
        violation, worst, sign = tolerance, -1, 0.0
        for i in range(k):
            if holds[i] != 0:
                continue
            value = 0.0
            for j in range(p):
                value += rows[i, j] * x[j]
            if value - upper[i] > violation:
                violation, worst, sign = value - upper[i], i, -1.0
            elif lower[i] - value > violation:
                violation, worst, sign = lower[i] - value, i, 1.0
        if worst < 0:
            return True
        new = 0.0  # the multiplier of the bound that is taken in
        while True:
            # The bound's normal n in the basis: Qᵀn. What lies off the held normals is the way to go.
            square, rest = 0.0, 0.0
            for j in range(p):
                total = 0.0
                for i in range(p):
                    total += basis[i, j] * rows[worst, i]
                normal[j] = sign * total
                square += total * total
                if j >= held:
                    rest += total * total
            # How the held multipliers fall meanwhile, R⁻¹Q₁ᵀn, and which of them is zero first.
            step, leaves = math.inf, -1
            for i in range(held - 1, -1, -1):
                total = normal[i]
                for j in range(i + 1, held):
                    total -= r[i, j] * change[j]
                change[i] = total / r[i, i]
            for i in range(held):
                if change[i] > 0.0 and multiplier[i] < step * change[i]:
                    step, leaves = multiplier[i] / change[i], i
            free = rest > _PARALLEL * square
            full = violation / rest if free else math.inf
            if not free and leaves < 0:
                return False
            step = min(step, full)
            if free:
                for i in range(p):
                    total = 0.0
                    for j in range(held, p):
                        total += basis[i, j] * normal[j]
                    x[i] += step * total
                violation -= step * rest
            for i in range(held):
                multiplier[i] = max(multiplier[i] - step * change[i], 0.0)
            new += step
            if step == full:
                _take_in(basis, r, normal, held)
                index[held], multiplier[held] = worst, new
                holds[worst] = 1
                held += 1
                break
            holds[index[leaves]] = 0
            for i in range(leaves, held - 1):
                index[i], multiplier[i] = index[i + 1], multiplier[i + 1]
            _let_go(basis, r, leaves, held)
            held -= 1
    return False


@compiled
def nearest_number(rows: Array, lower: Array, upper: Array, tolerance: float, x: Array) -> bool:
    """Write the same as `active_set` for p = 1 or 0: the number nearest to 0 in the intersection of k intervals."""
    k, p = rows.shape
    least, most = -math.inf, math.inf
    for i in range(k):
        factor = rows[i, 0] if p > 0 else 0.0
        if factor == 0.0:
            if lower[i] > tolerance or upper[i] < -tolerance:
                return False
            continue
        one, other = lower[i] / factor, upper[i] / factor
        slack = tolerance / abs(factor)
        low, high = min(one, other), max(one, other)
        if low > most + slack or high < least - slack:
            return False
        least, most = max(least, low), min(most, high)
    if p > 0:
        x[0] = min(max(0.0, least), most)
    return True


@compiled
def _take_in(basis: Array, r: Array, normal: Array, held: int) -> None:
    """Turn the free columns of Q so that the first of them takes all of `normal` = Qᵀn; a column more for R."""
    p = basis.shape[0]
    for j in range(p - 1, held, -1):
        length = math.hypot(normal[j - 1], normal[j])
        if length == 0.0:
            continue
        c, s = normal[j - 1] / length, normal[j] / length
        normal[j - 1], normal[j] = length, 0.0
        for i in range(p):
            left, right = basis[i, j - 1], basis[i, j]
            basis[i, j - 1], basis[i, j] = c * left + s * right, c * right - s * left
    for i in range(held + 1):
        r[i, held] = normal[i]


@compiled
def _let_go(basis: Array, r: Array, leaves: int, held: int) -> None:
    """Take column `leaves` out of R and make it triangular again."""
    p = basis.shape[0]
    for j in range(leaves, held - 1):
        for i in range(j + 2):
            r[i, j] = r[i, j + 1]
        length = math.hypot(r[j, j], r[j + 1, j])
        c, s = r[j, j] / length, r[j + 1, j] / length
        r[j, j], r[j + 1, j] = length, 0.0
        for i in range(j + 2, held):
            upper, lower = r[j, i], r[j + 1, i]
            r[j, i], r[j + 1, i] = c * upper + s * lower, c * lower - s * upper
        for i in range(p):
            left, right = basis[i, j], basis[i, j + 1]
            basis[i, j], basis[i, j + 1] = c * left + s * right, c * right - s * left


def daqp_active_set(rows: Array, lower: Array, upper: Array, tolerance: float, x: Array) -> bool:
    """Write the same as `active_set`, by DAQP."""
    k, p = rows.shape
    if p <= 1:
        return nearest_number(rows, lower, upper, tolerance, x)
    solution, _, flag, _ = daqp.solve(
        np.eye(p), np.zeros(p), rows, upper, lower, np.zeros(k, dtype=np.int32), primal_tol=tolerance
    )
    if flag != 1:  # it gives up on some that have a solution
        return active_set(rows, lower, upper, tolerance, x)
    x[:] = solution
    return True


least_distance = active_set if HAS_NUMBA else daqp_active_set
