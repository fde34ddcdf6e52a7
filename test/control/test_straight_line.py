"""Straight lines that ask for more than the joints can give, and the tool's own bounds."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from motions import bundled, difference, moved, started

from ik_controller import ControllerParameters, Reference
from ik_controller.control.status import Limit
from ik_controller.control.targets import Targets

WAY = np.array([0.1, 0.5, -0.3])  # of a line through the Panda's workspace [m]


def line(robot, seconds: float, t: float):
    """Return the pose at t [s] of a straight line of `WAY`, gone in `seconds` at constant speed."""
    home = robot.model.forward(robot.home)
    share = min(max(t / seconds, 0.0), 1.0)
    return moved(home, np.append((share - 0.5) * WAY, np.zeros(3)))


def off_line(robot, pose) -> float:
    """Return how far [m] a pose is from the line, or [rad] turned off it."""
    change = difference(pose, robot.model.forward(robot.home))
    along = WAY / np.linalg.norm(WAY)
    aside = change[:3] - (change[:3] @ along) * along
    return float(max(np.linalg.norm(aside), np.linalg.norm(change[3:])))


def references(kind: str, robot, seconds: float, parameters: ControllerParameters, dt: float):
    """Yield each cycle's reference, the line given in one of the ways that a client may give it, until it has ended."""
    targets = Targets(parameters)
    period, start = round(1e9 * dt), 1_000_000_000
    twist = np.append(WAY / seconds, np.zeros(3))
    end = start + round(1e9 * seconds)
    if kind == "trajectory":
        points = [(start + round(1e9 * t), line(robot, seconds, t)) for t in (0.0, seconds)]
        targets.set_trajectory(
            start, [(time, pose.translation.copy(), pose.rotation.copy(), twist.copy()) for time, pose in points]
        )
    sent = 0
    for now in range(start, end + 3_000_000_000, period):
        while kind != "trajectory" and start + sent * 10_000_000 <= now:  # 100 Hz, also after the end
            stamp = start + sent * 10_000_000
            pose = line(robot, seconds, (stamp - start) * 1e-9)
            targets.add_pose(stamp, now, pose.translation.copy(), pose.rotation.copy())
            if kind == "poses and twists":
                targets.add_twist(stamp, now, twist if stamp < end else np.zeros(6))
            sent += 1
        yield targets.reference(now, dt)


def at_start(robot) -> np.ndarray:
    """Return joints at the line's start."""
    controller = started(robot)
    for _ in range(1500):
        step = controller.step(controller.position, Reference.pose(line(robot, 1.0, 0.0)), 1e-3)
    return step.position


@pytest.mark.parametrize("kind", ["poses", "poses and twists", "trajectory"])
@pytest.mark.parametrize(("rate", "scales"), [(1000.0, (0.2, 1.0)), (500.0, (0.2, 1.0)), (1000.0, (0.2, 0.1))])
def test_a_line_too_fast_for_the_joints_is_left_by_less_than_a_micrometre(kind, rate, scales):
    """The line asks for 1.2 m/s, the joints at a fifth of their speeds give a third of it."""
    robot = bundled("panda")
    changes = {"rate": rate, "velocity_scale": scales[0], "acceleration_scale": scales[1]}
    controller = started(robot, at_start(robot), **changes)
    worst, slowest = 0.0, 1.0
    for reference in references(kind, robot, 0.5, controller.parameters, 1.0 / rate):
        step = controller.step(controller.position, reference, 1.0 / rate)
        worst = max(worst, off_line(robot, robot.model.forward(step.position)))
        slowest = min(slowest, step.status.scale)
    assert slowest < 0.5
    assert worst < 1e-6
    assert np.abs(difference(line(robot, 0.5, 1.0), robot.model.forward(step.position))).max() < 1e-6


def test_a_joint_held_at_its_limit_costs_no_accuracy():
    """With one joint kept from moving on, a smooth line is tracked as exactly as without, from start to end. What error
    there is comes of the steps in time and of the joints' path, which is another one for each joint held.
    """
    robot = bundled("panda")
    start, errors = at_start(robot), {}
    shares = np.linspace(0.0, 1.0, 2001)
    poses = [line(robot, 1.0, s * s * s * (10 - 15 * s + 6 * s * s)) for s in shares]
    for held in (None, 0, 2, 4):
        upper = robot.model.upper.copy()
        if held is not None:
            upper[held] = start[held]
        limited = type(robot)(_with_bounds(robot.model.lower, upper), robot.parameters, robot.home)
        controller = started(limited, start)
        errors[held] = 0.0
        for now, then in pairwise(poses):
            step = controller.step(controller.position, Reference.between(now, then, 1e-3), 1e-3)
            errors[held] = max(errors[held], np.abs(difference(then, limited.model.forward(step.position))).max())
            assert step.status.scale == 1.0
            assert (step.position <= upper + 1e-12).all()
        if held is not None:
            assert abs(step.position[held] - start[held]) < 0.1  # it moves by 0.2 to 0.9 rad where it may
    assert errors[None] < 1e-8
    assert max(errors.values()) < 1e-8


# Limits of the real arm (libfranka).
ACCELERATION = [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]
JERK = [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0]


