"""Cycles that are worked out together are the same to the bit as one by one, whatever is asked of the arm."""

from __future__ import annotations

import numpy as np
import pytest
import wire
from hypothesis import given, settings
from hypothesis import strategies as st
from motions import arm, bundled, moved
from test_session import START

from ik_controller.kinematics.accelerate import HAS_NUMBA
from ik_controller.messages.cdr import JointStateWriter
from ik_controller.session import Session

pytestmark = pytest.mark.skipif(not HAS_NUMBA, reason="worked out together by compiled kernels only")


class Log:
    """What a session commanded: (position, velocity, error) of each cycle as bytes, None where it commanded nothing."""

    def __init__(self, robot, changes):
        self.session = Session(robot.model, robot.parameters.replace(changes))
        self.commands: list[tuple[bytes, ...] | None] = []
        self.together = 0

    def run(self, role, data, arrival, times, states):
        """Take a target, then run cycles with the joint states that arrive at them, where some do."""
        self.session.take(role, data, arrival)
        for time, state in zip(times, states, strict=True):
            if state is not None:
                self.session.take("joint_states", state, time)
            step = self.session.cycle(time)
            self.commands.append(step and tuple(x.tobytes() for x in (step.position, step.velocity, step.error)))

    def run_together(self, role, data, arrival, times, states):
        """Do the same, told about the cycles beforehand."""
        self.session.take(role, data, arrival)
        self.session.expect(times)
        passed = 0
        for time, state in zip(times, states, strict=True):
            if state is not None:
                self.session.take("joint_states", state, time)
            if self.session.passes(time):
                passed += 1
                continue
            self._settle(passed)
            passed = 0
            step = self.session.cycle(time)
            self.commands.append(step and tuple(x.tobytes() for x in (step.position, step.velocity, step.error)))
        self._settle(passed)

    def _settle(self, passed):
        rows = list(zip(*self.session.settle(), strict=True))
        assert len(rows) == passed
        self.commands += [tuple(x.tobytes() for x in row) for row in rows]
        self.together += passed


@pytest.mark.parametrize("name", ["panda", "panda jerk", "ur5e", "scara"])
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.sampled_from([1e-3, 0.05, 2.0]),
    changes=st.sampled_from(
        [
            {},
            {"velocity_scale": 0.05},
            {"reference_mode": "interpolate"},
            {"feed_forward": False},
            {"acceleration_scale": 0.3},
        ]
    ),
)
def test_together_or_one_by_one(name, seed, size, changes):
    robot = arm(name)
    rng = np.random.default_rng(seed)
    home = robot.model.forward(robot.home)
    writer = JointStateWriter(robot.model.joint_names)
    state = writer.write(START, np.array(robot.home), np.zeros(robot.model.n))
    single, grouped = Log(robot, changes), Log(robot, changes)
    now = START
    period = single.session.period
    base = robot.model.base_frame
    for _ in range(12):
        count = int(rng.integers(1, 60))
        times = [now + (k + int(rng.random() < 0.02)) * period for k in range(count)]
        times = [max(times[: k + 1]) for k in range(count)]
        fed = rng.random() > 0.1  # else the joints fall silent, and it must stop
        states = [state if fed and rng.random() < 0.9 else None for _ in range(count)]
        if rng.random() < 0.5:
            target = moved(home, size * rng.standard_normal(6))
            role, data = "target_pose", wire.pose(wire.seven(target), base, now)
        else:
            role, data = "target_twist", wire.twist(size * rng.standard_normal(6), base, now)
        single.run(role, data, now, times, states)
        grouped.run_together(role, data, now, times, states)
        now = times[-1] + period
        assert grouped.commands == single.commands
        assert grouped.session.status == single.session.status
        assert grouped.session.state() == single.session.state()


def test_a_quiet_stream_is_worked_out_together():
    robot = bundled("panda")
    home, base = robot.model.forward(robot.home), robot.model.base_frame
    state = JointStateWriter(robot.model.joint_names).write(START, np.array(robot.home), np.zeros(robot.model.n))
    log = Log(robot, {})
    now = START
    for k in range(20):
        times = [now + i * log.session.period for i in range(10)]
        log.session.take("target_twist", wire.twist([0.01, 0, 0, 0, 0, 0], base, now), now)
        pose = moved(home, np.array([1e-4 * k, 0, 0, 0, 0, 0]))
        log.run_together("target_pose", wire.pose(wire.seven(pose), base, now), now, times, [state] * 10)
        now = times[-1] + log.session.period
    assert log.together >= 180
