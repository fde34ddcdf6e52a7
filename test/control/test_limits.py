"""The published stream stays within position, velocity, acceleration and jerk limits, whatever is asked of it."""

from __future__ import annotations

import math

import arms
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motions import JERKS, arm, difference, moved, started

from ik_controller import Controller, ControllerParameters, Reference, RobotModel
from ik_controller.control.status import Code, Limit

DT = 1e-3
ARMS = ["panda", "ur5e", "scara", "skewed_7", "planar_2r", "planar_3r", "panda jerk", "ur5e jerk", "scara jerk"]


class Watch:
    """Holds every command of a run against the limits."""

    def __init__(self, controller: Controller) -> None:
        model = controller.model
        self.controller, self.model = controller, model
        self.q, self.v, self.a = controller.position.copy(), controller.velocity.copy(), np.zeros(self.model.n)
        # What may be outside: a joint that starts outside its bounds, as far as it has come back.
        self.lower, self.upper = np.fmin(model.lower, self.q), np.fmax(model.upper, self.q)

    def check(self, step, dt: float, acceleration_scale: float | None = None) -> None:
        """`acceleration_scale` None: it has been lowered on the way, and stopping at a bound may take more of it."""
        model, parameters = self.model, self.controller.parameters
        q, v = step.position, step.velocity
        assert np.isfinite(q).all()
        assert np.isfinite(v).all()
        np.testing.assert_allclose(q, self.q + v * dt, rtol=1e-12, atol=1e-15)
        acceleration = model.acceleration_limit * (acceleration_scale or 1.0)
        step_limit = acceleration * dt * (1 + 1e-9) + 1e-14
        assert (np.abs(v - self.v) <= step_limit).all()
        assert step.status.code is not Code.FAULT, step.status.reason
        a = (v - self.v) / dt
        rounding = 1e-15 * (np.abs(v) + np.abs(self.v)) / dt
        assert (np.abs(a - self.a) <= model.jerk_limit * dt * (1 + 1e-9) + rounding).all()
        limit = model.velocity_limit * parameters.velocity_scale
        # Above a limit that has just been lowered: only while it brakes as hard as it may.
        scaled = model.acceleration_limit * parameters.acceleration_scale
        braking = np.abs(v) <= np.abs(self.v) - scaled * dt * (1 - 1e-9) + 1e-12
        jerky = np.isfinite(model.jerk_limit)  # such a joint comes down as its jerk limit allows
        scaled_down = parameters.velocity_scale < 1.0
        assert ((np.abs(v) <= limit * (1 + 1e-9)) | braking | (jerky & scaled_down)).all()
        assert (np.abs(v) <= model.velocity_limit * (1 + 1e-9)).all()
        margin = 1e-9 * np.fmax(np.abs(q), 1.0)
        assert (q <= self.upper + margin).all()
        assert (q >= self.lower - margin).all()
        self.lower, self.upper = np.fmin(model.lower, q), np.fmax(model.upper, q)
        self.q, self.v, self.a = q, v, a


KINDS = [
    "jump",
    "far",
    "flip",
    "none",
    "twist",
    "huge twist",
    "joints",
    "joints beyond",
    "stream",
    "nan",
    "no feedback",
]


def reference_of(kind: str, model: RobotModel, q: np.ndarray, rng: np.random.Generator):
    """Return (reference, is there feedback) of a kind, from an adversary who knows where the arm is."""
    inside = np.where(np.isfinite(model.lower), model.lower, -7.0), np.where(np.isfinite(model.upper), model.upper, 7.0)
    here = model.forward(q)
    if kind == "jump":
        return Reference.pose(model.forward(rng.uniform(*inside)), rng.normal(0.0, 0.5, 6)), True
    if kind == "far":
        return Reference.pose(
            moved(here, np.append(rng.normal(0.0, 1.0, 3) * 10.0 ** rng.uniform(-3, 6), [0, 0, 0]))
        ), True
    if kind == "flip":
        axis = rng.normal(size=3)
        return Reference.pose(moved(here, np.append([0, 0, 0], math.pi * axis / np.linalg.norm(axis)))), True
    if kind == "stream":
        return Reference.pose(moved(here, rng.normal(0.0, 0.05, 6)), rng.normal(0.0, 1.0, 6)), True
    if kind == "twist":
        return Reference.velocity(rng.normal(0.0, 1.0, 6)), True
    if kind == "huge twist":
        return Reference.velocity(rng.normal(0.0, 1.0, 6) * 10.0 ** rng.uniform(0, 12)), True
    if kind == "joints":
        return Reference.joint(rng.uniform(*inside)), True
    if kind == "joints beyond":
        return Reference.joint(rng.uniform(*inside) * 5.0, rng.normal(0.0, 30.0, model.n)), True
    if kind == "nan":
        return Reference(np.full(3, np.nan), np.full((3, 3), np.nan), np.full(6, np.nan)), True
    return None, kind == "none"


