"""Messages as bytes, as a node or a bag would hand them over, for the tests of messages and sessions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ik_controller.messages import cdr


def _vector(values: Sequence[float]) -> Any:
    return cdr.message("geometry_msgs/msg/Vector3", *map(float, values))


def _twist(values: Sequence[float]) -> Any:
    return cdr.message("geometry_msgs/msg/Twist", _vector(values[:3]), _vector(values[3:]))


def _quaternion(values: Sequence[float]) -> Any:
    return cdr.message("geometry_msgs/msg/Quaternion", *map(float, values))


def seven(pose: Any) -> np.ndarray:
    """Return x y z qx qy qz qw of a `pin.SE3`."""
    return pin.SE3ToXYZQUAT(pose)


def pose(values: Sequence[float], frame: str, stamp: int = 0) -> bytes:
    """A PoseStamped of x y z qx qy qz qw."""
    point = cdr.message("geometry_msgs/msg/Point", *map(float, values[:3]))
    body = cdr.message("geometry_msgs/msg/Pose", point, _quaternion(values[3:]))
    return cdr.encode(cdr.message(cdr.POSE, cdr.header(stamp, frame), body))


def twist(values: Sequence[float], frame: str, stamp: int = 0) -> bytes:
    """A TwistStamped of v and ω."""
    return cdr.encode(cdr.message(cdr.TWIST, cdr.header(stamp, frame), _twist(values)))


def _duration(seconds: float) -> Any:
    return cdr.message("builtin_interfaces/msg/Duration", *divmod(round(seconds * 1e9), 10**9))


def trajectory(
    points: Sequence[tuple[float, Sequence[Sequence[float]], Sequence[Sequence[float]]]],
    frame: str,
    stamp: int = 0,
    names: Sequence[str] = (),
) -> bytes:
    """A MultiDOFJointTrajectory of (time from start [s], transforms, velocities)."""
    made = []
    for time, transforms, velocities in points:
        made.append(
            cdr.message(
                "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
                [cdr.message("geometry_msgs/msg/Transform", _vector(t[:3]), _quaternion(t[3:])) for t in transforms],
                [_twist(v) for v in velocities],
                [],
                _duration(time),
            )
        )
    return cdr.encode(cdr.message(cdr.TRAJECTORY, cdr.header(stamp, frame), list(names), made))


def joints(names: Sequence[str], position: Sequence[float], velocity: Sequence[float] = (), stamp: int = 0) -> bytes:
    """A JointState."""
    arrays = [np.array(values, dtype=float) for values in (position, velocity, ())]
    return cdr.encode(cdr.message(cdr.JOINT_STATE, cdr.header(stamp, ""), list(names), *arrays))


def joint_trajectory(
    points: Sequence[tuple[float, Sequence[float], Sequence[float]]], names: Sequence[str], stamp: int = 0
) -> bytes:
    """A JointTrajectory of (time from start [s], positions, velocities)."""
    made = []
    for time, positions, velocities in points:
        made.append(
            cdr.message(
                "trajectory_msgs/msg/JointTrajectoryPoint",
                *[np.array(values, dtype=float) for values in (positions, velocities, (), ())],
                _duration(time),
            )
        )
    return cdr.encode(cdr.message(cdr.JOINT_TRAJECTORY, cdr.header(stamp, ""), list(names), made))


def joint_jog(
    names: Sequence[str], velocities: Sequence[float], stamp: int = 0, displacements: Sequence[float] = ()
) -> bytes:
    """A JointJog."""
    arrays = [np.array(values, dtype=float) for values in (displacements, velocities)]
    return cdr.encode(cdr.message(cdr.JOINT_JOG, cdr.header(stamp, ""), list(names), *arrays, 0.0))


def markers(entries: Sequence[tuple[str, int, int, int, Sequence[float], Sequence[float]]], frame: str) -> bytes:
    """A MarkerArray of (namespace, id, type, action, position, scale), upright."""
    nothing = cdr.message("builtin_interfaces/msg/Duration", 0, 0)
    color = cdr.message("std_msgs/msg/ColorRGBA", 1.0, 1.0, 1.0, 1.0)
    image = cdr.message("sensor_msgs/msg/CompressedImage", cdr.header(0, ""), "", np.zeros(0, dtype=np.uint8))
    mesh = cdr.message("visualization_msgs/msg/MeshFile", "", np.zeros(0, dtype=np.uint8))
    made = []
    for namespace, number, kind, action, position, scale in entries:
        point = cdr.message("geometry_msgs/msg/Point", *map(float, position))
        at = cdr.message("geometry_msgs/msg/Pose", point, _quaternion((0.0, 0.0, 0.0, 1.0)))
        made.append(
            cdr.message(
                "visualization_msgs/msg/Marker", cdr.header(0, frame), namespace, number, kind, action, at,
                _vector(scale), color, nothing, False, [], [], "", image, [], "", "", mesh, False,
            )
        )  # fmt: skip
    return cdr.encode(cdr.message(cdr.MARKERS, made))
