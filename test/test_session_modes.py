"""Modes, units, reference points, trajectories and the tool through a session: each followed, none with a bump."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest
import wire
from motions import difference, moved
from test_session import MS, Run

from ik_controller.control.status import Code
from ik_controller.errors import IkControllerError, ParameterError

SECOND = 1000 * MS


@pytest.fixture
def run(panda):
    return Run(panda)


def tool(run):
    return run.session.model.forward(run.last.position)


def pose_message(run, pose):
    return "target_pose", wire.pose(wire.seven(pose), run.robot.parameters.base_frame, run.now)


def twist_message(run, twist, frame=None):
    return "target_twist", wire.twist(twist, frame or run.robot.parameters.base_frame, run.now)


def joints_message(run, q):
    return "target_joints", wire.joints(run.model.joint_names, q, (), run.now)


# -- modes

KINDS = {
    "target_pose": lambda run: wire.pose(wire.seven(run.home), run.robot.parameters.base_frame),
    "target_twist": lambda run: wire.twist([0.05, 0, 0, 0, 0, 0], run.robot.parameters.base_frame),
    "target_trajectory": lambda run: wire.trajectory(
        [(1, [wire.seven(run.home)], [])], run.robot.parameters.base_frame
    ),
    "target_joints": lambda run: wire.joints(run.model.joint_names, run.robot.home),
    "target_joint_trajectory": lambda run: wire.joint_trajectory([(1, run.robot.home, [])], run.model.joint_names),
    "target_joint_jog": lambda run: wire.joint_jog(run.model.joint_names[:1], [0.1]),
}
FOLLOWED = {
    "auto": set(KINDS),
    "pose": {"target_pose", "target_twist"},
    "twist": {"target_twist"},
    "trajectory": {"target_trajectory", "target_joint_trajectory"},
    "joints": {"target_joints", "target_joint_jog"},
}


@pytest.mark.parametrize("mode", FOLLOWED)
def test_a_mode_takes_its_kinds_and_rejects_the_others(panda, mode):
    run = Run(panda, mode=mode)
    run.cycle()
    for role, make in KINDS.items():
        assert run.session.take(role, make(run), run.now) == (role in FOLLOWED[mode]), role
        if role not in FOLLOWED[mode]:
            assert f"{role}: not followed in mode '{mode}'" in run.session.last_rejected
    assert set(run.session.rejected) == set(KINDS) - FOLLOWED[mode]


@pytest.mark.parametrize("mode", ["pose", "trajectory", "joints"])
def test_a_mode_drops_what_it_does_not_follow(run, mode):
    run.cycles(200, twist_message(run, [0.1, 0, 0, 0, 0, 0]))
    run.apply("parameters", values={"mode": mode})
    run.cycle()
    assert run.code() is Code.STOPPING
    run.cycles(200)
    assert run.code() is Code.HOLDING


def test_a_mode_keeps_the_pose_stream_that_it_follows(run):
    target = moved(run.home, np.array([0.05, 0, 0, 0, 0, 0]))
    run.cycles(50, pose_message(run, target))
    run.apply("parameters", values={"mode": "pose"})
    run.cycle()
    assert run.code() is Code.TRACKING


def test_poses_twists_trajectories_joints_and_jogs_follow_one_another_without_a_bump(run):
    """Every change in the middle of a motion; `Run` holds each command against the acceleration limits."""
    target = moved(run.home, np.array([0.1, 0.05, 0, 0.1, 0, 0]))
    frame, names = run.robot.parameters.base_frame, run.model.joint_names
    points = [(0.4, [wire.seven(target)], []), (0.8, [wire.seven(run.home)], [])]
    streams = [
        lambda: pose_message(run, target),
        lambda: twist_message(run, [-0.2, 0, 0, 0, 0, 0.3]),
        lambda: joints_message(run, run.robot.home + 0.2),
        lambda: ("target_joint_jog", wire.joint_jog(names[2:4], [0.5, -0.5], run.now)),
    ]
    once = [
        ("target_trajectory", wire.trajectory(points, frame)),
        ("target_joint_trajectory", wire.joint_trajectory([(0.5, run.robot.home - 0.1, [])], names)),
    ]
    for number in range(24):
        run.cycles(40, streams[number % 4]())
        assert run.code() is Code.TRACKING
        if number % 3 == 0:
            run.cycle(once[number // 3 % 2])
            run.cycles(120)
            assert run.code() is Code.TRACKING
    assert not run.session.rejected


# -- units and reference point


def test_unitless_twists_and_jogs_are_scaled_and_more_than_one_is_rejected(panda):
    run = Run(panda, twist_unit="unitless", linear_scale=0.2, angular_scale=0.5, joint_scale=0.3)
    run.cycles(400, twist_message(run, [0.5, 0, 0, 0, 0, -1.0]))
    twist = run.session.model.jacobian(run.last.position) @ run.last.velocity
    np.testing.assert_allclose(twist, [0.1, 0, 0, 0, 0, -0.5], atol=1e-3)
    assert not run.session.take(*twist_message(run, [0, 0, 1.01, 0, 0, 0]), run.now)
    assert "need −1 to 1, twist_unit is unitless" in run.session.last_rejected
    name = run.model.joint_names[3]
    run.cycles(200, ("target_joint_jog", wire.joint_jog([name], [-1.0])))
    np.testing.assert_allclose(run.last.velocity, [0, 0, 0, -0.3, 0, 0, 0], atol=1e-12)
    assert not run.session.take("target_joint_jog", wire.joint_jog([name], [-1.5]), run.now)


def test_a_twist_about_a_frames_origin_leaves_the_point_there_where_it_is(panda):
    """Turning about the origin of the base frame: the tool runs on a circle around it, to 0.1 µm after a second."""
    run = Run(panda, twist_reference_point="frame")
    radius = np.linalg.norm(run.home.translation[:2])
    start = run.home.translation
    run.cycle()
    for _ in range(1000):
        run.cycle(twist_message(run, [0, 0, 0, 0, 0, 0.4]))
    end = tool(run).translation
    assert abs(np.linalg.norm(end[:2]) - radius) < 1e-7
    assert abs(end[2] - start[2]) < 1e-7
    assert np.linalg.norm(end - start) > 0.1


def test_a_twist_about_the_tool_turns_it_on_the_spot(run):
    run.cycles(500, twist_message(run, [0, 0, 0, 0, 0, 0.4], "panda_hand_tcp"))
    assert np.abs(tool(run).translation - run.home.translation).max() < 1e-6
    assert np.linalg.norm(pin.log3(tool(run).rotation @ run.home.rotation.T)) > 0.1


# -- trajectories


def goal(run):
    return run.session.goal.outcome


@pytest.mark.parametrize("kind", ["tool", "joints"])
def test_the_first_point_is_reached_at_its_time_from_where_the_arm_is(run, kind):
    """A single point 0.5 s ahead: halfway in time, the arm is halfway there."""
    run.cycle()
    if kind == "tool":
        target = moved(run.home, np.array([0.08, 0, 0.02, 0, 0.1, 0]))
        data = wire.trajectory([(0.5, [wire.seven(target)], [])], run.robot.parameters.base_frame)
        run.cycle(("target_trajectory", data))
    else:
        target = run.model.forward(run.robot.home + 0.1)
        data = wire.joint_trajectory([(0.5, run.robot.home + 0.1, [])], run.model.joint_names)
        run.cycle(("target_joint_trajectory", data))
    assert goal(run) == "under way"
    run.cycles(250)
    way = np.linalg.norm(target.translation - run.home.translation)
    half = np.linalg.norm(tool(run).translation - run.home.translation)
    assert half == pytest.approx(0.5 * way, rel=0.05)
    run.cycles(249)
    assert np.abs(difference(tool(run), target)).max() < 1e-6
    run.cycles(3)
    assert goal(run).startswith("reached: ")


def test_a_start_in_the_future_waits_and_then_follows(run):
    run.cycle()
    target = run.robot.home + 0.1
    stamp = run.now + 300 * MS
    data = wire.joint_trajectory([(0.4, target, [])], run.model.joint_names, stamp)
    run.cycle(("target_joint_trajectory", data))
    run.cycles(290)
    np.testing.assert_allclose(run.last.position, run.robot.home, atol=1e-12)
    run.cycles(409)
    np.testing.assert_allclose(run.last.position, target, atol=1e-9)


def test_joint_paths_meet_points_and_velocities(run):
    """Cubic between points: position and velocity at each, and no bump between; the limits are held by `Run`."""
    names, home = run.model.joint_names, run.robot.home
    points = [(0.3, home + 0.05, np.full(7, 0.3)), (0.6, home + 0.1, ()), (1.0, home, ())]
    run.cycle()
    run.cycle(("target_joint_trajectory", wire.joint_trajectory(points, names)))
    run.cycles(299)
    np.testing.assert_allclose(run.last.position, home + 0.05, atol=1e-7)
    np.testing.assert_allclose(run.last.velocity, 0.3, atol=2e-2)
    run.cycles(300)
    np.testing.assert_allclose(run.last.position, home + 0.1, atol=1e-7)
    run.cycles(400)
    np.testing.assert_allclose(run.last.position, home, atol=1e-7)
    run.cycle()
    assert np.abs(run.last.velocity).max() < 1e-3


@pytest.mark.parametrize("kind", ["target_trajectory", "target_joint_trajectory"])
def test_an_appended_trajectory_goes_on_where_the_last_one_ends(panda, kind):
    run = Run(panda, trajectory_mode="append")
    one, two = run.robot.home + 0.1, run.robot.home - 0.05
    run.cycle()

    def message(q, stamp=0):
        if kind == "target_joint_trajectory":
            return kind, wire.joint_trajectory([(0.4, q, [])], run.model.joint_names, stamp)
        pose = wire.seven(run.model.forward(q))
        return kind, wire.trajectory([(0.4, [pose], [])], run.robot.parameters.base_frame, stamp)

    run.cycle(message(one))
    run.cycles(200)
    run.cycle(message(two))  # in the middle of the first
    assert np.abs(difference(tool(run), run.model.forward(one))).max() > 0.01
    run.cycles(198)
    assert np.abs(difference(tool(run), run.model.forward(one))).max() < 1e-6
    run.cycles(400)
    assert goal(run) == "under way"
    run.cycles(5)
    assert np.abs(difference(tool(run), run.model.forward(two))).max() < 1e-6
    assert goal(run).startswith("reached")
    assert not run.session.rejected


def test_a_trajectory_spliced_into_another_goes_on_with_it_until_its_start(panda):
    """Replaced from 0.5 s on, the first half of the old one is followed as if nothing had come."""
    frame = panda.parameters.base_frame
    far = wire.seven(moved(panda.model.forward(panda.home), np.array([0.1, 0, 0.05, 0, 0, 0.2])))
    logs = []
    for spliced in (False, True):
        run = Run(panda, trajectory_mode="append")
        run.cycle()
        start = run.now
        run.cycle(("target_trajectory", wire.trajectory([(1.0, [far], [])], frame)))
        run.cycles(200)
        if spliced:
            home = wire.seven(run.home)
            run.cycle(("target_trajectory", wire.trajectory([(0.5, [home], [])], frame, start + 500 * MS)))
        else:
            run.cycle()
        positions = [run.cycle().position for _ in range(250)]
        logs.append(np.array(positions))
        if spliced:
            run.cycles(560)
            assert np.abs(difference(tool(run), run.home)).max() < 1e-6
    np.testing.assert_allclose(logs[0], logs[1], atol=1e-7)


def test_goals_are_missed_or_abandoned_and_the_outcome_says_so(panda):
    run = Run(panda, goal_time=0.2)
    run.cycle()
    beyond = moved(run.home, np.array([2.0, 0, 0, 0, 0, 0]))
    data = wire.trajectory([(0.1, [wire.seven(beyond)], [])], run.robot.parameters.base_frame)
    run.cycle(("target_trajectory", data))
    run.cycles(290)
    assert goal(run) == "under way"
    run.cycles(20)
    assert goal(run).startswith("missed: ")
    assert "mm" in goal(run)
    run.cycle(("target_joint_trajectory", wire.joint_trajectory([(0.5, run.q, [])], run.model.joint_names)))
    run.cycle(twist_message(run, np.zeros(6)))
    run.cycle()
    assert goal(run) == "abandoned"


# -- the tool

LONG = [0.0, 0.05, 0.2, 0.0, 0.0, 0.0, 1.0]


def test_a_changed_tool_is_brought_to_the_target_without_a_jump(run):
    run.cycles(50, pose_message(run, run.home))
    before = run.last.position.copy()
    run.apply("parameters", values={"tool_offset": LONG})
    step = run.cycle(pose_message(run, run.home))
    assert np.abs(step.position - before).max() < 1e-4
    assert np.linalg.norm(step.error[:3]) > 0.1  # the new tool point is elsewhere
    run.cycles(1500, pose_message(run, run.home))
    for _ in range(500):
        run.cycle(pose_message(run, run.home))
    hand = run.robot.model.forward(run.last.position)
    np.testing.assert_allclose(hand.act(np.array(LONG[:3])), run.home.translation, atol=1e-6)
    assert run.robot.model.tool_offset.isIdentity()  # the model given is left as it was
    run.apply("parameters", values={"tool_offset": []})
    for _ in range(1500):
        run.cycle(pose_message(run, run.home))
    assert np.abs(difference(run.robot.model.forward(run.last.position), run.home)).max() < 1e-6


def test_a_tool_that_is_no_pose_is_refused_and_nothing_changes(run):
    run.cycles(5, run.push())
    before = run.session.state()
    with pytest.raises(ParameterError, match="tool_offset: quaternion"):
        run.apply("parameters", values={"tool_offset": [0, 0, 0, 1, 1, 0, 0], "gain": 10.0})
    assert run.session.state() == before


# -- events: transforms, refusals, the clock


def test_a_transform_serves_the_next_message_alone(run):
    run.cycle()
    camera = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([0.3, 0.1, 0.6]))
    inside = wire.seven(camera.actInv(run.home))
    message = "target_pose", wire.pose(inside, "camera", run.now)
    assert run.session.foreign_frame(*message) == "camera"
    assert run.session.foreign_frame("target_pose", wire.pose(inside, "panda_link3")) == ""
    assert run.session.foreign_frame("target_joints", joints_message(run, run.q)[1]) == ""
    run.apply("transform", frame="camera", pose=wire.seven(camera).tolist())
    assert run.session.take(*message, run.now)
    run.cycle()
    assert np.abs(run.last.error).max() < 1e-12
    assert not run.session.take(*message, run.now)
    assert "frame_id 'camera' is unknown; legal: panda" in run.session.last_rejected
    run.apply("transform", frame="camera", reason="tf2 is not installed")
    assert not run.session.take(*message, run.now)
    assert "'camera' is unknown: no link of the model, and tf2 is not installed; legal" in run.session.last_rejected
    for bad in ([1, 2, 3], [0, 0, 0, 1, 1, 0, 0], "here"):
        with pytest.raises(IkControllerError, match="transform of 'camera'"):
            run.apply("transform", frame="camera", pose=bad)


def test_an_input_is_refused_until_it_is_taken_again(run):
    run.cycle()
    run.apply("refuse", role="target_twist", reason="2 publishers: /a, /b")
    assert not run.session.take(*run.push(), run.now)
    assert run.session.last_rejected == "target_twist: 2 publishers: /a, /b"
    assert run.session.take(*joints_message(run, run.q), run.now)
    state = run.session.state()
    other = Run(run.robot)
    other.session.apply(state)
    assert not other.session.take(*run.push(), run.now)
    run.apply("refuse", role="target_twist", reason="")
    assert run.session.take(*run.push(), run.now)


@pytest.mark.parametrize("jump", [-50 * SECOND, -10 * MS, 3 * SECOND, 500 * SECOND])
def test_a_jump_of_the_clock_brakes_and_starts_where_the_arm_is(run, jump):
    run.cycles(300, run.push())
    assert np.abs(run.last.velocity).max() > 0.05
    run.now += jump
    run.apply("clock")
    moved_to = run.q + 0.1  # the world begins anew elsewhere
    run.q, run.follow = moved_to, 0.0
    braking = 0
    while run.last is not None and run.last.velocity.any():
        run.cycle(run.push())
        braking += 1
        assert braking < 400
    assert braking > 3
    for _ in range(300):
        before = run.last
        run.cycle(run.push())
        if not np.array_equal(run.last.position, before.position):
            break
    np.testing.assert_array_equal(run.last.position, moved_to)
    assert not run.last.velocity.any()
    run.cycle(run.push())
    assert run.code() is Code.TRACKING


# -- the same calls, the same bits


def busy(run, k):
    """One cycle of a run that uses what is tested here."""
    rng = np.random.default_rng(k)
    values = [
        {"mode": str(rng.choice(list(FOLLOWED)))},
        {"tool_offset": [[], LONG][k % 2]},
        {"twist_reference_point": ["tool", "frame"][k % 2], "trajectory_mode": ["append", "replace"][k % 2]},
        {"integration_base": str(rng.choice(["commanded", "measured", "bounded"]))},
    ]
    if k % 37 == 5:
        run.apply("parameters", values=values[k // 37 % 4])
    if k == 333:
        run.apply("clock")
    messages = []
    if k % 10 == 0:
        messages.append(pose_message(run, moved(run.home, rng.uniform(-0.05, 0.05, 6))))
    if k % 7 == 0:
        messages.append(twist_message(run, rng.uniform(-0.2, 0.2, 6), ["panda_link0", "panda_link5"][k % 2]))
    if k % 50 == 3:
        q = run.robot.home + rng.uniform(-0.1, 0.1, 7)
        messages.append(
            ("target_joint_trajectory", wire.joint_trajectory([(0.1, q, [])], run.model.joint_names, run.now + 20 * MS))
        )
    if k % 60 == 20:
        points = [(0.05, [wire.seven(run.home)], []), (0.15, [wire.seven(run.home)], [np.zeros(6)])]
        run.apply("transform", frame="camera", pose=[0, 0, 0.01 * rng.uniform(), 0, 0, 0, 1])
        messages.append(("target_trajectory", wire.trajectory(points, "camera")))
    if k % 90 == 70:
        messages.append(("target_joint_jog", wire.joint_jog(run.model.joint_names[:2], [0.1, -0.2])))
    run.cycle(*messages)


@pytest.mark.parametrize("at", [0, 30, 104, 222, 334, 405, 471])
def test_a_session_continued_from_a_state_gives_the_same_bits(panda, at):
    one = Run(panda)
    for k in range(at):
        busy(one, k)
    state = one.session.state()
    assert json.loads(state)["do"] == "state"
    two = Run(panda)
    two.session.apply(state)
    assert two.session.state() == state
    two.q, two.now, two.last, two.log = one.q, one.now, one.last, list(one.log)
    for k in range(at, at + 150):
        busy(one, k)
        busy(two, k)
    assert one.log == two.log
    assert one.session.state() == two.session.state()
