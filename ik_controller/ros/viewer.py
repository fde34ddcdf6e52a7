"""The viewer: the live page's ROS side. It watches one node of ours, wherever that runs, and steers it through the same
topics, services and parameters that everybody has; the node does not know of it.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from ik_controller.control.obstacles import Scene
from ik_controller.endings import on_signal
from ik_controller.errors import IkControllerError, MessageError
from ik_controller.kinematics.collision_world import World
from ik_controller.kinematics.model import RobotModel
from ik_controller.messages import cdr
from ik_controller.messages.frames import Frames
from ik_controller.messages.markers import take_markers
from ik_controller.parameters import ControllerParameters, specs
from ik_controller.robots import build_model, urdf_text
from ik_controller.ros.polling import PolledGroup, PolledSubscription
from ik_controller.ros.question import Question
from ik_controller.ros.start import full_name, start_ros
from ik_controller.view.page import SLIDERS, Page, Steering

Array = NDArray[np.float64]

_DRAG = 0.02  # [s] between two targets while one is dragged
_LOOK = 0.04  # [s] between two looks at what the node has sent
_LINGER = 5.0  # [s] after the last target that we stay a publisher of targets; two of them fight over the arm
_SETTLE = 2.0  # [s] after letting go in which the target stays, so that the arm arrives
_ARRIVED = 1e-4  # [m and rad] from the target
_NICE = 5  # a picture may wait, a control loop on the same machine may not
_SILENT = 1.0  # [s] without status after which the node is taken for gone

_FACTS = {
    "mode": "mode",
    "limit": "limit",
    "joint": "joint",
    "scale": "speed scale",
    "smallest_singular_value": "smallest singular value",
    "rejected": "rejected inputs",
    "period_p99_us": "period p99 [µs]",
    "missed": "missed cycles",
    "recorder": "recorder",
}


class Viewer:
    """Feeds a Page from the node `target` (such as "/ik_controller") and back; `run` until `stop`."""

    def __init__(
        self,
        target: str,
        page_title: str,
        dark: bool = False,
        context: Any = None,
        failed: Callable[[], str] = lambda: "",
    ) -> None:
        """`failed` says why the node will not come back, empty while it may."""
        self.page = Page(page_title, Steering(self._drag, self._set, self._press), dark)
        self._lock = threading.Lock()
        self._goal: tuple[Any, float] | None = None  # dragged pose, and until when it is sent
        self._stop = False
        self._wake = threading.Event()  # something to send, or the end
        self._failed = failed
        self.node = node = Node("viewer", context=context, start_parameter_services=False)
        self._target = target = full_name(node, target)
        self._set_parameters = node.create_client(SetParameters, f"{target}/set_parameters")
        self._services = {
            "pause": (node.create_client(SetBool, f"{target}/pause"), SetBool.Request(data=True)),
            "resume": (node.create_client(SetBool, f"{target}/pause"), SetBool.Request(data=False)),
            "reset": (node.create_client(Trigger, f"{target}/reset"), Trigger.Request()),
            "record": (node.create_client(SetBool, f"{target}/record"), SetBool.Request(data=True)),
            "seal": (node.create_client(SetBool, f"{target}/record"), SetBool.Request(data=False)),
        }
        self._pose: Any = None  # the publisher, while somebody steers
        self._sent = 0.0  # when the last target was
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._description: str | None = None
        node.create_subscription(String, _beside(target, "robot_description"), self._on_description, latched)
        group = PolledGroup()
        inputs = {
            # Not joint_states and joint_commands: a thousand a second to one more reader cost those who send them.
            "measured": (JointState, f"{target}/measured_joints"),
            "commanded": (JointState, f"{target}/commanded_joints"),
            "status": (DiagnosticStatus, f"{target}/status"),
        }
        self._inputs = {
            name: PolledSubscription(node, group, kind, topic, 1, reliable=False)
            for name, (kind, topic) in inputs.items()
        }
        # Obstacles may be latched or not; see `inputs`.
        self._markers = [
            PolledSubscription(node, group, MarkerArray, f"{target}/obstacles", 100, reliable=latch, latched=latch)
            for latch in (True, False)
        ]
        # Made last: whoever answers it has found all of the above.
        self._get = node.create_client(GetParameters, f"{target}/get_parameters")
        self._world = World()
        self._frames: Frames | None = None
        self._q: Array | None = None  # as last commanded
        self._model: RobotModel | None = None
        self._joints: cdr.JointStateReader | None = None
        self._error = np.zeros(2)  # position [m] and orientation [rad], from the last status
        self._speed = 0.0
        self._question: Question | None = None
        self._heard = float("-inf")  # when the node last told its status

    def stop(self, *_: Any) -> None:
        """End `run`; for signal handlers."""
        self._stop = True

    def run(self) -> None:
        """Watch and steer until `stop`."""
        executor = SingleThreadedExecutor(context=self.node.context)
        executor.add_node(self.node)
        start, look_at = time.monotonic(), 0.0
        while not self._stop:
            begin = time.monotonic()
            steered = self._send_goal(begin)
            if begin >= look_at:
                look_at = begin + _LOOK
                executor.spin_once(timeout_sec=0.0)
                self._look(begin, begin - start)
            by = min(look_at, begin + _DRAG) if steered else look_at
            self._wake.wait(max(by - time.monotonic(), 0.001))
            self._wake.clear()
        executor.shutdown()
        self.page.close()
        self.node.destroy_node()

    # -- what the arm does

    def _look(self, now: float, seconds: float) -> None:
        status = self._inputs["status"].latest()
        if status is not None:
            if now - self._heard > _SILENT:  # new, or come back: it may be another arm now
                self._question = None
                self._model = None
            self._heard = now
            self._tell(cdr.decode("diagnostic_msgs/msg/DiagnosticStatus", status), seconds)
        elif now - self._heard > _SILENT:
            self._tell_silence()
        if self._model is None and now - self._heard <= _SILENT:
            self._attach()
        if self._model is None or self._joints is None:
            return
        self._look_at_obstacles()
        for kind in ("measured", "commanded"):
            data = self._inputs[kind].latest()
            if data is None:
                continue
            try:
                q = self._joints.read(data)
            except MessageError:
                continue
            if q is not None:
                self.page.show_arm(kind, q.copy())
                if kind == "commanded":
                    self._q = q.copy()
                    velocity = np.array(cdr.decode(cdr.JOINT_STATE, data).velocity)
                    self._speed = float(np.max(np.abs(velocity) / self._model.velocity_limit))

    def _look_at_obstacles(self) -> None:
        frames, changed = self._frames, False
        for subscription in self._markers if frames is not None else ():
            while (data := subscription.take()) is not None:
                with contextlib.suppress(MessageError):  # the node says what is wrong with it
                    take_markers(data, self._world, lambda name: frames.placement(name, self._q))  # type: ignore[union-attr]
                    changed = True
        if changed:
            self.page.show_obstacles(self._world)

    def _tell_silence(self) -> None:
        failure = self._failed()
        if failure:
            self.page.show_status(2, failure)
        elif np.isinf(self._heard) and self.node.count_publishers(f"{self._target}/status"):
            self.page.show_status(3, "the node is starting; the very first time it compiles, for a minute or two")
        else:
            self.page.show_status(3, f"no node answers as {self._target}")

    def _tell(self, status: Any, seconds: float) -> None:
        values = {pair.key: pair.value for pair in status.values}
        facts = [(label, values[key]) for key, label in _FACTS.items() if values.get(key)]
        self.page.show_status(int(status.level), str(status.message), facts)
        with contextlib.suppress(KeyError, ValueError):  # a node that is not active has no errors
            self._error = np.array((float(values["position_error_m"]), float(values["orientation_error_rad"])))
            if np.isfinite(self._error).all():
                self.page.show_errors(seconds, float(self._error[0]), float(self._error[1]), self._speed)

    # -- which arm it is

    def _on_description(self, message: String) -> None:
        self._description = message.data

    def _attach(self) -> None:
        """Ask the node for its parameters, and show the arm that they name."""
        names = [spec.name for spec in specs()]
        self._question = self._question or Question(self._get, GetParameters.Request(names=names))
        answer = self._question.answer()
        if answer is None:
            return
        self._question = None
        values = {
            name: parameter_value_to_python(value)
            for name, value in zip(names, answer.values, strict=False)
            if value.type != ParameterType.PARAMETER_NOT_SET
        }
        try:
            parameters = ControllerParameters.from_mapping({n: v for n, v in values.items() if v is not None})
            try:
                urdf = urdf_text(parameters)
            except IkControllerError:
                urdf = None  # a file of the node's machine, not of this one
            urdf = urdf or self._description
            if urdf is None:
                self.page.show_status(1, "waiting for the topic robot_description")
                return
            model = build_model(parameters, urdf)
        except IkControllerError as error:
            self.page.show_status(2, str(error))
            return
        # Beside its URDF a robot's meshes are found too.
        self.page.load(model, [str(f) for f in Path(parameters.urdf).absolute().parents] if parameters.urdf else [])
        self._model, self._joints, self._frames = model, cdr.JointStateReader(model.joint_names), Frames(model)
        with contextlib.suppress(IkControllerError):  # a file of the node's machine, not of this one
            self._world = Scene.of(model, parameters).world
            self.page.show_obstacles(self._world)
        sliders = {name: getattr(parameters, name) for name in SLIDERS}
        self.page.show_parameters({n: float(v[0] if isinstance(v, tuple) else v) for n, v in sliders.items()})

    # -- what the user does; from the page's threads

    def _drag(self, pose: Any, held: bool) -> None:
        with self._lock:
            self._goal = (pose, float("inf") if held else time.monotonic() + _SETTLE)
        self._wake.set()

    def _send_goal(self, now: float) -> bool:
        """Send what is dragged; return whether anything is."""
        with self._lock:
            goal = self._goal
            if goal is not None:
                pose, until = goal
                arrived = until < float("inf") and float(self._error.max()) < _ARRIVED and until - now < 1.5
                if now > until or arrived:
                    goal = self._goal = None
        model = self._model
        if goal is None or model is None:
            if self._pose is not None and now > self._sent + _LINGER:
                self.node.destroy_publisher(self._pose)
                self._pose = None
            return False
        if self._pose is None:
            self._pose = self.node.create_publisher(PoseStamped, f"{self._target}/target_pose", 1)
        normal = pin.SE3(pin.Quaternion(pose.rotation).normalized(), pose.translation)
        self._pose.publish(cdr.pose_message(time.time_ns(), model.base_frame, normal))
        self._sent = now
        return True

    def _set(self, name: str, value: float) -> None:
        kind = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        if name == "gain":
            kind = ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[value])
        request = SetParameters.Request(parameters=[Parameter(name=name, value=kind)])
        if not self._set_parameters.service_is_ready():
            self.page.notify(name, f"no node answers as {self._target}")
            return
        self._set_parameters.call_async(request).add_done_callback(lambda done: self._was_set(name, done))

    def _was_set(self, name: str, done: Any) -> None:
        for result in done.result().results:
            if not result.successful:
                self.page.notify(name, str(result.reason))

    def _press(self, name: str) -> None:
        client, request = self._services[name]
        if not client.service_is_ready():
            self.page.notify(name, f"no node answers as {self._target}")
            return
        client.call_async(request).add_done_callback(lambda done: self._answered(name, done))

    def _answered(self, name: str, done: Any) -> None:
        self.page.notify(name, str(done.result().message))


def _beside(target: str, topic: str) -> str:
    """Return a topic of the node's namespace."""
    return f"{target.rpartition('/')[0]}/{topic}"


def view(
    target: str,
    title: str,
    dark: bool,
    opened: Any,
    ros_arguments: list[str],
    failed: Callable[[], str] = lambda: "",
) -> None:
    """Serve the page of the node `target` until SIGINT or SIGTERM; `opened(page)` is called once it is served, `failed`
    is that of Viewer.
    """
    os.nice(_NICE)  # before its threads start, which inherit it
    start_ros(ros_arguments)
    viewer = Viewer(target, title, dark, failed=failed)
    on_signal(viewer.stop)
    try:
        opened(viewer.page)
        viewer.run()
    finally:
        rclpy.try_shutdown()
