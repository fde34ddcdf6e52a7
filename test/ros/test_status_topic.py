"""Every reason of the status' table is provoked and seen on ~/status, with its level and with words that tell."""

from __future__ import annotations

import math
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from faulty_node import MAD
from geometry_msgs.msg import PoseStamped, Transform, Twist, TwistStamped
from rig import NODE, Rig, values_of
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from ik_controller.control.status import Code, Limit
from ik_controller.ros import reasons
from ik_controller.ros.reasons import REASONS

HOME = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
JOINTS = [f"panda_joint{i}" for i in range(1, 8)]
JERK = "[7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0]"
PLAIN = {
    "velocity_scale": 1.0,
    "acceleration_scale": 1.0,
    "jerk_scale": 1.0,
    "tool_linear_speed": 0.0,
    "tool_linear_acceleration": 0.0,
    "posture_gain": 1.0,
    "transform_timeout": 0.0,
    "goal_time": 0.05,
}

Provocation = Callable[[Rig], AbstractContextManager[tuple[str, str]]]
PROVOKED: dict[str, Provocation] = {}


def provokes(reason: str) -> Callable[[Callable[[Rig], Iterator[tuple[str, str]]]], None]:
    """Register what brings a reason about while its block lasts; it yields words of the message and who tells it."""

    def register(function: Callable[[Rig], Iterator[tuple[str, str]]]) -> None:
        PROVOKED[reason] = contextmanager(function)

    return register


def test_every_code_and_limit_has_a_reason_and_every_reason_a_provocation() -> None:
    keys = {*reasons._CODES.values(), *reasons._LIMITS.values()}
    assert keys <= set(REASONS)
    assert len(keys) == len(Code) + len(Limit) - 1
    assert set(PROVOKED) == set(REASONS)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """An arm with every kind of limit, at 250 Hz; and a second node, "bystander", that waits for a clock."""
    with closing(Rig(tmp_path_factory.mktemp("cell"))) as made:
        made.hear("bystander", DiagnosticStatus, "/bystander/status")
        apart = ["-r", "__node:=bystander", "-r", "joint_commands:=elsewhere", "-p", "record:=false"]
        made.start("bystander", [*NODE, "--ros-args", *apart, "-p", "robot:=panda", "-p", "use_sim_time:=true"])
        made.sim = made.start_sim("--rate", "500")
        command = [sys.executable, str(Path(__file__).parent / "faulty_node.py"), *NODE[3:]]
        settings = {
            **PLAIN,
            "robot": "panda",
            "rate": 250.0,
            "jerk_limits": JERK,
            "record_folder": made.folder / "runs",
        }
        settings |= {"self_collision": "true", "obstacle_avoidance": "true"}
        given = [part for name, value in settings.items() for part in ("-p", f"{name}:={value}")]
        made.node = made.start("node", [*command, "--ros-args", *given])
        made.until_status("holding")
        yield made


@pytest.fixture
def home(cell: Rig) -> Iterator[Rig]:
    """The arm at home and at rest; parameters as they were afterwards."""
    cell.listen()
    if np.abs(np.array(cell.heard["joint_commands"][-1].position) - HOME).max() > 1e-3:
        with cell.sending("target_joints", joints(*HOME)):
            cell.until_new(
                "joint_commands", lambda c: np.abs(np.array(c.position) - HOME).max() < 1e-3, "the arm at home"
            )
    cell.until_status("holding")
    yield cell
    assert cell.set_parameters(**PLAIN).successful


@pytest.mark.parametrize("reason", REASONS)
def test_a_reason_is_seen_with_its_level_and_words_that_tell(home: Rig, reason: str) -> None:
    before = len(home.heard["status"])
    with PROVOKED[reason](home) as (words, role):
        begin = before if role == "status" else 0

        def told() -> DiagnosticStatus | None:
            for status in home.heard[role][begin:]:
                if reason in given(status) and words in status.message:
                    return status
            return None

        status = home.until(told, f"the reason {reason}, and the words '{words}'")
    assert status.level[0] == reasons.level_of(given(status)) >= REASONS[reason].level
    assert REASONS[reason].remedy in values_of(status)["what_to_do"]


def given(status: DiagnosticStatus) -> list[str]:
    return values_of(status)["reasons"].split(", ")


# -- messages


def joints(*position: float) -> JointState:
    return JointState(name=JOINTS, position=list(position))


def twist(x: float = 0.0, z: float = 0.0) -> TwistStamped:
    message = TwistStamped()
    message.header.frame_id = "panda_link0"
    message.twist.linear.x, message.twist.linear.z = x, z
    return message


