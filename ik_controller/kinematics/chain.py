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
from ik_controller.kinematics.model import RobotModel, frame_jacobian

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


@compiled
def chain_kinematics(chain: tuple[Any, ...], q: Array, rotation: Array, position: Array, jacobian: Array) -> None:
    """Write the tool's rotation (3, 3), position (3,) [m] and basic Jacobian J₀ (6, n), (v, ω) in base axes, at q (n,).

    `chain`: a Chain as plain tuple, which a compiled function takes twice as fast.
    """
    rotations, translations, prismatic, leader, factor, offset = chain
    m = leader.shape[0]
    axes = np.empty((m, 3))
    points = np.empty((m, 3))
    r, p = np.zeros((3, 3)), np.zeros(3)
    r[0, 0] = r[1, 1] = r[2, 2] = 1.0
    fixed = np.empty((3, 3))
    for k in range(m + 1):
        for i in range(3):
            p[i] += r[i, 0] * translations[k, 0] + r[i, 1] * translations[k, 1] + r[i, 2] * translations[k, 2]
            for j in range(3):
                fixed[i, j] = r[i, 0] * rotations[k, 0, j] + r[i, 1] * rotations[k, 1, j] + r[i, 2] * rotations[k, 2, j]
        if k == m:
            break
        value = factor[k] * q[leader[k]] + offset[k]
        c, s = (1.0, 0.0) if prismatic[k] else (math.cos(value), math.sin(value))
        for i in range(3):
            r[i, 0] = c * fixed[i, 0] + s * fixed[i, 1]
            r[i, 1] = c * fixed[i, 1] - s * fixed[i, 0]
            r[i, 2] = fixed[i, 2]
            axes[k, i] = fixed[i, 2]
            points[k, i] = p[i]
            if prismatic[k]:
                p[i] += value * fixed[i, 2]
    for i in range(3):
        position[i] = p[i]
        for j in range(3):
            rotation[i, j] = fixed[i, j]
    for i in range(6):
        for j in range(jacobian.shape[1]):
            jacobian[i, j] = 0.0
    for k in range(m):
        column, gain = leader[k], factor[k]
        if prismatic[k]:
            for i in range(3):
                jacobian[i, column] += gain * axes[k, i]
        else:
            x, y, z = p[0] - points[k, 0], p[1] - points[k, 1], p[2] - points[k, 2]
            jacobian[0, column] += gain * (axes[k, 1] * z - axes[k, 2] * y)
            jacobian[1, column] += gain * (axes[k, 2] * x - axes[k, 0] * z)
            jacobian[2, column] += gain * (axes[k, 0] * y - axes[k, 1] * x)
            for i in range(3):
                jacobian[3 + i, column] += gain * axes[k, i]


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
