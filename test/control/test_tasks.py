"""The stack of tasks: selected axes and their errors, tolerances, priorities in the bare law and within the limits."""

from __future__ import annotations

import functools
import json
import math
import re
from pathlib import Path

import arms
import daqp
import numpy as np
import pinocchio as pin
import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from motions import Robot, bundled, difference, figure_eight, moved, started

from ik_controller import Controller, ControllerParameters, Reference, RobotModel
from ik_controller.control.law import Law
from ik_controller.control.limits import JointLimits
from ik_controller.control.stack import stack_cycle
from ik_controller.control.status import Limit
from ik_controller.errors import ParameterError
from ik_controller.kinematics.inverses import inverse, weighted_right
from ik_controller.kinematics.task import axes_mask
from ik_controller.messages.cdr import JointStateWriter, pose_message
from ik_controller.session import Session

DT = 1e-3
SEEDS = st.integers(0, 2**32 - 1)


@functools.cache
def arm(name: str) -> Robot:
    if name != "planar":
        return bundled(name)
    model = RobotModel.from_urdf(arms.planar_3r(), "tool")
    return Robot(model, ControllerParameters(), np.array([0.4, 0.7, 0.6]))


# What the arms are asked for: a first task that leaves some motion, and tasks below it.
CASES = {
    "drill": ("panda", {"task_axes": "xyzrp", "task_frame": "tool"}, ["z panda_link4"], [0.5]),
    "whole pose": ("panda", {}, ["swivel"], [0.7]),
    "position": ("panda", {"task_axes": "xyz"}, ["orientation panda_link6"], [0.0, 0.6, 0.0, 0.8]),
    "two below": ("panda", {"task_axes": "xyz"}, ["y panda_link4", "swivel"], [0.1, -0.4]),
    "six joints": ("ur5e", {"task_axes": "xyzr"}, ["z wrist_1_link"], [0.4]),
    "orientation": ("ur5e", {"task_axes": "rpy"}, ["xy wrist_1_link"], [0.3, 0.2]),
    "planar": ("planar", {"task_axes": "x"}, ["y link3"], [0.9]),
}
BELOW = {"objectives": ["joint_centring", "limit_repulsion", "manipulability"], "objective_gains": [3.0, 0.1, 2.0]}


def selected_rows(changes, frame: np.ndarray) -> np.ndarray:
    """Return the rows (m, 6) of the axes that a case selects, but for a single rotation axis."""
    rows = np.zeros((6, 6))
    rows[:3, :3] = rows[3:, 3:] = frame.T
    return rows[axes_mask(changes.get("task_axes", "xyzrpy")) > 0.0]


class Cycle:
    """One cycle from rest at q: the velocity that the stack gives, and the scale, within the arm's limits or none."""

    def __init__(self, robot: Robot, changes, q, reference: Reference, limited: bool = False) -> None:
        parameters = robot.parameters.replace(changes)
        n = robot.model.n
        law = Law(robot.model, parameters)
        table = JointLimits(robot.model).table.copy()
        if not limited:
            table[0], table[3] = 1e9, 1e9
            table[1], table[2], table[4] = 1e9, 1e12, 1e12
        state, out = np.concatenate((q, np.zeros(n + 6))), np.zeros(2 * n + 12)
        assert law.stack is not None
        self.how, self.scale, _, _, self.sigma = stack_cycle(
            law.chain, law.table, table, state, q, reference.position, np.ascontiguousarray(reference.rotation),
            reference.twist, True, False, DT, out, np.zeros((7, n)), *law.stack.tables,
        )  # fmt: skip
        self.velocity, self.error = out[n : 2 * n], out[2 * n + 6 :]


