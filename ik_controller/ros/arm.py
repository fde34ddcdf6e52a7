"""The simulated arm as a ROS process: joint_commands in, joint_states out at a rate, robot_description latched."""

from __future__ import annotations

from typing import Any

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from ik_controller.control.simulated_arm import SimulatedArm
from ik_controller.endings import on_signal
from ik_controller.errors import MessageError
from ik_controller.kinematics.model import RobotModel
from ik_controller.messages.cdr import JointStateReader, JointStateWriter
from ik_controller.ros.loop import Loop
from ik_controller.ros.polling import PolledGroup, PolledSubscription
from ik_controller.ros.start import start_ros


def simulate(
    model: RobotModel, q: NDArray[np.float64], rate: float, ros_arguments: list[str], **arm: Any
) -> dict[str, int]:
    """Run a simulated arm from rest at q (n,) until SIGINT or SIGTERM; `arm`: the options of `SimulatedArm`.

    Return how many cycles it ran, missed, and how many commands it took. Raises ParameterError for malformed ROS
    arguments.
    """
    start_ros(ros_arguments)
    node = Node("simulated_arm", start_parameter_services=False)
    commands = PolledSubscription(node, PolledGroup(), JointState, "joint_commands", 10, reliable=False)
    states = node.create_publisher(JointState, "joint_states", 10)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_publisher(String, "robot_description", latched).publish(String(data=model.urdf_text))

    simulated = SimulatedArm(q, **arm)
    reader, writer = JointStateReader(model.joint_names), JointStateWriter(model.joint_names)
    period = round(1e9 / rate)
    counts = {"cycles": 0, "missed": 0, "commands": 0}

    def cycle(index: int, now: int, late: int) -> None:
        while (data := commands.take()) is not None:
            try:
                command = reader.read(data)
            except MessageError as error:
                node.get_logger().warning(f"rejected: joint_commands: {error}", throttle_duration_sec=1.0)
                continue
            if command is not None:
                simulated.command(command)
                counts["commands"] += 1
        counts["cycles"] += 1
        simulated.advance(period / 1e9)
        states.publish(writer.write(now, *simulated.measure()))

    loop = Loop(period, cycle)

    def stop(*_: Any) -> None:
        loop.stop = True

    on_signal(stop)
    node.get_logger().info(f"simulating {len(model.joint_names)} joints at {rate:g} Hz")
    try:
        loop.run()
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    counts["missed"] = loop.missed
    return counts
