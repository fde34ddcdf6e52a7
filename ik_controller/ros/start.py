"""Start: what every ROS process of this package begins with, and the names that its ROS arguments give."""

from __future__ import annotations

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ik_controller.errors import ParameterError
from ik_controller.ros.transport import leave_shared_memory


def start_ros(arguments: list[str]) -> None:
    """Initialise rclpy with `--ros-args …`, or nothing. Raises ParameterError where they are malformed.

    Signals stay ours: rclpy's own handlers shut the context down before a last command can go out.
    """
    leave_shared_memory()
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # a malformed argument, or a parameter file that cannot be read
        raise ParameterError(" ".join(str(error).split())) from None


def full_name(node: Node, name: str) -> str:
    """Return the full name of the node `name`: as it is with a leading "/", else in the namespace of `node`."""
    return name if name.startswith("/") else f"{node.get_namespace().rstrip('/')}/{name}"
