"""Inputs: from messages to targets in the base frame. What cannot be used is rejected in one clear line.

Target frames may be any link of the robot model: links fixed to the base by their constant placement, links of the
chain by forward kinematics at the commanded joints at the moment of arrival.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.targets import Targets
from ik_controller.errors import MessageError, choices
from ik_controller.kinematics.model import RobotModel, frame_pose
from ik_controller.messages import cdr

Array = NDArray[np.float64]

# Role of an input → its message type. Roles are what the node's topics, remapped or not, and bags are matched by.
INPUTS = {
    "joint_states": cdr.JOINT_STATE,
    "target_pose": cdr.POSE,
    "target_twist": cdr.TWIST,
    "target_trajectory": cdr.TRAJECTORY,
    "target_joints": cdr.JOINT_STATE,
}

_QUATERNION_TOLERANCE = 1e-3


class Frames:
    """Placements of the model's links in its base frame."""

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self._data: Any = model.pin_model.createData()
        self._ids = {f.name: i for i, f in enumerate(model.pin_model.frames) if f.type == pin.FrameType.BODY}
        self._fixed = {
            name: pin.SE3(model.pin_model.frames[i].placement)
            for name, i in self._ids.items()
            if model.pin_model.frames[i].parentJoint == 0
        }
        self.base = self._fixed[model.base_frame] = pin.SE3.Identity()

    def placement(self, name: str, q: Array | None) -> Any:
        """Return the link's `pin.SE3` in the base frame at q (n,). Raises MessageError: empty or unknown frame, no
        q.
        """
        placement = self._fixed.get(name)
        if placement is not None:
            return placement
        frame = self._ids.get(name)
        if frame is None:
            given = "is empty" if not name else f"'{name}' is unknown"
            raise MessageError(f"frame_id {given}; legal: {choices(sorted({*self._ids, self._model.base_frame}))}")
        if q is None:
            raise MessageError(f"frame_id '{name}' moves with the arm, and no joint state has come yet")
        return frame_pose(self._model, self._data, q, frame)


class Inputs:
    """Puts target messages into `Targets`; `q` in the calls is the commanded position, None before the first."""

    def __init__(self, model: RobotModel, targets: Targets) -> None:
        self._frames = Frames(model)
        self._tip = model.tip_frame
        self._joints = cdr.JointStateReader(model.joint_names)
        self._poses = cdr.StampedReader(cdr.POSE, 7)
        self._twists = cdr.StampedReader(cdr.TWIST, 6)
        self._names = model.joint_names
        self._targets = targets

    def take(self, role: str, data: bytes, arrival: int, q: Array | None) -> None:
        """Take one target message of `role` (a key of INPUTS but joint_states). Raises MessageError; takes nothing
        then.
        """
        getattr(self, "_" + role)(data, arrival, q)

    def _target_pose(self, data: bytes, arrival: int, q: Array | None) -> None:
        stamp, frame, numbers = self._poses.read(data)
        placement = self._frames.placement(frame, q)
        pose = _pose(numbers.copy())
        if placement is not self._frames.base:
            pose = placement * pose
        self._targets.add_pose(stamp, arrival, pose.translation.copy(), pose.rotation.copy())

    def _target_twist(self, data: bytes, arrival: int, q: Array | None) -> None:
        stamp, frame, numbers = self._twists.read(data)
        self._targets.add_twist(stamp, arrival, self._twist(numbers, self._frames.placement(frame, q)))

    def _twist(self, numbers: Array, placement: Any) -> Array:
        if not math.isfinite(numbers.dot(numbers)):  # or so large that it might as well be
            raise MessageError(f"twist {numbers.tolist()}: values must be finite")
        if placement is self._frames.base:
            return numbers
        rotation = placement.rotation
        return np.concatenate((rotation @ numbers[:3], rotation @ numbers[3:]))

    def _target_trajectory(self, data: bytes, arrival: int, q: Array | None) -> None:
        content = cdr.decode(cdr.TRAJECTORY, data)
        names = list(content.joint_names)
        if names not in ([], [self._tip]):
            raise MessageError(f"joint_names {names}: need none, or the tip frame '{self._tip}'")
        if not content.points:
            raise MessageError("the trajectory has no points")
        frame = self._frames.placement(content.header.frame_id, q)
        start = cdr.stamp_of(content) or arrival
        points: list[tuple[int, Array, Array, Array | None]] = []
        for index, point in enumerate(content.points):
            if len(point.transforms) != 1:
                raise MessageError(f"point {index} has {len(point.transforms)} transforms, need 1")
            if len(point.velocities) > 1:
                raise MessageError(f"point {index} has {len(point.velocities)} velocities, need 1 or none")
            duration = point.time_from_start
            time = start + int(duration.sec) * 1_000_000_000 + int(duration.nanosec)
            if points and time <= points[-1][0]:
                raise MessageError(f"point {index}: time_from_start must rise from point to point")
            transform = point.transforms[0]
            p, r = transform.translation, transform.rotation
            placement = frame * _pose(np.array((p.x, p.y, p.z, r.x, r.y, r.z, r.w)))
            twist = None
            if point.velocities:
                v, w = point.velocities[0].linear, point.velocities[0].angular
                twist = self._twist(np.array((v.x, v.y, v.z, w.x, w.y, w.z)), frame)
            points.append((time, placement.translation.copy(), placement.rotation.copy(), twist))
        if points[-1][0] <= arrival:
            late = (arrival - points[-1][0]) * 1e-9
            raise MessageError(f"the trajectory ended {late:.1f} s ago by its stamp; stamp 0 starts it on arrival")
        self._targets.set_trajectory(arrival, points)

    def _target_joints(self, data: bytes, arrival: int, q: Array | None) -> None:
        content = cdr.decode(cdr.JOINT_STATE, data)
        position = self._joints.read(data)
        if position is None:
            raise MessageError(f"none of the joints {choices(self._names)}; the message has: {choices(content.name)}")
        velocity = np.zeros(len(self._names))
        if len(content.velocity):
            given = dict(zip(content.name, content.velocity, strict=True))
            velocity = np.array([given[name] for name in self._names])
            if not np.isfinite(velocity).all():
                raise MessageError("a velocity is not finite")
        self._targets.set_joints(arrival, position.copy(), velocity)


def _pose(values: Array) -> Any:
    """Return x y z qx qy qz qw, which are overwritten, as a `pin.SE3`."""
    if not math.isfinite(values.dot(values)) and not np.isfinite(values).all():
        raise MessageError(f"pose {values.tolist()}: values must be finite")
    turn = values[3:]
    norm = math.sqrt(turn.dot(turn))
    if norm == 0.0:
        raise MessageError("the quaternion is zero: need unit norm; (0, 0, 0, 1) is no rotation")
    if abs(norm - 1.0) > _QUATERNION_TOLERANCE:
        raise MessageError(f"the quaternion has norm {norm:.6g}: need 1 within {_QUATERNION_TOLERANCE:g}")
    turn /= norm
    return pin.XYZQUATToSE3(values)
