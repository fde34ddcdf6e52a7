"""Through singularities, at the edge of reach, at joint limits: bounded, continuous, at rest at the closest approach,
and always a way back. The ideal arm: what is commanded is where it is."""

from __future__ import annotations

import math

import arms
import numpy as np
import pytest
from motions import Robot, arm, bundled, difference, moved, started

from ik_controller import Controller, ControllerParameters, Reference, RobotModel
from ik_controller.control.status import Code, Limit

DT = 1e-3


def shoulder_of_the_ur5e() -> float:
    """Return the lift at which the UR5e's wrist stands above the first axis: where the tool cannot move sideways."""
    model, lifts = bundled("ur5e").model, np.linspace(-1.5, -0.3, 4001)
    sigma = [np.linalg.svd(model.jacobian([0.2, lift, -2.0, -0.6, -1.2, 0.3]))[1][-1] for lift in lifts]
    assert min(sigma) < 1e-3
    return float(lifts[int(np.argmin(sigma))])


# (arm, configuration, the joint that turns through, from how far before)
PASSES = {
    "ur5e wrist": ("ur5e", [0.2, -1.2, 1.4, -1.0, 0.0, 0.3], 4, 0.4),
    "ur5e elbow": ("ur5e", [0.2, -1.2, 0.0, -1.0, -1.3, 0.3], 2, 0.4),
    "ur5e shoulder": ("ur5e", [0.2, None, -2.0, -0.6, -1.2, 0.3], 1, 0.3),
    "panda wrist": ("panda", [0.1, -0.6, 0.1, -2.2, math.pi / 2, 0.35, 0.7], 4, 0.4),
    "panda shoulder": ("panda", [0.1, 0.0, math.pi / 2, -2.2, 0.1, 1.6, 0.7], 1, 0.4),
}


@pytest.mark.parametrize("offset", [0.0, 1.0], ids=["through", "beside"])
@pytest.mark.parametrize("speed", [0.2, 1.0])
@pytest.mark.parametrize("case", PASSES)
def test_passes_through_and_beside_a_singularity(case, speed, offset):
    """A pose stream that a joint motion makes, and one a centimetre and 3° beside it: the gate lets every command
    through, so velocity and acceleration are within limits; a second after the singularity, nothing is left of it.
    """
    name, middle, joint, before = PASSES[case]
    robot = bundled(name)
    middle = np.array([shoulder_of_the_ur5e() if value is None else value for value in middle])
    duration = 2.0 * before / speed

    def pose(t: float):
        share = min(max(t / duration, 0.0), 1.0)
        q = middle.copy()
        q[joint] += before * (1.0 - 2.0 * share * share * (3.0 - 2.0 * share))
        aside = offset * math.sin(math.pi * share) ** 2 * np.array([0.005, 0.01, 0.0, 0.05, 0.0, 0.0])
        return moved(robot.model.forward(q), aside)

    start = middle.copy()
    start[joint] += before
    controller, q, now = started(robot, start), start, pose(0.0)
    left, errors = 0, []
    for k in range(round((duration + 1.0) / DT)):
        then = pose((k + 1) * DT)
        step = controller.step(q, Reference.between(now, then, DT), DT)
        assert step.status.code is Code.TRACKING
        q, now = step.position, then
        if step.status.smallest_singular_value < 2 * robot.parameters.singular_value_threshold:
            left = k + 1
        errors.append(np.abs(difference(then, robot.model.forward(q))).max())
    assert left > 0 or name == "panda"
    late = errors[left + 1000 :] or errors[-1:]
    assert max(late) < 1e-6


def run_to_rest(controller: Controller, target, limit: float, cycles: int = 6000) -> None:
    """Go towards a target until nothing moves faster than `limit`, for a tenth of a second."""
    still = 0
    for _ in range(cycles):
        step = controller.step(controller.position, Reference.pose(target), DT)
        still = still + 1 if np.abs(step.velocity).max() < limit else 0
        if still > 100:
            return
    raise AssertionError(f"still moving at {np.abs(step.velocity).max():.2g} rad/s")


