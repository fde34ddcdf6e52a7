"""Small dense linear algebra for the inner loops: 6×6 eigenvalues and products of a few rows.

Compiled, loops over a handful of numbers beat any library call; without Numba the same names are NumPy's and Eigen's.
"""

from __future__ import annotations

import math

import eigenpy
import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import HAS_NUMBA, compiled, inlined
from ik_controller.kinematics.scratch import scratch_integers, scratch_table

Array = NDArray[np.float64]

DEPENDENT = 1e-8  # share of the longest row's square that a row must add to count as another direction
_WELL = 1e6  # tr(MMᵀ) · tr((MMᵀ)⁻¹), above the square of the condition number
_SWEEPS = 30  # Jacobi converges quadratically: six or seven are usual


@compiled
def jacobi_spectrum(matrix: Array) -> tuple[Array, Array]:
    """Return (eigenvalues (m,) ascending, eigenvectors (m, m) in columns) of a symmetric matrix (m, m), which is kept.

    Cyclic Jacobi rotations (Golub and Van Loan, 8.5): short, and small eigenvalues come out as well as large ones.
    """
    m = matrix.shape[0]
    a = scratch_table(m, m)
    a[:] = matrix
    u = np.eye(m)
    for _ in range(_SWEEPS):
        off, on = 0.0, 0.0
        for i in range(m):
            on += a[i, i] * a[i, i]
            for j in range(i + 1, m):
                off += a[i, j] * a[i, j]
        if off <= 1e-28 * on:
            break
        for p in range(m - 1):
            for q in range(p + 1, m):
                if a[p, q] == 0.0:
                    continue
                theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(m):
                    left, right = a[k, p], a[k, q]
                    a[k, p], a[k, q] = c * left - s * right, s * left + c * right
                for k in range(m):
                    left, right = a[p, k], a[q, k]
                    a[p, k], a[q, k] = c * left - s * right, s * left + c * right
                    left, right = u[k, p], u[k, q]
                    u[k, p], u[k, q] = c * left - s * right, s * left + c * right
    values = np.empty(m)
    for i in range(m):
        values[i] = a[i, i]
    for i in range(m - 1):  # a handful of values: sorted by selection
        low = i
        for j in range(i + 1, m):
            if values[j] < values[low]:
                low = j
        if low != i:
            values[i], values[low] = values[low], values[i]
            for k in range(m):
                u[k, i], u[k, low] = u[k, low], u[k, i]
    return values, u


@compiled
def loop_times(matrix: Array, vector: Array, result: Array) -> Array:
    """Write matrix (m, n) times vector (n,) to `result` (m,) and return that."""
    m, n = matrix.shape
    for i in range(m):
        total = 0.0
        for j in range(n):
            total += matrix[i, j] * vector[j]
        result[i] = total
    return result


@compiled
def loop_transposed_times(matrix: Array, vector: Array, result: Array) -> Array:
    """Write the transpose of matrix (m, n) times vector (m,) to `result` (n,) and return that."""
    m, n = matrix.shape
    for j in range(n):
        result[j] = 0.0
    for i in range(m):
        for j in range(n):
            result[j] += matrix[i, j] * vector[i]
    return result


@compiled
def loop_gram(matrix: Array, result: Array) -> Array:
    """Write M Mᵀ of a matrix (m, n) to `result` (m, m) and return that."""
    m, n = matrix.shape
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += matrix[i, k] * matrix[j, k]
            result[i, j] = total
            result[j, i] = total
    return result


@compiled
def loop_product(left: Array, right: Array, result: Array) -> Array:
    """Write left (m, k) times right (k, n) to `result` (m, n) and return that."""
    m, n = left.shape[0], right.shape[1]
    for i in range(m):
        for j in range(n):
            result[i, j] = 0.0
        for k in range(right.shape[0]):
            for j in range(n):
                result[i, j] += left[i, k] * right[k, j]
    return result


@inlined
def sized_inverse_factor(matrix: Array, m: int, low: Array) -> bool:
    """Write L⁻¹ (m, m) of the Cholesky factor of M = L Lᵀ (m, m), on and below its diagonal; return whether M is
    positive definite. Where it is not, that is unfinished.
    """
    definite = True
    for j in range(m):  # L, then L⁻¹
        total = matrix[j, j]
        for k in range(j):
            total -= low[j, k] * low[j, k]
        if not total > 1e-14 * matrix[j, j]:
            definite = False
            break
        low[j, j] = math.sqrt(total)
        for i in range(j + 1, m):
            total = matrix[i, j]
            for k in range(j):
                total -= low[i, k] * low[j, k]
            low[i, j] = total / low[j, j]
    if definite:
        for j in range(m):
            low[j, j] = 1.0 / low[j, j]
            for i in range(j + 1, m):
                total = 0.0
                for k in range(j, i):
                    total -= low[i, k] * low[k, j]
                low[i, j] = total / low[i, i]
    return definite


@inlined
def sized_inverse_spd(matrix: Array, m: int, low: Array, result: Array) -> None:
    """Write the inverse (m, m) of a symmetric positive definite matrix by Cholesky; zeros where it is not definite.
    `low` (m, m) as in `sized_inverse_factor`.
    """
    definite = sized_inverse_factor(matrix, m, low)
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            if definite:
                for k in range(i, m):
                    total += low[k, i] * low[k, j]
            result[i, j] = total
            result[j, i] = total


@compiled
def inverse_factor(matrix: Array, result: Array) -> bool:
    """Write L⁻¹ (m, m) of the Cholesky factor of M = L Lᵀ (m, m): see `sized_inverse_factor`."""
    return sized_inverse_factor(matrix, matrix.shape[0], result)


