"""TaskStack: the tables of a stack of tasks, from the parameters: axes, secondary tasks, objectives, weights.

A secondary task is one line of the parameter `secondary_tasks`:

    position FRAME      the frame's origin                 target x y z [m]
    x FRAME             or some axes of it: any of "xyz"   as many values
    orientation FRAME   the frame's orientation            target qx qy qz qw
    swivel              the elbow's swivel angle           target [rad]

FRAME is a link that the arm's joints move; everything is in the base frame.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.objectives import OBJECTIVES
from ik_controller.control.secondary import (
    AXES,
    ELBOW,
    GAIN,
    JOINTS,
    KIND,
    ORIENTATION,
    POSITION,
    SHOULDER,
    SWIVEL,
    TARGET,
)
from ik_controller.control.selection import (
    MASK,
    OPTIONS,
    TOLERANCE,
    axes_error,
    axes_rows,
    feed_forward_twist,
)
from ik_controller.control.stack import GAINS, LOWER, UPPER, WEIGHTS
from ik_controller.errors import ArgumentError, ParameterError, choices
from ik_controller.kinematics.chain import table_to
from ik_controller.kinematics.closed_form.geometry import Screws
from ik_controller.kinematics.model import RobotModel, frame_pose
from ik_controller.kinematics.orientation_error import DEFAULT_ORIENTATION_ERROR
from ik_controller.kinematics.rotation import rotation_from_quaternion
from ik_controller.parameters import ControllerParameters

Array = NDArray[np.float64]

DEFAULT_GAIN = 2.0  # [1/s] of secondary tasks, and of objectives 1 rad²/s
_EVERY_AXIS = "xyzrpy"
_COLUMNS = 24


def is_configured(parameters: ControllerParameters) -> bool:
    """Tell whether the parameters ask for more than the whole pose and a posture."""
    return bool(
        parameters.task_axes != _EVERY_AXIS
        or parameters.task_frame != "base"
        or any(parameters.task_tolerance)
        or parameters.secondary_tasks
        or parameters.objectives
        or parameters.joint_weights
    )


class TaskStack:
    """Tables as `stack.stack_cycle` takes them: `axes` (3, 6), `levels` (l, 24), `chains` (l, m + 1, 16), `objectives`
    (4, n); together in `tables`.
    """

    def __init__(self, model: RobotModel, parameters: ControllerParameters) -> None:
        """Raises ParameterError where the parameters do not fit the arm or each other, naming the legal choices."""
        for name, default in (("inverse", "numerical_filtering"), ("orientation_error", DEFAULT_ORIENTATION_ERROR)):
            if getattr(parameters, name) != default:
                raise ParameterError(
                    f"{name} = '{getattr(parameters, name)}': selected axes, tolerances, secondary tasks, objectives "
                    f"and joint weights need '{default}'"
                )
        self.axes = _axes(parameters)
        self.levels, self.chains = _secondary(model, parameters)
        self.objectives = _objectives(model, parameters)
        self.tables = self.axes, self.levels, self.chains, self.objectives
        self._model = model
        self.axes[OPTIONS, 1] = _directions(model, self.axes)

    def error(self, position: Array, rotation: Array, q: Array) -> Array:
        """Return e (6,) of the tool at q (n,) in base axes: 0 on free axes and within the tolerances."""
        tool = self._model.forward(q)
        frame = np.ascontiguousarray(rotation) if self.axes[OPTIONS, 0] else np.eye(3)
        raw = np.empty(6)
        axes_error(
            self.axes,
            frame,
            position,
            np.ascontiguousarray(rotation),
            np.array(tool.translation),
            np.ascontiguousarray(tool.rotation),
            raw,
        )
        left = raw - np.clip(raw, -self.axes[TOLERANCE], self.axes[TOLERANCE])
        return np.concatenate((frame @ left[:3], frame @ left[3:]))

    def selected(self, q: Array) -> tuple[Array, int]:
        """Return the selected axes (m, 6), rows in base axes, at q (n,), and along how many the arm can move at all."""
        rows = np.eye(6)
        if self.axes[OPTIONS, 0]:
            rows[:3, :3] = rows[3:, 3:] = self._model.forward(q).rotation.T
        return rows[self.axes[MASK] > 0.0], int(self.axes[OPTIONS, 1])

    def wanted(
        self, position: Array, rotation: Array, twist: Array, error: Array, gain: Array, q: Array
    ) -> tuple[Array, Array]:
        """Return the rows (6, 6) that select the axes, 0 for free ones, and ẋ_d + K e (6,) along them, at q (n,)."""
        tool, desired = self._model.forward(q), np.ascontiguousarray(rotation)
        at, turn = np.array(tool.translation), np.ascontiguousarray(tool.rotation)
        frame = desired if self.axes[OPTIONS, 0] else np.eye(3)
        rows = np.empty((6, 6))
        axes_rows(self.axes, frame, True, desired, turn, rows)
        local = np.concatenate((frame.T @ error[:3], frame.T @ error[3:]))
        forward: Array = rows @ feed_forward_twist(self.axes, twist, position, desired, at, turn)
        return rows, forward + self.axes[MASK] * (gain @ local)


def _directions(model: RobotModel, axes: Array) -> int:
    """Return along how many of the selected axes the arm can move at once, at its best: at a few generic postures."""
    generator, most = np.random.default_rng(0), 0
    for _ in range(8):
        q = generator.uniform(np.maximum(model.lower, -1.0), np.minimum(model.upper, 1.0))
        rotation = model.forward(q).rotation if axes[OPTIONS, 0] else np.eye(3)
        jacobian = model.jacobian(q)
        rows = np.vstack((rotation.T @ jacobian[:3], rotation.T @ jacobian[3:]))[axes[MASK] > 0.0]
        most = max(most, int(np.linalg.matrix_rank(rows, tol=1e-6)))
    return most


def _axes(parameters: ControllerParameters) -> Array:
    match = re.fullmatch("(x?)(y?)(z?)(r?)(p?)(y?)", parameters.task_axes)
    if match is None or not parameters.task_axes:
        raise ParameterError(
            f"task_axes = '{parameters.task_axes}': need some letters of {_EVERY_AXIS} in this order, the last y "
            "being the yaw"
        )
    table = np.zeros((3, 6))
    table[MASK] = [1.0 if letter else 0.0 for letter in match.groups()]
    table[TOLERANCE] = parameters.task_tolerance or 0.0
    table[OPTIONS, 0] = parameters.task_frame == "tool"
    return table


def _objectives(model: RobotModel, parameters: ControllerParameters) -> Array:
    table = np.zeros((4, max(model.n, len(OBJECTIVES))))
    gains = _gains(parameters.objectives, parameters.objective_gains, "objective", 1.0)
    for name, gain in zip(parameters.objectives, gains, strict=True):
        if name not in OBJECTIVES:
            raise ParameterError(f"objectives: unknown '{name}'; legal: {choices(OBJECTIVES)}")
        if name == "manipulability" and model.expansion is not None:
            raise ParameterError("objectives: 'manipulability' is not for arms with joints that mimic others")
        table[GAINS, OBJECTIVES.index(name)] = gain
    table[LOWER, : model.n], table[UPPER, : model.n] = model.lower, model.upper
    weights = parameters.joint_weights
    if weights and len(weights) != model.n:
        names = choices(model.joint_names)
        raise ParameterError(f"joint_weights: {len(weights)} values, need {model.n}, one for each of {names}")
    if weights:
        table[WEIGHTS, : model.n] = np.array(weights) / np.mean(weights)
    return table


def _gains(names: tuple[str, ...], gains: tuple[float, ...], what: str, default: float) -> tuple[float, ...]:
    if gains and len(gains) != len(names):
        raise ParameterError(f"{what}_gains: {len(gains)} values, need {len(names)}, one for each of {choices(names)}")
    return gains or (default,) * len(names)


def _secondary(model: RobotModel, parameters: ControllerParameters) -> tuple[Array, Array]:
    lines = parameters.secondary_tasks
    gains = _gains(lines, parameters.secondary_gains, "secondary", DEFAULT_GAIN)
    targets = list(parameters.secondary_targets)
    levels, chains = np.zeros((len(lines), _COLUMNS)), []
    for level, line, gain in zip(levels, lines, gains, strict=True):
        count, chain = _describe(model, line, level)
        values, targets = targets[:count], targets[count:]
        if len(values) < count:
            raise ParameterError(f"secondary_targets: '{line}' needs {count} values, {len(values)} are left for it")
        _take_target(level, line, values)
        level[GAIN], level[JOINTS] = gain, len(chain) - 1
        chains.append(chain)
    if targets:
        raise ParameterError(f"secondary_targets: {len(targets)} values more than {choices(lines)} take")
    longest = max((len(chain) for chain in chains), default=1)
    padded = np.zeros((len(lines), longest, 16))
    for place, chain in zip(padded, chains, strict=True):
        place[: len(chain)] = chain
    return levels, padded


def _describe(model: RobotModel, line: str, level: Array) -> tuple[int, Array]:
    """Write what kind of task the line names, and where; return how many target values it takes, and its chain."""
    kind, *frame = line.split()
    if kind == "swivel" and not frame:
        shoulder, elbow, wrist = elbow_points(model)
        chain = table_to(model, 4, pin.SE3(np.eye(3), wrist))
        level[KIND], level[SHOULDER : SHOULDER + 3], level[ELBOW : ELBOW + 3] = SWIVEL, shoulder, elbow - wrist
        return 1, chain
    axes = "xyz" if kind == "position" else kind
    orientation = kind == "orientation"
    if len(frame) != 1 or not (orientation or (axes and re.fullmatch("x?y?z?", axes))):
        raise ParameterError(
            f"secondary_tasks: '{line}': need 'position FRAME', 'orientation FRAME', 'swivel', or some of x, y, z and "
            "a FRAME, as 'z FRAME'"
        )
    joints, placement = _frame(model, frame[0])
    level[KIND] = ORIENTATION if orientation else POSITION
    level[AXES : AXES + 3] = [1.0 if orientation or letter in axes else 0.0 for letter in "xyz"]
    return 4 if orientation else len(axes), table_to(model, joints, placement)


def elbow_points(model: RobotModel) -> tuple[Array, Array, Array]:
    """Return shoulder, elbow and wrist (3,) [m] at q = 0 of a 7-joint arm, as `closed_form.seven` has them.

    Where axis 7 misses the wrist, as the Panda's does, the wrist is where axes 5 and 6 meet: then turning
    the elbow moves it a little, but means the same. Raises ParameterError where the arm is none of these.
    """
    screws = Screws.of(model)
    if screws is not None and model.n == 7 and not model.prismatic.any():
        shoulder = screws.meeting_point(0, 1, 2)
        wrist = screws.meeting_point(4, 5, 6)
        wrist = screws.meeting_point(4, 5) if wrist is None else wrist
        if shoulder is not None and wrist is not None:
            elbow = screws.point[3] + (screws.axis[3] @ (shoulder - screws.point[3])) * screws.axis[3]
            return shoulder, elbow, wrist
    raise ParameterError("secondary_tasks: 'swivel' is for 7-joint shoulder-elbow-wrist arms; this is none")


def _take_target(level: Array, line: str, values: list[float]) -> None:
    if level[KIND] == ORIENTATION:
        try:
            level[TARGET : TARGET + 9] = rotation_from_quaternion(values).ravel()
        except ArgumentError as error:
            raise ParameterError(f"secondary_targets: '{line}': {error}") from None
    elif level[KIND] == SWIVEL:
        level[TARGET] = values[0]
    else:
        level[TARGET : TARGET + 3][level[AXES : AXES + 3] > 0.0] = values


def _frame(model: RobotModel, name: str) -> tuple[int, Any]:
    """Return how many joints move the frame, and its placement at q = 0."""
    frames = [frame for frame in model.pin_model.frames if frame.type == pin.FrameType.BODY and frame.parentJoint > 0]
    found = next((frame for frame in frames if frame.name == name), None)
    if found is None:
        legal = choices(frame.name for frame in frames)
        raise ParameterError(f"secondary_tasks: no moving frame '{name}'; there are: {legal}")
    frame_id = model.pin_model.getFrameId(name, pin.FrameType.BODY)
    return int(found.parentJoint), frame_pose(model, model.pin_model.createData(), np.zeros(model.n), frame_id)
