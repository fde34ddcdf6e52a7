"""The bounded problem: the task within joint intervals; redundancy before slowing down, slowing before bending.

    minimize  ‖D (q̇ − s q̇_wanted)‖² + W (1 − s)²
    subject to  J q̇ = s J q̇_wanted,  low ≤ q̇ ≤ high,  G q̇ ≤ g,  0 ≤ s ≤ 1

is a true quadratic program: a joint at its bound is relieved by the others (null space) before the task is scaled by s
along its direction. D divides by the velocity limits; s = 1 is tried first, and W is large, so s is given up last. With
y = D q̇ and N a basis of the y that do not move the tool, the equality is solved beforehand: y = s y_wanted + N z, and
what remains is the shortest (√W (1 − s), z) within the bounds: two unknowns for a 7-joint arm.

Redundancy keeps the task at its full speed, but is not there to speed it up: null-space motion bought for a faster
start has to be braked as well, and is missing where the tool is to stop. So where s < 1 anyway, it rises from cycle to
cycle no faster than the joints' accelerations allow without that help.

Where no s in [0, 1] can hold the direction, because a joint must still brake from the last cycle, the tool may go on
along its last velocity too: J q̇ = s₁ J q̇_wanted + s₂ ẋ_last, s₁, s₂ ≥ 0, s₁ + s₂ ≤ 1. So it leaves no straight line,
turns from one direction into another between the two, and is no faster than the faster of them. Where that has no
solution either, the velocity in the intervals that leaves the line least is taken, which slows down on it, or near a
singularity the closest; with the rows G q̇ ≤ g as far as they can be kept.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.interval import highest, stop_braking
from ik_controller.control.least_distance import active_set, least_distance
from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.scratch import scratch, scratch_table
from ik_controller.kinematics.small import DEPENDENT, inverse_factor, row_space

Array = NDArray[np.float64]

# How the velocity was found.
ALONG, BETWEEN, CLOSEST = 0, 1, 2

SCALE_WEIGHT = 1e8  # W, against joint velocities of order one
_STACK_WEIGHT = 1e11  # W in a stack, whose secondary tasks have weights of their own
_CLOSEST_WEIGHT = 1e-4  # on joint velocities beside the way off the line, where the line cannot be held
_ROW_WEIGHT = 1e8  # on the square of how far a row of G is not kept
CURVE_SHARE = 0.7  # of the accelerations that the path's own curvature may take where the path is slowed anyway
SLOWING_SHARE = 0.5  # of the accelerations by which it is slowed for that
_SPEED_SHARE = 0.98  # of the velocity limits that a path is led to under jerk limits, where it is slowed anyway
TOLERANCE = 1e-12  # of bounds, as a share of the velocity limits


@compiled
def bounded_velocity(
    wanted: Array,
    jacobian: Array,
    last: Array,
    low: Array,
    high: Array,
    limit: Array,
    step: Array,
    rows: Array,
    row_bounds: Array,
    velocity: Array,
    own: Any = None,
    secondary: Any = None,
    weights: Any = None,
    motion: Any = None,
    ahead: bool = False,
) -> tuple[float, int]:
    """Write the velocity (n,) nearest to `wanted` (n,) in [`low`, `high`] that keeps the tool's direction; return s and
    how it was found.

    `jacobian` J (m, n); `last` ẋ_last (m,), the task velocity of the last cycle; `limit` (n,), the velocity limits;
    `step` (n,), by how much a velocity may change in a cycle; `rows` G (k, n) and `row_bounds` g (k,), k may be 0. In a
    stack of tasks, `own` (n,) is what of `wanted` the first task asks for, and `secondary` (l, n) are those that give
    way before it does, but after what is in no task, at their `weights` (l,). `motion` (3, n): the last velocities, by
    how much they changed in the last cycle, and by how much that change may change, inf without a jerk limit; where
    it is given and `ahead`, the path's speed is kept where the next cycles can go on along it. The result is always in
    [low, high].
    """
    n, m = wanted.shape[0], jacobian.shape[0]
    task, aim, largest = scratch_table(m, n), scratch(n), 1.0
    for j in range(n):
        aim[j] = wanted[j] / limit[j]
        largest = max(largest, abs(aim[j]))
        for i in range(m):
            task[i, j] = jacobian[i, j] * limit[j]
    tolerance = TOLERANCE * largest
    basis, before = scratch_table(n, n), scratch(n)
    null = basis[: row_space(task, last, basis, before)]
    ways, y, found = scratch_table(2, n), scratch(n), ALONG
    omega, ease, free = math.sqrt(SCALE_WEIGHT), aim, null
    if own is not None:
        omega, ease, free = math.sqrt(_STACK_WEIGHT), own / limit, null.copy()
        _weigh(free, secondary, weights, limit)
    jerky, slowest = False, -math.inf
    solved, scale = _on_path(aim, ways, omega, 0, 1.0, 0.0, free, low, high, limit, rows, row_bounds, tolerance, y)
    if not solved:
        for j in range(n):
            ways[0, j], ways[1, j] = -aim[j], before[j]
        most = _most_at_ease(ease, before, null, limit, step)
        if motion is not None:
            fastest, turn = math.inf, _turning(before, null, limit, motion, scratch(n))
            if math.isfinite(motion[2].min()):
                slowest, jerky = _slowest(before, turn, limit, step, motion), True
                solved, fastest = _on_path(
                    aim, ways, omega, 1, 1.0, 0.0, null, -limit, limit, limit, rows[:0], row_bounds[:0], tolerance, y
                )
                fastest = _SPEED_SHARE * fastest if solved else 0.0
            if ahead:
                most = min(most, _most_ahead(aim, before, turn, null, limit, step, motion, fastest))
        solved, scale = _on_path(aim, ways, omega, 1, most, 0.0, free, low, high, limit, rows, row_bounds, tolerance, y)
    # With jerk limits the tool must perhaps go on speeding up, and must not slow down too hard to land at rest.
    for attempt in range(3 if jerky else 1):
        if not solved:
            found, most = BETWEEN, 1.0 if attempt == 0 else 2.0
            least = slowest if attempt < 2 else -math.inf
            solved, scale = _on_path(
                aim, ways, omega, 2, most, least, free, low, high, limit, rows, row_bounds, tolerance, y
            )
    if not solved:
        found = CLOSEST
        scale = _closest(aim, 0.0 if ahead else 1.0 / largest, jacobian, low, high, limit, rows, row_bounds, y)
    for j in range(n):
        velocity[j] = min(max(y[j] * limit[j], low[j]), high[j])
    return min(max(scale, 0.0), 1.0), found


@compiled
def _weigh(null: Array, secondary: Array, weights: Array, limit: Array) -> None:
    """Turn the basis `null` (p, n) so that its first rows span, one after the other, what `secondary` (l, n) leaves of
    it, and divide each of these by √weight: as an unknown it then costs that weight.
    """
    (p, n), first = null.shape, 0
    mirror = scratch(p)
    for task in range(secondary.shape[0]):
        square, size = 0.0, 0.0
        for i in range(first, p):
            mirror[i] = 0.0
            for j in range(n):
                mirror[i] += null[i, j] * secondary[task, j] * limit[j]
            square += mirror[i] * mirror[i]
        for j in range(n):
            size += secondary[task, j] * secondary[task, j] * limit[j] * limit[j]
        if square <= DEPENDENT * size or square == 0.0:
            continue
        corner = -math.sqrt(square) if mirror[first] > 0.0 else math.sqrt(square)
        mirror[first] -= corner
        factor = -1.0 / (corner * mirror[first])
        for j in range(n):
            total = 0.0
            for i in range(first, p):
                total += null[i, j] * mirror[i]
            for i in range(first, p):
                null[i, j] -= factor * total * mirror[i]
            null[first, j] /= math.sqrt(weights[task])
        first += 1


@compiled
def _moving_part(vector: Array, null: Array, part: Array) -> Array:
    """Write what of a vector (n,) moves the tool, the rest of it beside `null` (p, n), to `part` and return that."""
    n = vector.shape[0]
    for j in range(n):
        part[j] = vector[j]
    for i in range(null.shape[0]):
        total = 0.0
        for j in range(n):
            total += null[i, j] * vector[j]
        for j in range(n):
            part[j] -= total * null[i, j]
    return part


@compiled
def _most_at_ease(aim: Array, last: Array, null: Array, limit: Array, step: Array) -> float:
    """Return the largest s ≤ 1 that the tool can be brought to in this cycle without help from the null space.

    `last` b (n,): the part of the last velocity that moved the tool; a, the same part of `aim` (n,). With s_last =
    a·b/a·a the joints change by s aim − b − s_last (aim − a), each by its `step` (n,) at most; 1 where no s does that.
    """
    n, along, square = aim.shape[0], 0.0, 0.0
    part = _moving_part(aim, null, scratch(n))
    for j in range(n):
        along += part[j] * last[j]
        square += part[j] * part[j]
    before = along / square if square > 0.0 else 0.0
    least, most = -math.inf, 1.0
    for j in range(n):
        goal, start = aim[j] * limit[j], (last[j] + before * (aim[j] - part[j])) * limit[j]
        if goal < 0.0:
            goal, start = -goal, -start
        if goal > 0.0:
            least, most = max(least, (start - step[j]) / goal), min(most, (start + step[j]) / goal)
    return most if least <= most and most > 0.0 else 1.0


@compiled
def _turning(last: Array, null: Array, limit: Array, motion: Array, turn: Array) -> Array:
    """Write by how much the joints (n,) must change in a cycle to keep the tool's velocity while J changes to `turn`
    and return that: J⁺ẋ_last, which is `last`, − P q̇, with P onto what moves the tool.
    """
    n = last.shape[0]
    for j in range(n):
        turn[j] = last[j] - motion[0, j] / limit[j]
    for i in range(null.shape[0]):
        idle = 0.0
        for j in range(n):
            idle += null[i, j] * motion[0, j] / limit[j]
        for j in range(n):
            turn[j] += idle * null[i, j]
    return turn


@compiled
def _most_ahead(
    aim: Array, last: Array, turn: Array, null: Array, limit: Array, step: Array, motion: Array, fastest: float
) -> float:
    """Return the largest s after which the joints can go on along the path, as far as this cycle shows it.

    `turn` grows with the square of s: it may take `CURVE_SHARE` of the joints' accelerations. A joint that it speeds
    up comes to its velocity limit, from where on s must fall with it: it must be slow enough for that until then. With
    jerk limits, s itself moves like one joint whose limits are those of the joint that has the least for its part in
    `aim`: so none lets go of its acceleration faster than the others can, before s is at `fastest`. Arrays as above.
    """
    n, along, square, change = aim.shape[0], 0.0, 0.0, 0.0
    part = _moving_part(aim, null, scratch(n))
    unit, hardest, curve = math.inf, math.inf, 0.0
    for j in range(n):
        along += part[j] * last[j]
        square += part[j] * part[j]
        change += part[j] * (motion[1, j] / limit[j] - turn[j])
        size = abs(aim[j]) * limit[j]
        if size > 0.0:
            hardest, unit = min(hardest, step[j] / size), min(unit, motion[2, j] / size)
        if step[j] > 0.0:
            curve = max(curve, abs(turn[j]) * limit[j] / step[j])
    if not (square > 0.0 and along > 0.0):
        return 1.0
    before, change = along / square, change / square
    if curve > CURVE_SHARE:
        fastest = min(fastest, before * math.sqrt(CURVE_SHARE / curve))
    for j in range(n):
        speed = motion[0, j] / limit[j]
        if turn[j] * speed > 0.0:
            at_limit = (CURVE_SHARE * hardest * before * before / abs(turn[j])) ** (1.0 / 3.0)
            late = at_limit + CURVE_SHARE * hardest * max(1.0 - abs(speed), 0.0) / abs(turn[j])
            fastest = min(fastest, late)
    if unit < math.inf:
        hardest *= SLOWING_SHARE
        most: float = unit * highest(before / unit, change / unit, hardest / unit, fastest / unit, math.inf)
    else:
        most = max(fastest, before - SLOWING_SHARE * hardest)
    return most if most > 0.0 else 1.0


@compiled
def _slowest(last: Array, turn: Array, limit: Array, step: Array, motion: Array) -> float:
    """Return the share of the last velocity b (n,) that a stop of the joints as one keeps in this cycle."""
    unit, hardest, change, square = math.inf, math.inf, 0.0, 0.0
    for j in range(last.shape[0]):
        change += last[j] * (motion[1, j] / limit[j] - turn[j])
        square += last[j] * last[j]
        size = abs(last[j]) * limit[j]
        if size > 0.0:
            hardest, unit = min(hardest, step[j] / size), min(unit, motion[2, j] / size)
    if not unit < math.inf:
        return -math.inf
    return 1.0 - unit * stop_braking(1.0 / unit, -change / square / unit, hardest / unit)


@compiled
def _on_path(
    aim: Array,
    ways: Array,
    omega: float,
    count: int,
    most: float,
    least: float,
    null: Array,
    low: Array,
    high: Array,
    limit: Array,
    rows: Array,
    row_bounds: Array,
    tolerance: float,
    y: Array,
) -> tuple[bool, float]:
    """Write y = aim + Σ tᵢ waysᵢ + N z (n,) within all bounds, ‖(ω t, z)‖ the shortest; return (is there one, s₁).

    `ways` (2, n), of which the first `count` are used: t₁ = 1 − s₁ and t₂ = s₂, 0 ≤ s₁ ≤ 1; without any, s₁ = 1. With
    one, s₁ is the nearest to `most` that there is. With two, s₁ + s₂ ≤ `most`, and what goes along ways₂ is at least
    `least` of it. `null` (n − r, n): N, transposed; ω² = W.
    """
    n, k = aim.shape[0], row_bounds.shape[0]
    p = count + null.shape[0]
    start = most if count == 1 else 1.0  # s₁ where t₁ = 0
    first = n + (4 if count == 2 else count)  # the first row of G
    c, ends, x = scratch_table(first + k, p), scratch_table(2, first + k), scratch(p)
    lower, upper = ends[0], ends[1]
    for row in range(n, first + k):
        for column in range(p):
            c[row, column] = 0.0
    for j in range(n):
        for way in range(count):
            c[j, way] = ways[way, j] / omega
        for column in range(count, p):
            c[j, column] = null[column - count, j]
        lower[j], upper[j] = low[j] / limit[j] - start * aim[j], high[j] / limit[j] - start * aim[j]
    if count > 0:
        c[n, 0] = 1.0 / omega
        lower[n], upper[n] = start - 1.0, start
    if count > 1:
        c[n + 1, 1] = 1.0 / omega
        lower[n + 1], upper[n + 1] = 0.0, most
        c[n + 2, 0], c[n + 2, 1] = -1.0 / omega, 1.0 / omega
        lower[n + 2], upper[n + 2] = -math.inf, most - 1.0
        along, square = 0.0, 0.0
        for j in range(n):
            along += aim[j] * ways[1, j]
            square += ways[1, j] * ways[1, j]
        along = along / square if square > 0.0 else 0.0
        c[n + 3, 0], c[n + 3, 1] = -along / omega, 1.0 / omega
        lower[n + 3], upper[n + 3] = least - along if square > 0.0 else -math.inf, math.inf
    for i in range(k):
        row = first + i
        size = _row_size(rows, i, limit)
        lower[row], upper[row] = -math.inf, row_bounds[i] / size
        for j in range(n):
            share = rows[i, j] * limit[j] / size
            upper[row] -= share * start * aim[j]
            for column in range(p):
                c[row, column] += share * c[j, column]
    if not least_distance(c, lower, upper, tolerance, x):
        return False, 0.0
    for j in range(n):
        y[j] = start * aim[j]
        for column in range(p):
            y[j] += c[j, column] * x[column]
    return True, start - x[0] / omega if count > 0 else 1.0


@compiled
def _row_size(rows: Array, i: int, limit: Array) -> float:
    """Return ‖G_i D⁻¹‖, 1 for an empty row: rows are measured in shares of the velocity limits too."""
    total = 0.0
    for j in range(limit.shape[0]):
        total += rows[i, j] * rows[i, j] * limit[j] * limit[j]
    return math.sqrt(total) if total > 0.0 else 1.0


@compiled
def _closest(
    aim: Array,
    scale: float,
    jacobian: Array,
    low: Array,
    high: Array,
    limit: Array,
    rows: Array,
    row_bounds: Array,
    y: Array,
) -> float:
    """Write the y (n,) within its bounds that minimizes ‖A D⁻¹(y − s aim)‖² + c ‖y − s aim‖² + ρ ‖violation of rows‖²,
    s the `scale`; return the share of the wanted speed that is left.

    A is J; for s = 0, (I − d dᵀ) J with d the wanted direction: nothing counts as much as not to leave the line, so the
    arm slows down on it, and after a few cycles can follow it again. With L Lᵀ = D⁻¹AᵀA D⁻¹ + c I and y = s aim + L⁻ᵀx
    this is the shortest (x, √ρ violations).
    """
    n, m, k = aim.shape[0], jacobian.shape[0], row_bounds.shape[0]
    pull, across, direction, square = scratch_table(n, n), scratch_table(m, n), scratch(m), 0.0
    for row in range(m):
        direction[row] = 0.0
        for j in range(n):
            across[row, j] = jacobian[row, j] * limit[j]
            direction[row] += across[row, j] * aim[j]
        square += direction[row] * direction[row]
    for j in range(n):
        along = 0.0
        for row in range(m):
            along += direction[row] * across[row, j]
        for row in range(m):
            across[row, j] -= direction[row] * along / square if scale == 0.0 and square > 0.0 else 0.0
    for j in range(n):
        for i in range(j, n):
            pull[i, j] = _CLOSEST_WEIGHT if i == j else 0.0
            for row in range(m):
                pull[i, j] += across[row, i] * across[row, j]
    factor = scratch_table(n, n)
    inverse_factor(pull, factor)  # L⁻¹
    c, lower, upper, x = scratch_table(n + k, n + k), scratch(n + k), scratch(n + k), scratch(n + k)
    for i in range(n + k):
        x[i] = 0.0
        for column in range(n + k):
            c[i, column] = 0.0
    for j in range(n):
        for column in range(j, n):
            c[j, column] = factor[column, j]
        lower[j], upper[j] = low[j] / limit[j] - scale * aim[j], high[j] / limit[j] - scale * aim[j]
    for i in range(k):
        size = _row_size(rows, i, limit)
        lower[n + i], upper[n + i] = -math.inf, row_bounds[i] / size
        c[n + i, n + i] = -1.0 / math.sqrt(_ROW_WEIGHT)
        for j in range(n):
            share = rows[i, j] * limit[j] / size
            upper[n + i] -= scale * share * aim[j]
            for column in range(n):
                c[n + i, column] += share * c[j, column]
    # The weight of the rows is more than DAQP's digits bear.
    solved = least_distance(c, lower, upper, TOLERANCE, x) if k == 0 else active_set(c, lower, upper, TOLERANCE, x)
    if not solved:
        for column in range(n + k):  # not in exact arithmetic: the bounds alone have a solution always
            x[column] = 0.0
    for j in range(n):
        y[j] = scale * aim[j]
        for column in range(j, n):
            y[j] += c[j, column] * x[column]
    speed = 0.0
    for row in range(m):
        for j in range(n):
            speed += direction[row] * jacobian[row, j] * limit[j] * y[j]
    return speed / square if scale == 0.0 and square > 0.0 else scale
