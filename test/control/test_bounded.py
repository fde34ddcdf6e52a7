"""The bounded velocity against independent solutions: ratios for square J, corner enumeration for one redundant joint,
the optimality conditions for the rest, and DAQP on the program as it is written down."""

from __future__ import annotations

import itertools

import daqp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ik_controller.control.bounded import ALONG, BETWEEN, CLOSEST, SCALE_WEIGHT, bounded_velocity
from ik_controller.control.least_distance import active_set, daqp_active_set


def solve(wanted, J, low, high, limit, last=None, rows=None, row_bounds=None, step=None):
    """Return (velocity, s, how)."""
    velocity = np.empty(wanted.size)
    rows = np.zeros((0, wanted.size)) if rows is None else rows
    row_bounds = np.zeros(0) if row_bounds is None else row_bounds
    last = np.zeros(len(J)) if last is None else last
    step = np.full(wanted.size, np.inf) if step is None else step
    scale, how = bounded_velocity(wanted, J, last, low, high, limit, step, rows, row_bounds, velocity)
    return velocity, scale, how


def problem(rng: np.random.Generator, m: int, n: int, around_zero: bool = True):
    """Return (wanted, J, low, high, velocity limits)."""
    J = rng.normal(size=(m, n))
    velocity_limit = rng.uniform(0.5, 3.0, n)
    wanted = rng.normal(size=n) * velocity_limit * 10.0 ** rng.uniform(-0.5, 1.5)
    low, high = -velocity_limit * rng.uniform(0.01, 1.0, n), velocity_limit * rng.uniform(0.01, 1.0, n)
    if not around_zero:  # joints in motion, that cannot be stopped within one cycle
        middle = rng.uniform(-1, 1, n) * velocity_limit
        low, high = middle - 0.05 * velocity_limit, middle + 0.05 * velocity_limit
    return wanted, J, low, high, velocity_limit


def ratio_interval(wanted, low, high):
    """Return the s for which low ≤ s·wanted ≤ high."""
    ends = np.sort(np.vstack((low / wanted, high / wanted)), axis=0)
    return ends[0].max(), ends[1].min()


@given(st.integers(0, 2**32 - 1), st.integers(2, 6), st.booleans())
def test_without_redundancy_the_scale_is_the_smallest_ratio(seed, n, around_zero):
    """J square: q̇ = s q̇_wanted, and s follows from each joint's ratio."""
    args = problem(np.random.default_rng(seed), n, n, around_zero)
    wanted, J, low, high, _ = args
    assume(np.linalg.svd(J)[1][-1] > 0.03)
    least, most = ratio_interval(wanted, low, high)
    least, most = max(least, 0.0), min(most, 1.0)
    assume(abs(most - least) > 1e-6)
    velocity, scale, how = solve(*args)
    bent = how != ALONG
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
    wanted, J, low, high, velocity_limit = args
    assume(np.linalg.svd(J)[1][-1] > 0.1)
    null = np.linalg.svd(J)[2][-1]
    points = corners(wanted, null, low, high)
    velocity, scale, how = solve(*args)
    bent = how != ALONG
    assert (velocity >= low).all()
    assert (velocity <= high).all()
    if not points:
        assert bent or scale < 1e-6
        return
    assert not bent
    best = max(s for s, _ in points)
    # The weight of s is large but finite: what redundancy costs to reach the last 1e-6 of s may be left.
    assert best - 2e-6 * (1.0 + np.max((wanted / velocity_limit) ** 2)) < scale < best + 1e-9
    np.testing.assert_allclose(J @ velocity, scale * J @ wanted, atol=1e-8 * np.abs(J @ wanted).max())
    # Given s, t is as small as the intervals leave it.
    base = scale * wanted
    ends = np.sort(np.vstack(((low - base) / null, (high - base) / null)), axis=0)
    expected = min(max(0.0, ends[0].max()), ends[1].min())
    assert (velocity - base) @ null == pytest.approx(expected, abs=1e-6 * max(1.0, np.abs(wanted).max()))


