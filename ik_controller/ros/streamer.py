"""The target streamer: sends the targets of a bag to the node at their own pace, stamped with the time of sending."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import rclpy
import rclpy.duration
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory

from ik_controller.endings import on_signal
from ik_controller.errors import IkControllerError
from ik_controller.recording.target_bag import TargetBag, restamped
from ik_controller.ros.loop import clocks
from ik_controller.ros.polling import PolledGroup, PolledSubscription
from ik_controller.ros.start import full_name, start_ros

_PIECE = 0.1  # [s] that a sleep may last

_KINDS = {
    "target_pose": PoseStamped,
    "target_twist": TwistStamped,
    "target_trajectory": MultiDOFJointTrajectory,
    "target_joints": JointState,
}


def stream(
    targets: TargetBag,
    node_name: str = "ik_controller",
    ros_arguments: list[str] | None = None,
    *,
    duration: float | None = None,
    loop: bool = False,
    patience: float = 10.0,
    progress: Callable[[float], None] | None = None,
) -> int:
    """Send targets until they end, `duration` [s] is over, or SIGINT or SIGTERM; return how many were sent.

    Waits up to `patience` [s] until the node listens and tells its tool's pose, which it does once it knows the arm's
    joints; raises IkControllerError if it does not. `progress` is called with the seconds sent so far.
    """
    start_ros(ros_arguments or [])
    node = Node("target_streamer", start_parameter_services=False)
    node_name = full_name(node, node_name)
    stopped = False

    def stop(*_: Any) -> None:
        nonlocal stopped
        stopped = True

    on_signal(stop)
    publishers: dict[str, Any] = {}
    try:
        roles = sorted(targets.roles)
        try:
            for role in roles:
                publishers[role] = node.create_publisher(_KINDS[role], f"{node_name}/{role}", 100)
        except (InvalidTopicNameException, ValueError) as error:
            raise IkControllerError(f"'{node_name}' cannot be a node's name: {' '.join(str(error).split())}") from None
        sign = PolledSubscription(node, PolledGroup(), PoseStamped, f"{node_name}/current_pose", 1, reliable=False)
        by = time.monotonic() + patience
        ready = False
        while not stopped and not ready:
            heard = all(publisher.get_subscription_count() for publisher in publishers.values())
            ready = heard and sign.take() is not None
            if time.monotonic() > by:
                raise IkControllerError(
                    f"the node '{node_name}' does not know its arm's joints yet: does anybody publish joint_states?"
                    if heard
                    else f"nobody listens on {node_name}/{roles[0]}: is the node '{node_name}' running?"
                )
            time.sleep(0.02)
        sent = 0
        while not stopped:
            start, epoch = clocks()
            for target in targets:
                if duration is not None and target.time > duration * 1e9:
                    break
                # In pieces, for the next target may be far off when we are told to end.
                while not stopped and (wait := start + target.time - time.monotonic_ns()) > 0:
                    time.sleep(min(wait * 1e-9, _PIECE))
                if stopped:
                    break
                publishers[target.role].publish(restamped(target.data, epoch + target.time))
                sent += 1
                if progress is not None:
                    progress(target.time * 1e-9)
            if not loop:
                break
        return sent
    finally:
        # What was sent last must leave before the process does.
        for publisher in publishers.values():
            publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=0.5))
        node.destroy_node()
        rclpy.try_shutdown()
