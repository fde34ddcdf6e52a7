"""A session's start, stop, pause, reset, bad messages, and that the same calls give the same bits."""

from __future__ import annotations

import json

import numpy as np
import pytest
import wire
from motions import Robot, bundled, figure_eight, figure_eight_twist, moved

from ik_controller.control.status import Code
from ik_controller.errors import IkControllerError, ParameterError
from ik_controller.messages.cdr import JointStateWriter
from ik_controller.session import Session

MS = 1_000_000
START = 1_790_000_000_000 * MS


class Run:
    """A session with an arm behind it; every published command is held against the limits."""

    def __init__(self, robot: Robot, q=None, follow: float = 1.0, **changes):
        """`follow`: share of the way to the command that the arm makes in a cycle."""
        self.robot, self.model = robot, robot.model
        self.session = Session(robot.model, robot.parameters.replace(changes))
        self.writer = JointStateWriter(robot.model.joint_names)
        self.q = np.array(robot.home if q is None else q)
        self.home = robot.model.forward(robot.home)
        self.follow, self.now, self.log, self.last = follow, START, [], None
        self.feedback = True

    def cycle(self, *messages):
        """Feed the joints' state and (role, data) messages, run a cycle; return its Step or None."""
        if self.feedback:
            state = self.writer.write(self.now, self.q, np.zeros(self.model.n))
            assert self.session.take("joint_states", state, self.now)
        for role, data in messages:
            self.session.take(role, data, self.now)
        step = self.session.cycle(self.now)
        if step is not None:
            self.check(step)
            self.q = self.q + self.follow * (step.position - self.q)
        self.last = step
        self.log.append(None if step is None else (step.position.tobytes(), step.velocity.tobytes()))
        self.now += self.session.period
        return step

    def check(self, step):
        limit = self.model.acceleration_limit * self.session.dt * (1 + 1e-9) + 1e-14
        before = np.zeros(self.model.n) if self.last is None else self.last.velocity
        assert (np.abs(step.velocity - before) <= limit).all()
        assert (np.abs(step.velocity) <= self.model.velocity_limit * (1 + 1e-9)).all()

    def cycles(self, count, *messages):
        for _ in range(count):
            step = self.cycle(*messages)
        return step

    def apply(self, do, **more):
        self.session.apply(json.dumps({"do": do, **more}))

    def code(self):
        return self.session.status.code

    def push(self, x=0.15):
        """A twist along x."""
        return "target_twist", wire.twist([x, 0, 0, 0, 0, 0], self.robot.parameters.base_frame, self.now)

    def figure_eight(self, k):
        """Pose and twist of the figure-eight, every tenth cycle."""
        if k % 10:
            return []
        frame, t = self.robot.parameters.base_frame, k * 1e-3
        return [
            ("target_pose", wire.pose(wire.seven(figure_eight(self.home, t)), frame, self.now)),
            ("target_twist", wire.twist(figure_eight_twist(self.home, t), frame, self.now)),
        ]


@pytest.fixture
def run(panda):
    return Run(panda)


# -- start


def test_waits_for_the_first_joint_state_then_starts_where_the_arm_is(run):
    run.feedback = False
    assert run.cycles(5, run.push()) is None
    assert run.code() is Code.WAITING
    run.feedback = True
    run.q = run.robot.home + 0.01
    step = run.cycle(run.push())
    np.testing.assert_array_equal(step.position, run.robot.home + 0.01)
    assert not step.velocity.any()
    assert run.cycle(run.push()).velocity.any()
    assert run.code() is Code.TRACKING


def test_holds_still_without_targets(run):
    run.cycle()
    for _ in range(20):
        np.testing.assert_array_equal(run.cycle().position, run.robot.home)
        assert run.code() is Code.HOLDING


# -- targets stop, feedback stops