@settings(max_examples=100)
@given(st.integers(0, 2**32 - 1), st.sampled_from([(6, 7), (6, 6), (3, 7), (2, 5), (6, 3)]), st.booleans())
def test_optimality_conditions(seed, shape, around_zero):
    """No direction that the constraints leave open improves the objective (first order)."""
    m, n = shape
    args = problem(np.random.default_rng(seed), m, n, around_zero)
    wanted, J, low, high, velocity_limit = args
    assume(np.linalg.svd(J)[1][-1] > 0.1)
    velocity, scale, how = solve(*args)
    bent = how != ALONG
    assert np.isfinite(velocity).all()
    assert (velocity >= low).all()
    assert (velocity <= high).all()
    assert 0.0 <= scale <= 1.0
    if bent:
        return
    np.testing.assert_allclose(J @ velocity, scale * J @ wanted, atol=1e-8 * np.abs(J @ wanted).max())
    # With (q̇, s) in the interior of its bounds for the free variables, the gradient is in the span of the equalities.
    away = (velocity - scale * wanted) / velocity_limit**2
    gradient = np.append(away, SCALE_WEIGHT * (scale - 1.0) - away @ wanted)
    x, lower, upper = np.append(velocity, scale), np.append(low, 0.0), np.append(high, 1.0)
    equality = np.column_stack((J, -J @ wanted))
    margin = 1e-7 * np.fmax(1.0, np.abs(upper))
    signs = np.where(x <= lower + margin, 1, np.where(x >= upper - margin, -1, 0))  # which way it may move
    if scale == 1.0:  # comes first, whatever it costs: of either sign
        equality = np.vstack((equality, np.eye(n + 1)[n]))
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


def by_daqp(wanted, J, low, high, limit, rows, row_bounds):
    """Return (q̇, s) of the program in the module's docstring as it is written, s = 1 first; None where DAQP finds
    none."""
    return _by_daqp(1.0, wanted, J, low, high, limit, rows, row_bounds) or _by_daqp(
        0.0, wanted, J, low, high, limit, rows, row_bounds
    )


def _by_daqp(least, wanted, J, low, high, limit, rows, row_bounds):
    n, k = wanted.size, len(row_bounds)
    singular, basis = np.linalg.svd(J * limit)[1:]
    task = basis[: np.sum(singular > 1e-4 * singular[0])] / limit
    r = len(task)
    deviation = np.column_stack((np.diag(1.0 / limit), -wanted / limit))
    hessian = deviation.T @ deviation
    hessian[n, n] += SCALE_WEIGHT
    linear = np.append(np.zeros(n), -SCALE_WEIGHT)
    constraints = np.vstack((np.column_stack((task, -task @ wanted)), np.column_stack((rows, np.zeros(k)))))
    upper, lower = (
        np.concatenate((high, [1.0], np.zeros(r), row_bounds)),
        np.concatenate((low, [least], np.zeros(r), -1e30 * np.ones(k))),
    )
    sense = np.repeat(np.array([0, 5, 0], dtype=np.int32), (n + 1, r, k))
    x, _, flag, _ = daqp.solve(hessian, linear, constraints, upper, lower, sense, primal_tol=1e-12)
    return (x[:n], x[n]) if flag == 1 else None


@settings(max_examples=500)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([(6, 7), (6, 6), (3, 7), (2, 5), (6, 3), (6, 8), (5, 6), (1, 7), (3, 2)]),
    st.sampled_from([0, 0, 1, 8]),
    st.sampled_from(["general", "dependent rows", "idle joint", "at its bound", "one velocity left", "in motion"]),
)
def test_equals_daqp(seed, shape, k, kind):
    """To 1e-9, where there is a velocity along the direction; DAQP must then find one too."""
    rng = np.random.default_rng(seed)
    m, n = shape
    wanted, J, low, high, limit = problem(rng, m, n, around_zero=kind != "in motion")
    if kind == "dependent rows":
        J[-1] = 2.0 * J[0]
    elif kind == "idle joint":
        J[:, -1] = 0.0
    elif kind == "at its bound":
        low[0] = 0.0
    elif kind == "one velocity left":
        low[0] = high[0]
    singular = np.linalg.svd(J * limit)[1]
    assume(not ((singular > 1e-7 * singular[0]) & (singular < 1e-2 * singular[0])).any())  # the rank is beyond doubt
    rows, row_bounds = rng.normal(size=(k, n)), rng.uniform(-0.1, 1.0, k)
    velocity, scale, how = solve(wanted, J, low, high, limit, None, rows, row_bounds)
    assert (low <= velocity).all()
    assert (velocity <= high).all()
    expected = by_daqp(wanted, J, low, high, limit, rows, row_bounds)
    if how != ALONG:
        assert expected is None
        return
    np.testing.assert_allclose(J @ velocity, scale * (J @ wanted), atol=1e-10 * np.abs(wanted).max())
    assert (rows @ velocity <= row_bounds + 1e-10 * np.abs(wanted).max()).all()
    if expected is None:  # it misses some where only s = 0 is left
        assert scale < 1e-9
        return
    assert abs(scale - expected[1]) < 1e-9
    np.testing.assert_allclose(
        velocity / limit, expected[0] / limit, atol=1e-9 * max(1.0, np.abs(wanted / limit).max())
    )


