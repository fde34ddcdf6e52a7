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

from ik_controller.kinematics.accelerate import HAS_NUMBA, compiled, inlined
from ik_controller.kinematics.scratch import scratch_table
from ik_controller.kinematics.small import gram, sized_inverse_spd, spectrum

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


@inlined
def undamped(matrix: Array, threshold: float, m: int, space: Array, inverse: Array) -> float:
    """Write B = (J Jᵀ)⁻¹ (m, m) for `matrix` = J Jᵀ (m, m) and return σ_min, 0 where a direction may need damping.

    tr(B³²)^(1/32) ≥ 1/σ_min², so where that bound is beyond the threshold, none does. σ_min is then the Rayleigh
    quotient at the strongest column of B³², exact to (σ₁/σ₂)¹²⁸ of the two smallest. `space` (2m, m) is written over.
    """
    power, square, sigma = space[:m], space[m:], 0.0
    sized_inverse_spd(matrix, m, power, inverse)
    if inverse[0, 0] > 0.0:
        scale = 0.0
        for i in range(m):
            scale += inverse[i, i]
        for i in range(m):
            for j in range(m):
                power[i, j] = inverse[i, j] / scale
        for _ in range(5):
            for i in range(m):
                for j in range(i + 1):
                    total = 0.0
                    for k in range(m):
                        total += power[i, k] * power[j, k]
                    square[i, j] = square[j, i] = total
            power, square = square, power
        trace, strongest = 0.0, 0
        for i in range(m):
            trace += power[i, i]
            if power[i, i] > power[strongest, strongest]:
                strongest = i
        if scale * trace ** (1.0 / 32.0) * (threshold * threshold) < 1.0:
            above, below = 0.0, 0.0
            for i in range(m):
                image = 0.0
                for j in range(m):
                    image += matrix[i, j] * power[strongest, j]
                above += power[strongest, i] * image
                below += power[strongest, i] * power[strongest, i]
            sigma = math.sqrt(above / below)
    return sigma


@compiled
def damped_gram_inverse(matrix: Array, damping: float, threshold: float, inverse: Array, rank: int = 6) -> float:
    """Write U diag(1/(σᵢ² + λᵢ²)) Uᵀ (m, m) for `matrix` = J Jᵀ (m, m) and return σ_min: J⁺x = Jᵀ (`inverse` · x).

    Compiled, the inverse of a well-conditioned matrix is found quicker than its eigenvalues. `rank`: in how many
    directions the arm can move at all, where that is less than m; σ_min is the smallest of those.
    """
    m = matrix.shape[0]
    if HAS_NUMBA and rank >= m:
        # With the size a constant the compiler unrolls the loops: half the time.
        space = scratch_table(2 * m, m)
        if m == 6:
            sigma = undamped(matrix, threshold, 6, space, inverse)
        else:
            sigma = undamped(matrix, threshold, m, space, inverse)
        if sigma > 0.0:
            return sigma
    values, directions = spectrum(matrix)
    factors = damping_factors(values, damping, threshold)
    gram(directions * np.sqrt(factors), inverse)
    return math.sqrt(max(values[max(m - rank, 0)], 0.0))
