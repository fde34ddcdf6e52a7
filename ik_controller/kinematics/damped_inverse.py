"""DampedInverse: J⁺ for the control loop, exact away from singularities and damped only in the weak directions.

With J Jᵀ = U diag(σᵢ²) Uᵀ the damped inverse Jᵀ(J Jᵀ + λ²I)⁻¹ (N5, N12) becomes Jᵀ U diag(1/(σᵢ² + λᵢ²)) Uᵀ, and each
direction gets its own damping, as in numerical filtering (Maciejewski & Klein 1988; Chiaverini 1997):

    λᵢ² = λ² (1 − (σᵢ/ε)²)  where σᵢ < ε,  0 elsewhere.

One symmetric 6×6 eigenvalue problem serves m = n, m < n and m > n, and gives the singular values for the status.
"""

from __future__ import annotations

import math
from typing import Any

import eigenpy
import numpy as np
from numpy.typing import NDArray

from ik_controller.errors import ArgumentError

Array = NDArray[np.float64]

# (σ/σ_max)² below which a direction is out of reach (more rows than columns, or singular): round-off is no velocity.
_OUT_OF_REACH = 1e-14
_TINY = 1e-300  # keeps 1/σ² finite for J = 0


class DampedInverse:
    """Factor J once, then apply J⁺ to several right-hand sides. Holds its buffers; one per loop."""

    def __init__(self, rows: int, damping: float, threshold: float) -> None:
        """`rows` m of J; `damping` λ and `threshold` ε as in the module's docstring. Raises ArgumentError if negative."""
        if damping < 0.0 or threshold < 0.0:
            raise ArgumentError(f"damping {damping} and threshold {threshold} must be ≥ 0")
        self._damping2 = damping * damping
        self._threshold2 = threshold * threshold
        self._gram = np.empty((rows, rows))
        self._solver: Any = eigenpy.SelfAdjointEigenSolver(rows)
        self._jacobian: Array = np.zeros((rows, 1))
        self.eigenvalues: Array = np.ones(rows)  # σᵢ², ascending
        self.directions: Array = np.eye(rows)  # column i: the task direction of σᵢ
        self.factors: Array = np.ones(rows)  # 1/(σᵢ² + λᵢ²)
        self.damped = False

    def factor(self, jacobian: Array) -> None:
        """Take J (m, n); the array must stay unchanged until the last `apply`."""
        self._jacobian = jacobian
        np.dot(jacobian, jacobian.T, out=self._gram)
        self._solver.compute(self._gram)
        values: Array = self._solver.eigenvalues()
        self.eigenvalues = values
        self.directions = self._solver.eigenvectors()
        self.damped = values.item(0) < self._threshold2
        if self.damped:
            reach = values > _OUT_OF_REACH * values.item(-1)
            values = np.maximum(values, _TINY)
            weak = np.maximum(1.0 - values / self._threshold2, 0.0)
            self.factors = reach / (values + self._damping2 * weak)
        else:
            self.factors = 1.0 / values

    def apply(self, velocity: Array) -> Array:
        """Return J⁺ v (n,) or (n, k) for v (m,) or (m, k), damped near singularities."""
        weights = self.directions.T.dot(velocity)
        weights = (weights.T * self.factors).T
        result: Array = self._jacobian.T.dot(self.directions.dot(weights))
        return result

    @property
    def smallest_singular_value(self) -> float:
        """σ_min of J: 0 where it has more rows than columns or is singular."""
        return math.sqrt(max(self.eigenvalues.item(0), 0.0))

    @property
    def condition_number(self) -> float:
        """σ_max / σ_min; inf at a singularity."""
        low, high = self.eigenvalues.item(0), self.eigenvalues.item(-1)
        return math.sqrt(high / low) if low > 0.0 else math.inf