def drawn(name: str, seed: int, far: float = 1.0):
    """Return a case's robot and parameters, a configuration drawn within the limits, and a reference near by."""
    rng = np.random.default_rng(seed)
    name, first, tasks, targets = CASES[name]
    robot = arm(name)
    model = robot.model
    low, high = np.maximum(model.lower, -3.0), np.minimum(model.upper, 3.0)
    q = low + rng.uniform(0.1, 0.9, model.n) * (high - low)
    pose = moved(model.forward(q), far * rng.uniform(-1, 1, 6) * [0.01, 0.01, 0.01, 0.03, 0.03, 0.03])
    reference = Reference.pose(pose, far * rng.uniform(-0.2, 0.2, 6))
    return robot, first, {"secondary_tasks": tasks, "secondary_targets": targets}, q, reference


@given(st.sampled_from(sorted(CASES)), SEEDS)
@settings(max_examples=120)
def test_no_lower_task_disturbs_a_higher_one(case, seed):
    """Away from singularities, to 1e-9, in the bare law; against rows worked out here."""
    robot, first, below, q, reference = drawn(case, seed)
    twist = reference.twist
    frame = pin.exp3(0.5 * DT * twist[3:]) @ reference.rotation if first.get("task_frame") == "tool" else np.eye(3)
    rows = selected_rows(first, frame)
    if case == "six joints":
        rows = rows[:3]  # the row of a single rotation axis has a test of its own
    J = robot.model.jacobian(q)
    # A weight alone makes it a stack where nothing else does.
    alone = Cycle(robot, {**first, "joint_weights": [1.0] * robot.model.n}, q, reference)
    assume(alone.sigma > 0.05)
    second = Cycle(robot, {**first, **below}, q, reference)
    all_three = Cycle(robot, {**first, **below, **BELOW}, q, reference)
    for lower in (second, all_three):
        np.testing.assert_allclose(rows @ J @ lower.velocity, rows @ J @ alone.velocity, atol=1e-9)
    np.testing.assert_allclose(alone.error, second.error, atol=1e-15)

    n = robot.model.n
    J1 = rows @ J
    J2 = secondary_jacobian(robot.model, q, below["secondary_tasks"][0])
    part = J2 @ (np.eye(n) - np.linalg.pinv(J1) @ J1)
    if case != "six joints" and np.linalg.svd(part, compute_uv=False).min() > 0.05:
        # The swivel's row here is from differences.
        rough = 1e-9 if below["secondary_tasks"][0] != "swivel" else 1e-7
        np.testing.assert_allclose(J2 @ all_three.velocity, J2 @ second.velocity, atol=rough)


def elbow_angle(model: RobotModel, q) -> tuple[float, float]:
    """Return the swivel angle by its definition, from the joints' poses, and the factor that its row has."""
    data = model.pin_model.createData()
    pin.forwardKinematics(model.pin_model, data, q)
    axis, point = [], []
    for joint, pose in zip(model.pin_model.joints[1:], data.oMi[1:], strict=True):
        axis.append(pose.rotation @ joint.createData().S.ravel()[3:])
        point.append(pose.translation)

    def meeting(one: int, other: int) -> np.ndarray:
        across = [np.eye(3) - np.outer(axis[j], axis[j]) for j in (one, other)]
        return np.linalg.solve(across[0] + across[1], across[0] @ point[one] + across[1] @ point[other])

    shoulder, wrist = meeting(0, 1), meeting(4, 5)
    elbow = point[3] + axis[3] @ (shoulder - point[3]) * axis[3] - shoulder
    line = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
    up = np.array([0.0, 0.0, 1.0]) - line[2] * line
    side = elbow - (line @ elbow) * line
    return math.atan2(line @ np.cross(up, elbow), up @ elbow), float(np.linalg.norm(up) * np.linalg.norm(side))


def secondary_jacobian(model: RobotModel, q, task: str) -> np.ndarray:
    """Return a secondary task's Jacobian by Pinocchio; the swivel angle's by differences."""
    if task == "swivel":
        h = 1e-6
        row = [elbow_angle(model, q + h * e)[0] - elbow_angle(model, q - h * e)[0] for e in np.eye(model.n)]
        wrapped = np.mod(np.array([row]) + math.pi, 2.0 * math.pi) - math.pi
        return elbow_angle(model, q)[1] * wrapped / (2.0 * h)
    kind, frame = task.split()
    data = model.pin_model.createData()
    J = pin.computeFrameJacobian(model.pin_model, data, q, model.pin_model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED)
    return J[3:] if kind == "orientation" else J[["xyz".index(c) for c in kind]]


