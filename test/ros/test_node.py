"""One run of the main job over DDS, watched by an independent subscriber: start, follow, hold, Ctrl-C while moving."""

from __future__ import annotations

import signal
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from mcap_ros2.reader import read_ros2_messages
from published import assert_limits_hold, recorded, restarts_of, stamp, table
from rig import CLI, Process, Rig, figure_bag, values_of
from rosbags.highlevel import AnyReader

from ik_controller.recording.reader import open_bag
from ik_controller.recording.replay import replay
from ik_controller.recording.run import RunInfo
from ik_controller.robots import build_model, bundled_parameters

RATE = 250.0
PERIOD = 4_000_000  # [ns]


class Run(NamedTuple):
    rig: Rig
    model: Any
    node: Process
    commands: list[Any]  # all that it sent, from the bag: a listener that is held up itself misses some
    moving_until: int  # stamp of a command when the stop was asked for
    streamed: int  # when the targets began [ns]
    held: Any  # the status when they had ended
    bag: Path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    folder = tmp_path_factory.mktemp("run")
    targets = figure_bag(folder / "targets", 2.5)
    rig = Rig(folder)
    try:
        node = rig.start_node(robot="panda", rate=RATE)
        rig.until_status("waiting for the first joint state")
        rig.start_sim("--rate", "250", "--start", "0.05", "-0.7", "0", "-2.3", "0", "1.6", "0.8")
        rig.until_status("holding")
        for _ in range(5):  # where the machine holds the arm or its node up, there is nothing to see
            streamed, first = time.time_ns(), len(rig.heard["status"]) - 1
            assert rig.run_cli("stream", str(targets)).wait() == 0
            held = rig.until_status("holding")
            seen = [values_of(status) for status in rig.heard["status"][first:]]
            if len({values["stalls"] for values in seen}) == 1 and "no_feedback" not in {v["state"] for v in seen}:
                break
        again = rig.start("stream", [*CLI, "stream", str(targets), "--loop"])
        rig.until_new("joint_commands", lambda c: np.abs(c.velocity).max() > 0.1, "the arm to move")
        moving_until = stamp(rig.heard["joint_commands"][-1])
        node.send(signal.SIGINT)
        assert node.wait() == 0, node.err
        again.send(signal.SIGINT)
        assert again.wait() == 0, again.err
        rig.listen()
        (bag,) = rig.bags()
        commands = recorded(bag, "/joint_commands")
        yield Run(rig, build_model(bundled_parameters("panda")), node, commands, moving_until, streamed, held, bag)
    finally:
        rig.close()


def test_the_first_command_is_the_measured_position(run: Run) -> None:
    first, state = run.commands[0], recorded(run.bag, "/joint_states")[0]
    assert list(first.position) == list(state.position)
    assert not np.any(first.velocity)


def test_commands_carry_the_models_joints_with_position_and_velocity(run: Run) -> None:
    for command in run.rig.heard["joint_commands"]:
        assert tuple(command.name) == run.model.joint_names
        assert len(command.position) == len(command.velocity) == run.model.n
        assert len(command.effort) == 0


def test_limits_hold_in_the_published_stream_also_in_the_last_stop(run: Run) -> None:
    assert_limits_hold(run.commands, run.model, PERIOD, restarts_of(run.bag))
    last = run.commands[-1]
    assert not np.any(last.velocity)
    (then,) = (command for command in run.commands if stamp(command) == run.moving_until)
    assert stamp(last) > stamp(then)
    assert list(last.position) != list(then.position)


def test_the_arm_follows_the_poses_it_was_sent(run: Run) -> None:
    stamps, q, _ = table(run.commands)
    targets = [target for target in recorded(run.bag, "/ik_controller/target_pose") if stamp(target) > run.streamed]
    begin, gaps = stamp(targets[0]), []
    for target in targets:
        # One second in, the way to the figure has been made; 2.5 s in, the targets end.
        if begin + 1_000_000_000 < stamp(target) < begin + 2_300_000_000:
            index = int(np.searchsorted(stamps, stamp(target)))
            share = (stamp(target) - stamps[index - 1]) / (stamps[index] - stamps[index - 1])
            tool = run.model.forward((1.0 - share) * q[index - 1] + share * q[index])
            gap = pin.XYZQUATToSE3(pose_of(target.pose)).actInv(tool)
            gaps.append((np.linalg.norm(gap.translation), np.linalg.norm(pin.log3(gap.rotation))))
    assert len(gaps) > 50
    position, rotation = np.median(np.array(gaps), axis=0)  # a held-up machine may lose some targets
    assert position < 2e-4
    assert rotation < 5e-4


