"""Inputs: what the node subscribes to, and the subscriptions of one run, which the loop polls."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from ik_controller.parameters import ControllerParameters
from ik_controller.ros.optional import optional
from ik_controller.ros.polling import PolledGroup, PolledSubscription

_TAKEN_AT_ONCE = 200  # messages of one input a cycle, so that a flood cannot stop the loop
_TURN = 0.005  # [s] in which every silent input is looked at


class Input(NamedTuple):
    """One input: message class, topic, queue depth, reliable, transient local."""

    kind: Any
    topic: str
    depth: int
    reliable: bool
    latched: bool = False


# By role, as in `messages.inputs.INPUTS`. A trajectory comes once and must come; streams must not wait.
_INPUTS = {
    "joint_states": Input(JointState, "joint_states", 10, False),
    "target_pose": Input(PoseStamped, "~/target_pose", 100, False),
    "target_twist": Input(TwistStamped, "~/target_twist", 100, False),
    "target_trajectory": Input(MultiDOFJointTrajectory, "~/target_trajectory", 10, True),
    "target_joints": Input(JointState, "~/target_joints", 100, False),
    "target_joint_trajectory": Input(JointTrajectory, "~/target_joint_trajectory", 10, True),
    "obstacles": Input(MarkerArray, "~/obstacles", 100, True, True),
}


# Role → MoveIt Servo's name, behind the parameter servo_name.
_SERVO = {
    "target_pose": "pose_target_cmds",
    "target_twist": "delta_twist_cmds",
    "target_joint_jog": "delta_joint_cmds",
}


def inputs_of(parameters: ControllerParameters) -> dict[str, Input]:
    """Return role → input, with MoveIt Servo's names where the parameters ask for them."""
    inputs = dict(_INPUTS)
    jog = optional("control_msgs.msg", "JointJog")
    if jog is not None:
        inputs["target_joint_jog"] = Input(jog, "~/target_joint_jog", 100, False)
    if parameters.servo_interface:
        for role, name in _SERVO.items():
            if role in inputs:
                inputs[role] = inputs[role]._replace(topic=f"{parameters.servo_name}/{name}")
    return inputs


class _Entry:
    """A subscription with the role of its messages, and the cycle of the last one."""

    __slots__ = ("heard", "role", "subscription", "take")

    def __init__(self, role: str, subscription: PolledSubscription) -> None:
        self.role, self.subscription, self.take = role, subscription, subscription.take
        self.heard = 0


class Inputs:
    """The subscriptions of one run, from its activation on: what was sent before is not taken.

    A look at a subscription is not free: those that have been silent for a second take turns, so that a stream's first
    message waits `_TURN` at most and the cycle pays for those that stream. `topics`: role → resolved topic.
    """

    def __init__(self, node: Node, parameters: ControllerParameters) -> None:
        group = PolledGroup()
        self._node = node
        inputs = list(inputs_of(parameters).items())
        # What was latched before we came reaches only a subscription that asks for it, and who does not latch reaches
        # only one that does not ask: both are needed, and markers taken twice are the same markers.
        inputs.append(("obstacles", dict(inputs)["obstacles"]._replace(reliable=False, latched=False)))
        self._entries = [_Entry(role, PolledSubscription(node, group, *settings)) for role, settings in inputs]
        self._live, self._silent = list(self._entries), deque[_Entry]()
        self.topics = {entry.role: entry.subscription.topic for entry in self._entries}
        self._cycle = 0
        self._second = round(parameters.rate)  # cycles in it
        self._turn = max(_TURN * parameters.rate, 1.0)  # cycles in which all silent ones are looked at

    def take(self) -> list[tuple[str, bytes]]:
        """Return role and bytes of everything that has arrived, input by input."""
        self._cycle += 1
        arrived: list[tuple[str, bytes]] = []
        for entry in self._live:
            self._empty(entry, arrived)
        for _ in range(math.ceil(len(self._silent) / self._turn)):
            entry = self._silent.popleft()
            self._empty(entry, arrived)
            (self._live if entry.heard == self._cycle else self._silent).append(entry)
        if self._cycle % self._second == 0:
            before = self._cycle - self._second
            self._silent.extend(entry for entry in self._live if entry.heard <= before)
            self._live = [entry for entry in self._live if entry.heard > before]
        return arrived

    def _empty(self, entry: _Entry, arrived: list[tuple[str, bytes]]) -> None:
        for _ in range(_TAKEN_AT_ONCE):
            data = entry.take()
            if data is None:
                break
            arrived.append((entry.role, data))
            entry.heard = self._cycle

    def close(self) -> None:
        """Stop listening."""
        for entry in self._entries:
            self._node.destroy_subscription(entry.subscription.subscription)
        self._entries, self._live, self._silent = [], [], deque()
