"""Inverses J# (n, m) of a Jacobian J (m, n), one interface, by name (notes N5, N12), and null spaces (N6).

    exact                 J⁻¹                                     m = n
    right                 Jᵀ (J Jᵀ)⁻¹                             m ≤ n, smallest ‖q̇‖
    left                  (Jᵀ J)⁻¹ Jᵀ                             m ≥ n, smallest ‖ẋ − J q̇‖
    pseudo                V Σ⁺ Uᵀ                                 always: Moore-Penrose, by SVD with a rank tolerance
    weighted_right        W⁻¹ Jᵀ (J W⁻¹ Jᵀ)⁻¹                     m ≤ n, smallest q̇ᵀ W q̇; W (n, n)
    weighted_left         (Jᵀ W⁻¹ J)⁻¹ Jᵀ W⁻¹                     m ≥ n, smallest ‖ẋ − J q̇‖ in the metric W⁻¹; W (m, m)
    damped                Jᵀ (J Jᵀ + λ² I)⁻¹                      always, constant λ
    damped_manipulability the same, λ² = λ₀² (1 − w/w₀)²          where w = √det J Jᵀ < w₀ (Nakamura & Hanafusa 1986)
    damped_singular_value the same, λ² = λ₀² (1 − (σ/ε)²)         where the smallest σ < ε (Chiaverini et al. 1994)
    numerical_filtering   that λ² along u of the smallest σ only  Jᵀ (J Jᵀ + λ² u uᵀ)⁻¹ (Maciejewski & Klein 1988)
    transpose             Jᵀ                                      always

J and W carry mixed units where the tool both moves and turns; the choice of metres and radians is then part of the
answer of every method but exact. The control loop has its own fast form, `kinematics.damped_inverse`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ik_controller.errors import ArgumentError, choices
from ik_controller.kinematics.checks import Array, check_array, check_choice, check_number

# Singular values below this share of the largest count as zero.
RANK_TOLERANCE = 1e-10


def exact(J: Array) -> Array:
    """Return J⁻¹ (n, n). Raises ArgumentError: J not square or singular. (000)"""
    if J.shape[0] != J.shape[1]:
        raise ArgumentError(f"J: shape {J.shape} is not square, exact needs m = n; use 'pseudo'")
    _require_rank(J, "exact")
    inverted: Array = np.asarray(np.linalg.inv(J), dtype=np.float64)
    return inverted


def right(J: Array) -> Array:
    """Return Jᵀ (J Jᵀ)⁻¹ (n, m), J J# = I. Raises ArgumentError: m > n or rank below m. (000, 001, 004 p. 58)"""
    if J.shape[0] > J.shape[1]:
        raise ArgumentError(f"J: shape {J.shape} has m > n, right needs m ≤ n; use 'left' or 'pseudo'")
    _require_rank(J, "right")
    # With Jᵀ = Q R it is Q R⁻ᵀ: conditioned as J, where J Jᵀ would square the condition number.
    Q, R = np.linalg.qr(J.T)
    J_sharp: Array = np.linalg.solve(R, Q.T).T
    return J_sharp


def left(J: Array) -> Array:
    """Return (Jᵀ J)⁻¹ Jᵀ (n, m), J# J = I. Raises ArgumentError: m < n or rank below n. (001, 004 p. 58)"""
    if J.shape[0] < J.shape[1]:
        raise ArgumentError(f"J: shape {J.shape} has m < n, left needs m ≥ n; use 'right' or 'pseudo'")
    _require_rank(J, "left")
    # With J = Q R it is R⁻¹ Qᵀ.
    Q, R = np.linalg.qr(J)
    J_sharp: Array = np.linalg.solve(R, Q.T)
    return J_sharp


def pseudo(J: Array, tolerance: float = RANK_TOLERANCE) -> Array:
    """Return the Moore-Penrose inverse J⁺ (n, m); singular values ≤ tolerance · largest count as zero. (004 p. 57)"""
    u, sigma, vt = np.linalg.svd(J, full_matrices=False)
    keep = sigma > tolerance * sigma[0]
    inverted = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=keep)
    J_sharp: Array = (vt.T * inverted) @ u.T
    return J_sharp


def weighted_right(J: Array, weight: Array) -> Array:
    """Return W⁻¹ Jᵀ (J W⁻¹ Jᵀ)⁻¹ (n, m) for W (n, n), J J# = I. (004 p. 59)

    Raises ArgumentError: m > n, rank below m, W not symmetric positive definite.
    """
    if J.shape[0] > J.shape[1]:
        raise ArgumentError(f"J: shape {J.shape} has m > n, weighted_right needs m ≤ n; use 'weighted_left'")
    _require_rank(J, "weighted_right")
    # With W = L Lᵀ and A = J L⁻ᵀ it is L⁻ᵀ A⁺.
    L = _cholesky(weight, J.shape[1])
    A: Array = np.linalg.solve(L, J.T).T
    J_sharp: Array = np.linalg.solve(L.T, pseudo(A, 0.0))
    return J_sharp