@given(SEEDS)
def test_two_tasks_are_those_of_the_formula(seed):
    """q̇ = J₁⁺ẋ₁ + (J₂N₁)⁺(ẋ₂ − J₂ J₁⁺ẋ₁), with the library's pseudo-inverse."""
    robot, first, below, q, reference = drawn("two below", seed, far=0.01)
    model = robot.model
    below = {"secondary_tasks": ["yz panda_link4"], "secondary_gains": [3.0]}
    data = model.pin_model.createData()
    pin.framesForwardKinematics(model.pin_model, data, q)
    there = data.oMf[model.pin_model.getFrameId("panda_link4")].translation[1:] + np.array([0.002, -0.001])
    below["secondary_targets"] = there.tolist()
    J1, J2 = model.jacobian(q)[:3], secondary_jacobian(model, q, "yz panda_link4")
    sharp = inverse(J1, "pseudo")
    part = J2 @ (np.eye(7) - sharp @ J1)
    assume(np.linalg.svd(J1, compute_uv=False).min() > 0.05)
    assume(np.linalg.svd(part, compute_uv=False).min() > 0.05)
    error = reference.position - model.forward(q).translation
    velocity = sharp @ (reference.twist[:3] + 50.0 * error)
    velocity = velocity + inverse(part, "pseudo") @ (3.0 * np.array([0.002, -0.001]) - J2 @ velocity)
    result = Cycle(robot, {**first, **below}, q, reference)
    np.testing.assert_allclose(result.velocity, velocity, atol=1e-9)


# -- within the limits


@given(st.sampled_from(sorted(CASES)), SEEDS, st.floats(0.0, 2.0))
@settings(max_examples=120)
def test_within_the_limits_lower_tasks_give_way_first(case, seed, haste):
    """The first task keeps its direction, as fast as without any others; objectives give way before secondary tasks."""
    robot, first, below, q, reference = drawn(case, seed, far=10.0**haste / 30.0)
    n = robot.model.n
    free = Cycle(robot, {**first, **below, **BELOW}, q, reference)
    assume(free.sigma > 0.05)
    alone = Cycle(robot, {**first, "joint_weights": [1.0] * n}, q, reference, limited=True)
    result = Cycle(robot, {**first, **below, **BELOW}, q, reference, limited=True)
    assert result.scale == pytest.approx(alone.scale, abs=1e-5)
    frame = np.eye(3)
    if first.get("task_frame") == "tool":
        frame = pin.exp3(0.5 * DT * reference.twist[3:]) @ reference.rotation
    rows = selected_rows(first, frame)[:3] if case == "six joints" else selected_rows(first, frame)
    A = rows @ robot.model.jacobian(q)
    if result.how != 2:
        np.testing.assert_allclose(A @ result.velocity, result.scale * (A @ free.velocity), atol=1e-9)
    # Where both tasks can be kept, only the objectives give way.
    B = secondary_jacobian(robot.model, q, below["secondary_tasks"][0])
    step = robot.model.acceleration_limit * DT  # from rest, this is what a cycle allows
    both = np.vstack((A, B))
    goal = both @ free.velocity
    flag = daqp.solve(
        np.eye(n), np.zeros(n), both, np.concatenate((0.98 * step, goal)), np.concatenate((-0.98 * step, goal)),
        np.array([0] * n + [5] * len(goal), dtype=np.int32),
    )[2]  # fmt: skip
    singular = np.linalg.svd(B @ (np.eye(n) - np.linalg.pinv(A) @ A), compute_uv=False).min() < 0.05
    if flag == 1 and not singular and case != "six joints":
        np.testing.assert_allclose(
            B @ result.velocity, B @ free.velocity, atol=2e-3 * np.abs(step).max() + 1e-4 * np.abs(goal).max()
        )


