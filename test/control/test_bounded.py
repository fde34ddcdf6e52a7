"""The bounded velocity against independent solutions: ratios for square J, corner enumeration for one redundant joint,
and the optimality conditions for the rest."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ik_controller.control.bounded import bounded_velocity


def problem(rng: np.random.Generator, m: int, n: int, around_zero: bool = True):
    """Return (wanted, J, eigenvalues, directions, low, high, velocity limits)."""
    J = rng.normal(size=(m, n))
    eigenvalues, directions = np.linalg.eigh(J @ J.T)
    velocity_limit = rng.uniform(0.5, 3.0, n)
    wanted = rng.normal(size=n) * velocity_limit * 10.0 ** rng.uniform(-0.5, 1.5)
    low, high = -velocity_limit * rng.uniform(0.01, 1.0, n), velocity_limit * rng.uniform(0.01, 1.0, n)
    if not around_zero:  # joints in motion, that cannot be stopped within one cycle
        middle = rng.uniform(-1, 1, n) * velocity_limit
        low, high = middle - 0.05 * velocity_limit, middle + 0.05 * velocity_limit
    return wanted, J, eigenvalues, directions, low, high, velocity_limit


def ratio_interval(wanted, low, high):
    """Return the s for which low ≤ s·wanted ≤ high."""
    ends = np.sort(np.vstack((low / wanted, high / wanted)), axis=0)
    return ends[0].max(), ends[1].min()


@given(st.integers(0, 2**32 - 1), st.integers(2, 6), st.booleans())
def test_without_redundancy_the_scale_is_the_smallest_ratio(seed, n, around_zero):
    """J square: q̇ = s q̇_wanted, and s follows from each joint's ratio."""
    args = problem(np.random.default_rng(seed), n, n, around_zero)
    wanted, J, eigenvalues, _, low, high, _ = args
    assume(eigenvalues[0] > 1e-3)
    least, most = ratio_interval(wanted, low, high)
    least, most = max(least, 0.0), min(most, 1.0)
    assume(abs(most - least) > 1e-6)
    velocity, scale, bent = bounded_velocity(*args)
    assert (velocity >= low).all()
    assert (velocity <= high).all()
    assert bent == (least > most)
    if not bent:
        assert scale == pytest.approx(most, abs=1e-6)
        np.testing.assert_allclose(velocity, most * wanted, atol=1e-5 * np.abs(wanted).max())
        np.testing.assert_allclose(J @ velocity, scale * J @ wanted, atol=1e-8 * np.abs(wanted).max())


def corners(wanted, null, low, high):
    """Return the corners (s, t) of low ≤ s·wanted + t·null ≤ high, 0 ≤ s ≤ 1."""
    rows = np.vstack((np.column_stack((wanted, null)), [[1.0, 0.0]]))
    lower, upper = np.append(low, 0.0), np.append(high, 1.0)
    found = []
    for (i, a), (j, b) in itertools.combinations([(i, side) for i in range(len(rows)) for side in (0, 1)], 2):
        matrix = rows[[i, j]]
        if abs(np.linalg.det(matrix)) < 1e-9:
            continue
        point = np.linalg.solve(matrix, [(lower, upper)[a][i], (lower, upper)[b][j]])
        value = rows @ point
        if (value >= lower - 1e-9).all() and (value <= upper + 1e-9).all():
            found.append(point)
    return found


@given(st.integers(0, 2**32 - 1), st.integers(2, 7), st.booleans())
def test_one_redundant_joint_is_used_before_slowing_down(seed, n, around_zero):
    """n = m + 1: q̇ = s q̇_wanted + t z with z the null vector; the largest s is at a corner of the polygon in (s, t)."""
    args = problem(np.random.default_rng(seed), n - 1, n, around_zero)
    wanted, J, eigenvalues, _, low, high, velocity_limit = args
    assume(eigenvalues[0] > 1e-2)
    null = np.linalg.svd(J)[2][-1]
    points = corners(wanted, null, low, high)
    velocity, scale, bent = bounded_velocity(*args)
    assert (velocity >= low).all()
    assert (velocity <= high).all()
    if not points:
        assert bent or scale < 1e-6
        return
    assert not bent
    best = max(s for s, _ in points)
    # The weight of s is large but finite: what redundancy costs to reach the last 1e-4 of s may be left.
    assert best - 2e-4 * (1.0 + np.max((wanted / velocity_limit) ** 2)) < scale < best + 1e-7
    np.testing.assert_allclose(J @ velocity, scale * J @ wanted, atol=1e-8 * np.abs(J @ wanted).max())
    # Given s, t minimizes the weighted distance to the wanted velocity within what the intervals leave.
    weight = 1.0 / velocity_limit**2
    base = scale * wanted
    free = ((weight * (wanted - base)) @ null) / ((weight * null) @ null)
    ends = np.sort(np.vstack(((low - base) / null, (high - base) / null)), axis=0)
    expected = min(max(free, ends[0].max()), ends[1].min())
    assert (velocity - base) @ null == pytest.approx(expected, abs=1e-4 * max(1.0, np.abs(wanted).max()))


