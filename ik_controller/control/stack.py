"""The stack of tasks, worked out: each level in the null space of those before it (notes N6; Nakamura, Hanafusa and
Yoshikawa 1987; Siciliano and Slotine 1991).

    q̇₁ = J₁⁺(ẋ₁ + β K e),             N₁ = I − J₁⁺J₁
    q̇ₖ = q̇ₖ₋₁ + Pₖ⁺(ẋₖ − Jₖ q̇ₖ₋₁),     Pₖ = Jₖ Nₖ₋₁,   Nₖ = (I − Pₖ⁺Pₖ) Nₖ₋₁
    q̇  = q̇ₗ + Nₗ q̇₀

J⁺ is the inverse of `damped_inverse`, so damped in weak directions alone: for Pₖ these are the algorithmic
singularities, where a task would need what a higher one holds. Pₖ⁺ maps into Nₖ₋₁ whatever its damping: no higher task
sees it. q̇₀ is the way to the posture plus k ∇H of the objectives.

A tolerance gives the axis a band instead of a value: its rate must be in ẋ + K (e ± tolerance). The stack is solved
without such axes; those that would leave their bands are held at the edge, and it is solved again.

With weights W, q̇ₗ + Nₗ z is chosen to minimize (q̇ − q̇₀)ᵀ W (q̇ − q̇₀): the weighted inverse W⁻¹Jᵀ(J W⁻¹Jᵀ)⁻¹ for one
task, without changing where it is damped.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.curvature import follow_bend, nearness
from ik_controller.control.kernel import (
    AHEAD,
    BRAKING,
    FREE,
    POSTURE,
    SCALARS,
    SEEK_LIMIT,
    bound_tool,
    bounded_cycle,
    braking_factor,
    stoppable_share,
    tool_is_free,
)
from ik_controller.control.objectives import (
    CENTRING,
    MANIPULABILITY,
    REPULSION,
    add_centring,
    add_manipulability,
    add_repulsion,
)
from ik_controller.control.reach import LAST
from ik_controller.control.secondary import secondary_rows
from ik_controller.control.selection import (
    MASK,
    OPTIONS,
    TOLERANCE,
    axes_error,
    axes_rows,
    feed_forward_twist,
    half_way,
)
from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.damped_inverse import damped_gram_inverse
from ik_controller.kinematics.levenberg_marquardt import kinematics, kinematics_pose
from ik_controller.kinematics.scratch import borrowed, scratch, scratch_table
from ik_controller.kinematics.small import gram, inverse_spd, product, times, transposed_times

Array = NDArray[np.float64]

# Rows of the table of objectives (4, max(n, 3)).
GAINS = 0  # of OBJECTIVES, in their order
LOWER, UPPER = 1, 2  # the joints' bounds
WEIGHTS = 3  # W; all 0: none

# A secondary task is followed at most at this multiple of the posture's speed.
_SECONDARY_SPEED = 2.5
# Against algorithmic singularities there is some damping always.
_LEAST_DAMPING = 0.01
# The first secondary task against the joints' ways in the bounded problem, and each further one as a share of it.
_FIRST_WEIGHT, _NEXT_WEIGHT = 1e4, 0.03


@compiled
def add_level(rows: Array, rates: Array, gain: float, law: Array, projector: Array, velocity: Array) -> None:
    """Add the next task `rows` q̇ = `rates`, (m, n) and (m,), to `velocity` (n,) as far as `projector` N (n, n) leaves
    it, and write the projector that is left over N.

    `rates` are gain · e: slowed as a whole to what the joints can brake.
    """
    m, n = rows.shape
    part, squares, inverse, image = scratch_table(m, n), scratch_table(m, m), scratch_table(m, m), scratch(m)
    product(rows, projector, part)
    damping, threshold = max(law[SCALARS, 2], _LEAST_DAMPING), max(law[SCALARS, 3], _LEAST_DAMPING)
    damped_gram_inverse(gram(part, squares), damping, threshold, inverse)
    approach = transposed_times(part, times(inverse, rates, image), scratch(n))
    moved = times(rows, velocity, scratch(m))
    correction = transposed_times(part, times(inverse, moved, image), scratch(n))
    share = braking_factor(approach, gain, law[BRAKING : BRAKING + 2])
    ratio = 1.0
    for j in range(n):
        ratio = max(ratio, share * abs(approach[j]) / (_SECONDARY_SPEED * law[SEEK_LIMIT, j]))
    for j in range(n):
        velocity[j] += share / ratio * approach[j] - correction[j]
    # N (I − P⁺P) N is symmetric and never negative, also where a singularity of a higher task makes N no projector.
    rest = scratch_table(n, n)
    beside(part, inverse, rest)
    product(projector, product(rest, projector, scratch_table(n, n)), rest)
    for i in range(n):
        for j in range(n):
            projector[i, j] = rest[i, j]


@compiled
def beside(rows: Array, inverse: Array, projector: Array) -> None:
    """Write I − P⁺P (n, n) of P (m, n), `inverse` (m, m) so that P⁺ = Pᵀ · inverse."""
    m, n = rows.shape
    kept = product(inverse, rows, scratch_table(m, n))
    for i in range(n):
        for j in range(n):
            projector[i, j] = 1.0 if i == j else 0.0
            for k in range(m):
                projector[i, j] -= rows[k, i] * kept[k, j]


@compiled
def wanted_rest(law: Array, objectives: Array, at: Array, jacobian: Array, selection: Array, rest: Array) -> None:
    """Write q̇₀ (n,): the way to the posture and k ∇H, slowed as a whole to its limits."""
    n, ratio = at.shape[0], 1.0
    for j in range(n):
        rest[j] = law[SCALARS, 1] * (law[POSTURE, j] - at[j])
    if objectives[GAINS, CENTRING] != 0.0:
        add_centring(at, objectives[LOWER], objectives[UPPER], objectives[GAINS, CENTRING], rest)
    if objectives[GAINS, REPULSION] != 0.0:
        add_repulsion(at, objectives[LOWER], objectives[UPPER], objectives[GAINS, REPULSION], rest)
    if objectives[GAINS, MANIPULABILITY] != 0.0:
        add_manipulability(jacobian, selection, objectives[GAINS, MANIPULABILITY], rest)
    for j in range(n):
        ratio = max(ratio, abs(rest[j]) / law[SEEK_LIMIT, j])
    for j in range(n):
        rest[j] /= ratio


@compiled
def add_rest(rest: Array, weights: Array, projector: Array, velocity: Array) -> None:
    """Add N q̇₀ to `velocity` (n,), or with `weights` (n,) the N z that brings it nearest to q̇₀ in their metric."""
    n = velocity.shape[0]
    moved = scratch(n)
    if weights[0] == 0.0:
        times(projector, rest, moved)
    else:
        # (N W N + I − N) z = N W (q̇₀ − q̇)
        matrix, inverse, force, pull = scratch_table(n, n), scratch_table(n, n), scratch(n), scratch(n)
        for i in range(n):
            force[i] = weights[i] * (rest[i] - velocity[i])
            for j in range(n):
                total = (1.0 if i == j else 0.0) - projector[i, j]
                for k in range(n):
                    total += projector[i, k] * weights[k] * projector[k, j]
                matrix[i, j] = total
        times(projector, force, pull)
        times(projector, times(inverse_spd(matrix, inverse), pull, force), moved)
    for j in range(n):
        velocity[j] += moved[j]


@compiled
def stack_velocity(
    rows: Array,
    feed_forward: Array,
    approach: Array,
    share: float,
    inverse: Array,
    levels: Array,
    starts: Array,
    secondary: Array,
    rates: Array,
    rest: Array,
    law: Array,
    weights: Array,
    own: Array,
    velocity: Array,
) -> None:
    """Write the velocity (n,) of the whole stack, and of its first task alone to `own` (n,).

    First task: `rows` J₁ (m, n), ẋ₁ `feed_forward` (m,) and `approach` J₁⁺K e (n,), of which `share` is followed,
    `inverse` (m, m) so that J₁⁺ = J₁ᵀ · inverse. Secondary: `rates` (k,) of the rows `secondary` (k, n), task i from
    `starts`[i] to `starts`[i + 1].
    """
    m, n = rows.shape
    beta = share * braking_factor(approach, share * law[SCALARS, 0], law[BRAKING : BRAKING + 2])
    transposed_times(rows, times(inverse, feed_forward, scratch(m)), velocity)
    for j in range(n):
        velocity[j] += beta * approach[j]
        own[j] = velocity[j]
    projector = scratch_table(n, n)
    beside(rows, inverse, projector)
    for i in range(levels.shape[0]):
        first, end = int(starts[i]), int(starts[i + 1])
        if end > first:
            add_level(secondary[first:end], rates[first:end], levels[i, 1], law, projector, velocity)
    add_rest(rest, weights, projector, velocity)


@compiled
def stack_cycle(
    chain: Any,
    law: Array,
    limits: Array,
    state: Array,
    at: Array,
    position: Array,
    rotation: Array,
    twist: Array,
    has_pose: bool,
    reserve: bool,
    dt: float,
    out: Array,
    detail: Array,
    axes: Array,
    levels: Array,
    chains: Array,
    objectives: Array,
) -> tuple[int, float, int, int, float]:
    """Write one cycle of the stack to `out` and return (how, s, joint, limit, σ_min), as `kernel.tool_cycle` does.

    `axes` (3, 6) of `selection`, `levels` (l, 24) and `chains` (l, m + 1, 16) of `secondary`, `objectives` (4, n): all
    of `tasks.TaskStack`. The error in `out` is 0 on free axes and within the tolerances. `detail`
    (7, n) gets the wanted velocity, and below it the rows of the first task, 0 where there are less than six.
    """
    n = at.shape[0]
    chain, law, limits, state, at, position, rotation, twist, out, detail, axes, levels, chains, objectives = borrowed(
        (chain, law, limits, state, at, position, rotation, twist, out, detail, axes, levels, chains, objectives)
    )
    middle, jacobian, tool, turn = scratch(n), scratch_table(6, n), scratch(3), scratch_table(3, 3)
    error, raw = out[2 * n + 6 :], scratch(6)
    for i in range(6):
        raw[i] = 0.0
    if has_pose:
        kinematics_pose(chain, at, turn, tool)
        frame = rotation if axes[OPTIONS, 0] > 0.0 else np.eye(3)
        axes_error(axes, frame, position, rotation, tool, turn, raw)
        for i in range(3):
            error[i], error[3 + i] = 0.0, 0.0
            for k in range(3):
                error[i] += frame[i, k] * beyond(raw[k], axes[TOLERANCE, k])
                error[3 + i] += frame[i, k] * beyond(raw[3 + k], axes[TOLERANCE, 3 + k])
    for j in range(n):
        middle[j] = at[j] + 0.5 * dt * (state[n + j] + dt * limits[LAST, j])
    kinematics(chain, middle, turn, tool, jacobian)
    selection, moving, then = scratch_table(6, 6), twist, rotation
    frame = np.eye(3)
    if has_pose:
        half = half_way(twist, dt, position, rotation)
        then = half[:3].copy()
        moving = feed_forward_twist(axes, twist, half[3], then, tool, turn)
        if axes[OPTIONS, 0] > 0.0:
            frame = then
    elif axes[OPTIONS, 0] > 0.0:
        frame = turn
    axes_rows(axes, frame, has_pose, then, turn, selection)
    feedback, forward = times(law[:6, :6], raw, scratch(6)), times(selection, moving, scratch(6))

    chosen, rest, count = scratch_table(6, 6), scratch(n), 0
    for i in range(6):
        if axes[MASK, i] > 0.0:
            chosen[count] = selection[i]
            count += 1
    wanted_rest(law, objectives, at, jacobian, chosen[:count], rest)
    starts = np.zeros(levels.shape[0] + 1)
    secondary, rates = np.zeros((3 * levels.shape[0], n)), np.zeros(3 * levels.shape[0])
    for i in range(levels.shape[0]):
        added = secondary_rows(levels[i], chains[i], at, middle, secondary[int(starts[i]) :], rates[int(starts[i]) :])
        starts[i + 1] = starts[i] + added

    # 1: held by the first task; 0: free, or within its band.
    held, edge, own, wanted, sigma = scratch(6), scratch(6), scratch(n), scratch(n), math.nan
    for i in range(6):
        held[i], edge[i] = 0.0, 0.0
        if axes[MASK, i] > 0.0 and (axes[TOLERANCE, i] == 0.0 or not has_pose):
            held[i] = 1.0
    first, ahead, back, pull, approach = scratch_table(6, 6), scratch(6), scratch(6), scratch(6), scratch(n)
    used, jacobian_1 = 0, scratch_table(0, n)
    bounded = not tool_is_free(law)
    for _ in range(7):
        used = 0
        for i in range(6):
            back[i] = 0.0
            if held[i] > 0.0:
                back[i] = feedback[i] + edge[i]
                first[used], ahead[used] = selection[i], forward[i]
                used += 1
        share = 1.0
        jacobian_1 = product(first[:used], jacobian, np.empty((used, n)))
        inverse = np.empty((used, used))
        if used > 0:
            sigma = damped_gram_inverse(
                gram(jacobian_1, np.empty((used, used))),
                law[SCALARS, 2],
                law[SCALARS, 3],
                inverse,
                int(axes[OPTIONS, 1]),
            )
            if bounded:
                share = stoppable_share(back, law)
        feed_back, image, k = np.empty(used), np.empty(used), 0
        for i in range(6):
            pull[i] = 0.0
        for i in range(6):
            if held[i] > 0.0:
                feed_back[k] = back[i]
                k += 1
                for axis in range(6):
                    pull[axis] += selection[i, axis] * back[i] / law[SCALARS, 0]
        transposed_times(jacobian_1, times(inverse, feed_back, image), approach)
        near = nearness(jacobian, pull, sigma, law[SCALARS, 2], law[SCALARS, 3]) if used > 0 else 0.0
        if near > 0.0:
            follow_bend(approach, jacobian_1, jacobian, feed_back, pull, near, law[SCALARS, 2])
        stack_velocity(
            jacobian_1, ahead[:used], approach, share, inverse, levels, starts, secondary, rates, rest, law,
            objectives[WEIGHTS], own, wanted,
        )  # fmt: skip
        if not leaves_band(axes, selection, jacobian, wanted, forward, feedback, law, held, edge):
            break
    slower, by_tool = 1.0, FREE
    if bounded:
        inverse = scratch_table(6, 6)
        damped_gram_inverse(
            gram(jacobian, scratch_table(6, 6)), law[SCALARS, 2], law[SCALARS, 3], inverse, int(law[SCALARS, 4])
        )
        slower, by_tool = bound_tool(wanted, jacobian, inverse, state[2 * n : 2 * n + 6], state[n : 2 * n], law, dt)
        for j in range(n):
            own[j] *= slower
    detail[0] = wanted
    for i in range(used):
        detail[1 + i] = jacobian_1[i]
    last = times(first[:used], state[2 * n : 2 * n + 6], scratch(used))
    total = int(starts[levels.shape[0]])
    weights, weight = scratch(total), _FIRST_WEIGHT
    for i in range(levels.shape[0]):
        weights[int(starts[i]) : int(starts[i + 1])] = weight
        weight = max(_NEXT_WEIGHT * weight, 1.0)
    planned = sigma >= AHEAD * law[SCALARS, 3]
    how, scale, joint, limit = bounded_cycle(
        wanted, jacobian, limits, state, reserve, planned, dt, out, jacobian_1, last, own, secondary[:total], weights
    )
    return how, slower * scale, joint, by_tool if limit == FREE else limit, sigma


@compiled
def beyond(error: float, tolerance: float) -> float:
    """Return the error measured from the edge of its band: 0 within."""
    if error > tolerance:
        return error - tolerance
    if error < -tolerance:
        return error + tolerance
    return 0.0


@compiled
def leaves_band(
    axes: Array,
    selection: Array,
    jacobian: Array,
    velocity: Array,
    forward: Array,
    feedback: Array,
    law: Array,
    held: Array,
    edge: Array,
) -> bool:
    """Hold the axes whose rate at `velocity` (n,) is not in ẋ + K (e ± tolerance), at the edge; tell whether there are
    any.
    """
    found = False
    rates = times(selection, times(jacobian, velocity, scratch(6)), scratch(6))
    for i in range(6):
        if axes[MASK, i] > 0.0 and held[i] == 0.0:
            half = law[i, i] * axes[TOLERANCE, i]
            relative = rates[i] - forward[i] - feedback[i]
            if abs(relative) > half * (1.0 + 1e-12):
                held[i], edge[i] = 1.0, half if relative > 0.0 else -half
                found = True
    return found