def test_when_targets_stop_the_arm_brakes_within_its_limits_and_holds(run):
    for _ in range(300):
        run.cycle(run.push())
    moving = run.last.velocity.copy()
    assert np.abs(moving).max() > 0.1
    for k in range(100):  # alive for 0.1 s of silence, by arrival
        run.cycle()
        assert run.code() is Code.TRACKING, k
    codes = []
    for _ in range(300):
        run.cycle()
        codes.append(run.code())
    stopped = codes.index(Code.HOLDING)
    assert set(codes[:stopped]) == {Code.STOPPING}
    assert set(codes[stopped:]) == {Code.HOLDING}
    assert not run.last.velocity.any()
    assert stopped <= 2 + np.max(2 * np.abs(moving) / run.model.acceleration_limit) / run.session.dt
    assert run.cycles(2, run.push()).velocity.any()  # and goes on
    assert run.code() is Code.TRACKING


def test_when_joint_states_stop_the_arm_halts_and_says_so_and_returns_to_where_it_is(run):
    run.cycles(300, run.push())
    run.feedback = False
    codes = []
    for _ in range(500):
        run.cycle(run.push())
        codes.append(run.code())
    assert codes[99] is Code.TRACKING
    assert set(codes[101:]) == {Code.NO_FEEDBACK}
    assert run.last is None  # at rest, nothing more is commanded
    assert "joint states have stopped" in run.session.status.sentence()
    run.feedback, run.q = True, run.q + 0.2  # someone has moved the arm
    expected = run.q.copy()
    np.testing.assert_array_equal(run.cycle(run.push()).position, expected)
    assert run.cycle(run.push()).velocity.any()


def test_a_short_loss_of_joint_states_goes_on_without_a_jump(run):
    """Back before the arm has come to rest: the command goes on from where it is."""
    run.cycles(300, run.push())
    run.feedback = False
    run.cycles(115, run.push())
    assert run.code() is Code.NO_FEEDBACK
    assert run.last.velocity.any()
    run.feedback = True
    before = run.last.position.copy()
    step = run.cycle(run.push())
    assert np.abs(step.position - before).max() < 5e-3
    assert run.code() is Code.TRACKING


# -- pause, resume, reset


def test_pause_brakes_and_resume_starts_from_the_measured_position(panda):
    run = Run(panda, follow=0.05)  # an arm that lags 20 ms
    run.cycles(300, run.push())
    run.apply("pause")
    for _ in range(400):
        run.cycle(run.push())
        assert run.code() is Code.PAUSED
    assert run.last is None
    run.q = run.q + 0.05
    run.apply("resume")
    expected = run.q.copy()
    np.testing.assert_array_equal(run.cycle(run.push()).position, expected)
    assert run.cycle(run.push()).velocity.any()


@pytest.mark.parametrize("event", ["resume", "reset"])
def test_resume_and_reset_of_a_moving_arm_brake_first_and_then_start_where_it_is(panda, event):
    """The limits hold in the published stream, always (checked by Run); the start is the measured position."""
    run = Run(panda, follow=0.05)
    run.cycles(300, run.push())
    assert np.abs(run.last.position - run.q).max() > 1e-3  # the command is ahead of the arm
    if event == "resume":
        run.apply("pause")
        run.cycles(3, run.push())
    run.apply(event)
    braked = 0
    while run.last is not None and run.last.velocity.any():
        run.cycle(run.push())
        braked += 1
        assert braked < 300
    assert braked > 3
    # At rest it waits for the arm to come to rest too, so that the new start is no step either.
    resting = run.last.position
    rested = 0
    while True:
        measured = run.q.copy()
        step = run.cycle(run.push())
        if not np.array_equal(step.position, resting):
            break
        rested += 1
        assert rested < 200
    assert rested >= 95
    np.testing.assert_array_equal(step.position, measured)
    assert np.abs(measured - resting).max() < 2e-4
    assert run.cycle(run.push()).velocity.any()


def test_reset_forgets_targets(run):
    target = moved(run.home, np.array([0.1, 0, 0, 0, 0, 0]))
    run.cycles(20, ("target_pose", wire.pose(wire.seven(target), run.robot.parameters.base_frame)))
    run.apply("reset")
    run.cycles(60)
    assert run.code() is Code.HOLDING


