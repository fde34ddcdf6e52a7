"""Inputs: what the node subscribes to, and the subscriptions of one run, which the loop polls."""

from __future__ import annotations

from collections.abc import Iterator
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


class Inputs:
    """The subscriptions of one run, from its activation on: what was sent before is not taken.

    `topics`: role → resolved topic of the targets.
    """

    def __init__(self, node: Node, parameters: ControllerParameters) -> None:
        group = PolledGroup()
        self._node = node
        self._subscriptions = [
            (role, PolledSubscription(node, group, *settings)) for role, settings in inputs_of(parameters).items()
        ]
        # What was latched before we came reaches only a subscription that asks for it, and who does not latch reaches
        # only one that does not ask: both are needed, and markers taken twice are the same markers.
        unlatched = inputs_of(parameters)["obstacles"]._replace(reliable=False, latched=False)
        self._subscriptions.append(("obstacles", PolledSubscription(node, group, *unlatched)))
        several = ("joint_states", "obstacles")  # may have more than one publisher
        self.topics = {role: entry.topic for role, entry in self._subscriptions if role not in several}

    def take(self) -> Iterator[tuple[str, bytes]]:
        """Yield role and bytes of everything that has arrived, input by input."""
        for role, subscription in self._subscriptions:
            for _ in range(_TAKEN_AT_ONCE):
                data = subscription.take()
                if data is None:
                    break
                yield role, data

    def close(self) -> None:
        """Stop listening."""
        for _, subscription in self._subscriptions:
            self._node.destroy_subscription(subscription.subscription)
        self._subscriptions = []