# -- the axes of the first task


def follow(robot: Robot, changes, target, cycles: int, q=None):
    """Follow target(t) from home or q; return the steps."""
    controller = started(robot, q, **changes)
    steps = []
    for k in range(cycles):
        reference = Reference.between(target(k * DT), target((k + 1) * DT), DT)
        steps.append(controller.step(controller.position, reference, DT))
    return steps


def test_an_axis_symmetric_tool_may_be_turned_any_way(panda):
    """From any turn about its own axis, even half a turn away, the axis comes to the target's at the rate of K."""
    home = panda.model.forward(panda.home)
    for turn in (0.5, 3.1, -2.0):
        tilt = pin.exp3(1e-3 * np.array([1.0, 0.5, 0.0]))
        target = pin.SE3(tilt @ home.rotation @ pin.exp3(np.array([0.0, 0.0, turn])), home.translation)
        steps = follow(panda, {"task_axes": "xyzrp", "task_frame": "tool"}, lambda t, target=target: target, 40)
        axes = [panda.model.forward(step.position).rotation[:, 2] for step in steps]
        angles = [np.linalg.norm(np.cross(a, target.rotation[:, 2])) for a in axes]
        assert angles[-1] / angles[19] == pytest.approx(0.95**20, rel=1e-3)
        assert abs(steps[-1].error[3:] @ target.rotation[:, 2]) < 1e-15
        assert np.abs(steps[-1].position - panda.home).max() < 0.05  # it has not turned


MOVING = {
    "drill": ({"task_axes": "xyzrp", "task_frame": "tool"}, lambda D, e, R, R_d: (e, D.T @ R_d[:, 2] - R_d[:, 2])),
    "upright": ({"task_axes": "xyzrp"}, lambda D, e, R, R_d: (e, R.T[:, 2] - R_d.T[:, 2])),
    "position": ({"task_axes": "xyz"}, lambda D, e, R, R_d: (e, np.zeros(3))),
    "orientation": ({"task_axes": "rpy"}, lambda D, e, R, R_d: (np.zeros(3), pin.log3(D))),
    "along the tool": (
        {"task_axes": "xyrpy", "task_frame": "tool"},
        lambda D, e, R, R_d: ((R_d.T @ e)[:2], pin.log3(D)),
    ),
    "yaw": (
        {"task_axes": "xyzy"},
        lambda D, e, R, R_d: (e, [math.atan2(*pin.Quaternion(D).coeffs()[[2, 3]])]),
    ),
}


@pytest.mark.parametrize("case", MOVING)
def test_selected_axes_follow_a_moving_target_to_nanometres(panda, case):
    """The others are far off and stay so: turned, or 5 cm away; the reference's motion counts where the tool is."""
    changes, errors = MOVING[case]
    home = panda.model.forward(panda.home)
    off = {"drill": (0, 0, 0, 0, 0, 0.6), "upright": (0, 0, 0, 0, 0, 0.6), "along the tool": (0, 0, 0.05, 0, 0, 0)}
    start = moved(home, np.array(off.get(case, np.zeros(6))))

    def target(t: float):
        return figure_eight(start, t)

    cycles = 1500
    steps = follow(panda, changes, target, cycles)
    tool, goal = panda.model.forward(steps[-1].position), target(cycles * DT)
    R, R_d = tool.rotation, goal.rotation
    position, rotation = errors(R_d @ R.T, goal.translation - tool.translation, R, R_d)
    assert np.abs(position).max() < 1e-7
    assert np.abs(rotation).max() < 1e-7
    assert np.abs(difference(goal, tool)).max() > 1e-3  # or nothing would have been free
    np.testing.assert_allclose(steps[-1].error, 0.0, atol=1e-6)


