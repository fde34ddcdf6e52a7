"""Over DDS: frame, mode, tool, integration base and kind of target switched at random moments while the arm moves; the
published stream stays within its limits and replays.

The same, longer and with every cycle checked at once, runs without a node in test_switched_session.py.
"""

from __future__ import annotations

import signal
import time
from typing import Any

import numpy as np
import pytest
from published import assert_limits_hold, recorded, restarts_of, stamp
from rig import Rig
from sensor_msgs.msg import JointState
from test_bad_input import HOME, JOINTS, pose, twist
from test_services import at_rest, replayed

from ik_controller.robots import build_model, bundled_parameters

FRAMES = ("panda_link0", "panda_hand_tcp", "panda_link4")
SETTINGS: dict[str, list[Any]] = {
    "mode": ["auto", "auto", "auto", "pose", "twist", "joints"],
    "tool_offset": [[], [0.05, 0.0, 0.1, 0.0, 0.0, 0.3826834323650898, 0.9238795325112867]],
    "integration_base": ["commanded", "measured", "bounded"],
    "twist_reference_point": ["tool", "frame"],
    "twist_unit": ["speed", "unitless"],
    "reference_mode": ["extrapolate", "interpolate"],
    "velocity_scale": [1.0, 0.2],
    "acceleration_scale": [1.0, 0.3],
}
EVERY = 0.1  # [s] on average between two changes


class Switching:
    """Sends targets of one kind and frame; at random moments either changes, or one of SETTINGS."""

    def __init__(self, rig: Rig, seed: int) -> None:
        self.rig = rig
        self.random = np.random.default_rng(seed)
        self.frame, self.kind = FRAMES[0], "target_twist"
        self.switches = 0
        self._next = time.monotonic()

    def push(self) -> None:
        """Send one target, after a change if it is time for one."""
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + float(self.random.exponential(EVERY))
            self.switches += 1
            choice = int(self.random.integers(2 + len(SETTINGS)))
            if choice == 0:
                self.frame = str(self.random.choice(FRAMES))
            elif choice == 1:
                self.kind = str(self.random.choice(["target_twist", "target_pose", "target_joints"]))
            else:
                name = list(SETTINGS)[choice - 2]
                value = SETTINGS[name][int(self.random.integers(len(SETTINGS[name])))]
                assert self.rig.set_parameters(**{name: value}).successful, (name, value)
        self.rig.publisher(self.kind).publish(self._target())

    def _target(self) -> Any:
        change = self.random.uniform(-0.2, 0.2, 7)
        if self.kind == "target_joints":
            return JointState(name=JOINTS, position=(np.array(HOME) + change).tolist())
        if self.kind == "target_pose":
            message = pose(self.frame)
            position = message.pose.position
            near = (0.4, 0.0, 0.4) if self.frame == FRAMES[0] else (0.0, 0.0, 0.0)  # of a link: about its origin
            position.x, position.y, position.z = (np.array(near) + 0.3 * change[:3]).tolist()
            return message
        message = twist(self.frame)
        linear, angular = message.twist.linear, message.twist.angular
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = change[:6].tolist()
        return message


def run(rig: Rig, seconds: float, seed: int) -> None:
    node = rig.start_node(robot="panda", rate=500.0)
    rig.start_sim("--rate", "500", "--lag", "0.02", "--delay", "0.02")
    rig.until_status("holding")
    switching = Switching(rig, seed)
    for role in ("target_twist", "target_pose", "target_joints"):
        rig.publisher(role)
    rig.ignore("joint_states", "current_pose", "tracking_error")
    commands = rig.heard["joint_commands"]
    end = stamp(commands[-1]) + round(seconds * 1e9)

    seen = moving = 0

    def done() -> bool:  # however slow the machine: enough time, enough changes, enough motion
        nonlocal seen, moving
        switching.push()
        moving += sum(np.abs(command.velocity).max() > 0.02 for command in commands[seen:])
        seen = len(commands)
        return stamp(commands[-1]) >= end and switching.switches > 5 * seconds and moving > 20 * seconds

    rig.until(done, "changes and motion", patience=180.0 + 3.0 * seconds)
    node.send(signal.SIGINT)
    assert node.wait() == 0, node.err
    (bag,) = rig.bags()
    assert replayed(bag).identical
    sent = recorded(bag, "/joint_commands")  # all of them: a listener that is held up itself misses some
    assert at_rest(sent[-1])
    assert_limits_hold(sent, build_model(bundled_parameters("panda")), 2_000_000, restarts_of(bag))


def test_switching_over_dds_never_breaks_a_limit(rig: Rig) -> None:
    run(rig, 5.0, seed=1)


@pytest.mark.soak
def test_switching_for_ten_minutes_never_breaks_a_limit(rig: Rig) -> None:
    run(rig, 600.0, seed=2)
