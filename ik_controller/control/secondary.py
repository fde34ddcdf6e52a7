"""Secondary tasks: rows of their Jacobian and the rates that lead them to their targets, k e.

    position     some axes of a frame's origin, in the base frame
    orientation  a frame's orientation: e = log(R_d Rᵀ)
    swivel       the elbow's turn φ about the line from shoulder S to wrist W, of a 7-joint arm (`closed_form.seven`)

With n along W − S, L its length, p the part across n of E − S, E the elbow, and l that of the base's z,

    φ̇ = (n × p̂)·(Ė − (n·(E − S)/L) Ẇ)/|p| + (n·z) (n × l̂)·Ẇ/(L |l|)

(Kreutz-Delgado, Long and Seraji 1992). Row and rate are both multiplied by |p| |l|: nothing is divided by where the
elbow is in line or the line upright, the task fades out there instead, under the damping of its inverse.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.selection import cross
from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.chain import chain_kinematics, chain_pose
from ik_controller.kinematics.levenberg_marquardt import rotation_log_kernel
from ik_controller.kinematics.scratch import scratch, scratch_table

Array = NDArray[np.float64]

POSITION, ORIENTATION, SWIVEL = 0, 1, 2

# Columns of the table of levels (l, 24).
KIND, GAIN, JOINTS = 0, 1, 2
AXES = 3  # 3 columns: 1 for an axis of the position that counts
TARGET = 6  # 9 columns: position, rotation by rows, or angle
SHOULDER = 15  # 3 columns
ELBOW = 18  # 3 columns: from the wrist, in the frame at it

_NOWHERE = 1e-9


@compiled
def secondary_rows(level: Array, chain: Array, at: Array, middle: Array, rows: Array, rates: Array) -> int:
    """Write a task's rows (up to 3, n) at `middle` (n,) and its rates k e at `at` (n,); return how many.

    `level` (24,); `chain` (m + 1, 16) to the frame, or to the wrist, padded to the length of the longest.
    """
    n = at.shape[0]
    chain = chain[: int(level[JOINTS]) + 1]
    rotation, position, jacobian = scratch_table(3, 3), scratch(3), scratch_table(6, n)
    if level[KIND] == SWIVEL:
        chain_pose(chain, at, rotation, position)
        angle, reach = swivel(level, rotation, position)
        chain_kinematics(chain, middle, rotation, position, jacobian)
        swivel_row(level, rotation, position, jacobian, rows[0])
        off = level[TARGET] - angle
        rates[0] = level[GAIN] * reach * (off - 2.0 * math.pi * math.floor(off / (2.0 * math.pi) + 0.5))
        return 1
    error = scratch(3)
    chain_pose(chain, at, rotation, position)
    if level[KIND] == POSITION:
        for i in range(3):
            error[i] = level[TARGET + i] - position[i]
    else:
        rotation_log_kernel(level[TARGET : TARGET + 9].copy().reshape((3, 3)), rotation, error)
    chain_kinematics(chain, middle, rotation, position, jacobian)
    top = 0 if level[KIND] == POSITION else 3
    count = 0
    for i in range(3):
        if level[AXES + i] > 0.0:
            rows[count] = jacobian[top + i]
            rates[count] = level[GAIN] * error[i]
            count += 1
    return count


@compiled
def swivel(level: Array, rotation: Array, wrist: Array) -> tuple[float, float]:
    """Return the swivel angle φ [rad] and |p| |l| at the pose of the frame at the wrist; 0 where there is none."""
    line, arm, side, up, turned = scratch(3), scratch(3), scratch(3), scratch(3), scratch(3)
    length, p, _ = elbow_triangle(level, rotation, wrist, line, arm, side)
    z = line[2]
    for i in range(3):
        up[i] = (1.0 if i == 2 else 0.0) - z * line[i]
    l = math.sqrt(up[0] * up[0] + up[1] * up[1] + up[2] * up[2])  # noqa: E741
    if min(length, p, l) < _NOWHERE:
        return 0.0, 0.0
    cross(line, up, turned)
    sine = turned[0] * side[0] + turned[1] * side[1] + turned[2] * side[2]
    cosine = up[0] * side[0] + up[1] * side[1] + up[2] * side[2]
    return math.atan2(sine, cosine), p * l


@compiled
def elbow_triangle(
    level: Array, rotation: Array, wrist: Array, line: Array, arm: Array, side: Array
) -> tuple[float, float, float]:
    """Write n, E − S and p (3,); return L, |p| and n·(E − S)."""
    length = 0.0
    for i in range(3):
        line[i] = wrist[i] - level[SHOULDER + i]
        length += line[i] * line[i]
        arm[i] = line[i]
        for k in range(3):
            arm[i] += rotation[i, k] * level[ELBOW + k]
    length = math.sqrt(length)
    ahead, p = 0.0, 0.0
    for i in range(3):
        line[i] /= max(length, _NOWHERE)
        ahead += line[i] * arm[i]
    for i in range(3):
        side[i] = arm[i] - ahead * line[i]
        p += side[i] * side[i]
    return length, math.sqrt(p), ahead


@compiled
def swivel_row(level: Array, rotation: Array, wrist: Array, jacobian: Array, row: Array) -> None:
    """Write |p| |l| ∂φ/∂q (n,) from the wrist's Jacobian (6, n); zeros where there is no swivel angle."""
    n = row.shape[0]
    line, arm, side = scratch(3), scratch(3), scratch(3)
    up, beside, above, elbow = scratch(3), scratch(3), scratch(3), scratch(3)
    length, p, ahead = elbow_triangle(level, rotation, wrist, line, arm, side)
    z = line[2]
    for i in range(3):
        up[i] = (1.0 if i == 2 else 0.0) - z * line[i]
    l = math.sqrt(up[0] * up[0] + up[1] * up[1] + up[2] * up[2])  # noqa: E741
    for j in range(n):
        row[j] = 0.0
    if min(length, p, l) < _NOWHERE:
        return
    cross(line, side, beside)
    cross(line, up, above)
    for i in range(3):
        elbow[i] = arm[i] - length * line[i]  # E − W
    for j in range(n):
        x, y, w = jacobian[3, j], jacobian[4, j], jacobian[5, j]
        # Ė = Ẇ + ω × (E − W), of one body
        moved = (
            jacobian[0, j] + y * elbow[2] - w * elbow[1],
            jacobian[1, j] + w * elbow[0] - x * elbow[2],
            jacobian[2, j] + x * elbow[1] - y * elbow[0],
        )
        total, other = 0.0, 0.0
        for i in range(3):
            total += beside[i] * (moved[i] - ahead / length * jacobian[i, j])
            other += above[i] * jacobian[i, j]
        row[j] = l / p * total + p / l * z / length * other