@pytest.mark.parametrize("name", ["ur5e", "panda"])
@pytest.mark.parametrize("direction", [(1, 0, 0), (0, -1, 0), (0.5, 0.5, 0.7)])
def test_the_closest_approach_is_at_rest_and_every_way_back_is_open(name, direction):
    robot = bundled(name)
    home = robot.model.forward(robot.home)
    controller = started(robot)
    far = moved(home, np.append(1.5 * np.array(direction) / np.linalg.norm(direction), np.zeros(3)))
    run_to_rest(controller, far, 0.02)  # slower and slower, without chatter
    stopped = controller.position
    edge = robot.model.forward(stopped)
    for back in (home, moved(home, np.array([0, 0, -0.1, 0, 0, 0])), moved(home, np.array([0, 0.1, 0.1, 0, 0, 0.3]))):
        again = started(robot, stopped)
        for _ in range(4000):
            step = again.step(again.position, Reference.pose(back), DT)
        assert np.abs(difference(back, robot.model.forward(step.position))).max() < 1e-6, difference(back, edge)


def rest_beyond_reach(name: str, seed: int, seconds: float = 12.0) -> float:
    """Send an arm to a pose out of reach, drawn by `seed`; return the largest share of the speed limits in the end."""
    robot = arm(name)
    random = np.random.default_rng(seed)
    way = random.normal(size=3)
    way *= random.uniform(1.0, 3.0) / np.linalg.norm(way)
    turn = random.normal(size=3) * random.choice([0.0, 0.5])
    target = Reference.pose(moved(robot.model.forward(robot.home), np.concatenate((way, turn))))
    controller, speeds = started(robot), []
    for _ in range(round(seconds / DT)):
        step = controller.step(controller.position, target, DT)
        speeds.append(np.abs(step.velocity / robot.model.velocity_limit).max())
        if len(speeds) > 1000 and max(speeds[-500:]) < 1e-3:
            assert step.status.closest or np.abs(step.error).max() < 1e-6  # a long way may lead to the other side
            return max(speeds[-500:])
    return max(speeds[-500:])


@pytest.mark.parametrize(("name", "seed"), [("panda", 2), ("panda", 7), ("ur5e", 1), ("scara", 2), ("planar_3r", 1)])
def test_a_target_out_of_reach_is_approached_to_rest(name, seed):
    """Stretched out, at joint bounds, or both: not thrown about, and not chattering between two ways."""
    assert rest_beyond_reach(name, seed) < 1e-3


@pytest.mark.soak
@pytest.mark.parametrize("name", ["panda", "ur5e", "scara", "planar_2r", "planar_3r"])
def test_forty_targets_out_of_reach_are_approached_to_rest(name):
    moving = {seed: speed for seed in range(40) if (speed := rest_beyond_reach(name, seed)) >= 1e-3}
    assert not moving


def limited_ur5e() -> Robot:
    """The UR5e with 0.3 rad less than it needs of joint 1."""
    robot = bundled("ur5e")
    model = RobotModel.from_urdf(robot.model.urdf_text, robot.model.tip_frame, robot.model.base_frame)
    upper = model.upper.copy()
    upper[0] = robot.home[0] + 0.3
    model.set_limits(upper=upper, acceleration=robot.model.acceleration_limit)
    return Robot(model, robot.parameters, robot.home)


def test_a_target_beyond_a_joint_limit_is_approached_along_the_limit():
    """Six joints, none to spare: the arm slides along the bound to where no joint could bring it nearer, and rests."""
    robot = limited_ur5e()
    beyond = robot.home.copy()
    beyond[0] += 0.6
    target = robot.model.forward(beyond)
    controller, speeds, errors = started(robot), [], []
    for _ in range(6000):
        step = controller.step(controller.position, Reference.pose(target), DT)
        speeds.append(np.abs(step.velocity).max())
        errors.append(np.linalg.norm(step.error))
    q = step.position
    assert max(speeds[-500:]) < 1e-6  # at rest, without chatter
    assert q[0] == pytest.approx(robot.model.upper[0], abs=1e-9)
    slope = robot.model.jacobian(q).T @ step.error  # of ½‖e‖²: only the joint at its bound would help
    assert slope[0] > 1e-3
    assert np.abs(slope[1:]).max() < 1e-6
    reached = np.argmax(np.array(errors) < errors[-1] + 1e-3)
    assert (np.diff(errors[:reached]) < 1e-9).all()  # never further away on the way
    assert (step.status.limit, step.status.joint) == (Limit.POSITION, 0)
    assert not step.status.feasible

    back = robot.model.forward(robot.home)
    for _ in range(3000):
        step = controller.step(controller.position, Reference.pose(back), DT)
    assert np.abs(difference(back, robot.model.forward(step.position))).max() < 1e-8


