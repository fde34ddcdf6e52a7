"""The jerk limit's interval against brute force: the stop's closed form, its order, that no other stop is shorter; then
streams of extreme choices. Velocities are in units of J dt², so that dt = J = 1."""

from __future__ import annotations

import math

import daqp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ik_controller.control.interval import highest, landing, ramp_sum, stop_braking, stop_distance, stop_together


def state(rng: np.random.Generator, largest: float = 300.0):
    """Return (v, x, A): a velocity, the last braking, the acceleration limit; often whole, where the cases meet."""
    most = 10.0 ** rng.uniform(-1.5, 1.7) if rng.random() < 0.7 else float(rng.integers(1, 30))
    x = rng.uniform(-most, most)
    if rng.random() < 0.3:
        x = float(np.clip(round(x), -most, most))
    v = 10.0 ** rng.uniform(-3.0, math.log10(largest)) if rng.random() < 0.6 else float(rng.integers(0, largest))
    return (-v if rng.random() < 0.3 else v), x, most


def stop(v: float, x: float, most: float) -> np.ndarray:
    """Return the velocities of the stop, to rest."""
    velocities = []
    while not (abs(v) < 1e-9 and abs(x) < 1e-9):
        x = stop_braking(v, x, most)
        v -= x
        velocities.append(v)
        assert len(velocities) < 100_000
    return np.array(velocities)


def can_land(v: float, x: float) -> bool:
    """Has the joint not braked so hard that it must turn back?"""
    return landing(v) >= (x - 1.0 if v >= 0.0 else x + 1.0)


@given(st.floats(0.0, 1e6))
def test_landing_is_the_inverse_of_the_ramps_sum(y):
    assert landing(ramp_sum(y)) == pytest.approx(y, rel=1e-12, abs=1e-12)
    whole = math.floor(y)
    assert ramp_sum(float(whole)) == sum(range(whole + 1)) if whole < 5000 else True
    assert landing(-y) == -landing(y)


@given(st.integers(0, 2**32 - 1))
def test_the_stop_keeps_its_limits_and_its_length_is_the_closed_forms(seed):
    rng = np.random.default_rng(seed)
    v, x, most = state(rng)
    velocities = np.concatenate(([v + x, v], stop(v, x, most)))  # two before tell the braking before
    braking = -np.diff(velocities)
    assert np.abs(braking).max() <= most * (1 + 1e-12)
    assert np.abs(np.diff(braking)).max() <= 1 + 1e-9
    assert abs(braking[-1]) <= 1 + 1e-9  # so that the next velocity may be zero again
    if can_land(v, x):
        size = 1 + np.abs(velocities).sum()
        assert stop_distance(v, x, most) == pytest.approx(velocities[2:].sum(), abs=1e-9 * size)


@given(st.integers(0, 2**32 - 1))
def test_no_stop_that_does_not_turn_back_is_shorter(seed):
    """A linear program over all of them has the same minimum. DAQP takes a quadratic term, so small that it is lost."""
    rng = np.random.default_rng(seed)
    v, x, most = state(rng, 40.0)
    assume(v > 0.0 and most > 0.3 and can_land(v, x))
    n = stop(v, x, most).size + 4
    sums = np.tril(np.ones((n, n)))  # v_i = v − (sums @ x)_i
    steps = np.eye(n) - np.eye(n, k=-1)
    first = np.zeros(n)
    first[0] = x
    rows = np.vstack((sums, steps))
    upper = np.concatenate((np.full(n, most), np.append(np.full(n - 1, v), v), first + 1.0))
    lower = np.concatenate((np.full(n, -most), np.append(np.full(n - 1, -1e4), v), first - 1.0))
    upper[n - 1], lower[n - 1] = min(most, 1.0), -min(most, 1.0)  # and no acceleration at the end
    weight = 1e-7
    solution, _, flag, _ = daqp.solve(
        weight * np.eye(n), -sums.sum(axis=0), rows, upper, lower, np.zeros(3 * n, dtype=np.int32)
    )
    assert flag == 1
    shortest = float((v - sums @ solution).sum())
    assert stop_distance(v, x, most) <= shortest + 1e-6 * (1 + abs(shortest))


@given(st.integers(0, 2**32 - 1))
def test_stops_keep_their_order(seed):
    """Of two next velocities the larger stays the larger at every later time."""
    rng = np.random.default_rng(seed)
    v, x, most = state(rng)
    low, high = v - min(x + 1.0, most), v - max(x - 1.0, -most)
    one, two = sorted(rng.uniform(low, high, 2))
    first, second = stop(one, v - one, most), stop(two, v - two, most)
    n = max(first.size, second.size)
    first, second = np.pad(first, (0, n - first.size)), np.pad(second, (0, n - second.size))
    assert (first <= second + 1e-9 * (1 + abs(v))).all()


