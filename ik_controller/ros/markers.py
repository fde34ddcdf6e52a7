"""Markers: the arm's target, path, tool, limits and self-motion for RViz, while anybody looks."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import Point
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ik_controller.kinematics.model import RobotModel
from ik_controller.session import Session

Array = NDArray[np.float64]

PERIOD = 0.1  # [s]
_PATH = 200  # positions of the tool that are kept: 20 s
_AXIS = 0.1  # [m]
_NEAR = 0.1  # share of a joint's range, to its bound, in which it is shown
_SELF_MOTION = 0.25  # [rad] along the null space
_RED, _GREEN, _BLUE = (1.0, 0.2, 0.2), (0.2, 0.8, 0.2), (0.2, 0.4, 1.0)
_GREY, _ORANGE, _NAVY = (0.6, 0.6, 0.6), (0.96, 0.52, 0.1), (0.1, 0.3, 0.6)


def markers(session: Session, path: list[Array]) -> list[Marker]:
    """Return the markers of a session at this moment; `path`: positions (3,) of the tool, oldest first.

    Namespaces: target and tool (axes), path, trajectory, limits (joints near a bound or held back by a limit),
    null_space (where the arm could stand with the tool where it is).
    """
    q = session.controller.position
    if q is None:
        return []
    model, status, reference = session.model, session.status, session.reference
    found = _axes("tool", model.forward(q), 1.0)
    if reference is not None and reference.position is not None and reference.rotation is not None:
        found += _axes("target", pin.SE3(reference.rotation, reference.position), 0.5)
    found.append(_line("path", 0, path, _NAVY, 0.004, 1.0))
    found.append(_line("trajectory", 0, session.targets.way(), _ORANGE, 0.004, 0.8))
    joints = _joints(model, q)
    room = np.minimum(q - model.lower, model.upper - q) / (model.upper - model.lower)
    for joint in range(model.n):
        held = joint == status.joint
        near = float(room[joint]) if np.isfinite(room[joint]) else 1.0
        if held or near < _NEAR:
            color = _RED if held else (1.0, 0.2 + 0.8 * max(near, 0.0) / _NEAR, 0.2)
            found.append(_sphere("limits", joint, joints[joint], color))
    if model.n > 6:
        free = np.linalg.svd(model.jacobian(q))[2][-1]
        for number, turn in enumerate((-_SELF_MOTION, _SELF_MOTION)):
            other = _joints(model, np.clip(q + turn * free, model.lower, model.upper))
            found.append(_line("null_space", number, other, _GREY, 0.008, 0.4))
    return found


def _joints(model: RobotModel, q: Array) -> list[Array]:
    """Return the joints' places and the tool point (n + 1 of them, (3,) each) in the base frame."""
    data = model.pin_model.createData()
    pin.forwardKinematics(model.pin_model, data, model.expand(q))
    places = [np.array(data.oMi[model.pin_model.getJointId(name)].translation) for name in model.joint_names]
    return [*places, np.array(pin.updateFramePlacement(model.pin_model, data, model.tool_id).translation)]


def _marker(space: str, number: int, kind: int, color: tuple[float, float, float], alpha: float) -> Marker:
    marker = Marker(ns=space, id=number, type=kind, action=Marker.ADD)
    marker.color = _color(color, alpha)
    marker.pose.orientation.w = 1.0
    marker.lifetime.nanosec = 500_000_000
    return marker


def _color(color: tuple[float, float, float], alpha: float) -> ColorRGBA:
    return ColorRGBA(r=color[0], g=color[1], b=color[2], a=alpha)


def _point(place: Array) -> Point:
    x, y, z = place.tolist()
    return Point(x=x, y=y, z=z)


def _axes(space: str, pose: Any, alpha: float) -> list[Marker]:
    marker = _marker(space, 0, Marker.LINE_LIST, _GREY, alpha)
    marker.scale.x = 0.006
    for axis, color in enumerate((_RED, _GREEN, _BLUE)):
        for place in (pose.translation, pose.translation + _AXIS * pose.rotation[:, axis]):
            marker.points.append(_point(place))
            marker.colors.append(_color(color, alpha))
    return [marker]


def _line(
    space: str, number: int, places: list[Array], color: tuple[float, float, float], width: float, alpha: float
) -> Marker:
    marker = _marker(space, number, Marker.LINE_STRIP, color, alpha)
    marker.scale.x = width
    marker.points = [_point(place) for place in places]
    if len(places) < 2:
        marker.action = Marker.DELETE
    return marker


def _sphere(space: str, number: int, place: Array, color: tuple[float, float, float]) -> Marker:
    marker = _marker(space, number, Marker.SPHERE, color, 0.7)
    marker.pose.position = _point(place)
    marker.scale.x = marker.scale.y = marker.scale.z = 0.12
    return marker


class MarkerOutput:
    """Publishes ~/markers ten times a second while somebody subscribes to it."""

    def __init__(self, node: Node, session: Session) -> None:
        self._node = node
        self._session = session
        self._path: deque[Array] = deque(maxlen=_PATH)
        self._publisher = node.create_publisher(MarkerArray, "~/markers", 1)
        self._timer = node.create_timer(PERIOD, self._tell)

    def _tell(self) -> None:
        if not self._publisher.get_subscription_count():
            self._path.clear()
            return
        q = self._session.controller.position
        if q is None:
            return
        model = self._session.model
        self._path.append(np.array(model.forward(q).translation))
        message = MarkerArray(markers=markers(self._session, list(self._path)))
        stamp = self._node.get_clock().now().to_msg()
        for marker in message.markers:
            marker.header.frame_id = model.base_frame
            marker.header.stamp = stamp
        self._publisher.publish(message)

    def close(self) -> None:
        """Stop."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)