def pose(x: float, y: float, z: float, frame: str = "panda_link0", turn: float = 0.0) -> PoseStamped:
    """Return a pose with the tool pointing down, turned about the vertical by an angle [rad]."""
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y, message.pose.position.z = x, y, z
    message.pose.orientation.x, message.pose.orientation.y = math.cos(0.5 * turn), math.sin(0.5 * turn)
    message.pose.orientation.w = 0.0
    return message


# -- the state


@provokes("unconfigured")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    assert rig.change_state("deactivate")
    assert rig.change_state("cleanup")
    yield "waiting to be configured", "status"
    assert rig.change_state("configure")
    assert rig.change_state("activate")
    rig.until_status("holding")


@provokes("preparing")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    for change in ("deactivate", "cleanup", "configure"):
        assert rig.change_state(change)
    yield "getting the control loop ready", "status"
    assert rig.change_state("activate")
    rig.until_status("holding")


@provokes("inactive")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    assert rig.change_state("deactivate")
    yield "nothing is commanded until it is activated", "status"
    assert rig.change_state("activate")
    rig.until_status("holding")


@provokes("finalized")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    rig.until(lambda: any("clock" in given(status) for status in rig.heard["bystander"]), "the other node")
    assert rig.change_state("shutdown", "/bystander")
    yield "shut down", "bystander"


@provokes("waiting")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    assert rig.change_state("deactivate")
    with stopped(rig):
        assert rig.change_state("activate")
        yield "waiting for the first joint state", "status"
    rig.until_status("holding")


@provokes("holding")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    yield "no live target", "status"


@provokes("tracking")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    with rig.sending("target_joints", joints(0.1, *HOME[1:])):
        yield "tracking", "status"


@provokes("stopping")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    assert rig.set_parameters(acceleration_scale=0.02).successful
    with rig.sending("target_twist", twist(z=0.1)):
        rig.until_new("joint_commands", lambda c: np.abs(c.velocity).max() > 0.05, "the arm to move")
    yield "stopping", "status"
    rig.until_status("holding")


@provokes("paused")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    assert rig.call("pause", True).success
    yield "paused", "status"
    assert rig.call("pause", False).success
    rig.until_status("holding")


@provokes("no_feedback")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    with stopped(rig):
        yield "joint states have stopped: the arm is halted", "status"
    rig.until_status("holding")


@provokes("fault")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    assert rig.set_parameters(posture_gain=MAD).successful
    yield "the commanded position of joint 'panda_joint1' does not follow from its velocity; reset to go on", "status"
    assert rig.set_parameters(**PLAIN).successful
    rig.until_status("fault")  # it is latched
    assert rig.call("reset").success
    rig.until_status("holding")


# -- what holds it back


@provokes("velocity limit")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    assert rig.set_parameters(velocity_scale=0.02).successful
    with rig.sending("target_joints", joints(0.3, *HOME[1:])):
        yield "velocity limit of 'panda_joint1'", "status"


@provokes("acceleration limit")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    assert rig.set_parameters(acceleration_scale=0.02).successful
    with rig.sending("target_twist", twist(z=0.1)):
        yield "acceleration limit of 'panda_joint", "status"
    rig.until_status("holding")


@provokes("position limit")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    with rig.sending("target_joints", joints(*HOME[:6], 3.5)):
        yield "position limit of 'panda_joint7'", "status"