def weighted_left(J: Array, weight: Array) -> Array:
    """Return (Jᵀ W⁻¹ J)⁻¹ Jᵀ W⁻¹ (n, m) for W (m, m), J# J = I. (004 p. 59, whose m < n is a misprint for m > n)

    Raises ArgumentError: m < n, rank below n, W not symmetric positive definite.
    """
    if J.shape[0] < J.shape[1]:
        raise ArgumentError(f"J: shape {J.shape} has m < n, weighted_left needs m ≥ n; use 'weighted_right'")
    _require_rank(J, "weighted_left")
    # With W = L Lᵀ and A = L⁻¹ J it is A⁺ L⁻¹.
    L = _cholesky(weight, J.shape[0])
    A: Array = np.asarray(np.linalg.solve(L, J), dtype=np.float64)
    J_sharp: Array = np.linalg.solve(L.T, pseudo(A, 0.0).T).T
    return J_sharp


def damped(J: Array, damping: float = 0.05) -> Array:
    """Return Jᵀ (J Jᵀ + λ² I)⁻¹ (n, m) with constant `damping` λ ≥ 0; λ = 0 is `pseudo`. (001, 002)

    One slide of 002 prints − λ² I, which would blow up instead of damp.
    """
    return _spectral(J, np.full(min(J.shape), damping**2))


def damped_manipulability(J: Array, damping: float = 0.05, threshold: float = 0.05) -> Array:
    """Return the damped inverse (n, m) with λ² = λ₀² (1 − w/w₀)² where w < w₀, else J⁺. (Nakamura & Hanafusa 1986)

    `damping` λ₀ ≥ 0 at the singularity; `threshold` w₀ > 0, the manipulability w = √det J Jᵀ where damping begins.
    """
    w = float(np.prod(np.linalg.svd(J, compute_uv=False)))
    factor = damping * (1.0 - w / threshold) if w < threshold else 0.0
    return _spectral(J, np.full(min(J.shape), factor**2))


def damped_singular_value(J: Array, damping: float = 0.05, threshold: float = 0.05) -> Array:
    """Return the damped inverse (n, m) with λ² = λ₀² (1 − (σ/ε)²) where the smallest σ < ε, else J⁺. (Chiaverini 1994)

    `damping` λ₀ ≥ 0 at the singularity; `threshold` ε > 0, the singular value where damping begins.
    """
    sigma = float(np.linalg.svd(J, compute_uv=False)[-1])
    return _spectral(J, np.full(min(J.shape), _ramp(sigma, damping, threshold)))


def numerical_filtering(J: Array, damping: float = 0.05, threshold: float = 0.05) -> Array:
    """Return Jᵀ (J Jᵀ + Σ λᵢ² uᵢ uᵢᵀ)⁻¹ (n, m), damped only along singular directions. (Maciejewski & Klein 1988)

    λᵢ² = λ₀² (1 − (σᵢ/ε)²) for each σᵢ < ε, `threshold`; the paper damps the smallest alone, this every one below ε,
    so that two singularities at once are as safe as one. Other directions keep their exact inverse.
    """
    sigma = np.linalg.svd(J, compute_uv=False)
    return _spectral(J, np.array([_ramp(float(value), damping, threshold) for value in sigma]))


def transpose(J: Array) -> Array:
    """Return Jᵀ (n, m): the direction of steepest descent of ½ ‖e‖², not an inverse. (000, 002)"""
    J_sharp: Array = J.T.copy()
    return J_sharp


@dataclass(frozen=True)
class Inverse:
    """An inverse by name: its function of J and of the options it takes, checked by `inverse`."""

    name: str
    function: Callable[..., Array]
    options: tuple[str, ...] = ()


INVERSES: dict[str, Inverse] = {
    entry.name: entry
    for entry in (
        Inverse("exact", exact),
        Inverse("right", right),
        Inverse("left", left),
        Inverse("pseudo", pseudo, ("tolerance",)),
        Inverse("weighted_right", weighted_right, ("weight",)),
        Inverse("weighted_left", weighted_left, ("weight",)),
        Inverse("damped", damped, ("damping",)),
        Inverse("damped_manipulability", damped_manipulability, ("damping", "threshold")),
        Inverse("damped_singular_value", damped_singular_value, ("damping", "threshold")),
        Inverse("numerical_filtering", numerical_filtering, ("damping", "threshold")),
        Inverse("transpose", transpose),
    )
}


