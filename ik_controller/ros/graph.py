"""Graph: looks at a running ROS graph for what keeps an arm from being controlled; for `ik_controller doctor`."""

from __future__ import annotations

import statistics
import time
from collections import Counter
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from ik_controller.findings import Finding
from ik_controller.kinematics.model import RobotModel
from ik_controller.parameters import ControllerParameters
from ik_controller.ros.publishers import name_of
from ik_controller.ros.reasons import LEVELS, OK, REASONS, what_to_do
from ik_controller.ros.transport import leave_shared_memory

_STREAMS = {"target_pose": PoseStamped, "target_twist": TwistStamped}
_TAKEN = {**_STREAMS, "joint_states": JointState, "robot_description": String}
_ASIDE = ("ik_controller_doctor", "_ros2cli")  # nodes that are looked past: ourselves and command line tools
_OFF = 0.2  # [s] that joint states' stamps may be off the clock here


class Graph:
    """A look at the graph: `listen` for some seconds, then `findings`. `description`: robot_description, or None.

    `node`: full name of the controller's node; its topics are those that it has, remapped or not, if it runs.
    """

    def __init__(self, node: str = "/ik_controller") -> None:
        leave_shared_memory()
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._self = Node(_ASIDE[0], context=self._context, enable_rosout=False, start_parameter_services=False)
        self._node = "/" + node.strip("/")
        self._subscriptions: dict[str, Any] = {}
        self._heard: dict[str, list[tuple[int, Any]]] = {}
        self._topics = {role: f"{self._node}/{role}" for role in (*_STREAMS, "status")}
        namespace = self._node.rpartition("/")[0]
        for name in ("joint_states", "joint_commands", "robot_description"):
            self._topics[name] = f"{namespace}/{name}"
        self.description: str | None = None

    def close(self) -> None:
        """Leave the graph."""
        self._self.destroy_node()
        rclpy.shutdown(context=self._context)

    def listen(self, seconds: float) -> bool:
        """Listen, first to who is there, then to what they say; return whether anybody else is there at all."""
        self._pass(0.5 * seconds)
        if not self._others():
            return False
        self._remapped()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        stream = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
        kinds = {**_STREAMS, "joint_states": JointState, "joint_commands": JointState, "status": DiagnosticStatus}
        for role, kind in kinds.items():
            self._subscribe(role, kind, stream)
        if self._endpoints("robot_description")[0]:
            self._subscribe("robot_description", String, latched)
        self._pass(0.5 * seconds)
        texts = self._heard.get("robot_description")
        self.description = texts[-1][1].data if texts else None
        return True

    def findings(self, model: RobotModel | None, parameters: ControllerParameters) -> list[Finding]:
        """Return what there is to say; without a model what needs none."""
        found = [*self._names(), *self._qos(), *self._description(parameters), *self._states(model, parameters)]
        found += [*self._commands(), *self._targets(model, parameters), *self._status()]
        domain = self._context.get_domain_id()
        return found or [Finding("ok", "graph", f"{len(self._others())} nodes in domain {domain}, nothing amiss")]

    # -- listening

    def _pass(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for role, subscription in self._subscriptions.items():
                with subscription.handle:
                    while (taken := subscription.handle.take_message(subscription.msg_type, False)) is not None:
                        self._heard[role].append((time.time_ns(), taken[0]))
            time.sleep(0.005)

    def _subscribe(self, role: str, kind: Any, qos: QoSProfile) -> None:
        types = dict(self._self.get_topic_names_and_types()).get(self._topics[role], [])
        if types in ([], [_type(kind)]):  # of another type: nothing of it can be taken
            self._heard[role] = []
            self._subscriptions[role] = self._self.create_subscription(kind, self._topics[role], lambda _: None, qos)

    def _others(self) -> list[str]:
        names = self._self.get_node_names_and_namespaces()
        return [f"{space.rstrip('/')}/{name}" for name, space in names if not name.startswith(_ASIDE)]

    def _remapped(self) -> None:
        """Take the topics that the controller's node has, by its own account."""
        space, _, name = self._node.rpartition("/")
        if self._node not in self._others():
            return
        subscribed = self._self.get_subscriber_names_and_types_by_node(name, space or "/")
        published = self._self.get_publisher_names_and_types_by_node(name, space or "/")
        for role, topics in (("joint_states", subscribed), ("joint_commands", published)):
            found = [t for t, kinds in topics if "sensor_msgs/msg/JointState" in kinds and not t.startswith(self._node)]
            if len(found) == 1:
                self._topics[role] = found[0]
        found = [topic for topic, kinds in subscribed if "std_msgs/msg/String" in kinds]
        if len(found) == 1:
            self._topics["robot_description"] = found[0]

    def _endpoints(self, role: str) -> tuple[list[Any], list[Any]]:
        """Return publishers and subscribers of a topic, ourselves left out."""
        sides = (self._self.get_publishers_info_by_topic, self._self.get_subscriptions_info_by_topic)
        publishers, subscribers = (
            [end for end in side(self._topics[role]) if not end.node_name.startswith(_ASIDE)] for side in sides
        )
        return publishers, subscribers

    # -- what is wrong

    def _names(self) -> list[Finding]:
        twice = [name for name, count in Counter(self._others()).items() if count > 1 and name == self._node]
        remedy = "end one, or start it with another name or namespace (-r __ns:=/left)"
        return [Finding("error", "nodes", f"two nodes have the name '{name}'", remedy) for name in twice]

    def _qos(self) -> list[Finding]:
        found = []
        for role, topic in self._topics.items():
            publishers, subscribers = self._endpoints(role)
            subject = f"topic {topic}"
            for publisher in publishers:
                if role in _TAKEN and publisher.topic_type != _type(_TAKEN[role]):
                    message = f"{name_of(publisher)} sends {publisher.topic_type}, taken is {_type(_TAKEN[role])}"
                    found.append(Finding("error", subject, message, "send the other type, or remap it away"))
                for subscriber in subscribers:
                    if publisher.topic_type != subscriber.topic_type:
                        continue
                    verdict, reason = qos_check_compatible(publisher.qos_profile, subscriber.qos_profile)
                    if verdict == QoSCompatibility.ERROR:
                        message = f"{name_of(subscriber)} cannot hear {name_of(publisher)}: {' '.join(reason.split())}"
                        found.append(Finding("error", subject, message, "change the quality of service of one of them"))
        return found

    def _description(self, parameters: ControllerParameters) -> list[Finding]:
        if parameters.robot or parameters.urdf:
            return []
        topic = self._topics["robot_description"]
        publishers, _ = self._endpoints("robot_description")
        if not publishers:
            remedy = "start robot_state_publisher, or give the parameter robot or urdf"
            return [Finding("error", f"topic {topic}", "nobody publishes the robot's URDF", remedy)]
        if len(publishers) > 1 and len({m.data for _, m in self._heard.get("robot_description", [])}) > 1:
            return [Finding("error", f"topic {topic}", f"different URDFs come from {_all(publishers)}", "end one")]
        if self.description is None:
            remedy = "publish it transient local (latched), as robot_state_publisher does"
            return [Finding("error", f"topic {topic}", f"{_all(publishers)} sends nothing to who comes later", remedy)]
        return []

    def _duplicates(self, role: str) -> list[Finding]:
        """Say where several publishers send the same joints."""
        publishers, _ = self._endpoints(role)
        groups: list[set[str]] = []
        for names in {tuple(message.name) for _, message in self._heard.get(role, [])}:
            if not any(group & set(names) for group in groups):
                groups.append(set(names))
        if len(publishers) <= max(len(groups), 1):
            return []
        message = f"{len(publishers)} publishers send the same joints: {_all(publishers)}"
        return [Finding("error", f"topic {self._topics[role]}", message, "end all but one, or remap them apart")]

    def _states(self, model: RobotModel | None, parameters: ControllerParameters) -> list[Finding]:
        subject = f"topic {self._topics['joint_states']}"
        publishers, _ = self._endpoints("joint_states")
        if not publishers:
            remedy = "start the arm's driver, or remap: -r joint_states:=ITS_TOPIC"
            return [Finding("error", subject, "nobody publishes joint states", remedy)]
        found = self._duplicates("joint_states")
        heard = self._heard.get("joint_states", [])
        if not heard:
            return [*found, Finding("error", subject, f"{_all(publishers)} sends nothing", "see to the driver")]
        if model is not None:
            found += _joints(subject, heard, model)
            heard = [(at, m) for at, m in heard if set(m.name) & set(model.joint_names)]
        found += _pace(subject, heard, parameters.feedback_timeout, "feedback_timeout")
        found += _stamps(subject, heard, _OFF, "the driver's clock")
        return found

    def _commands(self) -> list[Finding]:
        topic = self._topics["joint_commands"]
        publishers, subscribers = self._endpoints("joint_commands")
        found = self._duplicates("joint_commands")
        if publishers and not subscribers:
            remedy = "start the driver, or remap: -r joint_commands:=ITS_TOPIC"
            found.append(Finding("error", f"topic {topic}", "nobody listens to the commands", remedy))
        return found

    def _targets(self, model: RobotModel | None, parameters: ControllerParameters) -> list[Finding]:
        found = []
        for role in _STREAMS:
            subject, heard = f"topic {self._topics[role]}", self._heard.get(role, [])
            found += _pace(subject, heard, parameters.command_timeout, "command_timeout")
            found += _stamps(subject, heard, parameters.stamp_tolerance, "the sender's clock")
            publishers, _ = self._endpoints(role)
            if len(publishers) > 1:
                message = f"{len(publishers)} publishers: {_all(publishers)}"
                found.append(Finding("warning", subject, message, "let one at a time send targets"))
            if model is not None:
                links = {frame.name for frame in model.pin_model.frames} | {model.base_frame}
                for frame in {message.header.frame_id for _, message in heard} - links:
                    remedy = f"use a link of the robot, such as '{model.base_frame}', or have tf2 know it"
                    found.append(Finding("warning", subject, f"frame_id '{frame}' is no link of the robot", remedy))
        return found

    def _status(self) -> list[Finding]:
        heard = self._heard.get("status", [])
        if self._node not in self._others():
            message = f"the node '{self._node}' is not running"
            return [Finding("ok", "node", message, "start it: ros2 run ik_controller ik_controller_node")]
        if not heard:
            return [Finding("error", "node", f"'{self._node}' runs, and tells no status", "start it anew")]
        status = heard[-1][1]
        level = int.from_bytes(status.level, "little")
        if level == OK:
            return []
        values = {pair.key: pair.value for pair in status.values}
        keys = [key for key in values.get("reasons", "").split(", ") if key in REASONS and REASONS[key].level != OK]
        return [Finding("warning", f"node {self._node}", f"{LEVELS[level]}: {status.message}", what_to_do(keys))]


def _joints(subject: str, heard: list[tuple[int, Any]], model: RobotModel) -> list[Finding]:
    """Check names and positions of joint states against the model."""
    ours = [message for _, message in heard if set(message.name) & set(model.joint_names)]
    if not ours:
        message = f"no message has a joint of the model ({', '.join(model.joint_names)}); "
        message += f"they have: {', '.join(sorted({name for _, m in heard for name in m.name}))}"
        return [Finding("error", subject, message, "give the right tip_frame and base_frame, or the right URDF")]
    found = []
    last = ours[-1]
    missing = [name for name in model.joint_names if name not in last.name]
    if missing:
        message = f"joints are missing: {', '.join(missing)}"
        return [Finding("error", subject, message, "have the driver send all joints of the arm in one message")]
    if len(last.position) != len(last.name):
        message = f"{len(last.position)} positions for {len(last.name)} names"
        return [Finding("error", subject, message, "see to the driver")]
    q = np.array([last.position[list(last.name).index(name)] for name in model.joint_names])
    for name, value, low, high in zip(model.joint_names, q, model.lower, model.upper, strict=True):
        if not np.isfinite(value):
            found.append(Finding("error", subject, f"joint '{name}' is at {value}", "see to the driver"))
        elif not low <= value <= high:
            message = f"joint '{name}' is at {value:.4g}, outside its limits {low:.4g} … {high:.4g}"
            remedy = "move it by hand, or correct position_lower and position_upper"
            found.append(Finding("warning", subject, message, remedy))
    return found


def _pace(subject: str, heard: list[tuple[int, Any]], timeout: float, name: str) -> list[Finding]:
    """Check that messages come faster than a timeout."""
    if len(heard) < 3:
        return []
    gap = (heard[-1][0] - heard[0][0]) * 1e-9 / (len(heard) - 1)
    if gap <= 0.5 * timeout:
        return []
    message = f"a message every {gap:.3g} s, and {name} is {timeout:g} s"
    return [Finding("warning", subject, message, f"send faster, or raise {name} to {3.0 * gap:.2g}")]


def _stamps(subject: str, heard: list[tuple[int, Any]], tolerance: float, clock: str) -> list[Finding]:
    """Check the stamps against this machine's clock."""
    stamps = [(at, m.header.stamp.sec * 10**9 + m.header.stamp.nanosec) for at, m in heard]
    if any(stamp == 0 for _, stamp in stamps):
        return [Finding("warning", subject, "the stamp is 0", "have the sender stamp its messages")]
    if not stamps:
        return []
    off = statistics.median((at - stamp) * 1e-9 for at, stamp in stamps)
    if abs(off) <= tolerance:
        return []
    message = f"stamps are {abs(off):.3g} s {'behind' if off > 0 else 'ahead of'} the clock of this machine"
    return [Finding("warning", subject, message, f"synchronise {clock} (chrony, ptp)")]


def _type(kind: Any) -> str:
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


def _all(endpoints: list[Any]) -> str:
    return ", ".join(sorted(map(name_of, endpoints)))
