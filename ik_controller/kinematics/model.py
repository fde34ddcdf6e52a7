"""RobotModel: the chain of joints from a base frame to a tool point, built by Pinocchio from URDF (notes N1).

The model holds only the joints of the chain, in order from base to tip; every other joint of the robot is locked.
Its world frame *is* the base frame, so poses, twists and Jacobians come out expressed in the base frame at no cost.
q is a flat (n,) vector: continuous joints count turns as angles without limits, mimic joints follow their leader.
"""

from __future__ import annotations

import copy
import math
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ik_controller.errors import ModelError, choices
from ik_controller.kinematics.urdf import Urdf

Array = NDArray[np.float64]

# Where the URDF states no velocity limit; slow enough to be harmless, and named in `RobotModel.assumptions`.
DEFAULT_VELOCITY = {"revolute": 1.0, "continuous": 1.0, "prismatic": 0.25}
# URDF has no acceleration limits: without an override, full speed is reached in this time.
DEFAULT_RAMP_TIME = 0.25


class _Workspace(threading.local):
    """Pinocchio's intermediate results, a set for each thread: one that came between two calls of another would change
    what that one reads.
    """

    def __init__(self, pin_model: Any) -> None:
        self.data: Any = pin_model.createData()


class RobotModel:
    """A serial arm with limits, in its base frame; immutable but for `set_tool_offset`, and so fit for several threads.

    Attributes: `joint_names` (n names), `n`, `lower`, `upper` [rad or m], `velocity_limit` [rad/s or m/s],
    `acceleration_limit` [rad/s² or m/s²], `jerk_limit` [rad/s³ or m/s³, inf where none], each (n,); `prismatic` (n,)
    bool; `base_frame`, `tip_frame`; `urdf_text`; `assumptions` (what the URDF left open, a sentence each); `pin_model`
    and
    `tool_id`, Pinocchio's model and the index of the tool frame in it.
    """

    def __init__(
        self,
        urdf: Urdf,
        tip_frame: str,
        base_frame: str | None = None,
        *,
        locked_joints: Mapping[str, float] | None = None,
        tool_offset: ArrayLike | None = None,
    ) -> None:
        """Build the chain; prefer `from_urdf`. Raises ModelError for unknown frames or joints and unusable chains."""
        self.urdf_text = urdf.text
        self.tip_frame = tip_frame
        self.base_frame = urdf.root_link if base_frame is None else base_frame
        self.robot_name = urdf.name
        self._urdf = urdf
        chain = urdf.chain(self.base_frame, tip_frame)
        locked = dict(locked_joints or {})
        for name in locked:
            if name not in urdf.movable or name in {joint.name for joint in chain}:
                legal = sorted(set(urdf.movable) - {joint.name for joint in chain})
                raise ModelError(f"locked joint '{name}' is not a joint outside the chain; there are: {choices(legal)}")
        in_chain = {joint.name for joint in chain}
        free = [joint for joint in chain if joint.mimic is None or joint.resolve_mimic(urdf)[0] not in in_chain]
        # A mimic joint whose leader is not in the chain follows a locked value: it is locked itself.
        for joint in [j for j in free if j.mimic is not None]:
            free.remove(joint)
            locked[joint.name] = joint.mimic_value(urdf, locked)
        moving = {j.name for j in free}
        if not moving:
            raise ModelError(f"no movable joint between '{self.base_frame}' and '{tip_frame}'")

        try:
            full = pin.buildModelFromXML(urdf.pinocchio_text())
        except (ValueError, RuntimeError) as error:
            raise ModelError(
                f"Pinocchio cannot build the robot '{urdf.name}': {' '.join(str(error).split())}"
            ) from None
        q_locked = pin.neutral(full)
        for joint in urdf.joints.values():
            if joint.mimic is not None and joint.name not in in_chain and joint.name not in locked:
                locked[joint.name] = joint.mimic_value(urdf, locked)
        for name, value in locked.items():
            if not math.isfinite(value):
                raise ModelError(f"locked joint '{name}': {value} is not finite")
            joint_id = full.getJointId(name)
            if full.nqs[joint_id] == 1:
                q_locked[full.idx_qs[joint_id]] = value
        keep = [j for j in chain if j.name in moving or (j.mimic is not None and j.name not in locked)]
        kept_names = {j.name for j in keep}
        lock_ids = [i for i in range(1, full.njoints) if full.names[i] not in kept_names]
        try:
            self.pin_model: Any = pin.buildReducedModel(full, lock_ids, q_locked)
        except ValueError as error:
            raise ModelError(f"Pinocchio cannot lock the other joints of '{urdf.name}': {error}") from None
        self._move_world_to(self.base_frame)

        order = [next(j for j in keep if j.name == name) for name in list(self.pin_model.names)[1:]]
        leaders = [j for j in order if j.name in moving]
        self.joint_names: tuple[str, ...] = tuple(j.name for j in leaders)
        self.n = len(leaders)
        # q of Pinocchio = expansion @ q + expansion_offset; None where no joint mimics another.
        self.expansion: Array | None = None
        self.expansion_offset: Array | None = None
        if len(order) > len(leaders):
            self.expansion = np.zeros((len(order), self.n))
            self.expansion_offset = np.zeros(len(order))
            for row, joint in enumerate(order):
                name, factor, offset = joint.resolve_mimic(urdf)
                self.expansion[row, self.joint_names.index(name)] = factor
                self.expansion_offset[row] = offset

        self.prismatic = np.array([j.kind == "prismatic" for j in leaders])
        self.lower = np.array([j.lower for j in leaders])
        self.upper = np.array([j.upper for j in leaders])
        self.assumptions: list[str] = []
        velocity = []
        for joint in leaders:
            if joint.velocity > 0.0:
                velocity.append(joint.velocity)
            else:
                velocity.append(DEFAULT_VELOCITY[joint.kind])
                unit = "m/s" if joint.kind == "prismatic" else "rad/s"
                self.assumptions.append(
                    f"joint '{joint.name}' has no velocity limit in the URDF: {velocity[-1]} {unit} is assumed"
                )
        self.velocity_limit = np.array(velocity)
        self.acceleration_limit = self.velocity_limit / DEFAULT_RAMP_TIME
        self.jerk_limit = np.full(self.n, math.inf)
        self._fold_mimic_limits(order)

        tip_id = self.pin_model.getFrameId(tip_frame, pin.FrameType.BODY)
        tip = self.pin_model.frames[tip_id]
        self._tip_placement = pin.SE3(tip.placement)
        tool = pin.Frame("ik_controller_tool", tip.parentJoint, tip_id, tip.placement, pin.FrameType.OP_FRAME)
        self.tool_id: int = self.pin_model.addFrame(tool)
        self.tool_offset = pin.SE3.Identity()
        if tool_offset is not None:
            self.set_tool_offset(tool_offset)
        self._workspace = _Workspace(self.pin_model)

    # -- making one

    @classmethod
    def from_urdf(
        cls,
        path_or_xml: str | Path,
        tip_frame: str,
        base_frame: str | None = None,
        *,
        locked_joints: Mapping[str, float] | None = None,
        tool_offset: ArrayLike | None = None,
    ) -> RobotModel:
        """Build a model from a URDF file or text.

        `tip_frame`, `base_frame`: link names (base: the root link unless given). `locked_joints`: value [rad or m] of
        joints outside the chain, neutral unless given. `tool_offset`: tool point in the tip frame, (7,) x y z
        qx qy qz qw. Raises ModelError: URDF missing or malformed, unknown frame or joint, no movable joint, a joint
        type without one axis.
        """
        return cls(Urdf.load(path_or_xml), tip_frame, base_frame, locked_joints=locked_joints, tool_offset=tool_offset)

    def _move_world_to(self, base_frame: str) -> None:
        """Make the base frame Pinocchio's world: shift what hangs on the universe (all joints above base are
        locked).
        """
        model = self.pin_model
        base = model.frames[model.getFrameId(base_frame, pin.FrameType.BODY)]
        if base.parentJoint != 0:
            raise ModelError(f"base frame '{base_frame}' moves with the chain's own joints")
        shift = base.placement.inverse()
        for joint_id in range(1, model.njoints):
            if model.parents[joint_id] == 0:
                model.jointPlacements[joint_id] = shift * model.jointPlacements[joint_id]
        for frame in model.frames:
            if frame.parentJoint == 0:
                frame.placement = shift * frame.placement

    def _fold_mimic_limits(self, order: Sequence[Any]) -> None:
        """Narrow a leader's limits so that the joints that mimic it keep theirs."""
        if self.expansion is None or self.expansion_offset is None:
            return
        for row, joint in enumerate(order):
            column = int(np.flatnonzero(self.expansion[row])[0])
            factor, offset = self.expansion[row, column], self.expansion_offset[row]
            ends = sorted(((joint.lower - offset) / factor, (joint.upper - offset) / factor))
            self.lower[column] = max(self.lower[column], ends[0])
            self.upper[column] = min(self.upper[column], ends[1])
            if not self.lower[column] < self.upper[column]:
                leader = self.joint_names[column]
                raise ModelError(f"joint '{joint.name}' mimics '{leader}', and their limits leave no motion in common")
            if joint.velocity > 0.0:
                limit = joint.velocity / abs(factor)
                self.velocity_limit[column] = min(self.velocity_limit[column], limit)
                self.acceleration_limit[column] = self.velocity_limit[column] / DEFAULT_RAMP_TIME

    # -- changing what the URDF says

    def set_limits(
        self,
        *,
        lower: Sequence[float] = (),
        upper: Sequence[float] = (),
        velocity: Sequence[float] = (),
        acceleration: Sequence[float] = (),
        jerk: Sequence[float] = (),
    ) -> None:
        """Override limits, each (n,) or empty to keep; units as in the class docstring.

        Raises ModelError where a length is not n, a value is NaN, lower is not below upper, or a rate is not positive.
        """
        given = {"lower": lower, "upper": upper, "velocity": velocity, "acceleration": acceleration, "jerk": jerk}
        arrays: dict[str, Array] = {}
        for name, values in given.items():
            if len(values) == 0:
                continue
            if len(values) != self.n:
                raise ModelError(
                    f"{name} limits: {len(values)} values, need {self.n}, one for each of {choices(self.joint_names)}"
                )
            try:
                arrays[name] = np.array(values, dtype=float)
            except (TypeError, ValueError):
                raise ModelError(f"{name} limits: need numbers, got {list(values)}") from None
            if np.isnan(arrays[name]).any():
                raise ModelError(f"{name} limits: NaN is not a limit")
            if name not in ("lower", "upper") and (arrays[name] <= 0.0).any():
                raise ModelError(f"{name} limits must be positive: {list(values)}")
        new_lower, new_upper = arrays.get("lower", self.lower), arrays.get("upper", self.upper)
        for name, low, high in zip(self.joint_names, new_lower, new_upper, strict=True):
            if not low < high:
                raise ModelError(f"joint '{name}': lower limit {low} is not below upper limit {high}")
        self.lower, self.upper = new_lower, new_upper
        self.velocity_limit = arrays.get("velocity", self.velocity_limit)
        self.acceleration_limit = arrays.get("acceleration", self.acceleration_limit)
        self.jerk_limit = arrays.get("jerk", self.jerk_limit)

    def set_tool_offset(self, offset: ArrayLike) -> None:
        """Place the tool point in the tip frame: (7,) x y z [m] qx qy qz qw. Raises ModelError if it is not a pose."""
        self.tool_offset = pose_from(offset, "tool_offset")
        self.pin_model.frames[self.tool_id].placement = self._tip_placement * self.tool_offset

    def with_tool_offset(self, offset: ArrayLike) -> RobotModel:
        """Return a copy with another tool point; arguments and errors as `set_tool_offset`. This model is left as it
        is.
        """
        other = copy.copy(self)
        other.pin_model = pin.Model(self.pin_model)
        other._workspace = _Workspace(other.pin_model)
        other.set_tool_offset(offset)
        return other

    # -- asking

    def expand(self, q: Array) -> Array:
        """Return Pinocchio's joint vector for q (n,): the same, but for mimic joints, which it lists besides."""
        if self.expansion is None or self.expansion_offset is None:
            return q
        return self.expansion @ q + self.expansion_offset

    def forward(self, q: ArrayLike) -> Any:
        """Return the tool pose at q (n,) as a `pin.SE3` in the base frame [m]. Forward kinematics, N1."""
        return frame_pose(self, self._workspace.data, np.asarray(q, dtype=float), self.tool_id)

    def jacobian(self, q: ArrayLike) -> Array:
        """Return the basic Jacobian J₀ (6, n) at q (n,): (v, ω) = J₀ q̇, tool point, base frame [m/rad, 1]. N1."""
        return frame_jacobian(self, self._workspace.data, np.asarray(q, dtype=float), self.tool_id)

    def middle(self) -> Array:
        """Return the middle of the joint ranges (n,), 0 where a joint has no limits."""
        bounded = np.isfinite(self.lower) & np.isfinite(self.upper)
        low, high = np.where(bounded, self.lower, 0.0), np.where(bounded, self.upper, 0.0)
        return np.where(bounded, 0.5 * (low + high), np.clip(0.0, self.lower, self.upper))


