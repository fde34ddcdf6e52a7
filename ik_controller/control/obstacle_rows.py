"""The inequality rows G q̇ ≤ g of one cycle that keep the arm off itself and off the world; see `obstacles`.

One compiled function: place the capsules along the braking path, cull by bounding spheres, measure what is near, write
a row for what could become active within this cycle. Its work grows with what is near, but for the culling.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.interval import stop_braking, stop_distance
from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.collision import joint_frames, place_capsules
from ik_controller.kinematics.collision_distance import point_apart, segment_apart, segments_apart
from ik_controller.kinematics.scratch import borrowed, scratch, scratch_block, scratch_table

Array = NDArray[np.float64]

MOST_ROWS = 48  # a cycle; beyond, the loosest give way
_MOST_HERE = 32  # of them about the next position
_FIRST_STRIDE = 0.002  # [m] that no point of the arm moves more from here to the first look at the braking path
_STRIDE = 0.7  # of the way so far to the next one
_CLOSE = 0.005  # [m] above the minimum distance, where a row is written always
_AHEAD = 10.0  # cycles of acceleration in which a row farther away must be reached to be written
_STILL = 1e-9  # gradient [m/rad] of a distance that does not change
_PARALLEL = 0.1  # sine of the angle below which two capsules are watched at their ends too


@compiled
def obstacle_rows(
    chain: Any,
    arm: Any,
    world: Any,
    q: Array,
    low: Array,
    high: Array,
    brake: Array,
    deceleration: Array,
    dt: float,
    settings: Array,
    rows: Array,
    bounds: Array,
    about: Array,
) -> tuple[int, int, float, int, int]:
    """Write the rows of the cycle that starts at the commanded q (n,); return how many are about the next position, how
    many with those about the braking path behind them, and the nearest pair.

    `chain`, `arm` (joint, ends, radius, pairs, reach), `world`: arrays of `Chain`, `ArmCollision`, `World.arrays`;
    `low`, `high` (n,): the velocities that the joints may take; `brake`, `deceleration` (n,): of `hardest_stop`;
    `settings`: minimum distance to the world and to itself [m], influence distance [m], gain [1/s]. Written: `rows`
    (MOST_ROWS, n) of unit length, `bounds` (MOST_ROWS,), `about` (MOST_ROWS, 4): capsule, the other one or −1 − solid,
    distance [m] now or along the braking path, and what braking makes of the row. The nearest: (distance [m], capsule,
    other).
    """
    chain, (joint, ends, radius, pairs, reach), (kind, size, turn, center, bound) = borrowed((chain, arm, world))
    q, low, high, brake, deceleration, settings, rows, bounds, about = borrowed(
        (q, low, high, brake, deceleration, settings, rows, bounds, about)
    )
    n, count, m = q.shape[0], joint.shape[0], chain[3].shape[0]
    rotation, position, axes = scratch_block(m, 3, 3), scratch_table(m, 3), scratch_table(m, 3)
    placed, a, b, normal = scratch_block(count, 2, 3), scratch(3), scratch(3), scratch(3)
    at, slope, weight = scratch(n), scratch(n), scratch(n)
    # Of each capsule: twice its middle, its length squared and as it is, and how far that middle is from each solid at
    # the first look, or less.
    middle, square, length = scratch_table(count, 3), scratch(count), scratch(count)
    outside = np.empty((kind.shape[0], count))

    stop_time, way = 0.0, 0.0
    for i in range(n):
        time = abs(brake[i]) / deceleration[i]
        stop_time = max(stop_time, time)
        way += reach[i] * (abs(brake[i]) * 0.5 * time)
    used, begin, nearest, first, second = 0, 0, math.inf, -1, -1
    look, reached, stride, last = 0, 0.0, 0.0, False
    while not last:
        # Looks lie the closer the nearer they are: what lies between two is seen in time, when it has come nearer.
        last = reached >= way
        share = min(reached / way, 1.0) if way > 0.0 else 1.0
        time = stop_time * (1.0 - math.sqrt(1.0 - share))
        change = 0.0  # how far a pair's distance can go within this cycle's choice of velocities
        moved = 0.0  # no point of the arm has come farther since the first look
        for i in range(n):
            mine = min(time, abs(brake[i]) / deceleration[i])
            at[i] = q[i] + brake[i] * (dt + mine) - math.copysign(0.5 * deceleration[i] * mine * mine, brake[i])
            moved += reach[i] * (abs(brake[i]) - 0.5 * deceleration[i] * mine) * mine
            # Of the braking distance v²/2a, the slope of its chord up to the hardest acceleration from here.
            # The same for a joint at rest, so that near rest the row's direction is that of the gradient.
            weight[i] = dt if look == 0 else 2.0 * dt + mine
            change += reach[i] * weight[i] * (high[i] - low[i])
        # Between two looks a rounded body of radius R may come nearer than at both, by stride² / 8R.
        sag = 0.125 * stride * stride
        watch = settings[2] if look == 0 else 0.0
        joint_frames(chain, at, rotation, position, axes)
        place_capsules(joint, ends, rotation, position, placed)
        for i in range(count):
            for x in range(3):
                middle[i, x] = placed[i, 0, x] + placed[i, 1, x]
            if look == 0:
                square[i] = 0.0
                for x in range(3):
                    d = placed[i, 1, x] - placed[i, 0, x]
                    square[i] += d * d
                length[i] = math.sqrt(square[i])
        for k in range(pairs.shape[0]):
            i, j = pairs[k, 0], pairs[k, 1]
            minimum = settings[1] + sag / (settings[1] + radius[i] + radius[j])
            near = max(minimum + 2.0 * change, watch) + radius[i] + radius[j]
            between, far = 0.0, 2.0 * near + length[i] + length[j]
            for x in range(3):
                d = middle[i, x] - middle[j, x]
                between += d * d
            if between > far * far:
                continue
            apart = segments_apart(placed[i, 0], placed[i, 1], placed[j, 0], placed[j, 1], a, b)
            distance = apart - radius[i] - radius[j]
            if look == 0 and distance < nearest:
                nearest, first, second = distance, i, j
            if distance > near - radius[i] - radius[j]:
                continue
            _away(a, b, apart, placed, i, j, normal)
            gradient(chain, axes, position, joint[i], a, normal, 1.0, slope, True)
            gradient(chain, axes, position, joint[j], b, normal, -1.0, slope, False)
            used = _row(
                slope, weight, distance, minimum, settings[3], look == 0, brake, low, high, dt, i, j, used, begin, rows,
                bounds, about,
            )  # fmt: skip
            if look > 0 or not _parallel(placed, i, j, square[i], square[j]):
                continue
            # Side by side the nearest point jumps from end to end: hold the ends too.
            for e in range(4):
                k_end, k_other, s = (i, j, e) if e < 2 else (j, i, e - 2)
                end = placed[k_end, s]
                apart = segments_apart(end, end, placed[k_other, 0], placed[k_other, 1], a, b)
                if apart < 1e-9:
                    continue
                for x in range(3):
                    normal[x] = (a[x] - b[x]) / apart
                gradient(chain, axes, position, joint[k_end], a, normal, 1.0, slope, True)
                gradient(chain, axes, position, joint[k_other], b, normal, -1.0, slope, False)
                used = _row(
                    slope, weight, apart - radius[i] - radius[j], settings[1], settings[3], True, brake, low, high, dt,
                    i, j, used, begin, rows, bounds, about,
                )  # fmt: skip
        for w in range(kind.shape[0]):
            for i in range(count):
                if joint[i] < 0:  # the base stands where it stands
                    continue
                minimum = settings[0] + sag / (settings[0] + radius[i])
                near = max(minimum + change, watch) + radius[i]
                far = near + 0.5 * length[i]
                if look > 0 and outside[w, i] - moved > far:
                    continue
                # By the sphere about the solid, then by the middle of the capsule.
                between = 0.0
                for x in range(3):
                    a[x] = 0.5 * middle[i, x]
                    between += (a[x] - center[w, x]) * (a[x] - center[w, x])
                apart = math.sqrt(between) - bound[w]
                if apart <= far:
                    apart = point_apart(kind[w], size[w], turn[w], center[w], a, normal)
                if look == 0:
                    outside[w, i] = apart
                if apart > far:
                    continue
                apart, where = segment_apart(
                    kind[w], size[w], turn[w], center[w], placed[i, 0], placed[i, 1], a, normal
                )
                if look == 0 and apart - radius[i] < nearest:
                    nearest, first, second = apart - radius[i], i, -1 - w
                if apart > near:
                    continue
                gradient(chain, axes, position, joint[i], a, normal, 1.0, slope, True)
                used = _row(
                    slope, weight, apart - radius[i], minimum, settings[3], look == 0, brake, low, high, dt,
                    i, -1 - w, used, begin, rows, bounds, about,
                )  # fmt: skip
                if look > 0:
                    continue
                for e in range(2):  # flat on a face the nearest point jumps from end to end
                    if where != e and length[i] > 0.0:
                        apart = point_apart(kind[w], size[w], turn[w], center[w], placed[i, e], normal)
                        if apart <= near:
                            gradient(chain, axes, position, joint[i], placed[i, e], normal, 1.0, slope, True)
                            used = _row(
                                slope, weight, apart - radius[i], settings[0], settings[3], True, brake, low, high, dt,
                                i, -1 - w, used, begin, rows, bounds, about,
                            )  # fmt: skip
        if look == 0:
            begin = used
        look += 1
        stride = min(max(_FIRST_STRIDE, _STRIDE * reached), way - reached)
        reached += stride
        if way - reached < 1e-3 * way:
            reached = way
    return begin, used, nearest, first, second


@compiled
def hardest_stop(
    v: Array,
    a: Array,
    dt: float,
    low: Array,
    high: Array,
    acceleration: Array,
    jerk: Array,
    brake: Array,
    deceleration: Array,
) -> None:
    """Write how each joint comes to rest soonest: its next velocity and the constant deceleration (n,) of a stop from
    there that is as long as the joint's own.

    v, a (n,): velocity and last acceleration; `low`, `high`: the velocities that the joints may take; `acceleration`,
    `jerk` (n,): the limits, inf where there is no jerk limit.
    """
    for i in range(v.shape[0]):
        deceleration[i] = acceleration[i]
        unit = jerk[i] * dt * dt
        if not unit < np.inf:
            brake[i] = min(max(0.0, low[i]), high[i])
            continue
        most = acceleration[i] * dt / unit
        brake[i] = v[i] - unit * stop_braking(v[i] / unit, -a[i] * dt / unit, most)
        brake[i] = min(max(brake[i], low[i]), high[i])
        way = abs(stop_distance(brake[i] / unit, (v[i] - brake[i]) / unit, most)) * unit * dt
        if way > 0.0 and brake[i] != 0.0:
            deceleration[i] = min(0.5 * brake[i] * brake[i] / way, acceleration[i])


@compiled
def _away(a: Array, b: Array, apart: float, placed: Array, i: int, j: int, normal: Array) -> None:
    """Write the direction (3,) in which capsule i gets away from j, a and b their nearest points."""
    if apart > 1e-9:
        for x in range(3):
            normal[x] = (a[x] - b[x]) / apart
        return
    # The axes cross: across both, to the side on which the middles are.
    total, side = 0.0, 0.0
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        normal[x] = (placed[i, 1, y] - placed[i, 0, y]) * (placed[j, 1, z] - placed[j, 0, z])
        normal[x] -= (placed[i, 1, z] - placed[i, 0, z]) * (placed[j, 1, y] - placed[j, 0, y])
        total += normal[x] * normal[x]
        side += normal[x] * (placed[i, 0, x] + placed[i, 1, x] - placed[j, 0, x] - placed[j, 1, x])
    if total < 1e-18:
        normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
        return
    scale = math.copysign(1.0 / math.sqrt(total), side)
    for x in range(3):
        normal[x] *= scale


@compiled
def _parallel(placed: Array, i: int, j: int, square_i: float, square_j: float) -> bool:
    """Tell whether two capsules, squares of their lengths given, lie nearly side by side."""
    across = 0.0
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        c = (placed[i, 1, y] - placed[i, 0, y]) * (placed[j, 1, z] - placed[j, 0, z])
        c -= (placed[i, 1, z] - placed[i, 0, z]) * (placed[j, 1, y] - placed[j, 0, y])
        across += c * c
    return across < _PARALLEL * _PARALLEL * square_i * square_j


@compiled
def gradient(
    chain: Any,
    axes: Array,
    position: Array,
    joint: int,
    point: Array,
    normal: Array,
    sign: float,
    slope: Array,
    fresh: bool,
) -> None:
    """Add to `slope` (n,) sign · nᵀJ of a point (3,) on a joint; where `fresh`, start from zero."""
    prismatic, leader, factor = chain[2], chain[3], chain[4]
    if fresh:
        for i in range(slope.shape[0]):
            slope[i] = 0.0
    for k in range(joint + 1):
        x, y, z = axes[k, 0], axes[k, 1], axes[k, 2]
        if prismatic[k]:
            rate = normal[0] * x + normal[1] * y + normal[2] * z
        else:
            px, py, pz = point[0] - position[k, 0], point[1] - position[k, 1], point[2] - position[k, 2]
            rate = normal[0] * (y * pz - z * py) + normal[1] * (z * px - x * pz) + normal[2] * (x * py - y * px)
        slope[leader[k]] += sign * factor[k] * rate


@compiled
def _row(
    slope: Array,
    weight: Array,
    distance: float,
    minimum: float,
    gain: float,
    here: bool,
    brake: Array,
    low: Array,
    high: Array,
    dt: float,
    first: int,
    second: int,
    used: int,
    begin: int,
    rows: Array,
    bounds: Array,
    about: Array,
) -> int:
    """Write the row of one distance, whose gradient (n,) is `slope`, where it can become active; return how many are.

    `here`: at the next position, else on the braking path, whose rows start at `begin`; `weight` (n,) [s]: how that
    configuration moves with q̇.
    """
    n = slope.shape[0]
    room = distance - minimum
    length = 0.0
    for i in range(n):
        length += slope[i] * slope[i] * weight[i] * weight[i]
    length = math.sqrt(length)
    if length < _STILL * dt:
        return used
    keeping, fastest, farthest = 0.0, 0.0, 0.0  # G q̇ for braking, and the most and the least there is
    at = used
    if used == (_MOST_HERE if here else rows.shape[0]):  # full: the loosest gives way, where this one is tighter
        at = begin
        for k in range(begin + 1, used):
            if about[k, 2] > about[at, 2]:
                at = k
        if about[at, 2] <= distance:
            return used
    scale = -1.0 / length
    for i in range(n):
        g = scale * weight[i] * slope[i]
        keeping += g * brake[i]
        fastest += max(g * low[i], g * high[i])
        farthest += min(g * low[i], g * high[i])
    limit = keeping + room / length
    if here:
        damped = gain * room * dt / length  # G q̇ = −ḋ dt / length
        limit = min(max(damped, keeping), limit) if room > 0.0 else damped
    if room <= 0.0:
        limit = max(limit, min(keeping, 0.5 * (keeping + farthest)))
    # What could stop the arm within some cycles is told too: else it would go straight on in every cycle after one in
    # which it got a little away.
    if here and room < _CLOSE:
        fastest = math.inf
    elif here:
        fastest = keeping + _AHEAD * (fastest - keeping)
    if fastest <= limit:
        return used
    for i in range(n):
        rows[at, i] = scale * weight[i] * slope[i]
    bounds[at] = limit
    about[at, 0], about[at, 1], about[at, 2], about[at, 3] = first, second, distance, keeping
    return max(used, at + 1)
