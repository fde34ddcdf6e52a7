"""Over DDS: settings switched while the arm moves; the published stream stays within its limits and replays."""

from __future__ import annotations

import signal
from typing import Any

import numpy as np
from rig import Rig, assert_limits_hold, stalls_of
from test_bad_input import twist
from test_services import replayed

from ik_controller.robots import build_model, bundled_parameters

TOOL = [0.05, 0.0, 0.1, 0.0, 0.0, 0.3826834323650898, 0.9238795325112867]
SWITCHES: list[dict[str, Any]] = [
    {"tool_offset": TOOL},
    {"integration_base": "measured"},
    {"mode": "twist"},
    {"twist_reference_point": "frame"},
    {"integration_base": "bounded", "tool_offset": []},
    {"mode": "joints"},
    {"mode": "auto", "twist_reference_point": "tool"},
    {"integration_base": "commanded", "tool_offset": TOOL},
    {"twist_unit": "unitless"},
    {"twist_unit": "speed", "tool_offset": []},
]


def test_switching_over_dds_never_breaks_a_limit(rig: Rig) -> None:
    node = rig.start_node(robot="panda", rate=200.0)
    rig.start_sim("--rate", "200", "--lag", "0.02", "--delay", "0.02")
    rig.until_status("holding")
    publisher = rig.publisher("target_twist")
    commands = rig.heard["joint_commands"]
    sent = 0

    def push(frame: str, until: int) -> bool:
        nonlocal sent
        message = twist(frame)
        sent += 1
        message.twist.linear.z = 0.1 if sent // 60 % 2 else -0.1
        message.twist.angular.x = 0.1 * np.sin(0.05 * sent)
        publisher.publish(message)
        return len(commands) >= until

    for number, switch in enumerate(SWITCHES):
        assert rig.set_parameters(**switch).successful, switch
        frame = ("panda_link0", "panda_hand_tcp", "panda_link4")[number % 3]
        until = len(commands) + 60
        rig.until(lambda frame=frame, until=until: push(frame, until), "commands")
    node.send(signal.SIGINT)
    assert node.wait() == 0, node.err
    rig.until(lambda: not np.any(commands[-1].velocity), "the last command")
    moved = np.count_nonzero([np.abs(c.velocity).max() > 0.02 for c in commands])
    assert moved > 50
    assert_limits_hold(commands, build_model(bundled_parameters("panda")), 5_000_000, stalls_of(rig))
    (bag,) = rig.bags()
    assert replayed(bag).identical