def inverse(
    J: ArrayLike,
    method: str = "pseudo",
    *,
    weight: ArrayLike | None = None,
    damping: float | None = None,
    threshold: float | None = None,
    tolerance: float | None = None,
) -> Array:
    """Return an inverse J# (n, m) of J (m, n) by `method`, one of `INVERSES` (N5).

    `weight`: W, or its diagonal as a vector. `damping`: λ or λ₀. `threshold`: w₀ or ε. `tolerance`: rank tolerance
    relative to the largest singular value. An option left None takes the method's default; weight has none.
    Raises ArgumentError: unknown method, an option the method does not take, λ < 0, threshold ≤ 0, W singular or of a
    shape that does not match, J not finite, empty, or of a shape or rank the method cannot invert.
    """
    matrix = check_array(J, "J", (None, None))
    entry = INVERSES[check_choice(method, "inverse method", INVERSES)]
    options: dict[str, Array | float] = {}
    if weight is not None:
        options["weight"] = _metric(weight)
    if damping is not None:
        options["damping"] = check_number(damping, "damping", minimum=0.0)
    if threshold is not None:
        options["threshold"] = check_number(threshold, "threshold", minimum=0.0, exclusive=True)
    if tolerance is not None:
        options["tolerance"] = check_number(tolerance, "tolerance", minimum=0.0)
    for name in options:
        if name not in entry.options:
            raise ArgumentError(f"{name}: inverse '{method}' does not take it; it takes: {choices(entry.options)}")
    if "weight" in entry.options and "weight" not in options:
        raise ArgumentError(f"weight: inverse '{method}' needs it")
    return entry.function(matrix, **options)


def null_space_projector(J: ArrayLike, J_sharp: ArrayLike) -> Array:
    """Return I − J# J (n, n) (004 p. 54): J times it is 0 where J J# J = J, so for every inverse but damped, transpose.

    `J` (m, n), `J_sharp` (n, m). Raises ArgumentError where shapes do not match.
    """
    matrix = check_array(J, "J", (None, None))
    m, n = matrix.shape
    N: Array = np.eye(n) - check_array(J_sharp, "J_sharp", (n, m)) @ matrix
    return N


def general_solution(J: ArrayLike, J_sharp: ArrayLike, x: ArrayLike, q0: ArrayLike) -> Array:
    """Return q̇ = J# ẋ + (I − J# J) q̇₀ (n,) (000, 004 p. 44), computed as q̇₀ + J# (ẋ − J q̇₀).

    `J` (m, n), `J_sharp` (n, m), `x` (m,) task velocity, `q0` (n,) wished joint velocity. Raises ArgumentError where
    shapes do not match.
    """
    matrix = check_array(J, "J", (None, None))
    m, n = matrix.shape
    sharp = check_array(J_sharp, "J_sharp", (n, m))
    wish = check_array(q0, "q0", (n,))
    solution: Array = wish + sharp @ (check_array(x, "x", (m,)) - matrix @ wish)
    return solution


def _spectral(J: Array, squares: Array) -> Array:
    """Return Σ vᵢ σᵢ/(σᵢ² + λᵢ²) uᵢᵀ with `squares` λᵢ² (min(m, n),); 0 where σ and λ both vanish."""
    u, sigma, vt = np.linalg.svd(J, full_matrices=False)
    denominator = sigma**2 + squares
    keep = (sigma > RANK_TOLERANCE * sigma[0]) | (squares > 0.0)
    gains = np.divide(sigma, denominator, out=np.zeros_like(sigma), where=keep & (denominator > 0.0))
    J_sharp: Array = (vt.T * gains) @ u.T
    return J_sharp


def _ramp(sigma: float, damping: float, threshold: float) -> float:
    """Return λ² = λ₀² (1 − (σ/ε)²) for σ < ε, else 0."""
    return damping**2 * (1.0 - (sigma / threshold) ** 2) if sigma < threshold else 0.0


def _require_rank(J: Array, method: str) -> None:
    sigma = np.linalg.svd(J, compute_uv=False)
    if sigma[-1] <= RANK_TOLERANCE * sigma[0]:
        rank = int(np.count_nonzero(sigma > RANK_TOLERANCE * sigma[0]))
        raise ArgumentError(
            f"J: singular, rank {rank} of {len(sigma)}, which '{method}' cannot invert; use 'pseudo' or a damped method"
        )


def _metric(weight: ArrayLike) -> Array:
    """Return W as a matrix; a vector is its diagonal."""
    is_diagonal = np.ndim(weight) == 1
    W = check_array(weight, "weight", (None,) if is_diagonal else (None, None))
    return np.diag(W) if is_diagonal else W


def _cholesky(weight: Array, size: int) -> Array:
    W = check_array(weight, "weight", (size, size))
    if not np.allclose(W, W.T, rtol=1e-9, atol=0.0):
        raise ArgumentError("weight: must be symmetric")
    eigenvalues = np.linalg.eigvalsh(W)
    if eigenvalues[0] <= 1e-14 * abs(eigenvalues[-1]):
        raise ArgumentError(f"weight: must be positive definite, its smallest eigenvalue is {eigenvalues[0]:.3g}")
    L: Array = np.asarray(np.linalg.cholesky(W), dtype=np.float64)
    return L