def test_a_line_that_a_joint_limit_cuts_is_followed_exactly_up_to_it():
    robot = limited_ur5e()
    controller, home = started(robot), robot.model.forward(robot.home)
    q = robot.home.copy()
    path = [robot.model.forward(q + np.append(0.4 * k / 2000, np.zeros(5))) for k in range(2001)]
    for k in range(2000):
        step = controller.step(controller.position, Reference.between(path[k], path[k + 1], DT), DT)
        off = np.abs(difference(path[k + 1], robot.model.forward(step.position))).max()
        if k > 300 and 0.4 * (k + 1) / 2000 < 0.296 - 1e-6:  # for the last v²/2a it brakes
            assert off < 1e-6
    assert off > 1e-3
    for k in range(2000, 0, -1):  # and back
        step = controller.step(controller.position, Reference.between(path[k], path[k - 1], DT), DT)
    assert np.abs(difference(home, robot.model.forward(step.position))).max() < 1e-6


@pytest.mark.parametrize("name", ["planar_2r", "planar_3r", "scara"])
def test_arms_of_few_joints_track_as_others_do(name):
    """What they cannot do is no singularity: a fast circle in the axes they have is followed exactly."""
    model = RobotModel.from_urdf(getattr(arms, name)(), "tool")
    model.set_limits(velocity=[20.0] * model.n, acceleration=[500.0] * model.n)
    controller = Controller(model, ControllerParameters())
    middle = model.middle() + np.linspace(0.5, 0.9, model.n) * np.where(model.prismatic, 0.1, 1.0)

    def path(t: float) -> np.ndarray:
        return middle + np.where(model.prismatic, 0.02, 0.2) * np.sin(8.0 * t + np.arange(model.n))

    q = path(0.0)
    controller.reset(q)
    errors = []
    for k in range(1000):
        now, then = model.forward(path(k * DT)), model.forward(path((k + 1) * DT))
        step = controller.step(q, Reference.between(now, then, DT), DT)
        q = step.position
        errors.append(np.abs(difference(then, model.forward(q))).max())
        assert not step.status.damped
    assert max(errors[300:]) < 1e-6
    # And from 0.5 m or rad away: K e in full, as for an arm of six joints.
    assert step.status.smallest_singular_value > 0.04


def test_a_stretched_arm_bends_again():
    """From exactly the singular configuration, pulled straight inward, where first order sees no way."""
    model = RobotModel.from_urdf(arms.planar_2r(), "tool")
    for start in ([0.4, 0.0], [0.0, 0.0]):
        controller = Controller(model, ControllerParameters())
        controller.reset(start)
        target = model.forward(np.add(start, [-0.4, 0.8]))
        for _ in range(4000):
            step = controller.step(controller.position, Reference.pose(target), DT)
        assert np.abs(difference(target, model.forward(step.position))).max() < 1e-6


def test_the_status_says_which_direction_is_lost_and_how_far_the_target_is():
    robot = bundled("ur5e")
    home = robot.model.forward(robot.home)
    controller = started(robot)
    away = home.translation / np.linalg.norm(home.translation)
    far = moved(home, np.append(away, np.zeros(3)))
    for _ in range(4000):
        step = controller.step(controller.position, Reference.pose(far), DT)
    assert step.status.closest
    status = controller.explain(step.status)
    left, values, _ = np.linalg.svd(robot.model.jacobian(controller.position))
    assert status.smallest_singular_value == pytest.approx(values[-1], abs=1e-9)
    assert status.condition_number == pytest.approx(values[0] / values[-1], rel=1e-3)
    assert abs(np.dot(status.singular_direction, left[:, -1])) == pytest.approx(1.0, abs=1e-6)
    assert status.position_error == pytest.approx(np.linalg.norm(step.error[:3]))
    assert "at rest at the closest approach" in status.sentence()
    assert "cannot move along" in status.sentence()