def test_pause_forgets_targets(run):
    target = moved(run.home, np.array([0.1, 0, 0, 0, 0, 0]))
    frame = run.robot.parameters.base_frame
    points = [(0.0, [wire.seven(run.home)], []), (5.0, [wire.seven(target)], [])]
    run.cycle(("target_trajectory", wire.trajectory(points, frame)))
    run.cycles(100)
    run.apply("pause")
    run.cycles(100)
    run.apply("resume")
    run.cycles(5)
    assert run.code() is Code.HOLDING


# -- parameters and events


def test_parameters_change_between_cycles_without_a_jump(run):
    run.cycles(200, run.push())
    run.apply("parameters", values={"velocity_scale": 0.05, "gain": [20.0]})
    run.cycles(300, run.push())  # limits are checked by Run
    limit = 0.05 * run.model.velocity_limit
    assert (np.abs(run.last.velocity) <= limit * (1 + 1e-9)).all()
    assert run.session.parameters.gain == (20.0,)


@pytest.mark.parametrize(
    ("event", "text"),
    [
        (
            '{"do": "dance"}',
            "unknown event 'dance'; legal: pause, resume, reset, clock, parameters, refuse, transform, state",
        ),
        ("{}", "unknown event 'None'"),
        ("not JSON", "not an event"),
        ("[1]", "not an event"),
        ('{"do": "parameters"}', "no 'values'"),
        ('{"do": "parameters", "values": {"gian": 1}}', "unknown parameter 'gian'; did you mean: gain"),
        ('{"do": "parameters", "values": {"gain": -1}}', "gain must be positive definite"),
        ('{"do": "parameters", "values": {"velocity_scale": 0.5, "posture": [1, 2]}}', "posture: 2 values, need 7"),
    ],
)
def test_events_that_cannot_be_applied_change_nothing(run, event, text):
    run.cycles(50, run.push())
    before = run.session.state()
    with pytest.raises(IkControllerError) as caught:
        run.session.apply(event)
    assert text in str(caught.value)
    assert run.session.state() == before
    run.cycle(run.push())


def test_a_gain_equal_to_the_rate_is_taken_at_every_rate():
    """Cycles are whole nanoseconds: 1/600 s is rounded up, and gain × cycle time a little above 1."""
    for rate in (300.0, 600.0, 700.0, 999.0):
        run = Run(bundled("ur5e"), rate=rate, gain=rate)
        run.cycles(5, run.push())
        assert run.code() is Code.TRACKING


# -- bad messages

NAN = float("nan")


