"""Chain: a RobotModel as constant arrays, and its forward kinematics and Jacobian as a kernel (notes N1).

Every joint frame is turned so that the joint's axis is its z axis; a revolute joint then mixes two columns of the
rotation, a prismatic one moves along the third. Compiled, one evaluation costs about what Pinocchio's does, without
leaving the kernel; without Numba the same call goes to Pinocchio.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.model import RobotModel, frame_jacobian, frame_pose
from ik_controller.kinematics.scratch import scratch_table

Array = NDArray[np.float64]


class Chain(NamedTuple):
    """m joints in series, moved by n coordinates: joint value = factor · q[leader] + offset (m > n with mimic joints).

    `rotation` (m + 1, 3, 3), `translation` (m + 1, 3) [m]: joint frame in the frame before it, axis along z; the
    last one is the tool. `prismatic`, `factor`, `offset`, `leader` (m,).
    """

    rotation: Array
    translation: Array
    prismatic: NDArray[np.bool_]
    leader: NDArray[np.int64]
    factor: Array
    offset: Array


def chain_of(model: RobotModel) -> Chain:
    """Return the model's chain, kept until the model's tool offset changes."""
    kept = _CHAINS.get(model)
    if kept is None or kept[0] is not model.tool_offset:
        kept = _CHAINS[model] = (model.tool_offset, _extract(model))
    return kept[1]


_CHAINS: WeakKeyDictionary[RobotModel, tuple[Any, Chain]] = WeakKeyDictionary()


def _extract(model: RobotModel) -> Chain:
    pin_model = model.pin_model
    m = pin_model.njoints - 1
    data = pin_model.createData()
    zero = np.zeros(m)
    rotation, translation, prismatic = np.empty((m + 1, 3, 3)), np.empty((m + 1, 3)), np.zeros(m, dtype=np.bool_)
    turned = np.eye(3)  # the frame before, turned so that its joint's axis is z
    for k in range(m):
        # In its own frame a joint's Jacobian column is its axis, linear or angular.
        # eigenpy gives a matrix of one column as a vector
        column = np.reshape(pin.computeJointJacobian(pin_model, data, zero, k + 1), (6, -1))[:, k]
        prismatic[k] = np.linalg.norm(column[:3]) > 0.5
        axis = column[:3] if prismatic[k] else column[3:]
        placement = pin_model.jointPlacements[k + 1]
        to_axis = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).toRotationMatrix()
        if abs(axis[2] - 1.0) < 1e-15:
            to_axis = np.eye(3)
        rotation[k] = turned.T @ placement.rotation @ to_axis
        translation[k] = turned.T @ placement.translation
        turned = to_axis
    tool = pin_model.frames[model.tool_id].placement
    rotation[m], translation[m] = turned.T @ tool.rotation, turned.T @ tool.translation
    if model.expansion is None or model.expansion_offset is None:
        leader, factor, offset = np.arange(m), np.ones(m), np.zeros(m)
    else:
        leader = np.argmax(np.abs(model.expansion), axis=1)
        factor, offset = model.expansion[np.arange(m), leader], model.expansion_offset.copy()
    return Chain(rotation, translation, prismatic, leader.astype(np.int64), factor, offset)


def table_of(model: RobotModel) -> Array:
    """Return the model's chain as one table (m + 1, 16), a row a joint and the tool last: one array is what a compiled
    function takes in fastest.

    Columns: rotation (9) by rows, translation (3), prismatic (1 or 0), leader, factor, offset.
    """
    chain = chain_of(model)
    m = chain.leader.size
    table = np.zeros((m + 1, 16))
    table[:, :9] = chain.rotation.reshape(m + 1, 9)
    table[:, 9:12] = chain.translation
    for column, values in enumerate((chain.prismatic, chain.leader, chain.factor, chain.offset)):
        table[:m, 12 + column] = values
    return table


def table_to(model: RobotModel, joints: int, placement: Any) -> Array:
    """Return the table (joints + 1, 16) of `table_of` that leads over the first `joints` joints to a frame on the last
    of them, which at q = 0 is at `placement`, a `pin.SE3` in the base frame.
    """
    table: Array = table_of(model)[: joints + 1].copy()
    table[joints] = np.concatenate((np.eye(3).ravel(), np.zeros(7)))
    rotation, position = np.empty((3, 3)), np.empty(3)
    chain_pose(table, np.zeros(model.n), rotation, position)
    table[joints, :9] = (rotation.T @ placement.rotation).ravel()
    table[joints, 9:12] = rotation.T @ (placement.translation - position)
    return table


@compiled
def chain_pose(chain: Array, q: Array, rotation: Array, position: Array) -> None:
    """Write the tool's rotation (3, 3) and position (3,) [m] at q (n,); `chain` of `table_of`."""
    m = chain.shape[0] - 1
    _walk(chain, q, rotation, position, scratch_table(m, 3), scratch_table(m, 3))