@settings(max_examples=100)
@given(st.integers(0, 2**32 - 1), st.sampled_from([(6, 7), (6, 6), (3, 7), (2, 5), (6, 3)]), st.booleans())
def test_optimality_conditions(seed, shape, around_zero):
    """No direction that the constraints leave open improves the objective (first order)."""
    m, n = shape
    args = problem(np.random.default_rng(seed), m, n, around_zero)
    wanted, J, eigenvalues, _, low, high, velocity_limit = args
    assume(np.sort(eigenvalues)[-min(m, n)] > 1e-2)
    velocity, scale, bent = bounded_velocity(*args)
    assert np.isfinite(velocity).all()
    assert (velocity >= low).all()
    assert (velocity <= high).all()
    assert 0.0 <= scale <= 1.0
    if bent:
        return
    np.testing.assert_allclose(J @ velocity, scale * J @ wanted, atol=1e-8 * np.abs(J @ wanted).max())
    # With (q̇, s) in the interior of its bounds for the free variables, the gradient is in the span of the equalities.
    weight = 1.0 / velocity_limit**2
    gradient = np.append(weight * (velocity - wanted), 1e6 * (scale - 1.0))
    x, lower, upper = np.append(velocity, scale), np.append(low, 0.0), np.append(high, 1.0)
    equality = np.column_stack((J, -J @ wanted))
    margin = 1e-7 * np.fmax(1.0, np.abs(upper))
    signs = np.where(x <= lower + margin, 1, np.where(x >= upper - margin, -1, 0))  # which way it may move
    # Multipliers by non-negative least squares: gradient = equalityᵀ y + Σ signs_i μ_i, μ ≥ 0.
    active = np.flatnonzero(signs)
    bound_columns = np.zeros((n + 1, active.size))
    bound_columns[active, np.arange(active.size)] = signs[active]
    columns = np.hstack((equality.T, -equality.T, bound_columns))
    scale_of = np.linalg.norm(columns, axis=0)
    rest = residual_of_nonnegative_combination(columns / np.where(scale_of > 0, scale_of, 1.0), gradient)
    assert rest <= 1e-4 * max(1.0, np.linalg.norm(gradient))


def residual_of_nonnegative_combination(A: np.ndarray, b: np.ndarray) -> float:
    """Return ‖A x − b‖ minimal over x ≥ 0 (Lawson and Hanson's active sets)."""
    x, passive = np.zeros(A.shape[1]), np.zeros(A.shape[1], dtype=bool)
    for _ in range(20 * A.shape[1]):
        slope = A.T @ (b - A @ x)
        slope[passive] = -np.inf
        if slope.max(initial=-np.inf) <= 1e-10 * max(1.0, np.linalg.norm(b)):
            break
        passive[np.argmax(slope)] = True
        while True:
            trial = np.zeros_like(x)
            trial[passive] = np.linalg.lstsq(A[:, passive], b, rcond=None)[0]
            if (trial[passive] > 0).all():
                break
            blocking = passive & (trial <= 0)
            step = np.min(x[blocking] / np.maximum(x[blocking] - trial[blocking], 1e-300))
            x = x + step * (trial - x)
            passive &= x > 1e-14
        x = trial
    return float(np.linalg.norm(A @ x - b))


def test_a_task_direction_out_of_reach_is_no_constraint():
    """m > n: the rows that J cannot move along leave the others free."""
    J = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    eigenvalues, directions = np.linalg.eigh(J @ J.T)
    wanted, limit = np.array([2.0, 1.0]), np.array([1.0, 1.0])
    velocity, scale, bent = bounded_velocity(wanted, J, eigenvalues, directions, -limit, limit, limit)
    np.testing.assert_allclose(velocity, [1.0, 0.5], atol=1e-5)
    assert scale == pytest.approx(0.5, abs=1e-5)
    assert not bent


def test_where_the_direction_cannot_be_held_the_closest_velocity_is_taken():
    """Joint 1 must still move backwards: nothing in the interval is along the wanted direction."""
    J, limit = np.eye(2), np.array([1.0, 1.0])
    low, high = np.array([-0.5, -0.1]), np.array([-0.4, 0.6])
    velocity, _, bent = bounded_velocity(np.array([0.8, 0.4]), J, np.ones(2), np.eye(2), low, high, limit)
    np.testing.assert_allclose(velocity, [-0.4, 0.4], atol=1e-6)
    assert bent
