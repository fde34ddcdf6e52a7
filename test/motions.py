"""Smooth motions with known truth, and runs of the controller on an ideal arm, for the tests of the control room."""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ik_controller import Controller, ControllerParameters, Reference, RobotModel
from ik_controller.robots import build_model, bundled_parameters

PERIOD = 6.0  # of the figure-eight [s]


class Robot(NamedTuple):
    """A bundled robot: its model, its parameters without a posture to seek, its home configuration (n,)."""

    model: RobotModel
    parameters: ControllerParameters
    home: np.ndarray


@functools.cache
def bundled(name: str) -> Robot:
    """Return a bundled robot; the same object each time, so do not change its limits."""
    parameters = bundled_parameters(name)
    return Robot(build_model(parameters), parameters.replace({"posture": ()}), np.array(parameters.posture))


# rad/s³, as libfranka states them; soft ones, of which a ramp takes a tenth of a second; and joints without one.
JERKS = {
    "panda jerk": [7500, 3750, 5000, 6250, 7500, 10000, 10000],
    "ur5e jerk": [60, 60, math.inf, 100, 1e5, 80],
    "scara jerk": [40, 300, 20, math.inf],
}


@functools.cache
def arm(name: str) -> Robot:
    """A bundled robot, or a small arm: prismatic joints, fewer joints than the task has rows."""
    if name in ("panda", "ur5e"):
        return bundled(name)
    if name.endswith(" jerk"):
        plain = arm(name.removesuffix(" jerk"))
        model = RobotModel.from_urdf(plain.model.urdf_text, plain.model.tip_frame, plain.model.base_frame)
        limits = plain.model.velocity_limit, plain.model.acceleration_limit
        model.set_limits(velocity=limits[0], acceleration=limits[1], jerk=JERKS[name])
        return Robot(model, plain.parameters, plain.home)
    import arms  # beside the tests of kinematics

    model = RobotModel.from_urdf(getattr(arms, name)(), "tool")
    return Robot(model, ControllerParameters(), model.middle() + 0.1)


def figure_eight(home: Any, t: float) -> Any:
    """Return the pose at t [s] of a figure-eight, 0.15 m to each side of `home`, with changing orientation."""
    w = 2.0 * math.pi / PERIOD
    s, s2, c = math.sin(w * t), math.sin(2.0 * w * t), 1.0 - math.cos(w * t)
    turn = 0.3 * np.array([s, 0.5 * s2, c])
    return pin.SE3(pin.exp3(turn) @ home.rotation, home.translation + np.array([0.15 * s, 0.075 * s2, 0.05 * s]))


def figure_eight_twist(home: Any, t: float) -> np.ndarray:
    """Return the twist (6,) of `figure_eight` at t, by central differences (good to 1e-9)."""
    h = 1e-4
    return difference(figure_eight(home, t + h), figure_eight(home, t - h)) / (2.0 * h)


def difference(then: Any, now: Any) -> np.ndarray:
    """Return (6,): position and rotation vector from pose `now` to pose `then`, in the base frame."""
    return np.concatenate((then.translation - now.translation, pin.log3(then.rotation @ now.rotation.T)))


def moved(pose: Any, change: np.ndarray) -> Any:
    """Return the pose displaced by `change` (6,) in the base frame: the inverse of `difference`."""
    return pin.SE3(pin.exp3(change[3:]) @ pose.rotation, pose.translation + change[:3])


def started(robot: Robot, q: np.ndarray | None = None, **changes: Any) -> Controller:
    """Return a controller of the robot that has made its first step, at q (home unless given)."""
    controller = Controller(robot.model, robot.parameters.replace(changes))
    q = robot.home if q is None else q
    controller.reset(q)
    controller.step(q, None, 1.0 / controller.parameters.rate)
    return controller


def tracking_errors(robot: Robot, rate: float, begin: float, end: float, **changes: Any) -> np.ndarray:
    """Follow the figure-eight on an ideal arm to `end`; return errors (cycles, 6) of the commands after `begin` [s]."""
    dt = 1.0 / rate
    controller = started(robot, rate=rate, **changes)
    home, q, errors = robot.model.forward(robot.home), robot.home, []
    poses = [figure_eight(home, k * dt) for k in range(round(end * rate) + 1)]
    for k in range(len(poses) - 1):
        q = controller.step(q, Reference.between(poses[k], poses[k + 1], dt), dt).position
        if k * dt >= begin:
            errors.append(difference(poses[k + 1], robot.model.forward(q)))
    return np.array(errors)


def rms(errors: np.ndarray) -> float:
    """Return the root mean square length of vectors (k, 3)."""
    return math.sqrt(np.mean(np.sum(np.square(errors), axis=1)))