@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(1, 20), st.booleans())
def test_shortest_vector_equals_daqp(seed, p, k, degenerate):
    """Rows repeated, opposed and scaled too; where one finds nothing, the other does not either."""
    rng = np.random.default_rng(seed)
    rows, upper = rng.normal(size=(k, p)), rng.normal(size=k)
    if degenerate:
        rows[k // 2 :] = rows[: k - k // 2] * np.where(rng.integers(0, 2, k - k // 2), 1.0, -0.5)[:, None]
        upper[k // 2 :] = np.abs(upper[k // 2 :])
    lower = np.where(rng.integers(0, 2, k), -np.inf, upper - rng.uniform(0.0, 1.0, k))
    x, y = np.empty(p), np.empty(p)
    found = active_set(rows, lower, upper, 1e-12, x)
    assert found == daqp_active_set(rows, np.fmax(lower, -1e30), upper, 1e-12, y)
    if found:
        np.testing.assert_allclose(x, y, atol=1e-9 * max(1.0, np.abs(y).max()))


def test_a_task_direction_out_of_reach_is_no_constraint():
    """m > n: the rows that J cannot move along leave the others free."""
    J = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    wanted, limit = np.array([2.0, 1.0]), np.array([1.0, 1.0])
    velocity, scale, how = solve(wanted, J, -limit, limit, limit)
    np.testing.assert_allclose(velocity, [1.0, 0.5], atol=1e-12)
    assert scale == pytest.approx(0.5, abs=1e-12)
    assert how == ALONG


def test_on_its_line_the_tool_overshoots_rather_than_leaves_it():
    """Joint 0 must still be as fast as 0.4, the wanted 0.2 is too slow for it: the other is kept in proportion."""
    J, limit = np.eye(2), np.ones(2)
    low, high = np.array([0.4, -0.6]), np.array([0.5, 0.6])
    wanted, last = np.array([0.2, 0.1]), np.array([0.45, 0.225])
    velocity, _, how = solve(wanted, J, low, high, limit, last)
    assert how == BETWEEN
    assert velocity[0] >= 0.4
    assert velocity[1] / velocity[0] == pytest.approx(0.5, abs=1e-9)
    # Braking against the wanted direction: on the line still.
    velocity, _, how = solve(-wanted, J, low, high, limit, last)
    assert how == BETWEEN
    assert 0.4 <= velocity[0] < 0.45
    assert velocity[1] / velocity[0] == pytest.approx(0.5, abs=1e-9)


@given(st.integers(0, 2**32 - 1), st.sampled_from([(6, 7), (6, 6), (3, 7), (2, 5)]))
def test_between_the_wanted_and_the_last_direction(seed, shape):
    """From a state in motion: J q̇ is in the cone of the two directions wherever `BETWEEN` says so, and it says so
    wherever the last velocity itself is in the intervals."""
    rng = np.random.default_rng(seed)
    wanted, J, low, high, limit = problem(rng, *shape, around_zero=False)
    before = 0.5 * (low + high)
    velocity, _, how = solve(wanted, J, low, high, limit, J @ before)
    assert how in (ALONG, BETWEEN)
    if how == BETWEEN:
        ways = np.column_stack((J @ wanted, J @ before))
        shares, rest = np.linalg.lstsq(ways, J @ velocity, rcond=None)[:2]
        assert (shares >= -1e-7).all()
        assert rest.sum() < 1e-12 * max(1.0, np.abs(wanted).max())


def test_where_the_direction_cannot_be_held_the_closest_velocity_is_taken():
    """Joint 1 must still move backwards: nothing in the interval is along the wanted direction."""
    J, limit = np.eye(2), np.array([1.0, 1.0])
    low, high = np.array([-0.5, -0.1]), np.array([-0.4, 0.6])
    velocity, _, how = solve(np.array([0.8, 0.4]), J, low, high, limit)
    np.testing.assert_allclose(velocity, [-0.4, 0.4], atol=1e-6)
    assert how == CLOSEST


@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
def test_rows_that_cannot_all_be_kept_give_way_and_the_intervals_do_not(seed, k):
    """The sum of squares of what rows are overstepped by is as small as intervals allow: no step lowers it."""
    rng = np.random.default_rng(seed)
    wanted, J, low, high, limit = problem(rng, 6, 7)
    rows, row_bounds = rng.normal(size=(k, 7)), rng.uniform(-20.0, -10.0, k)
    rows /= np.linalg.norm(rows * limit, axis=1)[:, None]
    velocity, _, how = solve(wanted, J, low, high, limit, None, rows, row_bounds)
    assert how == CLOSEST
    assert (low <= velocity).all()
    assert (velocity <= high).all()
    slope = rows.T @ np.fmax(rows @ velocity - row_bounds, 0.0) * limit
    at_low, at_high = velocity <= low + 1e-9, velocity >= high - 1e-9
    assert (np.abs(slope[~at_low & ~at_high]) < 1e-4).all()
    assert (slope[at_low & ~at_high] > -1e-4).all()
    assert (slope[at_high & ~at_low] < 1e-4).all()