@pytest.mark.parametrize("jerk", [np.inf, 1.0, 0.1], ids=["no jerk limits", "its own", "a tenth of them"])
@pytest.mark.parametrize(("share", "seconds"), [(1.0, 0.15), (0.3, 0.4)])
def test_a_line_too_fast_is_kept_under_the_real_arms_limits(jerk, share, seconds):
    """The line asks for three to five times what the joints give, with their own accelerations and jerks."""
    robot = bundled("panda")
    model = _with_bounds(robot.model.lower, robot.model.upper)
    model.set_limits(
        lower=model.lower, upper=model.upper, acceleration=ACCELERATION, jerk=[jerk * limit for limit in JERK]
    )
    limited = type(robot)(model, robot.parameters, robot.home)
    controller = started(limited, at_start(robot), velocity_scale=share)
    worst, slowest = 0.0, 1.0
    for reference in references("trajectory", robot, seconds, controller.parameters, 1e-3):
        step = controller.step(controller.position, reference, 1e-3)
        worst = max(worst, off_line(robot, model.forward(step.position)))
        slowest = min(slowest, step.status.scale)
        if slowest < 1.0 and np.abs(difference(line(robot, seconds, 1.0), model.forward(step.position))).max() < 1e-6:
            break
    assert slowest < 0.5
    assert worst < 1e-6
    assert np.abs(difference(line(robot, seconds, 1.0), model.forward(step.position))).max() < 1e-6


def _with_bounds(lower, upper):
    from ik_controller.robots import build_model, bundled_parameters

    model = build_model(bundled_parameters("panda"))
    model.set_limits(lower=lower, upper=upper)
    return model


BOUNDS = {
    "tool_linear_speed": 0.3,
    "tool_angular_speed": 0.5,
    "tool_linear_acceleration": 2.0,
    "tool_angular_acceleration": 4.0,
}


def assert_tool_bounds_hold(poses: list, dt: float) -> None:
    """Hold the tool's poses, dt [s] apart, against BOUNDS."""
    twists = np.array([difference(then, now) / dt for now, then in pairwise(poses)])
    changes = np.diff(twists, axis=0) / dt
    for part, kind in ((slice(0, 3), "linear"), (slice(3, 6), "angular")):
        fastest = np.linalg.norm(twists[:, part], axis=1).max()
        hardest = np.linalg.norm(changes[:, part], axis=1).max()
        assert fastest <= BOUNDS[f"tool_{kind}_speed"] * (1 + 1e-3)
        assert hardest <= BOUNDS[f"tool_{kind}_acceleration"] * 1.1


@pytest.mark.parametrize(
    "change", [[0.2, 0.2, -0.2, 0, 0, 0], [0, 0, 0, 0.5, -0.3, 0.4], [0.1, -0.2, 0, 0.1, 0.2, 0.3]]
)
def test_the_tools_own_bounds_hold_while_tracking_and_stopping(change):
    """Measured on the stream of commands by an independent forward kinematics."""
    robot = bundled("panda")
    controller = started(robot, **BOUNDS)
    home = robot.model.forward(robot.home)
    target = moved(home, np.array(change, dtype=float))
    poses, limits, dt = [home], set(), 1e-3
    for k in range(3500):
        reference = Reference.pose(target) if k < 300 or 900 < k < 3200 else None
        step = controller.step(controller.position, reference, dt)
        limits.add(step.status.limit)
        poses.append(robot.model.forward(step.position))
    assert_tool_bounds_hold(poses, dt)
    assert {Limit.TOOL_SPEED, Limit.TOOL_ACCELERATION} & limits
    assert np.abs(difference(target, poses[3199])).max() < 1e-4


def test_the_tools_own_bounds_hold_towards_joint_targets_too():
    robot = bundled("panda")
    controller = started(robot, **BOUNDS)
    target = robot.home + np.array([0.6, 0.3, -0.5, 0.4, 0.2, -0.3, 0.8])
    poses, limits, dt = [robot.model.forward(robot.home)], set(), 1e-3
    for k in range(4000):
        reference = None if 300 < k < 600 else Reference.joint(target)
        step = controller.step(controller.position, reference, dt)
        limits.add(step.status.limit)
        poses.append(robot.model.forward(step.position))
    assert_tool_bounds_hold(poses, dt)
    assert {Limit.TOOL_SPEED, Limit.TOOL_ACCELERATION} <= limits
    np.testing.assert_allclose(step.position, target, atol=1e-6)


@pytest.mark.parametrize("change", [[-0.9, 0.3, -0.2, 0, 2.0, 0], [-1.5, 0.2, 0, 0, 0, 0]])
def test_the_tools_own_bounds_hold_beyond_the_joints_bounds_too(change):
    """Sliding to the closest approach, where joints come to their bounds: these must brake harder, now and then."""
    robot = bundled("panda")
    controller = started(robot, **BOUNDS)
    home = robot.model.forward(robot.home)
    target = moved(home, np.array(change, dtype=float))
    poses, dt, slid = [home], 1e-3, 0
    for _ in range(8000):
        step = controller.step(controller.position, Reference.pose(target), dt)
        slid += not step.status.feasible
        poses.append(robot.model.forward(step.position))
    twists = np.array([difference(then, now) / dt for now, then in pairwise(poses)])
    changes = np.diff(twists, axis=0) / dt
    for part, kind in ((slice(0, 3), "linear"), (slice(3, 6), "angular")):
        assert np.linalg.norm(twists[:, part], axis=1).max() <= BOUNDS[f"tool_{kind}_speed"] * 1.1
        harder = np.linalg.norm(changes[:, part], axis=1) > BOUNDS[f"tool_{kind}_acceleration"] * 1.1
        assert harder.mean() < 0.02
    assert slid > 500
    assert np.abs(step.velocity).max() < 1e-4
