"""Every reason of the status' table is provoked and seen on ~/status, with its level."""

from __future__ import annotations

import resource
from collections.abc import Iterator

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped
from rig import Rig, values_of
from sensor_msgs.msg import JointState

from ik_controller.control.status import Code, Limit
from ik_controller.ros import reasons

JOINTS = [f"panda_joint{i}" for i in range(1, 8)]
HOME = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]


def test_every_code_and_limit_has_a_reason() -> None:
    keys = {*reasons._CODES.values(), *reasons._LIMITS.values()}
    assert keys <= set(reasons.REASONS)
    assert len(keys) == len(Code) + len(Limit) - 1


def seen(rig: Rig, reason: str) -> DiagnosticStatus:
    """Wait for a reason on the topic and check the status' level."""
    status = rig.until_new("status", lambda s: reason in values_of(s)["reasons"].split(", "), f"the reason {reason}")
    given = values_of(status)["reasons"].split(", ")
    assert status.level[0] == reasons.level_of(given)
    return status


def joints(*position: float) -> JointState:
    return JointState(name=JOINTS, position=list(position))


def twist(x: float = 0.0, z: float = 0.0) -> TwistStamped:
    message = TwistStamped()
    message.header.frame_id = "panda_link0"
    message.twist.linear.x, message.twist.linear.z = x, z
    return message


@pytest.fixture
def home(live: Rig) -> Iterator[Rig]:
    """The arm at home and at rest; parameters as they were afterwards."""
    with live.sending("target_joints", joints(*HOME)):
        live.until_new("joint_commands", lambda c: np.abs(np.array(c.position) - HOME).max() < 1e-3, "the arm at home")
    live.until_status("holding")
    yield live
    live.set_parameters(velocity_scale=1.0, acceleration_scale=1.0)


def test_tracking_velocity_limit_stopping_and_holding(home: Rig) -> None:
    assert home.set_parameters(velocity_scale=0.02).successful
    with home.sending("target_joints", joints(0.5, *HOME[1:])):
        status = seen(home, "velocity limit")
        assert values_of(status)["joint"] == "panda_joint1"
        assert "panda_joint1" in status.message
        seen(home, "tracking")
    assert home.set_parameters(velocity_scale=1.0, acceleration_scale=0.02).successful
    with home.sending("target_twist", twist(z=0.2)):
        seen(home, "acceleration limit")
        seen(home, "tracking")
    seen(home, "stopping")
    assert home.set_parameters(acceleration_scale=1.0).successful
    assert "the last came" in seen(home, "holding").message


def test_position_limit(home: Rig) -> None:
    with home.sending("target_joints", joints(3.5, *HOME[1:])):
        assert values_of(seen(home, "position limit"))["joint"] == "panda_joint1"


def test_singular(home: Rig) -> None:
    with home.sending("target_twist", twist(x=0.3)):
        assert "singularity" in seen(home, "singular").message


def test_rejected_is_said_while_it_is_new(home: Rig) -> None:
    pose = PoseStamped()
    pose.header.frame_id = "map"
    with home.sending("target_pose", pose):
        status = seen(home, "rejected")
        assert "holding: no live target" in status.message
        assert "target_pose: frame_id 'map'" in status.message
    home.until_new("status", lambda s: "rejected" not in values_of(s)["reasons"], "the reason to go")


def test_recording_that_cannot_go_on(home: Rig) -> None:
    """The node's files may not grow any more: as with a full disk."""
    pid = home.node.popen.pid
    whole = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (4096, whole[1]))
    try:
        status = seen(home, "recording")
    finally:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, whole)
    assert "recording interrupted" in status.message
    home.until_new("status", lambda s: values_of(s)["recorder"] == "recording", "the recording to go on")


def test_late(home: Rig) -> None:
    """A process that is stopped for a moment begins its cycles late."""
    import signal
    import time

    def stopped() -> bool:
        home.node.send(signal.SIGSTOP)
        time.sleep(0.03)
        home.node.send(signal.SIGCONT)
        home.listen()
        return bool(home.heard["status"]) and "late" in values_of(home.heard["status"][-1])["reasons"].split(", ")

    home.until(stopped, "the reason late")
