"""What the node is measured against: a bare polled relay of the same messages, and a bare sleep loop.

    python -m ik_controller.ros.baseline relay|sleep|listen

The relay polls the node's subscriptions, sends each joint state on as relayed_commands, and does nothing else. It is
listened to by `listen`, as the node is by the arm: sending to nobody would cost less. All run until SIGTERM or SIGINT,
relay and sleep at 1 kHz, and then print one JSON object: period_p99_us.
"""

from __future__ import annotations

import json
import signal
import sys
import time
from typing import Any

from ik_controller.ros.loop import Loop
from ik_controller.ros.monitor import Timing

_PERIOD = 1_000_000  # [ns]


def relay() -> Loop:
    """Return the loop of the bare relay."""
    import rclpy
    from geometry_msgs.msg import PoseStamped, TwistStamped
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import JointState

    from ik_controller.ros.polling import PolledGroup, PolledSubscription

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node("relay")
    group = PolledGroup()
    states = PolledSubscription(node, group, JointState, "joint_states", 10, reliable=False)
    idle = [
        PolledSubscription(node, group, PoseStamped, "/ik_controller/target_pose", 100, reliable=False),
        PolledSubscription(node, group, TwistStamped, "/ik_controller/target_twist", 100, reliable=False),
    ]
    commands = node.create_publisher(JointState, "relayed_commands", 10)

    def cycle(index: int, now: int, late: int) -> None:
        for subscription in idle:
            subscription.take()
        while (data := states.take()) is not None:
            commands.publish(data)

    return Loop(_PERIOD, cycle)


def listen() -> Loop:
    """Return the loop of a process that only receives what the relay sends."""
    import rclpy
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import JointState

    from ik_controller.ros.polling import PolledGroup, PolledSubscription

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    commands = PolledSubscription(Node("listener"), PolledGroup(), JointState, "relayed_commands", 1, reliable=False)

    def cycle(index: int, now: int, late: int) -> None:
        commands.take()

    return Loop(10 * _PERIOD, cycle)


def sleep() -> Loop:
    """Return the loop that only sleeps to its deadlines."""
    return Loop(_PERIOD, lambda index, now, late: None)


def main() -> None:
    """Run one of them until a signal."""
    loop = {"relay": relay, "sleep": sleep, "listen": listen}[sys.argv[1]]()
    timing = Timing(_PERIOD, window=100_000)
    cycle = loop.cycle

    def timed(index: int, now: int, late: int) -> None:
        timing.add(time.monotonic_ns())
        cycle(index, now, late)

    loop.cycle = timed

    def stop(*_: Any) -> None:
        loop.stop = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    loop.run()
    print(json.dumps({"period_p99_us": timing.percentiles()[1]}))


if __name__ == "__main__":
    main()