def pose_of(pose: Any) -> np.ndarray:
    p, o = pose.position, pose.orientation
    return np.array([p.x, p.y, p.z, o.x, o.y, o.z, o.w])


def test_after_the_last_target_the_arm_holds(run: Run) -> None:
    assert run.held.message.startswith("holding: no live target")
    busy = "late" in values_of(run.held)["reasons"]  # the machine, not the node
    assert run.held.level == (b"\x01" if busy else b"\x00")
    assert float(values_of(run.held)["target_age_s"]) > 0.1


def test_current_pose_is_that_of_the_measured_joints(run: Run) -> None:
    states = recorded(run.bag, "/joint_states")
    measured = np.array([run.model.forward(np.array(state.position)).translation for state in states])
    poses = run.rig.heard["current_pose"]
    assert len(poses) > 100
    for message in poses[:: len(poses) // 50]:
        assert message.header.frame_id == "panda_link0"
        assert np.abs(measured - pose_of(message.pose)[:3]).max(axis=1).min() < 1e-12


def test_tracking_error_is_target_minus_tool_in_the_base_frame(run: Run) -> None:
    stamps, q, _ = table(run.commands)
    targets = recorded(run.bag, "/ik_controller/target_pose")
    times = np.array([stamp(target) for target in targets])
    places = np.array([pose_of(target.pose)[:3] for target in targets])
    gaps, sizes = [], []
    for message in run.rig.heard["tracking_error"]:
        assert message.header.frame_id == "panda_link0"
        error = message.twist.linear
        error = np.array([error.x, error.y, error.z])
        index = int(np.searchsorted(stamps, stamp(message)))
        follows = int(np.searchsorted(times, stamp(message)))
        if error.any() and 0 < follows < len(times) and index < len(stamps) and stamps[index] == stamp(message):
            reference = np.array([np.interp(stamp(message), times, places[:, axis]) for axis in range(3)])
            gaps.append(np.linalg.norm(run.model.forward(q[index]).translation + error - reference))
            sizes.append(np.linalg.norm(error))
    assert max(sizes) > 0.01  # the way to the figure
    assert np.median(gaps) < 2e-4


def test_status_and_diagnostics(run: Run) -> None:
    assert {"state", "rejected", "period_p99_us", "missed", "recorded_messages"} <= set(values_of(run.held))
    for status in run.rig.heard["status"]:
        assert status.name == "ik_controller"
        assert status.hardware_id == "panda"
        assert len(status.message) > 5
        assert isinstance(status.level, bytes)
    states = {values_of(status)["state"] for status in run.rig.heard["status"]}
    assert {"waiting", "holding", "tracking"} <= states
    array = run.rig.heard["diagnostics"][-1]
    assert stamp(array) > 10**18
    assert [status.name for status in array.status] == ["ik_controller"]
    assert any(array.status[0].values == status.values for status in run.rig.heard["status"])


def test_the_bag_is_sealed_and_holds_the_run_that_was_published(run: Run) -> None:
    bag = open_bag(run.bag)
    assert bag.complete
    info = RunInfo.of(bag)
    assert info is not None
    assert info.parameters.rate == RATE
    assert info.parameters.robot == "panda"
    assert {"numpy", "pin", "python", "processor", "ik_controller"} <= set(info.software)
    assert "<robot" in info.urdf
    heard = run.rig.heard["joint_commands"]
    written = {stamp(c): c for c in run.commands}
    assert len(heard) > 100
    assert len(written) == len(run.commands)
    for field in ("position", "velocity"):
        same = [getattr(written[stamp(c)], field) for c in heard]
        np.testing.assert_array_equal([getattr(c, field) for c in heard], same)


def test_every_reader_finds_the_same_messages(run: Run) -> None:
    with AnyReader([run.bag]) as reader:
        theirs = Counter(c.topic for c, _, data in reader.messages() if reader.deserialize(data, c.msgtype) is not None)
    (file,) = run.bag.glob("*.mcap")
    others = Counter(message.channel.topic for message in read_ros2_messages(str(file)))
    ours = Counter(message.topic for message in open_bag(run.bag).messages())
    assert theirs == others == ours
    for topic in ("/joint_states", "/joint_commands", "/robot_description", "/ik_controller/target_pose",
                  "/ik_controller/target_twist", "/ik_controller/status", "/ik_controller/cycle"):  # fmt: skip
        assert ours[topic] > 0


def test_the_run_replays_bit_identically(run: Run) -> None:
    result = replay(open_bag(run.bag))
    assert (result.identical, result.first_difference, result.max_difference) == (True, None, 0.0)
    assert result.commands == len(run.commands)
    assert result.software == {}
    assert result.errors.count > 500
