"""Cycles that are worked out together are the same to the bit as one by one, whatever came in and was asked for."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import wire
from bag_samples import evenly_chunked
from hypothesis import given, settings
from hypothesis import strategies as st
from motions import Robot, arm, bundled, moved

from ik_controller.messages import cdr
from ik_controller.messages.commands import CommandWriter
from ik_controller.recording.cycles import Stretch, cycles, stretches
from ik_controller.recording.reader import open_bag
from ik_controller.recording.run import RunInfo, RunWriter, default_topics
from ik_controller.session import Session

START = 1_790_000_000_000_000_000
EVENTS = [
    {"do": "pause"},
    {"do": "resume"},
    {"do": "clock"},
    {"do": "refuse", "role": "joint_states", "reason": "two publishers"},
    {"do": "refuse", "role": "joint_states", "reason": ""},
    {"do": "parameters", "values": {"velocity_scale": 0.2, "feedback_timeout": 0.01}},
]


class Recorded:
    """A run of a session, cycle by cycle, into a bag: `commands`, what it commanded as bytes, None where nothing."""

    def __init__(self, robot: Robot, changes: dict[str, Any], folder: Path) -> None:
        self.session = Session(robot.model, robot.parameters.replace(changes))
        self.writer = RunWriter(folder, self.session, default_topics(), patient=True)
        self.commands: list[tuple[bytes, ...] | None] = []
        self._encode = cdr.JointStateWriter(robot.model.joint_names)
        output = self.session.parameters.command_output
        self._other = None
        if output != "joint_state":
            self._other = CommandWriter(output, robot.model.joint_names, self.session.period, True)
        self.writer.begin(self.session, START)

    def take(self, role: str, data: bytes, now: int) -> None:
        self.session.take(role, data, now)
        self.writer.write(role, now, data)

    def event(self, content: dict[str, Any], now: int) -> None:
        self.session.apply(json.dumps(content))
        self.writer.event(now, json.dumps(content))

    def cycle(self, now: int) -> None:
        step = self.session.cycle(now)
        if step is not None:
            if self._other is not None:
                self.writer.write("command_output", now, self._other.write(step.position, step.velocity))
            self.writer.write("joint_commands", now, self._encode.write(now, step.position, step.velocity))
        self.writer.cycle(len(self.commands), now, int(self.session.status.code), 0, 0, int(step is not None))
        self.commands.append(step and tuple(x.tobytes() for x in (step.position, step.velocity, step.error)))


def compare(recorded: Recorded, robot: Robot, changes: dict[str, Any], bag: Path) -> tuple[int, int]:
    """Run the bag again, together; return how many cycles were worked out so, and how many one by one."""
    session = Session(robot.model, robot.parameters.replace(changes))
    opened = open_bag(bag)
    info = RunInfo.of(opened)
    commands, numbers, together = [], [], 0
    for cycle in stretches(opened, session, info, {}):
        if isinstance(cycle, Stretch):
            together += len(cycle.records)
            numbers += cycle.records[:, 0].tolist()
            commands += [tuple(x.tobytes() for x in row) for row in zip(*cycle[3:], strict=True)]
        else:
            step = cycle.step
            numbers.append(cycle.number)
            commands.append(step and tuple(x.tobytes() for x in (step.position, step.velocity, step.error)))
    assert numbers == list(range(len(recorded.commands)))
    assert commands == recorded.commands
    assert session.status == recorded.session.status
    assert session.state() == recorded.session.state()
    assert session.rejected == recorded.session.rejected
    assert session.last_rejected == recorded.session.last_rejected
    alone = Session(robot.model, robot.parameters.replace(changes))
    pairs = [(cycle.recorded, cycle.sent) for cycle in cycles(opened, alone, info, {})]
    whole = stretches(opened, Session(robot.model, robot.parameters.replace(changes)), info, {})
    assert pairs == [pair for cycle in whole for pair in (
        zip(cycle.recorded, cycle.sent, strict=True) if isinstance(cycle, Stretch) else [(cycle.recorded, cycle.sent)]
    )]  # fmt: skip
    return together, len(numbers) - together


@pytest.mark.parametrize("name", ["panda", "panda jerk", "ur5e", "scara"])
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.sampled_from([1e-3, 0.05, 2.0]),
    early=st.sampled_from([0, 40]),
    changes=st.sampled_from(
        [
            {},
            {"velocity_scale": 0.05},
            {"reference_mode": "interpolate"},
            {"feed_forward": False},
            {"acceleration_scale": 0.3},
            {"command_output": "joint_trajectory"},
        ]
    ),
)
def test_together_or_one_by_one(name: str, seed: int, size: float, early: int, changes: dict[str, Any]) -> None:
    """`early`: how many cycles at most a target is there before its time, as where the node had been held up."""
    robot, changes = arm(name), {"feedback_timeout": 0.02, **changes}
    rng = np.random.default_rng(seed)
    names, base = robot.model.joint_names, robot.model.base_frame
    home = robot.model.forward(robot.home)
    usual = rng.choice([1.0, 0.99, 0.9])  # of the joint states: one that is not has its chunk run one by one

    def joint_state(now: int) -> bytes:
        kind = rng.random() + 0.95 - usual
        if kind < 0.95:
            return wire.joints(names, robot.home, (), now)
        if kind < 0.96:  # of another arm
            return wire.joints(["gripper"], [0.0], (), now)
        if kind < 0.98:
            return wire.joints(names[::-1], robot.home[::-1], (), now)
        return wire.joints(names, np.full(len(names), np.nan), (), now)

    with TemporaryDirectory() as folder:
        recorded = Recorded(robot, changes, Path(folder) / "run")
        now, period = START, recorded.session.period
        for _ in range(12):
            if rng.random() < 0.15:
                recorded.event(EVENTS[rng.integers(len(EVENTS))], now)
            for _ in range(rng.integers(1, 4)):
                stamp = now + int(rng.integers(early + 1)) * period
                if rng.random() < 0.5:
                    pose = moved(home, size * rng.standard_normal(6))
                    recorded.take("target_pose", wire.pose(wire.seven(pose), base, stamp), now)
                else:
                    recorded.take("target_twist", wire.twist(size * rng.standard_normal(6), base, stamp), now)
            fed = rng.random() > 0.1  # else the joints fall silent, and it must stop
            for _ in range(rng.integers(1, 60)):
                if fed and rng.random() < 0.9:
                    recorded.take("joint_states", joint_state(now), now)
                recorded.cycle(now)
                now += int(rng.choice([1, 0, -3], p=[0.98, 0.01, 0.01])) * period  # some at a time that was before
        recorded.writer.close()
        evenly_chunked(Path(folder) / "run", Path(folder) / "chunks", int(rng.integers(20, 500)))
        compare(recorded, robot, changes, Path(folder) / "chunks")


@pytest.mark.parametrize("per_chunk", [1, 7, 100])
@pytest.mark.parametrize("output", ["joint_state", "position_array"])
def test_chunks_may_end_anywhere(tmp_path: Path, per_chunk: int, output: str) -> None:
    robot, changes = bundled("panda"), {"command_output": output}
    recorded = smooth(robot, tmp_path / "run", changes)
    recorded.writer.close()
    evenly_chunked(tmp_path / "run", tmp_path / "chunks", per_chunk)
    compare(recorded, robot, changes, tmp_path / "chunks")


@pytest.mark.parametrize("early", [0, 1, 15])
def test_a_stream_is_worked_out_together(tmp_path: Path, early: int) -> None:
    robot = bundled("panda")
    recorded = smooth(robot, tmp_path / "run", early=early)
    recorded.writer.close()
    together, alone = compare(recorded, robot, {}, tmp_path / "run")
    assert alone <= 10  # the first ones
    assert together >= 180


def smooth(robot: Robot, folder: Path, changes: dict[str, Any] | None = None, early: int = 0) -> Recorded:
    """A run in which the tool moves on at 1 cm/s: a target every ten cycles, so many cycles before its time."""
    recorded = Recorded(robot, changes or {}, folder)
    home, base = robot.model.forward(robot.home), robot.model.base_frame
    now = START
    for k in range(20):
        stamp = now + early * recorded.session.period
        recorded.take("target_twist", wire.twist([0.01, 0, 0, 0, 0, 0], base, stamp), now)
        pose = moved(home, np.array([1e-4 * k, 0, 0, 0, 0, 0]))
        recorded.take("target_pose", wire.pose(wire.seven(pose), base, stamp), now)
        for _ in range(10):
            recorded.take("joint_states", wire.joints(robot.model.joint_names, robot.home, (), now), now)
            recorded.cycle(now)
            now += recorded.session.period
    return recorded