def test_a_twist_alone_moves_the_selected_axes(panda):
    """Twist of the tool about an axis that is free does nothing; along one that is not, it does."""
    controller = started(panda, task_axes="xyzrp", task_frame="tool")
    home = panda.model.forward(panda.home)
    twist = np.concatenate((0.05 * home.rotation[:, 2], 0.5 * home.rotation[:, 2]))
    for _ in range(200):
        controller.step(controller.position, Reference.velocity(twist), DT)
    way = home.inverse() * panda.model.forward(controller.position)
    assert way.translation[2] == pytest.approx(0.01, rel=0.03)
    np.testing.assert_allclose(way.translation[:2], 0.0, atol=1e-6)
    assert np.linalg.norm(pin.log3(way.rotation)) < 0.02  # it would be 0.1


# -- tolerances


def test_within_its_tolerance_an_axis_is_let_be(panda):
    home = panda.model.forward(panda.home)
    tolerance = {"task_tolerance": [0.0, 0.01, 0.0, 0.0, 0.0, 0.0]}
    near, beyond = (moved(home, np.array([0, y, 0, 0, 0, 0])) for y in (0.008, 0.02))
    steps = follow(panda, tolerance, lambda t: near, 50)
    assert np.abs(steps[-1].position - panda.home).max() < 1e-12
    assert np.abs(steps[-1].error).max() < 1e-15
    steps = follow(panda, tolerance, lambda t: beyond, 400)
    left = difference(beyond, panda.model.forward(steps[-1].position))
    np.testing.assert_allclose(left, [0, 0.01, 0, 0, 0, 0], atol=1e-6)
    assert steps[1].error[1] == pytest.approx(0.01, abs=1e-4)  # measured from the edge
    assert steps[1].error[1] > steps[100].error[1] > 0.0


def test_a_moving_target_stays_in_its_band(panda):
    """The tool waits until the edge of its band comes near, and never leaves the band; the exact axes stay exact."""
    home = panda.model.forward(panda.home)
    band = 0.004
    controller = started(panda, task_tolerance=[0.0, band, 0.0, 0.0, 0.0, 0.0])
    worst, exact = 0.0, 0.0
    for k in range(1500):
        now, then = (moved(home, np.array([0, 0.05 * math.sin(2.0 * j * DT), 0, 0, 0, 0])) for j in (k, k + 1))
        step = controller.step(controller.position, Reference.between(now, then, DT), DT)
        left = difference(then, panda.model.forward(step.position))
        worst, exact = max(worst, abs(left[1])), max(exact, np.abs(np.delete(left, 1)).max())
        assert not step.error.any() or np.abs(step.error).max() < 1e-6
    assert 0.5 * band < worst <= band * (1.0 + 1e-6)
    assert exact < 1e-6


def test_what_is_below_may_use_the_band(panda):
    """A tool that may tilt a little lets the joints come nearer to their middle."""
    home = panda.model.forward(panda.home)
    free = {"objectives": ["joint_centring"], "objective_gains": [20.0]}
    middle = panda.model.middle()
    half = 0.5 * (panda.model.upper - panda.model.lower)

    def off(changes) -> float:
        q = follow(panda, changes, lambda t: home, 1500)[-1].position
        error = np.abs(difference(home, panda.model.forward(q)))
        assert (error <= np.array([0, 0, 0, *[changes.get("task_tolerance", [0] * 6)[3]] * 3]) + 2e-4).all()
        return float(np.linalg.norm((q - middle) / half))

    assert off({**free, "task_tolerance": [0, 0, 0, 0.1, 0.1, 0.1]}) < off(free) - 0.01


# -- secondary tasks and objectives, in a run


def test_the_elbow_turns_and_the_tool_stays(panda):
    home = panda.model.forward(panda.home)
    controller = started(panda, secondary_tasks=["swivel"], secondary_targets=[0.5], secondary_gains=[4.0])
    far = abs(elbow_angle(panda.model, panda.home)[0] - 0.5)
    assert far > 0.3
    for _ in range(2000):
        step = controller.step(controller.position, Reference.pose(home), DT)
        assert np.abs(difference(home, panda.model.forward(step.position))).max() < 1e-7
    assert abs(elbow_angle(panda.model, step.position)[0] - 0.5) < 0.01 * far