def test_bad_messages_are_counted_named_and_leave_no_trace_in_the_commands(panda):
    """The run with bad messages between the good ones publishes the bits of the run without them."""
    base = panda.parameters.base_frame
    names = list(panda.model.joint_names)
    home = wire.seven(panda.model.forward(panda.home))
    bad = [
        ("target_pose", wire.pose([NAN, *home[1:]], base), "must be finite"),
        ("target_pose", wire.pose([*home[:3], 0, 0, 0, 0], base), "the quaternion is zero"),
        ("target_pose", wire.pose([*home[:3], 0, 0, 0, 1.01], base), "norm 1.01"),
        ("target_pose", wire.pose(home, ""), "frame_id is empty"),
        ("target_pose", wire.pose(home, "world_of_mine"), "'world_of_mine' is unknown"),
        ("target_twist", wire.twist([np.inf] * 6, base), "must be finite"),
        ("target_trajectory", wire.trajectory([], base), "no points"),
        ("target_joints", wire.joints(names[1:], [0.0] * 6), "missing: panda_joint1"),
        ("target_joints", wire.joints(names, [0.0] * 6), "6 values in position"),
        ("joint_states", wire.joints(names[:-1], [0.0] * 6), "missing: panda_joint7"),
        ("joint_states", wire.joints([*names, names[0]], [0.0] * 8), "named twice: panda_joint1"),
        ("joint_states", wire.joints(names, [NAN] * 7), "position of 'panda_joint1' is nan"),
        ("joint_states", wire.joints(names, [0.0] * 8), "8 values in position for 7 names"),
        ("joint_states", b"\x00\x01\x00\x00garbage", "not a sensor_msgs/msg/JointState"),
    ]
    clean, dirty = Run(panda), Run(panda)
    for k in range(280):
        clean.cycle(*clean.figure_eight(k))
        good = dirty.figure_eight(k)
        if k % 20 == 5:
            role, data, text = bad[k // 20]
            assert not dirty.session.take(role, data, dirty.now)
            assert dirty.session.last_rejected.startswith(f"{role}: ")
            assert text in dirty.session.last_rejected
        dirty.cycle(*good)
    assert dirty.log == clean.log
    assert dirty.session.rejected == {
        "target_pose": 5, "target_twist": 1, "target_trajectory": 1, "target_joints": 2, "joint_states": 5
    }  # fmt: skip
    assert not clean.session.rejected


def test_joint_states_are_matched_by_name_among_others(run):
    """Re-ordered, with a gripper's joints, and a gripper's own messages in between."""
    names, q = list(run.model.joint_names), run.robot.home
    run.feedback = False
    run.session.take("joint_states", wire.joints([*names[::-1], "finger"], [*q[::-1], 0.04]), run.now)
    np.testing.assert_array_equal(run.cycle().position, q)
    assert run.session.take("joint_states", wire.joints(["finger"], [0.04]), run.now)
    assert not run.session.rejected


def test_joint_states_of_another_robot_are_told_of(run):
    run.feedback = False
    assert not run.session.take("joint_states", wire.joints(["shoulder"], [0.0]), run.now)
    assert "none of the joints panda_joint1" in run.session.last_rejected
    assert "the message has: shoulder" in run.session.last_rejected


# -- the same calls, the same bits


def busy(run: Run, k: int) -> None:
    """One cycle of a run that uses everything."""
    if k == 150:
        run.apply("parameters", values={"gain": [30.0], "velocity_scale": 0.3})
    if k in (250, 450):
        run.apply("pause" if k == 250 else "resume")
    if k == 520:
        run.apply("reset")
    if k == 580:
        values = {"reference_mode": "interpolate", "posture": list(run.robot.home + 0.1)[: run.model.n]}
        run.apply("parameters", values=values)
    run.feedback = not 640 <= k < 780
    messages = run.figure_eight(k) if k < 850 else []
    if k == 400:
        messages = [("target_joints", wire.joints(run.model.joint_names, run.robot.home + 0.1, (), run.now))]
    run.cycle(*messages)


def test_two_sessions_in_one_process_give_the_same_bits(robot):
    """Interleaved, with a third one doing something else between."""
    one, two, other = Run(robot), Run(robot), Run(robot, gain=20.0)
    for k in range(900):
        busy(one, k)
        if k % 7 == 0:
            other.cycle(other.push())
        busy(two, k)
    assert one.log == two.log
    assert one.session.state() == two.session.state()
    assert len(set(one.log)) > 400


@pytest.mark.parametrize("at", [0, 1, 77, 149, 200, 255, 300, 455, 525, 601, 700, 765, 860])
def test_a_session_continued_from_a_state_gives_the_same_bits(ur5e, at):
    """In the middle of anything: tracking, braking, paused, restarting, without feedback."""
    one = Run(ur5e)
    for k in range(at):
        busy(one, k)
    state = one.session.state()
    two = Run(ur5e, gain=1.0, velocity_scale=0.5)  # what it had before does not matter
    two.session.apply(state)
    assert two.session.state() == state
    two.q, two.now, two.last = one.q, one.now, one.last
    two.log = list(one.log)
    for k in range(at, min(at + 200, 900)):
        busy(one, k)
        busy(two, k)
    assert one.log == two.log
    assert one.session.state() == two.session.state()


def test_parameters_that_do_not_fit_the_model_are_refused():
    robot = bundled("ur5e")
    with pytest.raises(ParameterError, match="posture: 7 values, need 6"):
        Session(robot.model, robot.parameters.replace({"posture": [0.0] * 7}))