@st.composite
def schedules(draw):
    """A few spells of (kind, cycles, does the reference change every cycle)."""
    spell = st.tuples(st.sampled_from(KINDS), st.sampled_from([1, 5, 40, 100]), st.booleans())
    return draw(st.lists(spell, min_size=1, max_size=5))


def run(
    controller: Controller, schedule, rng: np.random.Generator, times=lambda rng: DT, before=None, **checks
) -> None:
    watch = Watch(controller)
    for kind, cycles, every in schedule:
        reference, feedback = reference_of(kind, controller.model, watch.q, rng)
        for _ in range(cycles):
            if every:
                reference, feedback = reference_of(kind, controller.model, watch.q, rng)
            if before is not None:
                before(rng)
            dt = times(rng)
            watch.check(controller.step(watch.q if feedback else None, reference, dt), dt, **checks)


@pytest.mark.parametrize("name", ARMS)
@settings(max_examples=8)
@given(schedule=schedules(), seed=st.integers(0, 2**32 - 1))
def test_limits_hold_whatever_is_asked(name, schedule, seed):
    rng = np.random.default_rng(seed)
    robot = arm(name)
    low, high = np.fmax(robot.model.lower, -6.0), np.fmin(robot.model.upper, 6.0)
    q = rng.uniform(low, high)
    at_bound = rng.random(robot.model.n)
    q = np.where(at_bound < 0.1, low, np.where(at_bound > 0.9, high, q))  # some start exactly at a bound
    base = ["commanded", "measured", "bounded"][seed % 3]
    controller = started(robot, q, integration_base=base, posture=rng.uniform(low, high).tolist() if seed % 2 else ())
    run(controller, schedule, rng, acceleration_scale=1.0)


@pytest.mark.parametrize("name", ["panda", "scara"])
@settings(max_examples=8)
@given(schedule=schedules(), seed=st.integers(0, 2**32 - 1))
def test_limits_hold_while_the_cycle_time_varies(name, schedule, seed):
    rng = np.random.default_rng(seed)
    controller = started(arm(name), gain=20.0)
    run(controller, schedule, rng, times=lambda rng: 10.0 ** rng.uniform(-4.0, -1.5), acceleration_scale=1.0)


@pytest.mark.parametrize("name", ["panda", "ur5e", "skewed_7", "panda jerk", "ur5e jerk"])
@settings(max_examples=8)
@given(schedule=schedules(), seed=st.integers(0, 2**32 - 1))
def test_limits_hold_while_the_scales_change(name, schedule, seed):
    rng = np.random.default_rng(seed)
    controller = started(arm(name))
    everything = controller.parameters

    def change(rng: np.random.Generator) -> None:
        if rng.random() < 0.02:
            scales = 10.0 ** rng.uniform(-2.0, 0.0, 3)
            changes = {"velocity_scale": scales[0], "acceleration_scale": scales[1], "jerk_scale": scales[2]}
            controller.set_parameters(everything.replace(changes))

    run(controller, schedule, rng, before=change)


@pytest.mark.parametrize("name", ["panda", "planar_3r", "scara jerk"])
@settings(max_examples=8)
@given(schedule=schedules(), seed=st.integers(0, 2**32 - 1))
def test_joints_that_start_outside_their_bounds_only_move_inward(name, schedule, seed):
    rng = np.random.default_rng(seed)
    model = arm(name).model
    q = np.clip(arm(name).home, -6, 6)
    outside = rng.random(model.n) < 0.5
    q = np.where(outside, np.where(rng.random(model.n) < 0.5, model.lower - 0.2, model.upper + 0.1), q)
    controller = started(arm(name), q)

    def slowly(rng: np.random.Generator) -> None:
        q, v = controller.position, controller.velocity
        beyond = (q > model.upper + 1e-9) | (q < model.lower - 1e-9)
        assert (np.abs(v) <= np.where(beyond, 0.1, 1.0) * model.velocity_limit * (1 + 1e-9)).all()

    run(controller, schedule, rng, before=slowly, acceleration_scale=1.0)


