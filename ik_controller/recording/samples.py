"""Samples: what somebody's messages say of a tool's motion, whatever their type.

Joints become the tool's poses by forward kinematics and its twists by the Jacobian, where a model is given. The twist
of an odometry is in its own moving frame and is turned into that of its pose.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.errors import BagError, MessageError, choices
from ik_controller.kinematics.model import RobotModel
from ik_controller.messages import cdr

Array = NDArray[np.float64]

ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TF = "tf2_msgs/msg/TFMessage"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"

# Message type → the roles that it can play, what it is taken for unasked first.
ROLES_OF_TYPE = {
    cdr.POSE: ("target_pose",),
    cdr.TWIST: ("target_twist",),
    cdr.TRAJECTORY: ("target_trajectory",),
    ODOMETRY: ("target_pose",),
    TRANSFORM: ("target_pose",),
    TF: ("target_pose",),
    cdr.JOINT_STATE: ("target_pose", "target_joints"),
    JOINT_TRAJECTORY: ("target_trajectory",),
}
OF_JOINTS = (cdr.JOINT_STATE, JOINT_TRAJECTORY)


class Point(NamedTuple):
    """A point of a trajectory: time from its start [ns], pose (7,), twist (6,) or None."""

    time: int
    pose: Array
    twist: Array | None


class Sample(NamedTuple):
    """One target: role, stamp [ns] (0: none), frame, values: pose (7,), twist (6,), or list of Points.

    `data`: the message's own bytes where it is of the role's type. `q` (n,): the joints that it comes from, or None.
    """

    role: str
    stamp: int
    frame: str
    values: Any
    data: bytes | None = None
    q: Array | None = None


Convert = Callable[[bytes], list[Sample]]


def converter(type_name: str, role: str, child: str, model: RobotModel | None) -> Convert:
    """Return the function from a message's bytes to samples of `role`; it raises MessageError for unusable bytes.

    `child`: which child frame of a TF topic. Raises BagError where the type cannot play the role, or needs a model.
    """
    if role not in ROLES_OF_TYPE.get(type_name, ()):
        able = [kind for kind, roles in ROLES_OF_TYPE.items() if role in roles]
        raise BagError(f"{type_name} cannot be a {role}; {choices(able)} can")
    if role == "target_joints":
        return _target_joints(model)
    if type_name in OF_JOINTS:
        if model is None:
            raise BagError(f"{type_name} needs a robot to become the tool's poses: give --robot or --urdf with --tip")
        return _joint_states(model) if type_name == cdr.JOINT_STATE else _joint_trajectories(model)
    if type_name in (cdr.POSE, cdr.TWIST):
        return _stamped(role, cdr.StampedReader(type_name, 7 if type_name == cdr.POSE else 6))
    if type_name == cdr.TRAJECTORY:
        return _trajectory
    if type_name == ODOMETRY:
        return _odometry
    return _transforms(type_name, child)


def _stamped(role: str, reader: cdr.StampedReader) -> Convert:
    def convert(data: bytes) -> list[Sample]:
        stamp, frame, numbers = reader.read(data)
        return [Sample(role, stamp, frame, numbers, data)]

    return convert


def _trajectory(data: bytes) -> list[Sample]:
    content = cdr.decode(cdr.TRAJECTORY, data)
    points = []
    for point in content.points:
        if len(point.transforms) != 1 or len(point.velocities) > 1:
            raise MessageError("a trajectory of several bodies")
        twist = _twist_numbers(point.velocities[0]) if point.velocities else None
        points.append(Point(_duration(point.time_from_start), _transform_numbers(point.transforms[0]), twist))
    return [Sample("target_trajectory", cdr.stamp_of(content), content.header.frame_id, points, data)]


def _odometry(data: bytes) -> list[Sample]:
    content = cdr.decode(ODOMETRY, data)
    stamp, frame = cdr.stamp_of(content), content.header.frame_id
    p, r = content.pose.pose.position, content.pose.pose.orientation
    pose = np.array((p.x, p.y, p.z, r.x, r.y, r.z, r.w))
    samples = [Sample("target_pose", stamp, frame, pose)]
    norm = float(np.linalg.norm(pose[3:]))
    if norm > 0.0:
        rotation = pin.Quaternion(*(pose[[6, 3, 4, 5]] / norm)).toRotationMatrix()
        own = _twist_numbers(content.twist.twist)
        twist = np.concatenate((rotation @ own[:3], rotation @ own[3:]))
        samples.append(Sample("target_twist", stamp, frame, twist))
    return samples


def _transforms(type_name: str, child: str) -> Convert:
    seen = child

    def convert(data: bytes) -> list[Sample]:
        nonlocal seen
        content = cdr.decode(type_name, data)
        transforms = content.transforms if type_name == TF else [content]
        children = sorted({transform.child_frame_id for transform in transforms} | ({seen} if seen else set()))
        if not child and len(children) > 1:
            raise BagError(f"transforms of several frames: say which, as in --map target_pose=TOPIC:{children[0]}; "
                           f"there are: {choices(children)}")  # fmt: skip
        seen = child or (children[0] if children else seen)
        return [
            Sample("target_pose", cdr.stamp_of(t), t.header.frame_id, _transform_numbers(t.transform))
            for t in transforms
            if t.child_frame_id == seen
        ]

    return convert


def _joint_states(model: RobotModel) -> Convert:
    reader = cdr.JointStateReader(model.joint_names)

    def convert(data: bytes) -> list[Sample]:
        q = reader.read(data)
        if q is None:
            return []  # of another arm or a gripper
        content = cdr.decode(cdr.JOINT_STATE, data)
        stamp = cdr.stamp_of(content)
        samples = [Sample("target_pose", stamp, model.base_frame, pin.SE3ToXYZQUAT(model.forward(q)), None, q.copy())]
        if len(content.velocity) == len(content.name):
            order = [content.name.index(name) for name in model.joint_names]
            rate = np.asarray(content.velocity, dtype=float)[order]
            if np.isfinite(rate).all():
                samples.append(Sample("target_twist", stamp, model.base_frame, model.jacobian(q) @ rate))
        return samples

    return convert


def _target_joints(model: RobotModel | None) -> Convert:
    reader = None if model is None else cdr.JointStateReader(model.joint_names)
    turns: Array | None = None  # that the whole recording is beyond the limits

    def convert(data: bytes) -> list[Sample]:
        nonlocal turns
        content = cdr.decode(cdr.JOINT_STATE, data)
        stamp, q = cdr.stamp_of(content), None
        if model is not None and reader is not None:
            q = reader.read(data)
            if q is None:
                return []  # of another arm or a gripper
            turns = q - within_turns(model, q) if turns is None else turns
            q = q - turns
            if turns.any():
                content.position = content.position.copy()
                for name, angle in zip(model.joint_names, q.tolist(), strict=True):
                    content.position[content.name.index(name)] = angle
                data = cdr.encode(content)
        return [Sample("target_joints", stamp, "", None, data, q)]

    return convert


def within_turns(model: RobotModel, q: Array) -> Array:
    """Return joints (n,) with whole turns taken off that lead beyond a limit."""
    turns = np.where(model.prismatic | ((q >= model.lower) & (q <= model.upper)), 0.0, 2.0 * np.pi)
    return np.where(turns > 0.0, q - 2.0 * np.pi * np.round((q - model.middle()) / (2.0 * np.pi)), q)


def _joint_trajectories(model: RobotModel) -> Convert:
    def convert(data: bytes) -> list[Sample]:
        content = cdr.decode(JOINT_TRAJECTORY, data)
        names = list(content.joint_names)
        if not set(names) & set(model.joint_names):
            return []
        missing = [name for name in model.joint_names if name not in names]
        if missing:
            raise MessageError(f"joint(s) missing: {choices(missing)}; the trajectory has: {choices(names)}")
        order = [names.index(name) for name in model.joint_names]
        points, first = [], None
        for point in content.points:
            q = np.asarray(point.positions, dtype=float)
            if q.size != len(names) or not np.isfinite(q).all():
                raise MessageError(f"a point has {q.size} positions, need {len(names)} finite ones")
            q = q[order]
            first = q if first is None else first
            rate = np.asarray(point.velocities, dtype=float)
            twist = model.jacobian(q) @ rate[order] if rate.size == len(names) and np.isfinite(rate).all() else None
            points.append(Point(_duration(point.time_from_start), pin.SE3ToXYZQUAT(model.forward(q)), twist))
        return [Sample("target_trajectory", cdr.stamp_of(content), model.base_frame, points, None, first)]

    return convert


def _duration(duration: Any) -> int:
    return int(duration.sec) * 1_000_000_000 + int(duration.nanosec)


def _transform_numbers(transform: Any) -> Array:
    p, r = transform.translation, transform.rotation
    return np.array((p.x, p.y, p.z, r.x, r.y, r.z, r.w))


def _twist_numbers(twist: Any) -> Array:
    v, w = twist.linear, twist.angular
    return np.array((v.x, v.y, v.z, w.x, w.y, w.z))


class SampleWriter:
    """Encodes samples as the messages of their roles."""

    def __init__(self) -> None:
        self._writers: dict[tuple[str, str], cdr.StampedWriter] = {}

    def encode(self, sample: Sample) -> bytes:
        """Return the sample as CDR bytes of its role's message type."""
        if sample.role == "target_trajectory":
            return _encode_trajectory(sample)
        key = sample.role, sample.frame
        writer = self._writers.get(key)
        if writer is None:
            if sample.role == "target_pose":
                empty, count = cdr.pose_message(0, sample.frame, pin.SE3.Identity()), 7
            else:
                empty, count = cdr.twist_message(0, sample.frame, np.zeros(6)), 6
            writer = self._writers[key] = cdr.StampedWriter(empty, count)
        return writer.write(sample.stamp, np.ascontiguousarray(sample.values))


def _encode_trajectory(sample: Sample) -> bytes:
    make, points = cdr.message, []
    for time, pose, twist in sample.values:
        p, r = make("geometry_msgs/msg/Vector3", *pose[:3]), make("geometry_msgs/msg/Quaternion", *pose[3:])
        velocities = []
        if twist is not None:
            v, w = make("geometry_msgs/msg/Vector3", *twist[:3]), make("geometry_msgs/msg/Vector3", *twist[3:])
            velocities = [make("geometry_msgs/msg/Twist", v, w)]
        duration = make("builtin_interfaces/msg/Duration", time // 1_000_000_000, time % 1_000_000_000)
        transform = make("geometry_msgs/msg/Transform", p, r)
        points.append(make("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint", [transform], velocities, [], duration))
    return cdr.encode(make(cdr.TRAJECTORY, cdr.header(sample.stamp, sample.frame), [], points))
