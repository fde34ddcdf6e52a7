"""The bounded problem: the task within joint intervals; redundancy before slowing down, slowing before bending.

    minimize  ‖D (q̇ − q̇_wanted)‖² + W (1 − s)²   subject to  J q̇ = s J q̇_wanted,  low ≤ q̇ ≤ high,  0 ≤ s ≤ 1

is a true quadratic program: a joint at its bound is relieved by the others (null space) before the task is scaled by s
along its direction. W is large, so s is given up last. Where no s can hold the direction (a joint must still brake from
the last cycle), the closest velocity in the intervals is taken. Solved by DAQP, a dual active-set method.
"""

from __future__ import annotations

import daqp
import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import compiled

Array = NDArray[np.float64]

_SCALE_WEIGHT = 1e6  # W: against joint velocities of order one (D divides by the velocity limits)
_CLOSEST_WEIGHT = 1e-4  # pull to the wanted joint velocities beside the task, where the task cannot be held
_RANK_TOLERANCE = 1e-8  # σ²/σ_max² below which a task direction is no constraint: the arm cannot move along it
_PRIMAL_TOLERANCE = 1e-11
_EQUALITY = 5
_SOLVED = 1


def bounded_velocity(
    wanted: Array,
    jacobian: Array,
    eigenvalues: Array,
    directions: Array,
    low: Array,
    high: Array,
    velocity_limit: Array,
) -> tuple[Array, float, bool]:
    """Return (q̇ (n,), s, bent): the velocity nearest to `wanted` (n,) in [low, high] that keeps J q̇ along J q̇_wanted.

    `jacobian` J (m, n) with `eigenvalues` (m,) and `directions` (m, m) of J Jᵀ. `bent` says that the direction could
    not be held and q̇ is the closest instead.
    """
    n = wanted.size
    hessian, linear = np.zeros((n + 1, n + 1)), np.empty(n + 1)
    equality = np.empty((eigenvalues.size, n + 1))
    upper, lower = np.zeros(n + 1 + eigenvalues.size), np.zeros(n + 1 + eigenvalues.size)
    m = _assemble(
        wanted, jacobian, eigenvalues, directions, low, high, velocity_limit, hessian, linear, equality, upper, lower
    )
    if m == 0:  # the arm can move the tool nowhere: there is no direction to hold
        return np.fmin(np.fmax(wanted, low), high), 1.0, False
    end = n + 1 + m
    sense = np.zeros(end, dtype=np.int32)
    sense[n + 1 :] = _EQUALITY
    solution, _, flag, _ = daqp.solve(
        hessian, linear, equality[:m], upper[:end], lower[:end], sense, primal_tol=_PRIMAL_TOLERANCE
    )
    if flag == _SOLVED:
        return np.fmin(np.fmax(solution[:n], low), high), min(max(solution.item(n), 0.0), 1.0), False

    # Closest: as fast as the joints' limits allow along the wanted direction, then least squares in the intervals.
    excess = float(np.max(np.abs(wanted) / velocity_limit))
    aim = wanted / max(excess, 1.0)
    rows = equality[:m, :n]
    hessian = rows.T @ rows + _CLOSEST_WEIGHT * hessian[:n, :n]
    linear = -(hessian @ aim)
    solution, _, flag, _ = daqp.solve(
        hessian, linear, np.zeros((1, n)), np.append(high, 1.0), np.append(low, -1.0), np.zeros(n + 1, dtype=np.int32)
    )
    closest = solution if flag == _SOLVED else aim
    return np.fmin(np.fmax(closest, low), high), 1.0 / max(excess, 1.0), True


@compiled
def _assemble(
    wanted: Array,
    jacobian: Array,
    eigenvalues: Array,
    directions: Array,
    low: Array,
    high: Array,
    velocity_limit: Array,
    hessian: Array,
    linear: Array,
    equality: Array,
    upper: Array,
    lower: Array,
) -> int:
    """Write the program for (q̇, s) and return its number of equalities: one for each direction the arm can move in.

    `hessian` (n + 1, n + 1) comes as zeros; `equality` (6, n + 1), `upper`, `lower` (n + 7,), zeros, bounds first.
    """
    n, rank = wanted.shape[0], eigenvalues.shape[0]
    first = 0
    while first < rank and eigenvalues[first] <= _RANK_TOLERANCE * eigenvalues[rank - 1]:
        first += 1
    for row in range(rank - first):
        along = 0.0
        for j in range(n):
            total = 0.0
            for i in range(jacobian.shape[0]):
                total += directions[i, first + row] * jacobian[i, j]
            equality[row, j] = total
            along += total * wanted[j]
        equality[row, n] = -along
    for j in range(n):
        hessian[j, j] = 1.0 / (velocity_limit[j] * velocity_limit[j])
        linear[j] = -hessian[j, j] * wanted[j]
        upper[j], lower[j] = high[j], low[j]
    hessian[n, n], linear[n] = _SCALE_WEIGHT, -_SCALE_WEIGHT
    upper[n] = 1.0
    count: int = rank - first
    return count
