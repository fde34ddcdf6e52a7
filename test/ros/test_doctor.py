"""The doctor looks at a running graph: a healthy one, and one with every mistake that it knows."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rig import CLI, ROOT, Rig, environment, next_domain
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from ik_controller.cli import main

JOINTS = [f"panda_joint{i}" for i in range(1, 8)]
HOME = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]


LOOKS = (2, 4, 8, 16, 32)  # [s]; on a busy machine it takes a longer one to see all that is there
Findings = list[tuple[str, str]]  # (level, "subject: message")


def doctor(
    rig: Rig, *arguments: str, seen: Callable[[Findings], bool], meanwhile: Callable[[], None] = lambda: None
) -> tuple[int, Findings]:
    """Run the doctor, longer each time, until it has seen what is there; return its exit code and findings.

    Something is done meanwhile.
    """

    def ended() -> bool:
        meanwhile()
        return process.popen.poll() is not None

    for seconds in LOOKS:
        process = rig.start("doctor", [*CLI, "doctor", "--json", "--seconds", str(seconds), *arguments])
        rig.until(ended, "the doctor to end")
        answer = json.loads(process.out)
        assert all(set(finding) == {"level", "subject", "message", "remedy"} for finding in answer["findings"])
        assert all(finding["remedy"] for finding in answer["findings"] if finding["level"] != "ok")
        assert answer["ok"] == (process.wait() == 0)
        findings = [(f["level"], f"{f['subject']}: {f['message']}") for f in answer["findings"]]
        if seen(findings):
            return process.wait(), findings
    raise AssertionError(findings)


def all_of(expected: Findings) -> Callable[[Findings], bool]:
    """Say whether each of these, levels and parts of the text, is among the findings."""
    return lambda findings: all(any(at == level and text in said for at, said in findings) for level, text in expected)


BUSY = ("began late", "no joint state", "a message every")


def test_a_healthy_arm(rig: Rig) -> None:
    rig.start_sim("--rate", "200")
    rig.start_node(robot="panda", rate=100.0)
    rig.until_status("holding")

    def healthy(findings: Findings) -> bool:
        """A busy machine makes the node late, or the arm, and the doctor says so; nothing else is amiss."""
        amiss = [text for level, text in findings if level != "ok"]
        alone = any("nothing live was checked" in text for _, text in findings)
        return not alone and all(any(word in text for word in BUSY) for text in amiss)

    code, findings = doctor(rig, seen=healthy)
    assert code == (1 if any(level != "ok" for level, _ in findings) else 0)


def test_nobody_there(tmp_path: Path) -> None:
    command = [*CLI, "doctor", "--json", "--seconds", "1"]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env=environment(next_domain()), timeout=180, check=False
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["ok"]
    assert any("nothing live was checked" in finding["message"] for finding in answer["findings"])


def test_frames_the_wrong_way_round(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    urdf = ROOT / "config" / "panda" / "robot.urdf"
    frames = ["--tip", "panda_link0", "--base", "panda_hand_tcp"]
    assert main(["doctor", "--offline", "--json", "--urdf", str(urdf), *frames]) == 1
    (finding,) = [f for f in json.loads(capsys.readouterr().out)["findings"] if f["level"] == "error"]
    assert finding["remedy"] == "swap tip_frame and base_frame"


def test_everything_is_wrong(rig: Rig) -> None:
    """No controller; two drivers at odds; an unsure clock; targets in an unknown frame; a publisher nobody can hear."""
    other = Node("other", context=rig.context, enable_rosout=False)
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    states = [node.create_publisher(JointState, "/joint_states", 10) for node in (rig._listener, other)]
    commands = other.create_publisher(JointState, "/joint_commands", best_effort)  # the rig listens reliably
    poses = other.create_publisher(PoseStamped, "/ik_controller/target_pose", 10)
    other.create_publisher(String, "/ik_controller/target_twist", 10)
    last = 0.0

    def send() -> None:
        nonlocal last
        if time.monotonic() - last < 0.3:
            return
        last = time.monotonic()
        state = JointState(name=JOINTS, position=[9.0, *HOME[1:6], float("nan")])
        state.header.stamp.sec = int(time.time()) - 60
        for publisher in states:
            publisher.publish(state)
        commands.publish(state)
        pose = PoseStamped()
        pose.header.frame_id = "map"
        poses.publish(pose)

    expected = [
        ("error", "topic /joint_states: 2 publishers send the same joints: /other, /test_listener"),
        ("warning", "topic /joint_states: joint 'panda_joint1' is at 9, outside its limits"),
        ("error", "topic /joint_states: joint 'panda_joint7' is at nan"),
        ("warning", "topic /joint_states: stamps are 60"),
        ("warning", "and feedback_timeout is 0.1 s"),
        ("error", "topic /joint_commands: /test_listener cannot hear /other"),
        ("warning", "topic /ik_controller/target_pose: frame_id 'map' is no link of the robot"),
        ("warning", "topic /ik_controller/target_pose: the stamp is 0"),
        ("warning", "and command_timeout is 0.1 s"),
        ("error", "topic /ik_controller/target_twist: /other sends std_msgs/msg/String, taken is geom"),
        ("ok", "node: the node '/ik_controller' is not running"),
    ]
    code, _ = doctor(rig, "--robot", "panda", seen=all_of(expected), meanwhile=send)
    other.destroy_node()
    assert code == 1


@pytest.mark.parametrize("described", [True, False])
def test_the_robot_of_the_topic(rig: Rig, described: bool) -> None:
    """Frames in the parameter file, URDF by topic; a driver with other joints, or without one."""
    file = rig.folder / "parameters.yaml"
    file.write_text("/left/arm: {ros__parameters: {tip_frame: panda_hand_tcp, gain: 900.0}}", encoding="utf-8")
    urdf = (ROOT / "config" / "panda" / "robot.urdf").read_text(encoding="utf-8")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    description = rig._listener.create_publisher(String, "/left/robot_description", latched)
    if described:
        description.publish(String(data=urdf))
    else:
        rig._listener.destroy_publisher(description)
    publisher = rig._listener.create_publisher(JointState, "/left/joint_states", 10)
    names = JOINTS[:6] if described else ["elbow"]

    def send() -> None:
        publisher.publish(JointState(name=names, position=HOME[: len(names)]))

    expected = [("ok", "robot: 7 joints"), ("warning", "gain / rate is 0.90"),
                           ("error", "topic /left/joint_states: joints are missing: panda_joint7")]  # fmt: skip
    if not described:
        expected = [("error", "robot: neither the parameters nor a topic robot_description name a URDF"),
                    ("error", "topic /left/robot_description: nobody publishes the robot's URDF")]  # fmt: skip
    code, _ = doctor(rig, "--params", str(file), "--node", "/left/arm", seen=all_of(expected), meanwhile=send)
    assert code == 1
