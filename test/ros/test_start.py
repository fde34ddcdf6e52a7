"""Mistakes at the start of the node: exit code 2 and one line on stderr that names the thing and the legal choices."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from rig import NODE, ROOT, Rig, environment, next_domain, values_of

from ik_controller.ros.process import main

PANDA = ["-p", "robot:=panda"]
URDF = str(ROOT / "config" / "panda" / "robot.urdf")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder to run the node in, in this process; signal handlers are put back."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(next_domain()))
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield tmp_path
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["-p", "robot:=pandabear"], ["pandabear", "panda", "ur5e"]),
        (["-p", "urdf:=no_such.urdf", "-p", "tip_frame:=tool"], ["no_such.urdf"]),
        (["-p", "urdf:=malformed.urdf", "-p", "tip_frame:=tool"], ["malformed.urdf"]),
        (["-p", f"urdf:={URDF}"], ["tip_frame"]),
        (["-p", f"urdf:={URDF}", "-p", "tip_frame:=tool"], ["'tool'", "panda_hand_tcp"]),
        ([*PANDA, "-p", "base_frame:=world"], ["'world'", "panda_link0"]),
        ([*PANDA, "-p", "rate:=5000"], ["rate", "1000", "Hz"]),
        ([*PANDA, "-p", "gain:=[1.0, 2.0]"], ["gain", "1 or 6 or 36"]),
        ([*PANDA, "-p", "damping:=much"], ["damping", "number"]),
        ([*PANDA, "-p", "posture:=[0.0]"], ["posture", "panda_joint1"]),
        ([*PANDA, "-p", "velocity_limits:=[1.0]"], ["velocity", "7"]),
        ([*PANDA, "-p", "dampings:=1.0"], ["'dampings'", "damping"]),
        ([*PANDA, "--params-file", "no_such.yaml"], ["no_such.yaml"]),
        ([*PANDA, "--params-file", "malformed.yaml"], ["malformed.yaml"]),
        (["-p", "robot"], ["robot"]),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(
    here: Path, capfd: pytest.CaptureFixture[str], arguments: list[str], named: list[str]
) -> None:
    (here / "malformed.urdf").write_text("<robot name='x'><link", encoding="utf-8")
    (here / "malformed.yaml").write_text("/**: [", encoding="utf-8")
    assert main(["ik_controller_node", "--ros-args", *arguments]) == 2
    (line,) = [line for line in capfd.readouterr().err.splitlines() if not line.startswith("[")]
    assert line.startswith("ik_controller_node: ")
    for name in named:
        assert name in line
    assert not (here / "runs").exists()


def test_a_folder_that_cannot_be_written_is_told_and_the_arm_still_runs(rig: Rig) -> None:
    (rig.folder / "file").write_text("no folder")
    node = rig.start_node(robot="panda", rate=200.0, record_folder=str(rig.folder / "file"))
    rig.until_status("waiting for the first joint state; nobody publishes on /joint_states")
    assert "not recording" in node.err
    status = rig.until_status("not recording: cannot record below ")
    assert values_of(status)["recorder"] == "interrupted"
    assert "recording" in values_of(status)["reasons"].split(", ")
    assert not rig.call("record", True).success
    (rig.folder / "file").unlink()
    status = rig.until_new("status", lambda s: values_of(s)["recorder"] == "recording", "it to record by itself")
    assert "recording" not in values_of(status)["reasons"].split(", ")
    assert values_of(status)["bag"].startswith(str(rig.folder / "file"))
    node.send(signal.SIGINT)
    assert node.wait() == 0, node.err


def test_the_process_says_it_too(tmp_path: Path) -> None:
    command = [*NODE, "--ros-args", "-p", "robot:=pandabear"]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env=environment(next_domain()), timeout=180, check=False
    )
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert "pandabear" in line
    assert "ur5e" in line


def test_a_malformed_description_from_the_topic_is_told(rig: Rig) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import String

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = rig._listener.create_publisher(String, "/robot_description", latched)
    publisher.publish(String(data="<robot"))
    node = rig.start_node(tip_frame="tool")
    assert node.wait() == 2
    line = node.err.splitlines()[-1]
    assert line.startswith("ik_controller_node: ")
    assert "Traceback" not in node.err