@pytest.mark.parametrize("name", ["panda", "panda jerk"])
def test_a_joint_outside_comes_in_when_it_may_and_rests_when_pulled_outward(name):
    robot = arm(name)
    model, q = robot.model, robot.home.copy()
    q[1] = model.upper[1] + 0.05
    controller = started(robot, q)
    outward = q.copy()
    outward[1] += 0.3
    for _ in range(200):
        step = controller.step(controller.position, Reference.joint(outward), DT)
    np.testing.assert_array_equal(step.position, q)
    assert "position limit of 'panda_joint2'" in step.status.sentence(model.joint_names)
    for _ in range(3000):
        step = controller.step(controller.position, Reference.joint(robot.home), DT)
    np.testing.assert_allclose(step.position, robot.home, atol=1e-9)


@pytest.mark.parametrize("scale", [0.05, 0.3])
def test_a_joint_stops_at_its_bound_when_its_acceleration_is_cut_on_the_way_there(panda, scale):
    controller, q = started(panda), panda.home
    target = np.array(panda.home)
    target[0] = panda.model.upper[0] + 1.0
    while panda.model.upper[0] - q[0] > 0.17:  # at full speed it needs 0.158 rad to stop
        q = controller.step(q, Reference.joint(target), DT).position
    controller.set_parameters(panda.parameters.replace({"acceleration_scale": scale}))
    watch = Watch(controller)
    for _ in range(1500):
        watch.check(controller.step(q, Reference.joint(target), DT), DT)
    assert panda.model.upper[0] - watch.q[0] < 1e-6


def test_scaled_limits_hold_and_are_used(panda):
    controller, q = started(panda, velocity_scale=0.2, acceleration_scale=0.1), panda.home
    watch, fastest = Watch(controller), 0.0
    for _ in range(800):
        watch.check(controller.step(q, Reference.joint(panda.home + 0.5), DT), DT, 0.1)
        fastest = max(fastest, np.max(np.abs(watch.v) / panda.model.velocity_limit))
    assert fastest == pytest.approx(0.2, rel=1e-9)


def test_unlimited_acceleration_and_speed_are_no_trouble():
    model = RobotModel.from_urdf(arms.planar_3r(), "tool")
    model.set_limits(velocity=[math.inf] * 3, acceleration=[math.inf] * 3)
    controller = Controller(model, ControllerParameters())
    q = np.array([0.2, 0.5, 0.3])
    controller.reset(q)
    target = Reference.pose(model.forward([2.9, 0.5, 0.3]))
    for k in range(400):
        step = controller.step(q, target if k < 300 else None, DT)
        q = step.position
        assert np.isfinite(q).all()
        assert (np.abs(q) <= math.pi).all()
    assert not step.velocity.any()


# -- the direction is kept


@pytest.mark.parametrize("axis", np.vstack((np.eye(3), [[0.6, -0.6, 0.5]])))
def test_a_twist_faster_than_the_limits_stays_on_its_line(robot, axis):
    """Straight-line streaming beyond the velocity limits: slower, not elsewhere. The line has no feedback here."""
    controller, q = started(robot), robot.home
    home, twist = robot.model.forward(q), np.append(3.0 * axis, np.zeros(3))
    limited = []
    for _ in range(400):
        step = controller.step(q, Reference.velocity(twist), DT)
        if step.status.damped or step.status.limit is Limit.POSITION:
            break
        q = step.position
        limited.append(step.status.limit)
        off = difference(robot.model.forward(q), home)
        along = off[:3] @ axis / (axis @ axis)
        assert np.linalg.norm(off[:3] - along * axis) < 1e-6
        assert np.linalg.norm(off[3:]) < 5e-6
        assert 0.0 <= step.status.scale < 1.0
    assert len(limited) > 100
    assert set(limited) <= {Limit.VELOCITY, Limit.ACCELERATION}


def test_a_pose_stream_faster_than_the_limits_stays_on_its_line(robot):
    controller, q = started(robot), robot.home
    home = robot.model.forward(q)
    axis = np.array([0.0, -0.6, 0.8])
    velocity = np.append(2.5 * axis, np.zeros(3))
    for k in range(200):
        now, then = moved(home, k * DT * velocity), moved(home, (k + 1) * DT * velocity)
        step = controller.step(q, Reference.between(now, then, DT), DT)
        q = step.position
        off = difference(robot.model.forward(q), home)
        assert np.linalg.norm(off[:3] - (off[:3] @ axis) * axis) < 1e-6
    assert step.status.scale < 0.9


