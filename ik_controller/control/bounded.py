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

Array = NDArray[np.float64]

_SCALE_WEIGHT = 1e6  # W: against joint velocities of order one (D divides by the velocity limits)
_CLOSEST_WEIGHT = 1e-4  # pull to the wanted joint velocities beside the task, where the task cannot be held
_RANK_TOLERANCE = 1e-8  # σ²/σ_max² below which a task direction is no constraint: the arm cannot move along it
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
    able = eigenvalues > _RANK_TOLERANCE * eigenvalues[-1]
    rows = directions[:, able].T @ jacobian
    task = rows @ wanted
    m = task.size

    weight = 1.0 / (velocity_limit * velocity_limit)
    hessian = np.diag(np.append(weight, _SCALE_WEIGHT))
    linear = np.append(-weight * wanted, -_SCALE_WEIGHT)
    equality = np.zeros((m, n + 1))
    equality[:, :n] = rows
    equality[:, n] = -task
    zeros = np.zeros(m)
    upper = np.concatenate((high, (1.0,), zeros))
    lower = np.concatenate((low, (0.0,), zeros))
    sense = np.zeros(n + 1 + m, dtype=np.int32)
    sense[n + 1 :] = _EQUALITY
    solution, _, flag, _ = daqp.solve(hessian, linear, equality, upper, lower, sense, primal_tol=1e-11)
    if flag == _SOLVED:
        return np.clip(solution[:n], low, high), float(min(max(solution[n], 0.0), 1.0)), False

    # Closest: as fast as the joints' limits allow along the wanted direction, then least squares in the intervals.
    excess = float(np.max(np.abs(wanted) / velocity_limit))
    aim = wanted / max(excess, 1.0)
    hessian = rows.T @ rows + _CLOSEST_WEIGHT * np.diag(weight)
    linear = -(hessian @ aim)
    solution, _, flag, _ = daqp.solve(
        hessian, linear, np.zeros((1, n)), np.append(high, 1.0), np.append(low, -1.0), np.zeros(n + 1, dtype=np.int32)
    )
    closest = solution if flag == _SOLVED else aim
    return np.clip(closest, low, high), 1.0 / max(excess, 1.0), True
