"""What several verbs share: naming a robot, JSON, tables."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ik_controller.errors import ParameterError

if TYPE_CHECKING:
    from ik_controller.kinematics.model import RobotModel
    from ik_controller.parameters import ControllerParameters
    from ik_controller.recording.target_bag import TargetOptions


def add_model_arguments(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    """Add --robot, --urdf, --tip, --base; `default` is the robot taken when neither robot nor URDF is given."""
    group = parser.add_argument_group("robot")
    group.add_argument("--robot", default=None, metavar="NAME", help=f"bundled robot{_default(default)}")
    group.add_argument("--urdf", metavar="FILE", help="URDF file of any other robot, with --tip")
    group.add_argument("--tip", metavar="FRAME", help="link that carries the tool")
    group.add_argument("--base", metavar="FRAME", help="link in which poses are given (default: the root link)")
    parser.set_defaults(default_robot=default)


def add_params_argument(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --params, a file that is `what`, and --node."""
    parser.add_argument("--params", metavar="FILE", help=f"parameter file {what}")
    parser.add_argument("--node", metavar="NAME", help="full name of the node whose parameters are meant in that file")


def values_from(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the names and values in the parameter file that the arguments name. Raises ParameterError."""
    from ik_controller.parameter_file import values_in

    return values_in(arguments.params, arguments.node) if arguments.params else {}


def _default(robot: str | None) -> str:
    return "" if robot is None else f" (default: {robot})"


def parameters_from(arguments: argparse.Namespace, values: Mapping[str, Any] | None = None) -> ControllerParameters:
    """Return the parameters of the robot that the arguments name, with `values` on top.

    Raises IkControllerError: no robot, both a robot and a URDF, a URDF without tip, unknown names.
    """
    from ik_controller.robots import with_bundled

    given: dict[str, Any] = dict(values or {})
    robot, urdf = arguments.robot, arguments.urdf
    if robot and urdf:
        raise ParameterError("give --robot or --urdf, not both")
    if not robot and not urdf and not given.get("robot") and not given.get("urdf"):
        robot = arguments.default_robot
        if robot is None:
            from ik_controller.errors import choices
            from ik_controller.share import robot_names

            raise ParameterError(f"no robot: give --robot NAME ({choices(robot_names())}), or --urdf FILE --tip FRAME")
    if robot:
        given["robot"] = robot
    if urdf:
        given["urdf"] = urdf
        if not arguments.tip and not given.get("tip_frame"):
            raise ParameterError("--urdf needs --tip FRAME, the link that carries the tool")
    if arguments.tip:
        given["tip_frame"] = arguments.tip
    if arguments.base:
        given["base_frame"] = arguments.base
    return with_bundled(given)


def model_from(arguments: argparse.Namespace) -> RobotModel:
    """Return the model that the arguments name. Raises IkControllerError as `parameters_from`, and for a bad URDF."""
    from ik_controller.robots import build_model

    return build_model(parameters_from(arguments))


def add_target_arguments(parser: argparse.ArgumentParser, placing: bool = False) -> None:
    """Add what says how somebody's motion is taken; `placing`: also where to, which needs a robot."""
    group = parser.add_argument_group("somebody's motion")
    group.add_argument(
        "--map",
        nargs="+",
        default=(),
        metavar="ROLE=TOPIC[:FRAME]",
        help="which topic is target_pose, target_twist, target_trajectory or target_joints; FRAME: the frame that "
        "moves, in a topic of transforms (unasked: what fits)",
    )
    group.add_argument("--frame", default="", metavar="LINK", help="link in which the poses are, instead of their own")
    group.add_argument("--scale", type=float, default=1.0, metavar="S", help="positions times S (1)")
    group.add_argument("--turn", type=float, default=1.0, metavar="T", help="rotations times T (1)")
    group.add_argument("--offset", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar=("X", "Y", "Z"), help="[m]")
    if placing:
        place = group.add_mutually_exclusive_group()
        place.add_argument("--to-start", action="store_true", help="move the first pose to the arm's posture")
        place.add_argument("--to-middle", action="store_true", help="move the motion's middle to the arm's posture")
    group.add_argument("--twists", action="store_true", help="give each pose the twist from its neighbours")
    group.add_argument("--max-gap", type=float, default=math.inf, metavar="S", help="shorten longer pauses to S")


def target_options_from(arguments: argparse.Namespace) -> TargetOptions:
    """Return what the arguments of `add_target_arguments` say. Raises IkControllerError."""
    from ik_controller.recording.fit import Fitting
    from ik_controller.recording.target_bag import Source, TargetOptions

    for name in ("scale", "turn"):
        value = getattr(arguments, name)
        if not 0.0 < value < math.inf and not (name == "turn" and value == 0.0):
            raise ParameterError(f"--{name} {value:g}: need a positive number")
    if not all(map(math.isfinite, arguments.offset)):
        raise ParameterError("--offset: need finite values")
    if not arguments.max_gap > 0.0:
        raise ParameterError(f"--max-gap {arguments.max_gap:g}: need a positive time")
    place = "start" if getattr(arguments, "to_start", False) else ""
    place = "middle" if getattr(arguments, "to_middle", False) else place
    return TargetOptions(
        sources=tuple(Source.parse(text) for text in arguments.map),
        frame=arguments.frame,
        fitting=Fitting(arguments.scale, arguments.turn, tuple(arguments.offset), place),
        twists=arguments.twists,
        max_gap=arguments.max_gap,
    )


def add_json_argument(parser: argparse.ArgumentParser) -> None:
    """Add --json."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def print_json(content: Any) -> None:
    """Print one JSON value on one line; numbers that JSON has no word for become null."""
    print(json.dumps(_plain(content)))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def print_table(rows: Sequence[Sequence[str]], header: Sequence[str] = ()) -> None:
    """Print rows in aligned columns: texts to the left, columns of numbers below a header to the right."""
    lines = [list(header), *map(list, rows)] if header else [list(row) for row in rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    numeric = [bool(header) and all(_is_number(row[i]) for row in rows) for i in range(len(widths))]
    for index, line in enumerate(lines):
        cells = [c.rjust(w) if n else c.ljust(w) for c, w, n in zip(line, widths, numeric, strict=True)]
        print("  ".join(cells).rstrip())
        if header and index == 0:
            print("  ".join("-" * w for w in widths))


def _is_number(text: str) -> bool:
    try:
        float(text or "0")
    except ValueError:
        return False
    return True


class Progress:
    """A progress bar on a terminal's stderr; nothing where stderr is not a terminal."""

    def __init__(self, total: float, label: str, unit: str = "s") -> None:
        self._total, self._label, self._unit = total, label, unit
        self._on = sys.stderr.isatty()

    def show(self, done: float) -> None:
        """Show how much is done."""
        if self._on:
            share = min(max(done / self._total, 0.0), 1.0) if self._total > 0.0 else 1.0
            bar = "█" * round(30 * share) + "░" * (30 - round(30 * share))
            sys.stderr.write(f"\r{self._label}  {bar}  {min(done, self._total):5.1f} / {self._total:.1f} {self._unit} ")
            sys.stderr.flush()

    def end(self) -> None:
        """Leave the line."""
        if self._on:
            sys.stderr.write("\r" + " " * 78 + "\r")
            sys.stderr.flush()
