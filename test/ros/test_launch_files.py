"""The launch files: what they ask for exists, and what each starts does its work over DDS.

Started twice: by `ros2 launch` where ROS's own packages are installed, and by the command lines that it would make.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from launch_files import EXECUTABLES, described
from published import recorded, table
from rclpy.qos import DurabilityPolicy, QoSProfile
from rig import CLI, ROOT, Process, Rig, figure_bag
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from test_bad_input import twist
from test_services import replayed
from trajectory_msgs.msg import JointTrajectory

from ik_controller.parameters import ControllerParameters
from ik_controller.robots import bundled_parameters
from ik_controller.share import robot_names

FILES = sorted(file.name.removesuffix(".launch.py") for file in (ROOT / "launch").glob("*.launch.py"))
ROS2 = [sys.executable, "-c", "import sys; from ros2cli.cli import main; sys.exit(main())"]
Start = Callable[..., Sequence[Process]]


def documented() -> list[str]:
    """Return the command lines with `ros2 launch` in the documentation and the files themselves."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "launch").glob("*.py"))]
    return [line for page in pages for line in re.findall(r"^ros2 launch .*$", page.read_text(encoding="utf-8"), re.M)]


@pytest.fixture(params=["as described", "ros2 launch"])
def start(request: pytest.FixtureRequest, rig: Rig, monkeypatch: pytest.MonkeyPatch) -> Start:
    """A function that starts a launch file with arguments; its processes, the one that ends all of them first."""
    if request.param == "as described":

        def start(file: str, /, **arguments: str) -> Sequence[Process]:
            description = described(file, **arguments)
            started = [rig.start(file, command) for command in description.commands]
            return [started.pop(description.last), *started]

        return start

    pytest.importorskip("ros2launch")
    # A checkout is no ROS package; this is one, as colcon's --symlink-install lays it.
    prefix = rig.folder / "prefix"
    index, programs = prefix / "share" / "ament_index" / "resource_index" / "packages", prefix / "lib" / "ik_controller"
    for folder in (index, programs):
        folder.mkdir(parents=True)
    (index / "ik_controller").touch()
    (prefix / "share" / "ik_controller").symlink_to(ROOT)
    for name, command in EXECUTABLES.items():
        (programs / name).write_text(f'#!/bin/sh\nexec {shlex.join(command)} "$@"\n', encoding="utf-8")
        (programs / name).chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join([str(prefix), os.environ["AMENT_PREFIX_PATH"]]))
    monkeypatch.setenv("ROS_LOG_DIR", str(rig.folder / "log"))

    def launch(file: str, /, **arguments: str) -> Sequence[Process]:
        given = [f"{key}:={value}" for key, value in arguments.items()]
        return [rig.start("launch", [*ROS2, "launch", "ik_controller", f"{file}.launch.py", *given])]

    return launch


def end(processes: Sequence[Process]) -> None:
    """End them as Ctrl-C does; every one ends by itself and well."""
    for process in processes:
        process.send(signal.SIGINT)
    for process in processes:
        assert process.wait() == 0, process.out + process.err
        assert "Traceback" not in process.out + process.err
        assert "process has died" not in process.out + process.err  # launch's words


@pytest.mark.parametrize("name", FILES)
def test_every_argument_is_described(name: str) -> None:
    said = described(name).help
    assert said
    assert all(text.endswith(".") and len(text) > 10 for text in said.values())


@pytest.mark.parametrize("robot", robot_names())
def test_the_files_that_demo_names_exist(robot: str) -> None:
    for view in ("false", "true"):
        for command in described("demo", robot=robot, view=view).commands:
            for word in command:
                assert not word.startswith(str(ROOT)) or Path(word).exists(), word


def test_arms_arguments_are_parameters_of_the_node_and_those_of_servo_too() -> None:
    own = {"params_file", "name", "namespace", "joint_states", "robot_description"}
    arguments = set(described("arm").help)
    assert arguments - own - {"use_sim_time"} <= set(ControllerParameters.__dataclass_fields__)
    assert set(described("servo").help) == arguments | {"servo_name"}


@pytest.mark.parametrize("line", documented())
def test_documented_lines_have_arguments_that_exist(line: str) -> None:
    _, _, package, file, *given = shlex.split(line, comments=True)
    assert package == "ik_controller"
    assert described(file.removesuffix(".launch.py"), **dict(word.split(":=") for word in given)).commands


def test_demo_follows_its_targets_and_ends(rig: Rig, start: Start) -> None:
    # A node that gets no processor for a second takes in the targets of that second at once, and then the order to end.
    targets = str(figure_bag(rig.folder / "targets", 4.0))
    streamer, *others = start("demo", targets=targets, rate="250", namespace="cell")
    rig.until(lambda: streamer.popen.poll() is not None, "the targets to be sent")
    end([streamer, *others])
    (bag,) = rig.bags()
    result = replayed(bag)
    assert result.identical
    assert recorded(bag, "/cell/ik_controller/target_pose")
    stamps, q, _ = table(recorded(bag, "/cell/joint_commands"))
    assert set(np.diff(stamps) % 4_000_000) == {0}
    assert (q != q[0]).any()


def test_an_arm_by_its_drivers_topics(rig: Rig, start: Start) -> None:
    """Its model from a topic, its commands as the driver takes them; parameters by file and by argument."""
    rig.hear("commands", Float64MultiArray, "/driver/commands")
    rig.hear("driver", JointState, "/driver/joint_states")
    rig.start("driver", [*CLI, "sim", "--robot", "ur5e", "--rate", "200", "--ros-args", "-r",
                         "joint_states:=/driver/joint_states"])  # fmt: skip
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = rig._listener.create_publisher(String, "/driver/description", latched)
    publisher.publish(String(data=(ROOT / "config" / "ur5e" / "robot.urdf").read_text(encoding="utf-8")))
    file = rig.folder / "my_arm.yaml"
    file.write_text("/**: {ros__parameters: {gain: 20.0, rate: 500.0, record: false}}", encoding="utf-8")
    processes = start(
        "arm",
        params_file=str(file),
        tip_frame=bundled_parameters("ur5e").tip_frame,
        rate="100",
        command_output="position_array",
        command_topic="/driver/commands",
        joint_states="/driver/joint_states",
        robot_description="/driver/description",
        namespace="left",
        name="arm",
    )
    rig.until(lambda: rig.heard["commands"] and rig.heard["driver"], "commands, and the driver")
    np.testing.assert_allclose(rig.heard["commands"][0].data, rig.heard["driver"][0].position, atol=1e-3)
    names = ("gain", "rate", "record")
    assert [rig.get_parameter(name, "/left/arm") for name in names] == [[20.0], 100.0, False]
    end(processes)
    assert not rig.bags()


def test_in_servos_place(rig: Rig, start: Start) -> None:
    topic = "/panda_arm_controller/joint_trajectory"
    rig.hear("commands", JointTrajectory, topic)
    rig.start_sim("--rate", "100")
    processes = start("servo", robot="panda", rate="100", command_topic=topic, servo_name="my_servo")
    first = rig.until(lambda: rig.heard["commands"], "commands")[0]
    publisher = rig._listener.create_publisher(TwistStamped, "/my_servo/delta_twist_cmds", 10)
    message = twist(x=0.1)

    def moved() -> bool:
        publisher.publish(message)
        positions = rig.heard["commands"][-1].points[0].positions
        return max(abs(a - b) for a, b in zip(positions, first.points[0].positions, strict=True)) > 0.02

    rig.until(moved, "the arm to move")
    end(processes)
    (bag,) = rig.bags()
    assert replayed(bag).identical