@given(st.integers(0, 2**32 - 1))
def test_the_highest_velocity_is_the_last_whose_stop_stays_in_the_room(seed):
    rng = np.random.default_rng(seed)
    v, x, most = state(rng)
    assume(can_land(v, x))
    least = stop(v, x, most)
    room = max(np.max(np.cumsum(least), initial=0.0), 0.0) * (1 + 10.0 ** rng.uniform(-6, 1)) + rng.exponential()
    fastest = max(v, least.max(initial=0.0)) + rng.exponential() * 10.0 ** rng.uniform(-2, 2)
    result = highest(v, -x, most, fastest, room)
    tolerance = 1e-9 * (1 + abs(v) + room)

    def fits(candidate: float, slack: float) -> bool:
        velocities = np.append(candidate, stop(candidate, v - candidate, most))
        return velocities.max() <= fastest + slack and np.cumsum(velocities).max() <= room + slack

    assert fits(result, tolerance)
    assert result >= least[0] - tolerance
    higher = result + 1e-4 * (1 + abs(result))
    assert higher > v - max(x - 1.0, -most) or not fits(higher, 0.0)


def walk(rng: np.random.Generator, steps: int) -> np.ndarray:
    """Go to the ends of the interval, at random, for some steps; return the worst excess over A, J, V, the bounds."""
    most, fastest = 10.0 ** rng.uniform(-1.3, 1.5), 10.0 ** rng.uniform(-0.5, 2.3)
    upper = 10.0 ** rng.uniform(-1.0, 4.0)
    q, v, w = rng.uniform(0.0, upper), 0.0, 0.0
    worst = np.zeros(4)
    style, choice, hold = rng.integers(0, 4), 0, 1
    for k in range(steps):
        high, low = highest(v, w, most, fastest, upper - q), -highest(-v, -w, most, fastest, q)
        assert low <= high + 1e-9 * (1 + abs(v))
        if k % hold == 0:
            choice, hold = rng.integers(0, 3), int(rng.integers(1, 60))
        chosen = (high, low, rng.uniform(min(low, high), high))[choice]
        if style == 0:
            chosen = high if rng.random() < 0.5 else low
        elif style == 1:
            chosen = min(max(low, 0.0), high)
        change = chosen - v
        q += chosen
        excess = abs(change) / most - 1, abs(change - w) - 1, abs(chosen) / fastest - 1, max(q / upper - 1, -q / upper)
        worst = np.maximum(worst, excess)
        v, w = chosen, change
    return worst


@pytest.mark.parametrize("walks", [300, pytest.param(4000, marks=pytest.mark.soak)])
def test_extreme_choices_leave_no_bound_and_always_a_way(walks):
    """The long form takes more than a million choices."""
    rng = np.random.default_rng(11)
    worst = np.max([walk(rng, 300) for _ in range(walks)], axis=0)
    assert (worst < 1e-10).all()


@given(st.integers(0, 2**32 - 1), st.integers(2, 7))
def test_joints_that_accelerate_along_their_direction_stop_along_it(seed, n):
    """Straight in joint space, each within its limits, exactly at rest in the end."""
    rng = np.random.default_rng(seed)
    dt = 1e-3
    acceleration, jerk = 10.0 ** rng.uniform(0, 1.5, n), 10.0 ** rng.uniform(1.5, 4, n)
    jerk[rng.random(n) < 0.2] = math.inf
    assume(np.isfinite(jerk).any())
    v = rng.normal(size=n) * 2.0
    pace = min(1.0, *(acceleration / np.abs(v))) * rng.uniform(-1, 1)
    pace = np.clip(pace, -np.sqrt(2 * np.min(jerk / np.abs(v))) / 2, None)  # not so hard that it must turn back
    direction, a = v / np.linalg.norm(v), pace * v
    for _ in range(200_000):
        after = stop_together(v, a, dt, acceleration, jerk)
        change = (after - v) / dt
        assert (np.abs(change) <= acceleration * (1 + 1e-9) + 1e-12).all()
        assert (np.abs(change - a) <= jerk * dt * (1 + 1e-9) + 1e-10).all()
        assert np.abs(after - (after @ direction) * direction).max() < 1e-12
        v, a = after, change
        if not v.any():
            break
    assert (np.abs(a) <= jerk * dt * (1 + 1e-9)).all()
