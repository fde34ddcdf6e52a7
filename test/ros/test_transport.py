"""What the processes talk over: not through shared memory, in whatever range, unless somebody chose it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from rig import CLI, NODE, PATIENCE, next_domain

from ik_controller.ros.transport import over_udp

UDP = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
CHOICES = ("FASTDDS_BUILTIN_TRANSPORTS", "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE")
# A process that knows nothing of this package, with all transports that rmw_fastrtps gives it.
STRANGER = """
import sys, rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
rclpy.init()
node, heard = Node("stranger"), set()
node.create_subscription(JointState, "joint_states", lambda m: heard.add("joint_states"), 10)
node.create_subscription(JointState, "joint_commands", lambda m: heard.add("joint_commands"), 10)
while len(heard) < 2:
    rclpy.spin_once(node)
print("heard both", flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, UDP),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_LOCALHOST_ONLY": "0"}, UDP),
        ({"RMW_IMPLEMENTATION": "rmw_fastrtps_dynamic_cpp"}, UDP),
        ({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", "ROS_LOCALHOST_ONLY": "1"}, {}),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "SHM"}, {}),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {}),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.2"}, {}),
    ],
)
def test_a_choice_of_somebody_stays(environment: dict[str, str], expected: dict[str, str], tmp_path: Path) -> None:
    assert over_udp(environment, tmp_path) == expected
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").touch()
    assert over_udp(environment, tmp_path) == {}


@pytest.mark.parametrize("near", [{"ROS_AUTOMATIC_DISCOVERY_RANGE": "localhost"}, {"ROS_LOCALHOST_ONLY": "1"}])
def test_what_keeps_to_this_host_still_does(near: dict[str, str], tmp_path: Path) -> None:
    changes = over_udp(near, tmp_path)
    assert changes["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
    assert changes.get("ROS_LOCALHOST_ONLY", "") != near.get("ROS_LOCALHOST_ONLY")  # rcl warns of it whenever it is set
    assert "<address>127.0.0.1</address>" in Path(changes["FASTRTPS_DEFAULT_PROFILES_FILE"]).read_text()
    assert over_udp({**near, **changes}, tmp_path) == {}  # as a child process finds it


class Started:
    """Processes with the transports of a plain installation, ended with the test."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._domain = folder, str(next_domain())
        self.running: list[subprocess.Popen[bytes]] = []

    def start(self, command: list[str], **environment: str) -> subprocess.Popen[bytes]:
        plain = {name: value for name, value in os.environ.items() if name not in CHOICES}
        process = subprocess.Popen(
            command,
            env={**plain, "ROS_DOMAIN_ID": self._domain, **environment},
            cwd=self._folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self.running.append(process)
        return process


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Started]:
    started = Started(tmp_path)
    yield started
    for process in started.running:
        process.kill()
        process.communicate()


def uses_shared_memory(process: subprocess.Popen[bytes]) -> bool:
    """Tell whether Fast DDS has mapped any of its segments, once it takes part in the graph."""
    deadline = time.monotonic() + PATIENCE
    while True:
        threads = {task.read_text().strip() for task in Path(f"/proc/{process.pid}/task").glob("*/comm")}
        if any(name.startswith("dds.udp") for name in threads):
            return "/dev/shm/fastrtps_" in Path(f"/proc/{process.pid}/maps").read_text()
        assert process.poll() is None
        assert time.monotonic() < deadline, threads
        time.sleep(0.05)


def test_arm_and_node_leave_shared_memory_to_others_and_are_heard_by_them(started: Started) -> None:
    sim, node = (
        started.start(command, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        for command in ([*CLI, "sim"], [*NODE, "--ros-args", "-p", "robot:=panda", "-p", "record:=false"])
    )
    stranger = started.start([sys.executable, "-c", STRANGER], ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    assert stranger.stdout is not None
    assert stranger.stdout.readline() == b"heard both\n"
    assert [uses_shared_memory(process) for process in (sim, node, stranger)] == [False, False, True]


def test_without_a_range_too_and_whoever_wants_it_has_it(started: Started) -> None:
    plain = started.start([*CLI, "sim"], ROS_AUTOMATIC_DISCOVERY_RANGE="OFF")
    wanted = started.start([*CLI, "sim"], ROS_AUTOMATIC_DISCOVERY_RANGE="OFF", FASTDDS_BUILTIN_TRANSPORTS="DEFAULT")
    assert [uses_shared_memory(process) for process in (plain, wanted)] == [False, True]
