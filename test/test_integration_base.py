"""The integration bases on an arm that lags: each is stable with the default gain; docs/node.md states the errors.

The arm has 20 ms delay and a first-order lag of 20 ms; targets come 100 times a second, with twists, at 500 Hz cycles.
"""

from __future__ import annotations

import numpy as np
import pytest
from motions import Robot, bundled, difference, figure_eight, figure_eight_twist, moved
from test_session import START

from ik_controller.control.simulated_arm import SimulatedArm
from ik_controller.messages import cdr
from ik_controller.messages.cdr import JointStateWriter
from ik_controller.session import Session

RATE = 500.0
LAG = {"delay": 0.02, "lag": 0.02}
BASES = ("commanded", "measured", "bounded")


class Run:
    """A session with a lagging arm; `errors` of the commanded and of the real tool to the target (cycles, 6)."""

    def __init__(self, robot: Robot, base: str, arm: dict[str, float] | None = None, **changes) -> None:
        self.robot, self.model = robot, robot.model
        self.session = Session(
            robot.model, robot.parameters.replace({"rate": RATE, "integration_base": base, **changes})
        )
        self.arm = SimulatedArm(robot.home, **(LAG if arm is None else arm))
        self.home = robot.model.forward(robot.home)
        self.writer = JointStateWriter(robot.model.joint_names)
        self.k, self.held, self.commanded, self.measured = 0, False, [], []

    def cycle(self, target, twist=None) -> None:
        now = START + self.k * self.session.period
        q = self.arm.measure()[0]
        self.session.take("joint_states", self.writer.write(now, q, np.zeros(self.model.n)), now)
        if self.k % 5 == 0:
            frame = self.model.base_frame
            self.session.take("target_pose", cdr.pose_message(now, frame, target), now)
            self.session.take(
                "target_twist", cdr.twist_message(now, frame, np.zeros(6) if twist is None else twist), now
            )
        step = self.session.cycle(now)
        self.commanded.append(difference(target, self.model.forward(step.position)))
        self.measured.append(difference(target, self.model.forward(q)))
        if not self.held:
            self.arm.command(step.position)
        self.arm.advance(self.session.dt)
        self.k += 1

    @property
    def time(self) -> float:
        return self.k * self.session.dt

    def follow(self, seconds: float) -> np.ndarray:
        """Follow the figure-eight; return the real tool's position errors [m] over time."""
        begin = self.k
        for _ in range(round(seconds * RATE)):
            self.cycle(figure_eight(self.home, self.time), figure_eight_twist(self.home, self.time))
        return np.linalg.norm(np.array(self.measured[begin:])[:, :3], axis=1)

    def rest(self, seconds: float, target) -> np.ndarray:
        begin = self.k
        for _ in range(round(seconds * RATE)):
            self.cycle(target)
        return np.linalg.norm(np.array(self.measured[begin:])[:, :3], axis=1)


@pytest.mark.parametrize("base", BASES)
def test_each_base_follows_a_moving_target_stably_with_its_error(panda, base):
    """Commanded and bounded trail by the arm's 40 ms; measured makes up for it, and neither rings."""
    errors = Run(panda, base).follow(6.0)[1500:]
    speed = max(
        np.linalg.norm(figure_eight_twist(panda.model.forward(panda.home), t)[:3]) for t in np.arange(0, 6, 0.01)
    )
    if base == "measured":
        assert np.sqrt(np.mean(errors**2)) < 0.3 * 0.04 * speed
    else:
        assert errors.max() < 1.05 * 0.04 * speed
    late, early = errors[750:], errors[:750]
    assert late.max() < 2.0 * early.max()  # no oscillation that grows


@pytest.mark.parametrize("base", BASES)
def test_each_base_comes_to_rest_at_a_target_10_cm_away(panda, base):
    run = Run(panda, base)
    target = moved(run.home, np.array([0.08, 0.0, -0.06, 0.1, 0.0, 0.0]))
    errors = run.rest(3.0, target)
    assert errors[-1] < 1e-5
    beyond = np.array(run.measured)[:, :3] @ (np.array([0.08, 0, -0.06]) / 0.1)
    assert beyond.min() > (-0.004 if base == "measured" else -1e-4)  # hardly beyond the target
    settled = int(np.argmax(errors < 1e-3))
    assert (errors[settled + 100 :] < 2e-3).all()


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("arm", [{}, {"delay": 0.02}, {"lag": 0.04}, {"delay": 0.03, "lag": 0.01}], ids=str)
def test_each_base_is_stable_whatever_the_40_ms_are_made_of(ur5e, base, arm):
    run = Run(ur5e, base, arm)
    target = moved(run.home, np.array([0.0, 0.05, 0.02, 0.0, 0.1, 0.0]))
    assert run.rest(2.5, target)[-1] < 1e-5


def test_the_measured_base_is_stable_up_to_its_stated_gain_and_not_far_beyond(panda):
    """Without `measured_gain`, the default gain of 50/s would ring on this arm: that is why it is there."""
    small = moved(panda.model.forward(panda.home), np.array([0.005, 0, 0, 0, 0, 0]))
    assert Run(panda, "measured", measured_gain=12.5).rest(2.0, small)[-1] < 1e-6  # 12.5/s · 40 ms = 0.5
    ringing = Run(panda, "measured", measured_gain=50.0).rest(1.0, small)
    assert ringing[250:].max() > 1e-4


def test_an_arm_that_was_held_up_is_awaited_by_bounded_and_measured(panda):
    """Held for a second while the target goes on: the commanded base runs away, bounded waits at its deviation."""
    gaps = {}
    for base in BASES:
        run = Run(panda, base, max_deviation=0.05)
        run.follow(1.0)
        run.held = True
        run.follow(1.0)
        q = run.arm.measure()[0]
        gaps[base] = float(np.abs(run.session.controller.position - q).max())
        run.held = False
        run.follow(1.5)
        assert run.follow(0.5).max() < 0.02  # all of them come back
    assert gaps["commanded"] > 0.2
    for base in ("bounded", "measured"):  # measured would wind up without the bound
        assert gaps[base] < 0.08


def test_an_arm_that_sags_is_put_right_by_the_measured_base_alone(panda):
    """A constant offset between command and joint, as of a soft servo under gravity."""
    ends = {}
    sag = np.zeros(7)
    sag[1] = 0.01
    for base in BASES:
        run = Run(panda, base)
        measure = run.arm.measure
        run.arm.measure = lambda m=measure: (m()[0] + sag, m()[1])
        ends[base] = run.rest(3.0, moved(run.home, np.array([0.02, 0, 0, 0, 0, 0])))[-1]
    assert ends["measured"] < 1e-5
    assert ends["commanded"] > 2e-3
    assert ends["bounded"] > 2e-3


def test_bundled_robots_are_not_changed_by_these_runs():
    assert bundled("panda").model.tool_offset.isIdentity()
