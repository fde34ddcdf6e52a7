"""The damped inverse: J⁺ for the control loop, exact away from singularities and damped only in the weak directions.

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
from ik_controller.kinematics.accelerate import HAS_NUMBA, compiled
from ik_controller.kinematics.small import gram, inverse_spd, spectrum, times

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
def damped_gram_inverse(matrix: Array, damping: float, threshold: float) -> tuple[Array, float]:
    """Return (U diag(1/(σᵢ² + λᵢ²)) Uᵀ (m, m), σ_min) for `matrix` = J Jᵀ (m, m): with it, J⁺x = Jᵀ (result · x).

    Compiled, the inverse of a well-conditioned matrix is found quicker than its eigenvalues. B = (J Jᵀ)⁻¹ tells
    whether it is one: tr(B³²)^(1/32) ≥ 1/σ_min², so where that bound is beyond the threshold, no direction is damped.
    σ_min is then the Rayleigh quotient at the strongest column of B³², exact to (σ₁/σ₂)¹²⁸ of the two smallest.
    """
    if HAS_NUMBA:
        inverse = inverse_spd(matrix)
        if inverse[0, 0] > 0.0:
            scale = 0.0
            for i in range(matrix.shape[0]):
                scale += inverse[i, i]
            power = inverse / scale
            for _ in range(5):
                power = gram(power)  # of a symmetric matrix: its square
            trace, strongest = 0.0, 0
            for i in range(matrix.shape[0]):
                trace += power[i, i]
                if power[i, i] > power[strongest, strongest]:
                    strongest = i
            if scale * trace ** (1.0 / 32.0) * (threshold * threshold) < 1.0:
                column = power[strongest]
                image = times(matrix, column)
                return inverse, math.sqrt(np.sum(column * image) / np.sum(column * column))
    values, directions = spectrum(matrix)
    factors = damping_factors(values, damping, threshold)
    return gram(directions * np.sqrt(factors)), math.sqrt(max(values[0], 0.0))


class DampedInverse:
    """Factor J once, then apply J⁺ to several right-hand sides. Holds its buffers; one per loop."""

    def __init__(self, rows: int, damping: float, threshold: float) -> None:
        """`rows` m of J; `damping` λ and `threshold` ε as in the module's docstring. Raises ArgumentError if
        negative.
        """
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