def test_weights_are_those_of_the_weighted_inverse(panda):
    """And with every weight the same, nothing changes."""
    rng = np.random.default_rng(3)
    weights = [1.0, 2.0, 30.0, 1.0, 5.0, 1.0, 100.0]
    for _ in range(10):
        q = panda.home + rng.uniform(-0.4, 0.4, 7)
        J = panda.model.jacobian(q)
        assert np.linalg.svd(J, compute_uv=False).min() > 0.05
        twist = rng.uniform(-0.2, 0.2, 6)
        reference = Reference.pose(panda.model.forward(q), twist)
        velocity = Cycle(panda, {"joint_weights": weights}, q, reference).velocity
        np.testing.assert_allclose(velocity, weighted_right(J, np.diag(weights)) @ twist, atol=1e-9)
        same = Cycle(panda, {"joint_weights": [7.0] * 7}, q, reference).velocity
        np.testing.assert_allclose(same, inverse(J, "right") @ twist, atol=1e-9)


def test_parameters_may_change_in_motion_within_the_limits(panda):
    controller = started(panda)
    home = panda.model.forward(panda.home)
    changes = [
        {"task_axes": "xyz"},
        {"task_axes": "xyzrp", "task_frame": "tool", "objectives": ["joint_centring"], "objective_gains": [50.0]},
        {"task_axes": "xyzrpy", "secondary_tasks": ["swivel"], "secondary_targets": [-1.5], "secondary_gains": [20.0]},
        {"task_tolerance": [0.01] * 6},
        {"joint_weights": [1, 1, 50, 1, 1, 1, 1], "task_tolerance": []},
    ]
    v = controller.velocity
    for k in range(600):
        if k % 100 == 50:
            controller.set_parameters(controller.parameters.replace(changes[k // 100] if k < 500 else {}))
        now, then = (figure_eight(home, 1.0 + j * DT) for j in (k, k + 1))
        step = controller.step(controller.position, Reference.between(now, then, DT), DT)
        assert (np.abs(step.velocity - v) <= panda.model.acceleration_limit * DT * (1 + 1e-9)).all()
        v = step.velocity


def test_the_tools_bounds_hold_with_selected_axes_too(panda):
    """A drill on its way to a far target, with the elbow turning: speed and acceleration of the tool."""
    bounds = {"tool_linear_speed": 0.1, "tool_linear_acceleration": 0.5}
    tasks = {"task_axes": "xyzrp", "task_frame": "tool", "secondary_tasks": ["swivel"], "secondary_targets": [0.4]}
    home = panda.model.forward(panda.home)
    target = moved(home, np.array([0.1, -0.1, 0.1, 0.0, 0.0, 0.0]))
    places = [
        panda.model.forward(step.position).translation
        for step in follow(panda, {**bounds, **tasks}, lambda t: target, 600)
    ]
    speeds = np.diff(places, axis=0) / DT
    assert 0.095 < np.linalg.norm(speeds, axis=1).max() < 0.1001
    assert np.linalg.norm(np.diff(speeds, axis=0), axis=1).max() / DT < 0.52


def test_a_session_goes_on_bit_for_bit_from_its_state(panda):
    """Tasks are taken in motion, by an event; the state of any moment is enough to go on from."""
    names, home = panda.model.joint_names, panda.model.forward(panda.home)
    tasks = {
        "task_axes": "xyzrp",
        "task_frame": "tool",
        "task_tolerance": 1e-3,
        "secondary_tasks": ["swivel"],
        "secondary_targets": [0.4],
        "objectives": ["limit_repulsion", "manipulability"],
        "joint_weights": [1, 2, 3, 1, 2, 3, 1],
    }

    def run(session: Session, cycles, q):
        log = []
        for k in cycles:
            now = 10**18 + k * session.period
            session.take("joint_states", JointStateWriter(names).write(now, q, np.zeros(7)), now)
            pose = figure_eight(home, 1.0 + k * DT)
            session.take("target_pose", pose_message(now, panda.model.base_frame, pose), now)
            if k == 20:
                session.apply(json.dumps({"do": "parameters", "values": tasks}))
            q = session.cycle(now).position
            log.append(q.tobytes())
        return log, q

    whole = Session(panda.model, panda.parameters)
    begun, q = run(whole, range(40), panda.home)
    other = Session(panda.model, panda.parameters)
    other.apply(whole.state())
    assert run(whole, range(40, 80), q)[0] == run(other, range(40, 80), q)[0]
    assert len(set(begun)) > 30


def test_a_deficient_arm_works_in_the_axes_it_has():
    robot = arm("planar")
    start = robot.model.forward(robot.home)
    target = moved(start, np.array([-0.05, 0.08, 0.0, 0.0, 0.0, 0.0]))
    changes = {"task_axes": "xy", "objectives": ["manipulability"]}
    step = follow(robot, changes, lambda t: target, 1500)[-1]
    assert np.abs(difference(target, robot.model.forward(step.position))[:2]).max() < 1e-6
    assert not step.status.damped


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"task_axes": "zyx"}, ["task_axes = 'zyx'", "xyzrpy"]),
        ({"task_axes": ""}, ["task_axes = ''"]),
        ({"task_frame": "world"}, ["task_frame", "base, tool"]),
        ({"secondary_tasks": ["swivle"]}, ["'swivle'", "'position FRAME'"]),
        ({"secondary_tasks": ["z"]}, ["'z'", "'z FRAME'"]),
        ({"secondary_tasks": ["position nowhere"]}, ["'nowhere'", "panda_link4"]),
        ({"secondary_tasks": ["position panda_link0"]}, ["'panda_link0'", "panda_link4"]),
        ({"secondary_tasks": ["swivel"]}, ["secondary_targets", "needs 1"]),
        ({"secondary_targets": [1.0], "joint_weights": [1.0] * 7}, ["secondary_targets: 1 values more"]),
        ({"secondary_tasks": ["orientation panda_link4"], "secondary_targets": [0, 0, 0, 2]}, ["norm", "panda_link4"]),
        ({"secondary_tasks": ["swivel"], "secondary_targets": [0], "secondary_gains": [1, 2]}, ["secondary_gains"]),
        ({"objectives": ["speed"]}, ["'speed'", "joint_centring", "manipulability"]),
        ({"objectives": ["joint_centring"], "objective_gains": [1, 2]}, ["objective_gains: 2 values, need 1"]),
        ({"joint_weights": [1, 2]}, ["joint_weights: 2 values, need 7", "panda_joint1"]),
        ({"task_axes": "xyz", "inverse": "transpose"}, ["inverse = 'transpose'", "numerical_filtering"]),
        ({"task_axes": "xyz", "orientation_error": "quaternion"}, ["orientation_error", "exponential_base"]),
    ],
)
def test_mistakes_are_named(panda, changes, words):
    with pytest.raises(ParameterError) as caught:
        Controller(panda.model, panda.parameters.replace(changes))
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


RECIPES = re.findall(
    r"^```yaml\n(.*?)^```$",
    (Path(__file__).parents[2] / "docs" / "tasks.md").read_text(encoding="utf-8"),
    re.MULTILINE | re.DOTALL,
)


@pytest.mark.parametrize("text", RECIPES, ids=lambda text: text.split()[-1])
def test_recipes_of_the_documentation_run(panda, text):
    controller = started(panda, **yaml.safe_load(text))
    home = panda.model.forward(panda.home)
    for _ in range(3):
        step = controller.step(controller.position, Reference.pose(home), DT)
    assert step.status.limit is Limit.NONE or step.status.scale > 0.99


def test_the_swivel_task_needs_an_arm_that_has_one(ur5e):
    with pytest.raises(ParameterError, match="7-joint"):
        Controller(ur5e.model, ur5e.parameters.replace({"secondary_tasks": ["swivel"], "secondary_targets": [0.0]}))