@provokes("jerk limit")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    """A twist that turns back three times a second, on joints that are slow to change their acceleration."""
    assert rig.set_parameters(jerk_scale=0.1).successful
    with rig.sending("target_twist", lambda: twist(z=0.1 if time.monotonic() // 0.3 % 2 else -0.1)):
        yield "jerk limit of 'panda_joint", "status"


@provokes("tool speed limit")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    assert rig.set_parameters(tool_linear_speed=0.02).successful
    with rig.sending("target_twist", twist(z=-0.1)):
        yield "the tool's speed limit", "status"


@provokes("tool acceleration limit")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    assert rig.set_parameters(tool_linear_acceleration=0.02).successful
    with rig.sending("target_twist", twist(z=-0.1)):
        yield "the tool's acceleration limit", "status"


@provokes("obstacle")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    crate = Marker(ns="crate", id=7, type=Marker.CUBE, action=Marker.ADD)
    crate.header.frame_id = "panda_link0"
    crate.pose.position.x, crate.pose.position.z = 0.31, 0.3
    crate.scale.x = crate.scale.y = crate.scale.z = 0.1
    with rig.sending("obstacles", MarkerArray(markers=[crate])), rig.sending("target_twist", twist(z=-0.1)):
        yield "an obstacle is near (panda_hand and crate/7", "status"
    crate.action = Marker.DELETEALL
    with rig.sending("obstacles", MarkerArray(markers=[crate])), rig.sending("target_joints", joints(*HOME)):
        rig.until_new("joint_commands", lambda c: np.abs(np.array(c.position) - HOME).max() < 1e-3, "the way back")


@provokes("self collision")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    with rig.sending("target_joints", joints(0.0, -1.5, 0.0, -3.05, 0.0, 0.0, 0.0)):
        yield "the arm is near itself (panda_", "status"


@provokes("infeasible")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    """Turned on and on, further than the wrist can: it slides along its joints' bounds."""
    begin = time.monotonic()
    with rig.sending("target_pose", lambda: pose(0.4, 0.0, 0.4, turn=-0.5 * (time.monotonic() - begin))):
        yield "the wanted direction cannot be kept", "status"


@provokes("out of reach")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    with rig.sending("target_pose", pose(0.9, 0.0, 0.3)):
        yield "at rest at the closest approach, ", "status"


@provokes("singular")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    with rig.sending("target_twist", twist(x=0.3)):
        yield "damped: cannot ", "status"


# -- what is amiss around it


@provokes("rejected")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    with rig.sending("target_pose", pose(0.4, 0.0, 0.4, frame="")):
        yield "target_pose: ", "status"
    rig.until_new("status", lambda s: "rejected" not in values_of(s)["reasons"], "the reason to go")


@provokes("publishers")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    rig.publisher("target_twist")
    second = rig._listener.create_publisher(TwistStamped, "/ik_controller/target_twist", 10)
    yield "target_twist: 2 publishers on /ik_controller/target_twist: ", "status"
    rig._listener.destroy_publisher(second)
    rig.until_new("status", lambda s: "publishers" not in values_of(s)["reasons"], "the reason to go")


@provokes("transform")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    assert rig.set_parameters(transform_timeout=10.0).successful
    with rig.sending("target_pose", pose(0.4, 0.0, 0.4, frame="lens")):
        yield "waiting for TF from 'lens' to 'panda_link0'", "status"
    assert rig.set_parameters(transform_timeout=0.0).successful
    rig.until_new("status", lambda s: "rejected" not in values_of(s)["reasons"], "the queue to be empty")


@provokes("goal missed")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    far = Transform()
    far.translation.x, far.rotation.x, far.rotation.w = 2.0, 1.0, 0.0
    point = MultiDOFJointTrajectoryPoint(transforms=[far], velocities=[Twist()])
    point.time_from_start.nanosec = 300_000_000
    message = MultiDOFJointTrajectory(points=[point])
    message.header.frame_id = "panda_link0"
    with rig.sending("target_trajectory", message, every=2.0):  # again: a hold-up of the process ends a trajectory
        yield "goal missed: ", "status"
    rig.publisher("target_twist").publish(twist())  # of zero: ends it


@provokes("clock")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    yield "the simulated time stands still", "bystander"


@provokes("held up")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    rig.node.send(signal.SIGSTOP)
    time.sleep(0.3)
    rig.node.send(signal.SIGCONT)
    yield "s and started again from the measured position", "status"


@provokes("late")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    """A process that is stopped for a moment, again and again, begins its cycles late."""
    ended = threading.Event()

    def disturb() -> None:
        while not ended.wait(0.03):
            rig.node.send(signal.SIGSTOP)
            time.sleep(0.03)
            rig.node.send(signal.SIGCONT)

    thread = threading.Thread(target=disturb)
    thread.start()
    try:
        yield "began late", "status"
    finally:
        ended.set()
        thread.join()


@provokes("recording")
def _(rig: Rig) -> Iterator[tuple[str, str]]:
    """The node's files may not grow any more: as with a full disk."""
    pid = rig.node.popen.pid
    whole = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (4096, whole[1]))
    try:
        yield "recording interrupted", "status"
    finally:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, whole)
    rig.until_new("status", lambda s: values_of(s)["recorder"] == "recording", "the recording to go on")


# -- what several of them need


@contextmanager
def stopped(rig: Rig) -> Iterator[None]:
    """The arm's driver says nothing."""
    rig.sim.send(signal.SIGSTOP)
    try:
        yield
    finally:
        rig.sim.send(signal.SIGCONT)
