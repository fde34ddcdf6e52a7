"""DampedInverse: J⁺ for the control loop, exact away from singularities and damped only in the weak directions.

With J Jᵀ = U diag(σᵢ²) Uᵀ the damped inverse Jᵀ(J Jᵀ + λ²I)⁻¹ (N5, N12) becomes Jᵀ U diag(1/(σᵢ² + λᵢ²)) Uᵀ, and each
direction gets its own damping, as in numerical filtering (Maciejewski & Klein 1988; Chiaverini 1997):

    λᵢ² = λ² (1 − (σᵢ/ε)²)  where σᵢ < ε,  0 elsewhere.

One symmetric 6×6 eigenvalue problem serves m = n, m < n and m > n, and gives the singular values for the status.
"""

from __future__ import annotations

import math
import numpy as np
from numpy.typing import NDArray

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.small import gram, spectrum, times, transposed_times

Array = NDArray[np.float64]

# (σ/σ_max)² below which a direction is out of reach (more rows than columns, or singular): round-off is no velocity.
_OUT_OF_REACH = 1e-14
_TINY = 1e-300  # keeps 1/σ² finite for J = 0


@compiled
def damping_factors(eigenvalues: Array, damping: float, threshold: float) -> Array:
    """Return 1/(σᵢ² + λᵢ²) (m,) for the eigenvalues σᵢ² (m,), ascending, of J Jᵀ; 0 for a direction out of reach."""
    weak = threshold * threshold
    if eigenvalues[0] >= weak:
        return 1.0 / eigenvalues
    values = np.maximum(eigenvalues, _TINY)
    factors = 1.0 / (values + damping * damping * np.maximum(1.0 - values / weak, 0.0))
    return np.where(eigenvalues > _OUT_OF_REACH * eigenvalues[-1], factors, 0.0)


@compiled
def apply_inverse(jacobian: Array, directions: Array, factors: Array, twist: Array) -> Array:
    """Return J⁺ x (n,) = Jᵀ U diag(f) Uᵀ x for a twist x (m,)."""
    return transposed_times(jacobian, times(directions, factors * transposed_times(directions, twist)))


class DampedInverse:
    """Factor J once, then apply J⁺ to several right-hand sides. Holds its buffers; one per loop."""

    def __init__(self, rows: int, damping: float, threshold: float) -> None:
        """`rows` m of J; `damping` λ and `threshold` ε as in the module's docstring. Raises ArgumentError if negative."""
        if damping < 0.0 or threshold < 0.0:
            raise ArgumentError(f"damping {damping} and threshold {threshold} must be ≥ 0")
        self._damping = damping
        self._threshold = threshold
        self._jacobian: Array = np.zeros((rows, 1))
        self.eigenvalues: Array = np.ones(rows)  # σᵢ², ascending
        self.directions: Array = np.eye(rows)  # column i: the task direction of σᵢ
        self.factors: Array = np.ones(rows)  # 1/(σᵢ² + λᵢ²)
        self.damped = False

    def factor(self, jacobian: Array) -> None:
        """Take J (m, n); the array must stay unchanged until the last `apply`."""
        self._jacobian = jacobian
        self.eigenvalues, self.directions = spectrum(gram(jacobian))
        self.damped = self.eigenvalues.item(0) < self._threshold * self._threshold
        self.factors = damping_factors(self.eigenvalues, self._damping, self._threshold)

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
