"""Robots: the model that parameters describe, and the parameters that come with a bundled robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ik_controller.errors import ModelError, ParameterError
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.urdf import Urdf
from ik_controller.parameter_file import values_in
from ik_controller.parameters import ControllerParameters
from ik_controller.share import robot_folder

_AGILE = 0.05  # [m or rad, per rad] smallest singular value from which on an arm moves freely
_SPREAD = 1.4  # [rad] that a joint is looked for around its middle


def bundled_parameters(name: str) -> ControllerParameters:
    """Return the parameters of a bundled robot's own parameter file. Raises ModelError: unknown robot."""
    return ControllerParameters.from_mapping(values_in(robot_folder(name) / "parameters.yaml"))


def with_bundled(values: dict[str, object]) -> ControllerParameters:
    """Return parameters of names and values; where they name a bundled robot, what they leave open is the robot's
    own.
    """
    robot = values.get("robot", "")
    base = bundled_parameters(robot) if isinstance(robot, str) and robot else ControllerParameters()
    return base.replace(values)


def urdf_text(parameters: ControllerParameters) -> str | None:
    """Return the URDF that parameters name (bundled robot or file), None where they leave it to robot_description."""
    if parameters.robot:
        return Urdf.load(robot_folder(parameters.robot) / "robot.urdf").text
    if parameters.urdf:
        return Urdf.load(Path(parameters.urdf)).text
    return None


def with_tool(model: RobotModel, before: ControllerParameters, after: ControllerParameters) -> RobotModel:
    """Return the model with the tool of the parameters `after`; the same model where `before` had it already.

    Raises ParameterError where the offset is no pose.
    """
    if before.tool_offset == after.tool_offset:
        return model
    try:
        return model.with_tool_offset(after.tool_offset or (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    except ModelError as error:
        raise ParameterError(str(error)) from None


def build_model(parameters: ControllerParameters, urdf: str | None = None) -> RobotModel:
    """Return the model with the parameters' frames, tool and limits; `urdf` text, or the one that parameters name.

    Raises ModelError for what does not fit the URDF, ParameterError where no URDF or tip frame is named.
    """
    text = urdf if urdf is not None else urdf_text(parameters)
    if text is None:
        raise ParameterError("no robot: give the parameter robot or urdf")
    if not parameters.tip_frame:
        raise ParameterError("tip_frame is empty: give the link that carries the tool")
    model = RobotModel.from_urdf(
        text,
        parameters.tip_frame,
        parameters.base_frame or None,
        locked_joints=dict(zip(parameters.locked_joint_names, parameters.locked_joint_values, strict=True)),
        tool_offset=parameters.tool_offset or None,
    )
    model.set_limits(
        lower=parameters.position_lower,
        upper=parameters.position_upper,
        velocity=parameters.velocity_limits,
        acceleration=parameters.acceleration_limits,
        jerk=parameters.jerk_limits,
    )
    return model


def start_posture(model: RobotModel) -> NDArray[np.float64]:
    """Return joints (n,) from which an arm of unknown habits can move all ways: the middle of its limits, or where that
    is singular, as a UR's stretched arm is, the least singular of some around it with the tool above the base.
    """

    def agility(q: NDArray[np.float64]) -> float:
        return float(np.linalg.svd(model.jacobian(q), compute_uv=False).min())

    best = middle = model.middle()
    most = agility(middle)
    if most >= _AGILE:
        return best
    half = np.fmin(0.45 * (model.upper - model.lower), _SPREAD)
    half[0] = 0.0  # straight ahead
    for q in middle + half * np.random.default_rng(0).uniform(-1.0, 1.0, (300, model.n)):
        value = agility(q)
        if value > most and model.forward(q).translation[2] > 0.1:
            best, most = q, value
    return best