@compiled
def inverse_spd(matrix: Array, result: Array) -> Array:
    """Write the inverse of a symmetric positive definite matrix (m, m) to `result` (m, m) and return that; zeros where
    it is not definite.
    """
    m = matrix.shape[0]
    sized_inverse_spd(matrix, m, scratch_table(m, m), result)
    return result


@compiled
def reflect_rows(matrix: Array, corner: Array, factor: Array, order: NDArray[np.int64]) -> int:
    """Factor M (m, n) as P M = L Qᵀ, in place, and return its rank r; Q is a product of reflections, see `turn_back`.

    Left in `matrix`: L below its diagonal, which is in `corner` (m,), and in row k the vector v of the k-th reflection
    I − f v vᵀ, f in `factor` (m,). `order` (m,) are P's rows: the longest that is left comes next (Golub and Van Loan,
    5.4), and those below 1e-4 of the first count as dependent.
    """
    m, n = matrix.shape
    for i in range(m):
        order[i] = i
    longest = 0.0
    for k in range(min(m, n)):
        square, pivot = -1.0, k
        for i in range(k, m):
            total = 0.0
            for j in range(k, n):
                total += matrix[i, j] * matrix[i, j]
            if total > square:
                square, pivot = total, i
        longest = max(longest, square)
        if square <= DEPENDENT * longest:
            return k
        if pivot != k:
            order[k], order[pivot] = order[pivot], order[k]
            for j in range(n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        corner[k] = -math.sqrt(square) if matrix[k, k] > 0.0 else math.sqrt(square)
        matrix[k, k] -= corner[k]
        factor[k] = -1.0 / (corner[k] * matrix[k, k])  # 2/|v|²
        for i in range(k + 1, m):
            total = 0.0
            for j in range(k, n):
                total += matrix[i, j] * matrix[k, j]
            total *= factor[k]
            for j in range(k, n):
                matrix[i, j] -= total * matrix[k, j]
    rank: int = min(m, n)
    return rank


@compiled
def turn_back(matrix: Array, factor: Array, rank: int, vector: Array) -> None:
    """Turn a vector (n,), in place, into Q times it: the first r axes to the rows' span, the others to its rest."""
    n = vector.shape[0]
    for k in range(rank - 1, -1, -1):
        total = 0.0
        for j in range(k, n):
            total += matrix[k, j] * vector[j]
        total *= factor[k]
        for j in range(k, n):
            vector[j] -= total * matrix[k, j]


@compiled
def loop_row_space(matrix: Array, wanted: Array, null: Array, shortest: Array) -> int:
    """Write N and b of M (m, n) of rank r, which is overwritten, and return n − r: so many orthonormal rows of `null`
    (n, n) with M Nᵀ = 0, and the `shortest` b (n,) with M b = `wanted` (m,), as far as M's rows reach.
    """
    m, n = matrix.shape
    space, order = scratch_table(2, m), scratch_integers(m)
    corner, factor = space[0], space[1]
    rank = reflect_rows(matrix, corner, factor, order)
    for j in range(n):
        shortest[j] = 0.0
        for i in range(n - rank):
            null[i, j] = 0.0
    for i in range(n - rank):
        null[i, rank + i] = 1.0
        turn_back(matrix, factor, rank, null[i])
    for i in range(rank):  # b = Q L⁻¹ P wanted
        total = wanted[order[i]]
        for j in range(i):
            total -= matrix[i, j] * shortest[j]
        shortest[i] = total / corner[i]
    turn_back(matrix, factor, rank, shortest)
    freedom: int = n - rank
    return freedom


def numpy_row_space(matrix: Array, wanted: Array, null: Array, shortest: Array) -> int:
    """Write the same as `loop_row_space`; for well-conditioned M with one column more than rows by I − Mᵀ(MMᵀ)⁻¹M,
    any column of which is along N.
    """
    m, n = matrix.shape
    if n != m + 1:
        return loop_row_space(matrix, wanted, null, shortest)
    squares: Array = matrix.dot(matrix.T)
    factor = eigenpy.LLT(squares)
    inverse: Array = factor.solve(np.eye(m))
    definite = factor.info() == eigenpy.ComputationInfo.Success
    if not (definite and 0.0 < inverse.trace() * squares.trace() < _WELL):
        return loop_row_space(matrix, wanted, null, shortest)
    back: Array = matrix.T.dot(inverse)
    rest = np.eye(n) - back.dot(matrix)
    column = int(rest.diagonal().argmax())
    null[0] = rest[column] / math.sqrt(rest.item(column, column))
    shortest[:] = back.dot(wanted[:m])
    return 1


def eigen_spectrum(matrix: Array) -> tuple[Array, Array]:
    """Return the same as `jacobi_spectrum`, by Eigen."""
    solver = eigenpy.SelfAdjointEigenSolver(matrix)
    return solver.eigenvalues(), solver.eigenvectors()


def numpy_transposed_times(matrix: Array, vector: Array, result: Array) -> Array:
    """Write the same as `loop_transposed_times`, by NumPy."""
    matrix.T.dot(vector, result)
    return result


def numpy_gram(matrix: Array, result: Array) -> Array:
    """Write the same as `loop_gram`, by NumPy."""
    matrix.dot(matrix.T, result)
    return result


if HAS_NUMBA:
    spectrum, times, transposed_times, gram = jacobi_spectrum, loop_times, loop_transposed_times, loop_gram
    product, row_space = loop_product, loop_row_space
else:
    spectrum, times, transposed_times, gram = eigen_spectrum, np.dot, numpy_transposed_times, numpy_gram  # type: ignore[assignment]
    product, row_space = np.dot, numpy_row_space  # type: ignore[assignment]
