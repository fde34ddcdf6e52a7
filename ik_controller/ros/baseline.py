"""What the node is measured against: a bare polled relay of the same messages, a bare sleep loop, and itself without a
recording.

    python -m ik_controller.ros.baseline relay|sleep|listen
    python -m ik_controller.ros.baseline switch ROUNDS

The relay polls the node's subscriptions, sends each joint state on as relayed_commands, and does nothing else. It is
listened to by `listen`, as the node is by the arm: sending to nobody would cost less. All run until SIGTERM or SIGINT,
relay and sleep at 1 kHz, and then print one JSON object: period_p99_us.

`switch` switches a node's recording on and off in turns, prints "on" or "off" when it is so and after `_WINDOW` seconds
the periods' 99th percentiles [µs] that the node told of meanwhile, as a list in JSON.
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
_WINDOW = 4.0  # [s]
_SETTLE = 1.5  # [s] after which the node's percentile, of its last 1000 cycles, knows nothing of the time before
_PATIENCE = 60.0  # [s]


def relay() -> Loop:
    """Return the loop of the bare relay."""
    from geometry_msgs.msg import PoseStamped, TwistStamped
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    from ik_controller.ros.polling import PolledGroup, PolledSubscription
    from ik_controller.ros.start import start_ros

    start_ros([])
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
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    from ik_controller.ros.polling import PolledGroup, PolledSubscription
    from ik_controller.ros.start import start_ros

    start_ros([])
    commands = PolledSubscription(Node("listener"), PolledGroup(), JointState, "relayed_commands", 1, reliable=False)

    def cycle(index: int, now: int, late: int) -> None:
        commands.take()

    return Loop(10 * _PERIOD, cycle)


def sleep() -> Loop:
    """Return the loop that only sleeps to its deadlines."""
    return Loop(_PERIOD, lambda index, now, late: None)


def switch(rounds: int) -> None:
    """Switch the recording of /ik_controller on and off, `rounds` times; see the module."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticStatus
    from rclpy.node import Node
    from std_srvs.srv import SetBool

    from ik_controller.ros.start import start_ros

    start_ros([])
    node = Node("switch")
    told: list[dict[str, str]] = []
    node.create_subscription(
        DiagnosticStatus, "/ik_controller/status", lambda s: told.append({v.key: v.value for v in s.values}), 10
    )
    client = node.create_client(SetBool, "/ik_controller/record")

    def spin(seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            rclpy.spin_once(node, timeout_sec=left)

    for wanted in (True, False) * rounds:
        state = "recording" if wanted else "off"
        deadline = time.monotonic() + _PATIENCE
        asked = 0.0
        while not told or told[-1].get("recorder") != state:  # a node that prepares has none
            if time.monotonic() - asked > 2.0:  # again: an answer, or the question, may be lost
                client.call_async(SetBool.Request(data=wanted))
                asked = time.monotonic()
            spin(0.05)
            if time.monotonic() > deadline:
                sys.exit(f"the node does not switch its recording to {state}")
        spin(_SETTLE)
        told.clear()
        print("on" if wanted else "off", flush=True)
        spin(_WINDOW)
        print(json.dumps([float(values["period_p99_us"]) for values in told]), flush=True)
    rclpy.shutdown()


def main() -> None:
    """Run one of them until a signal."""
    if sys.argv[1] == "switch":
        switch(int(sys.argv[2]))
        return
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
