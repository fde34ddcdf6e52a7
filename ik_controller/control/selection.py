"""Selection: the axes of the tool that the first task speaks of, the error e along them, and their rows of J.

F (3, 3) holds the axes as columns: those of the base, or those of the desired tool frame R_d (of the tool's own where
the reference is a twist alone). D = R_d Rᵀ is the rotation still to go. With so many rotation axes selected:

    3   e = Fᵀ log D                                               rows Fᵀ
    2   e: the shortest rotation of Dᵀa onto a, the free axis      rows Fᵀ without a
    1   e: the twist of D about the selected axis a, 2 atan2(v·a, w)
        of its quaternion (v, w)                                   row (w²a + w a×v + (v·a)v) / (w² + (v·a)²)

The second is what an axis-symmetric tool needs: it is smooth and at its smallest for *any* turn about the free axis,
where components of log D are neither. The third's row is the twist's exact rate. The reference's own motion counts
where the tool is: axes of the tool frame turn with the reference, so it moves at v_d + ω_d × (p − p_d); with base axes,
a turn D that is free to stay turns ω_d with it, Dᵀω_d.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.levenberg_marquardt import rotation_log
from ik_controller.kinematics.rotation_exp import rotation_exp
from ik_controller.kinematics.scratch import scratch, scratch_table

Array = NDArray[np.float64]

# Rows of the table of axes (3, 6).
MASK = 0  # 1 for a selected axis, x y z and the rotations about them
TOLERANCE = 1  # [m, rad], 0: exact
OPTIONS = 2  # 1 for axes of the tool frame; along how many of the selected ones the arm can move at all

_SMALL = 1e-12


@compiled
def free_axis(axes: Array) -> int:
    """Return which rotation axis, 0 to 2, is the odd one: the free one of two selected, the selected one of one."""
    count = axes[MASK, 3] + axes[MASK, 4] + axes[MASK, 5]
    odd = 0.0 if count == 2.0 else 1.0
    for i in range(3):
        if axes[MASK, 3 + i] == odd:
            return i
    return 0


@compiled
def cross(a: Array, b: Array, out: Array) -> None:
    """Write a × b (3,)."""
    out[0], out[1], out[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def quaternion(d: Array, out: Array) -> None:
    """Write the quaternion (x, y, z, w), w ≥ 0, of a rotation (3, 3): by the largest of its four parts."""
    squares = (1.0 + d[0, 0] + d[1, 1] + d[2, 2], 1.0 + d[0, 0] - d[1, 1] - d[2, 2])
    squares_2 = (1.0 - d[0, 0] + d[1, 1] - d[2, 2], 1.0 - d[0, 0] - d[1, 1] + d[2, 2])
    x, y, z = d[2, 1] - d[1, 2], d[0, 2] - d[2, 0], d[1, 0] - d[0, 1]
    if squares[0] >= 1.0:
        out[3], out[0], out[1], out[2] = squares[0], x, y, z
    elif squares[1] >= 1.0:
        out[3], out[0], out[1], out[2] = x, squares[1], d[1, 0] + d[0, 1], d[0, 2] + d[2, 0]
    elif squares_2[0] >= 1.0:
        out[3], out[0], out[1], out[2] = y, d[1, 0] + d[0, 1], squares_2[0], d[2, 1] + d[1, 2]
    else:
        out[3], out[0], out[1], out[2] = z, d[0, 2] + d[2, 0], d[2, 1] + d[1, 2], squares_2[1]
    length = math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2] + out[3] * out[3])
    if out[3] < 0.0:
        length = -length
    for i in range(4):
        out[i] /= length


@compiled
def rotation_to_go(desired: Array, rotation: Array, out: Array) -> None:
    """Write D = R_d Rᵀ (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = desired[i, 0] * rotation[j, 0] + desired[i, 1] * rotation[j, 1] + desired[i, 2] * rotation[j, 2]


@compiled
def axes_error(
    axes: Array, frame: Array, position: Array, desired: Array, tool: Array, rotation: Array, error: Array
) -> None:
    """Write e (6,) along the axes `frame` (3, 3), 0 on free ones, of a tool at `tool` (3,), `rotation` (3, 3)."""
    turn = scratch(3)
    for i in range(3):
        error[i], error[3 + i], turn[i] = 0.0, 0.0, 0.0
    count = axes[MASK, 3] + axes[MASK, 4] + axes[MASK, 5]
    if count == 3.0:
        rotation_log(desired, rotation, turn)
    elif count > 0.0:
        to_go = scratch_table(3, 3)
        rotation_to_go(desired, rotation, to_go)
        a = frame[:, free_axis(axes)].copy()
        if count == 2.0:
            swing(a, to_go, turn)
        else:
            q = scratch(4)
            quaternion(to_go, q)
            along = q[0] * a[0] + q[1] * a[1] + q[2] * a[2]
            angle = 2.0 * math.atan2(along, q[3])
            for i in range(3):
                turn[i] = angle * a[i]
    for i in range(3):
        for k in range(3):
            error[i] += frame[k, i] * (position[k] - tool[k])
            error[3 + i] += frame[k, i] * turn[k]
    for i in range(6):
        error[i] *= axes[MASK, i]


@compiled
def swing(a: Array, to_go: Array, turn: Array) -> None:
    """Write the shortest rotation vector (3,) that turns Dᵀa onto the unit vector a; D (3, 3) is `to_go`."""
    u = scratch(3)
    for i in range(3):
        u[i] = to_go[0, i] * a[0] + to_go[1, i] * a[1] + to_go[2, i] * a[2]
    cross(u, a, turn)
    sine = math.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    cosine = u[0] * a[0] + u[1] * a[1] + u[2] * a[2]
    if sine < _SMALL and cosine < 0.0:  # opposite: any axis across a will do
        least = 0
        for i in range(1, 3):
            if abs(a[i]) < abs(a[least]):
                least = i
        other = np.zeros(3)
        other[least] = 1.0
        cross(a, other, turn)
        sine = math.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
        for i in range(3):
            turn[i] *= math.pi / sine
        return
    scale = 1.0 if sine < _SMALL else math.atan2(sine, cosine) / sine
    for i in range(3):
        turn[i] *= scale


@compiled
def axes_rows(axes: Array, frame: Array, has_pose: bool, desired: Array, rotation: Array, selection: Array) -> None:
    """Write the rows (6, 6) that take a twist (v, ω) in base axes to the rates along the axes; 0 rows for free ones."""
    for i in range(6):
        for j in range(6):
            selection[i, j] = 0.0
    count = axes[MASK, 3] + axes[MASK, 4] + axes[MASK, 5]
    for i in range(3):
        for k in range(3):
            selection[i, k] = axes[MASK, i] * frame[k, i]
            selection[3 + i, 3 + k] = axes[MASK, 3 + i] * frame[k, i]
    if count == 1.0 and has_pose:
        one = free_axis(axes)
        a, q, side, to_go = frame[:, one].copy(), scratch(4), scratch(3), scratch_table(3, 3)
        rotation_to_go(desired, rotation, to_go)
        quaternion(to_go, q)
        along = q[0] * a[0] + q[1] * a[1] + q[2] * a[2]
        cross(a, q[:3], side)
        size = max(q[3] * q[3] + along * along, 1e-6)  # 0 where the tool is half a turn away across a: no twist there
        for k in range(3):
            selection[3 + one, 3 + k] = (q[3] * q[3] * a[k] + q[3] * side[k] + along * q[k]) / size


@compiled
def feed_forward_twist(
    axes: Array, twist: Array, position: Array, desired: Array, tool: Array, rotation: Array
) -> Array:
    """Return the twist (6,) at which the reference moves where the tool is; see the module's text."""
    result: Array = twist.copy()
    count = axes[MASK, 3] + axes[MASK, 4] + axes[MASK, 5]
    if axes[OPTIONS, 0] > 0.0:
        if axes[MASK, 0] + axes[MASK, 1] + axes[MASK, 2] < 3.0:
            off, more = scratch(3), scratch(3)
            for i in range(3):
                off[i] = tool[i] - position[i]
            cross(twist[3:], off, more)
            for i in range(3):
                result[i] += more[i]
    elif 0.0 < count < 3.0:
        to_go = scratch_table(3, 3)
        rotation_to_go(desired, rotation, to_go)
        for i in range(3):
            result[3 + i] = to_go[0, i] * twist[3] + to_go[1, i] * twist[4] + to_go[2, i] * twist[5]
    return result


@compiled
def half_way(twist: Array, dt: float, position: Array, desired: Array) -> Array:
    """Return (4, 3) the reference's rotation over its position after half of the cycle dt [s]."""
    pose = np.empty((4, 3))
    rotation_exp(0.5 * dt * twist[3:], desired, pose)
    for i in range(3):
        pose[3, i] = position[i] + 0.5 * dt * twist[i]
    return pose