def frame_pose(model: RobotModel, data: Any, q: Array, frame_id: int) -> Any:
    """Return the placement of a frame at q (n,) as `pin.SE3` in the base frame; overwrites `data`."""
    pin.forwardKinematics(model.pin_model, data, model.expand(q))
    return pin.SE3(pin.updateFramePlacement(model.pin_model, data, frame_id))


def frame_jacobian(model: RobotModel, data: Any, q: Array, frame_id: int) -> Array:
    """Return the basic Jacobian (6, n) of a frame at q (n,), (v, ω) in the base frame; overwrites `data`."""
    jacobian: Array = pin.computeFrameJacobian(
        model.pin_model, data, model.expand(q), frame_id, pin.LOCAL_WORLD_ALIGNED
    )
    if jacobian.ndim == 1:  # eigenpy gives a matrix of one column as a vector
        jacobian = jacobian.reshape(6, 1)
    return jacobian if model.expansion is None else np.ascontiguousarray(jacobian @ model.expansion)


def pose_from(values: ArrayLike, name: str = "pose") -> Any:
    """Return (7,) x y z [m] qx qy qz qw as `pin.SE3`, the quaternion normalized.

    Raises ModelError where the shape is wrong, a value is not finite, or the quaternion is off unit by more than 1e-3.
    """
    try:
        pose = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ModelError(f"{name}: need 7 values x y z qx qy qz qw, got {values!r:.60}") from None
    if pose.shape != (7,):
        raise ModelError(f"{name}: need 7 values x y z qx qy qz qw, got shape {pose.shape}")
    if not np.isfinite(pose).all():
        raise ModelError(f"{name}: values must be finite: {pose.tolist()}")
    norm = float(np.linalg.norm(pose[3:]))
    if abs(norm - 1.0) > 1e-3:
        raise ModelError(f"{name}: quaternion (x, y, z, w) has norm {norm:.6g}, need 1 within 1e-3")
    return pin.XYZQUATToSE3(np.concatenate((pose[:3], pose[3:] / norm)))
