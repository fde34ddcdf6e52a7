"""Inputs: from messages to targets in the base frame. What cannot be used is rejected in one clear line.

Target frames may be any link of the robot model: links fixed to the base by their constant placement, links of the
chain by forward kinematics at the commanded joints at the moment of arrival; others by TF, see `Frames`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.obstacles import Scene
from ik_controller.control.targets import Targets
from ik_controller.errors import MessageError, choices
from ik_controller.kinematics.model import RobotModel
from ik_controller.messages import cdr
from ik_controller.messages.frames import Frames
from ik_controller.messages.markers import take_markers
from ik_controller.parameters import ControllerParameters

Array = NDArray[np.float64]

# Role of an input → its message type. Roles are what the node's topics, remapped or not, and bags are matched by.
INPUTS = {
    "joint_states": cdr.JOINT_STATE,
    "target_pose": cdr.POSE,
    "target_twist": cdr.TWIST,
    "target_trajectory": cdr.TRAJECTORY,
    "target_joints": cdr.JOINT_STATE,
    "target_joint_trajectory": cdr.JOINT_TRAJECTORY,
    "target_joint_jog": cdr.JOINT_JOG,
    "obstacles": cdr.MARKERS,
}

# Mode → roles that it follows; `auto` follows all.
FOLLOWED = {
    "pose": ("target_pose", "target_twist"),
    "twist": ("target_twist",),
    "trajectory": ("target_trajectory", "target_joint_trajectory"),
    "joints": ("target_joints", "target_joint_jog"),
}
# Roles whose messages say in which frame they are.
FRAMED = ("target_pose", "target_twist", "target_trajectory")

_QUATERNION_TOLERANCE = 1e-3


class Inputs:
    """Puts target messages into `Targets`; q, v (n,) in the calls are the commanded state, None before the first.

    `frames`: where TF's transforms are told.
    """

    def __init__(
        self, model: RobotModel, targets: Targets, parameters: ControllerParameters, scene: Scene | None = None
    ) -> None:
        """`scene`: where obstacles go."""
        self.frames = Frames(model)
        self._model = model
        self._joints = cdr.JointStateReader(model.joint_names)
        self._poses = cdr.StampedReader(cdr.POSE, 7)
        self._twists = cdr.StampedReader(cdr.TWIST, 6)
        self._names = model.joint_names
        self._targets = targets
        self._scene = scene
        self.set_parameters(parameters)

    def set_parameters(self, parameters: ControllerParameters) -> None:
        """Take new parameters between two cycles."""
        self._mode = parameters.mode
        self._followed = FOLLOWED.get(parameters.mode)
        self._unitless = parameters.twist_unit == "unitless"
        self._scale = np.repeat((parameters.linear_scale, parameters.angular_scale), 3)
        self._joint_scale = parameters.joint_scale
        self._about_frame = parameters.twist_reference_point == "frame"
        self._append = parameters.trajectory_mode == "append"

    def take(self, role: str, data: bytes, arrival: int, q: Array | None, v: Array) -> None:
        """Take one target message of `role` (a key of INPUTS but joint_states). Raises MessageError; takes nothing
        then.
        """
        if self._followed is not None and role not in self._followed and role != "obstacles":
            raise MessageError(f"not followed in mode '{self._mode}', which takes: {choices(self._followed)}")
        getattr(self, "_" + role)(data, arrival, q, v)

    def _obstacles(self, data: bytes, arrival: int, q: Array | None, v: Array) -> None:
        if self._scene is None or not self._scene.world_watched:
            raise MessageError("obstacles are not heeded: start with obstacle_avoidance")
        take_markers(data, self._scene.world, lambda frame: self.frames.placement(frame, q))

    def _target_pose(self, data: bytes, arrival: int, q: Array | None, v: Array) -> None:
        stamp, frame, numbers = self._poses.read(data)
        placement = self.frames.placement(frame, q)
        pose = _pose(numbers.copy())
        if placement is not self.frames.base:
            pose = placement * pose
        self._targets.add_pose(stamp, arrival, pose.translation.copy(), pose.rotation.copy())

    def _target_twist(self, data: bytes, arrival: int, q: Array | None, v: Array) -> None:
        stamp, frame, numbers = self._twists.read(data)
        placement = self.frames.placement(frame, q)
        twist = self._twist(numbers, placement)
        if self._unitless:
            largest = float(np.abs(numbers).max())
            if largest > 1.0:
                raise MessageError(f"twist {numbers.tolist()}: need −1 to 1, twist_unit is unitless")
            twist = self._twist(self._scale * numbers, placement)
        point = placement.translation.copy() if self._about_frame else None
        self._targets.add_twist(stamp, arrival, twist, point)

    def _twist(self, numbers: Array, placement: Any) -> Array:
        if not math.isfinite(numbers.dot(numbers)):  # or so large that it might as well be
            raise MessageError(f"twist {numbers.tolist()}: values must be finite")
        if placement is self.frames.base:
            twist: Array = numbers.copy()  # one that may be written: Numba compiles for the others anew
            return twist
        rotation = placement.rotation
        return np.concatenate((rotation @ numbers[:3], rotation @ numbers[3:]))

    def _target_trajectory(self, data: bytes, arrival: int, q: Array | None, v: Array) -> None:
        content = cdr.decode(cdr.TRAJECTORY, data)
        names, tip = list(content.joint_names), self._model.tip_frame
        if names not in ([], [tip]):
            raise MessageError(f"joint_names {names}: need none, or the tip frame '{tip}'")
        start, times = self._schedule(content, arrival)
        frame = self.frames.placement(content.header.frame_id, q)
        points: list[tuple[int, Array, Array, Array | None]] = []
        for index, point in enumerate(content.points):
            if len(point.transforms) != 1:
                raise MessageError(f"point {index} has {len(point.transforms)} transforms, need 1")
            if len(point.velocities) > 1:
                raise MessageError(f"point {index} has {len(point.velocities)} velocities, need 1 or none")
            transform = point.transforms[0]
            p, r = transform.translation, transform.rotation
            placement = frame * _pose(np.array((p.x, p.y, p.z, r.x, r.y, r.z, r.w)))
            twist = None
            if point.velocities:
                linear, angular = point.velocities[0].linear, point.velocities[0].angular
                numbers = np.array((linear.x, linear.y, linear.z, angular.x, angular.y, angular.z))
                twist = self._twist(numbers, frame)
            points.append((times[index], placement.translation.copy(), placement.rotation.copy(), twist))
        begin = max(start, arrival)
        splice = self._splice(start)
        if splice is None and q is not None and start < times[0] and begin < times[0]:
            # Its first point is to be reached by then, from here.
            tool = self._model.forward(q)
            here = tool.translation.copy(), tool.rotation.copy()
            points.insert(0, (begin, *here, self._model.jacobian(q) @ v))
        self._targets.set_trajectory(arrival, points, splice)

    def _target_joint_trajectory(self, data: bytes, arrival: int, q: Array | None, v: Array) -> None:
        content = cdr.decode(cdr.JOINT_TRAJECTORY, data)
        order = cdr.joint_order(self._names, list(content.joint_names))
        start, times = self._schedule(content, arrival)
        positions, velocities = np.empty((2, len(times), len(order)))
        for index, point in enumerate(content.points):
            for field, rows in (("positions", positions), ("velocities", velocities)):
                given = getattr(point, field)
                if len(given) == 0 and field == "velocities":
                    rows[index] = np.nan  # to be filled from the neighbours
                    continue
                if len(given) != len(content.joint_names):
                    need = f"need {len(content.joint_names)}, one for each of joint_names"
                    raise MessageError(f"point {index} has {len(given)} {field}, {need}")
                rows[index] = np.asarray(given)[order]
                if not np.isfinite(rows[index]).all():
                    raise MessageError(f"point {index}: {field} must be finite")
        begin = max(start, arrival)
        splice = self._splice(start)
        if splice is None and start < times[0] and begin < times[0]:
            if q is None:
                raise MessageError("the way to the first point begins where the arm is: no joint state has come yet")
            times.insert(0, begin)
            positions, velocities = np.vstack((q, positions)), np.vstack((v, velocities))
        self._targets.set_path(arrival, times, positions, velocities, splice)

    def _schedule(self, content: Any, arrival: int) -> tuple[int, list[int]]:
        """Return a trajectory's start and the times of its points [ns]."""
        if not content.points:
            raise MessageError("the trajectory has no points")
        start = cdr.stamp_of(content) or arrival
        if self._append and not cdr.stamp_of(content):
            end = self._targets.trajectory_end()
            start = arrival if end is None else max(end[0], arrival)
        times: list[int] = []
        for index, point in enumerate(content.points):
            time = start + int(point.time_from_start.sec) * 1_000_000_000 + int(point.time_from_start.nanosec)
            if times and time <= times[-1]:
                raise MessageError(f"point {index}: time_from_start must rise from point to point")
            times.append(time)
        if times[-1] < arrival or (times[-1] == arrival and len(times) > 1):
            late = (arrival - times[-1]) * 1e-9
            raise MessageError(f"the trajectory ended {late:.1f} s ago by its stamp; stamp 0 starts it on arrival")
        return start, times

    def _splice(self, start: int) -> int | None:
        """Return until when the trajectory that is followed goes on, None where it does not."""
        return start if self._append and self._targets.trajectory_end() is not None else None

    def _target_joints(self, data: bytes, arrival: int, q: Array | None, v: Array) -> None:
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

    def _target_joint_jog(self, data: bytes, arrival: int, q: Array | None, v: Array) -> None:
        content = cdr.decode(cdr.JOINT_JOG, data)
        names = list(content.joint_names)
        unknown = [name for name in names if name not in self._names]
        if not names or unknown:
            raise MessageError(f"no joint(s) of the arm: {choices(unknown)}; there are: {choices(self._names)}")
        if len(set(names)) < len(names):
            raise MessageError(f"joint(s) named twice: {choices(sorted({n for n in names if names.count(n) > 1}))}")
        if len(content.displacements):
            raise MessageError("displacements are not followed: send velocities, or ~/target_joints")
        given = np.asarray(content.velocities, dtype=float)
        if given.size != len(names):
            raise MessageError(f"{given.size} values in velocities for {len(names)} names")
        if not np.isfinite(given).all():
            raise MessageError("a velocity is not finite")
        if self._unitless:
            if float(np.abs(given).max()) > 1.0:
                raise MessageError(f"velocities {given.tolist()}: need −1 to 1, twist_unit is unitless")
            given = self._joint_scale * given
        velocity = np.zeros(len(self._names))
        for name, value in zip(names, given.tolist(), strict=True):
            velocity[self._names.index(name)] = value
        self._targets.set_jog(arrival, velocity)


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