@pytest.mark.parametrize("seed", range(6))
def test_the_approach_to_a_far_target_does_not_overshoot(robot, seed):
    """Both translation and rotation: at most 2 % of the distance beyond the target, where staying on the line takes
    that, and at rest on it then."""
    rng = np.random.default_rng(seed)
    controller, q = started(robot), robot.home
    home = robot.model.forward(q)
    push, turn = rng.normal(size=3), rng.normal(size=3)
    change = np.append(0.2 * push / np.linalg.norm(push), 0.4 * turn / np.linalg.norm(turn))
    target = moved(home, change)
    furthest = np.zeros(2)
    for _ in range(1500):
        step = controller.step(q, Reference.pose(target), DT)
        q = step.position
        done = difference(robot.model.forward(q), home)
        for part in (slice(0, 3), slice(3, 6)):
            share = done[part] @ change[part] / (change[part] @ change[part])
            furthest[part.start // 3] = max(furthest[part.start // 3], share)
    assert np.abs(difference(target, robot.model.forward(q))).max() < 1e-9
    assert (furthest <= 1.02).all()


@settings(max_examples=12)
@given(schedule=schedules(), seed=st.integers(0, 2**32 - 1))
def test_braking_stops_all_joints_together_in_the_shortest_time(schedule, seed):
    """From any state: straight in joint space, as fast as the slowest joint can, then holding."""
    rng = np.random.default_rng(seed)
    plain = [name for name in ARMS if name not in JERKS]
    robot = arm(plain[seed % len(plain)])
    controller = started(robot)
    run(controller, [*schedule, ("twist", 40, False)], rng, acceleration_scale=1.0)
    q, v = controller.position, controller.velocity.copy()
    watch = Watch(controller)
    expected = np.max(np.abs(v) / robot.model.acceleration_limit)
    moving = 0
    for _ in range(int(expected / DT) + 2):
        step = controller.step(watch.q, None, DT)
        watch.check(step, DT, 1.0)
        if step.velocity.any():
            moving += 1
            assert step.status.code is Code.STOPPING
            share = np.max(np.abs(step.velocity)) / np.max(np.abs(v))
            np.testing.assert_allclose(step.velocity, share * v, atol=1e-9)
    assert step.status.code is Code.HOLDING
    assert moving <= expected / DT + 1
    assert np.abs(watch.q - q).max() <= np.abs(v).max() * expected / 2 + 1e-9


@pytest.mark.parametrize("name", JERKS)
def test_braking_with_jerk_limits_ends_at_rest_in_good_time(name):
    """As long as the slowest joint takes by itself, and once more for taking its acceleration away."""
    rng = np.random.default_rng(5)
    robot = arm(name)
    for _ in range(4):
        controller = started(robot)
        watch = Watch(controller)
        reference, _ = reference_of("jump", robot.model, watch.q, rng)
        for _ in range(int(rng.integers(20, 300))):
            watch.check(controller.step(watch.q, reference, DT), DT, 1.0)
        finite = np.where(np.isfinite(robot.model.jerk_limit), robot.model.jerk_limit, 1e9)
        ramp = robot.model.acceleration_limit / finite
        longest = np.max(np.abs(watch.v) / robot.model.acceleration_limit + 4.0 * ramp)
        for _ in range(int(2.0 * longest / DT) + 10):
            step = controller.step(watch.q, None, DT)
            watch.check(step, DT, 1.0)
        assert step.status.code is Code.HOLDING
        assert controller.at_rest


def test_a_reference_that_is_not_finite_stops_the_arm(panda):
    controller, q = started(panda), panda.home
    for _ in range(100):
        q = controller.step(q, Reference.velocity([0.2, 0, 0, 0, 0, 0]), DT).position
    broken = Reference(np.full(3, np.nan), np.full((3, 3), np.nan), np.full(6, np.nan))
    codes = []
    for _ in range(400):
        step = controller.step(q, broken, DT)
        q = step.position
        codes.append(step.status.code)
        assert np.isfinite(step.error).all()
    assert codes[0] is Code.STOPPING
    assert codes[-1] is Code.HOLDING
    q = controller.step(q, Reference.pose(panda.model.forward(q)), DT).position  # and the arm goes on
    assert np.isfinite(q).all()


def test_status_names_the_limit_and_the_joint(panda):
    controller, q = started(panda), panda.home
    target = np.array(panda.home)
    target[0] = 10.0
    seen = []
    for _ in range(2500):
        step = controller.step(q, Reference.joint(target), DT)
        q = step.position
        seen.append((step.status.limit, step.status.joint))
    assert seen[0] == (Limit.ACCELERATION, 0)
    assert (Limit.VELOCITY, 0) in seen
    assert seen[-1] == (Limit.POSITION, 0)
    assert "position limit of 'panda_joint1'" in step.status.sentence(panda.model.joint_names)