@compiled
def chain_kinematics(chain: Array, q: Array, rotation: Array, position: Array, jacobian: Array) -> None:
    """Write the tool's rotation (3, 3), position (3,) [m] and basic Jacobian J₀ (6, n), (v, ω) in base axes, at q (n,).

    Column of a joint with axis a through c, driven by its coordinate with `factor` f: f (a × (p − c), a), or f (a, 0).
    """
    m = chain.shape[0] - 1
    axes, points = scratch_table(m, 3), scratch_table(m, 3)
    _walk(chain, q, rotation, position, axes, points)
    for i in range(6):
        for j in range(jacobian.shape[1]):
            jacobian[i, j] = 0.0
    for k in range(m):
        column, gain = int(chain[k, 13]), chain[k, 14]
        ax, ay, az = gain * axes[k, 0], gain * axes[k, 1], gain * axes[k, 2]
        if chain[k, 12] > 0.0:
            jacobian[0, column] += ax
            jacobian[1, column] += ay
            jacobian[2, column] += az
        else:
            x, y, z = position[0] - points[k, 0], position[1] - points[k, 1], position[2] - points[k, 2]
            jacobian[0, column] += ay * z - az * y
            jacobian[1, column] += az * x - ax * z
            jacobian[2, column] += ax * y - ay * x
            jacobian[3, column] += ax
            jacobian[4, column] += ay
            jacobian[5, column] += az


@compiled
def _walk(chain: Array, q: Array, rotation: Array, position: Array, axes: Array, points: Array) -> None:
    """Write the tool's pose and each joint's axis (m, 3) and a point on it (m, 3), in the base frame."""
    m = chain.shape[0] - 1
    # The columns x, y, z of the rotation so far, and the position.
    x0, x1, x2, y0, y1, y2, z0, z1, z2 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    p0, p1, p2 = 0.0, 0.0, 0.0
    for k in range(m + 1):
        t = chain[k]
        p0 += x0 * t[9] + y0 * t[10] + z0 * t[11]
        p1 += x1 * t[9] + y1 * t[10] + z1 * t[11]
        p2 += x2 * t[9] + y2 * t[10] + z2 * t[11]
        u0, u1, u2 = (
            x0 * t[0] + y0 * t[3] + z0 * t[6],
            x1 * t[0] + y1 * t[3] + z1 * t[6],
            x2 * t[0] + y2 * t[3] + z2 * t[6],
        )
        v0, v1, v2 = (
            x0 * t[1] + y0 * t[4] + z0 * t[7],
            x1 * t[1] + y1 * t[4] + z1 * t[7],
            x2 * t[1] + y2 * t[4] + z2 * t[7],
        )
        z0, z1, z2 = (
            x0 * t[2] + y0 * t[5] + z0 * t[8],
            x1 * t[2] + y1 * t[5] + z1 * t[8],
            x2 * t[2] + y2 * t[5] + z2 * t[8],
        )
        if k == m:
            x0, x1, x2, y0, y1, y2 = u0, u1, u2, v0, v1, v2
            break
        axes[k, 0], axes[k, 1], axes[k, 2] = z0, z1, z2
        points[k, 0], points[k, 1], points[k, 2] = p0, p1, p2
        value = t[14] * q[int(t[13])] + t[15]
        if t[12] > 0.0:
            x0, x1, x2, y0, y1, y2 = u0, u1, u2, v0, v1, v2
            p0 += value * z0
            p1 += value * z1
            p2 += value * z2
        else:
            c, s = math.cos(value), math.sin(value)
            x0, x1, x2 = c * u0 + s * v0, c * u1 + s * v1, c * u2 + s * v2
            y0, y1, y2 = c * v0 - s * u0, c * v1 - s * u1, c * v2 - s * u2
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = x0, y0, z0
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = x1, y1, z1
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = x2, y2, z2
    position[0], position[1], position[2] = p0, p1, p2


class PinocchioChain:
    """The same arm for `model_kinematics`: the model and data of its own."""

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.data: Any = model.pin_model.createData()


def model_kinematics(chain: PinocchioChain, q: Array, rotation: Array, position: Array, jacobian: Array) -> None:
    """Write the same as `chain_kinematics`, by Pinocchio."""
    jacobian[:] = frame_jacobian(chain.model, chain.data, q, chain.model.tool_id)
    tool = chain.data.oMf[chain.model.tool_id]
    rotation[:], position[:] = tool.rotation, tool.translation


def model_pose(chain: PinocchioChain, q: Array, rotation: Array, position: Array) -> None:
    """Write the same as `chain_pose`, by Pinocchio."""
    tool = frame_pose(chain.model, chain.data, q, chain.model.tool_id)
    rotation[:], position[:] = tool.rotation, tool.translation
