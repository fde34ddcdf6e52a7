"""What several verbs share: naming a robot, JSON, and the terminal: tables, colours, progress.

On a terminal, texts are wrapped at its width, and colours and a line of progress are shown unless NO_COLOR says no;
elsewhere everything is plain, 80 columns wide, and progress is silent.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TextIO

from ik_controller.errors import ParameterError, short_names

if TYPE_CHECKING:
    from ik_controller.kinematics.model import RobotModel
    from ik_controller.parameters import ControllerParameters
    from ik_controller.recording.target_bag import TargetOptions


def add_model_arguments(parser: argparse.ArgumentParser, default: str | None = None, note: str = "") -> None:
    """Add --robot, --urdf, --tip, --base; `default` is the robot taken when neither robot nor URDF is given, `note`
    what the robot is for.
    """
    group = parser.add_argument_group("robot", note or None)
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


# -- the terminal

_STYLES = {"bold": "1", "good": "32", "warn": "33", "bad": "31"}


def width(stream: TextIO | None = None) -> int:
    """Return how many columns a text for that stream (stdout) may take: the terminal's, 80 where it is none."""
    stream = sys.stdout if stream is None else stream
    return max(shutil.get_terminal_size().columns, 40) if stream.isatty() else 80


def styled(text: str, style: str, stream: TextIO | None = None) -> str:
    """Return the text in one of the styles bold, good, warn, bad; plain where the stream (stdout) shows none."""
    stream = sys.stdout if stream is None else stream
    plain = not stream.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM", "dumb") == "dumb"
    return text if plain or not text else f"\x1b[{_STYLES[style]}m{text}\x1b[0m"


def print_error(who: str, message: str) -> None:
    """Print a mistake on stderr: one line, wrapped only where a person reads it on a terminal."""
    text = f"{who}: {message}"
    if sys.stderr.isatty():
        text = textwrap.fill(text, width(sys.stderr), subsequent_indent="  ", break_on_hyphens=False)
    print(text.replace(f"{who}:", styled(f"{who}:", "bad", sys.stderr), 1), file=sys.stderr)


def print_text(text: str) -> None:
    """Print a sentence, wrapped."""
    print(textwrap.fill(text, width(), break_on_hyphens=False, break_long_words=False))


def print_table(rows: Sequence[Sequence[str]], header: Sequence[str] = (), styles: Sequence[str] = ()) -> None:
    """Print rows in aligned columns: texts to the left, columns of numbers below a header to the right.

    Where the columns do not fit, the widest text is wrapped, and headers lose what all of them begin with. `styles`:
    one a row, for its first cell; empty for plain.
    """
    if not rows and not header:
        return
    numeric = [bool(header) and all(_is_number(row[i]) for row in rows) for i in range(len(header or rows[0]))]
    limit, head = width(), list(header)
    widths = _widths(rows, head)
    if head and _total(widths) > limit:
        short = iter(short_names([name for name, number in zip(head, numeric, strict=True) if number]))
        head = [next(short) if number else name for name, number in zip(head, numeric, strict=True)]
        widths = _widths(rows, head)
    if head and _total(widths) > limit:  # names over numbers go over several lines
        inner = _widths(rows, [])
        widths = [
            max(inner[i], *map(len, head[i].replace("_", "_ ").split())) if number else widths[i]
            for i, number in enumerate(numeric)
        ]
    gap = "  " if _total(widths) <= limit else " "
    texts = [i for i, number in enumerate(numeric) if not number]
    if _total(widths) > limit and texts:
        gap = "  "
        widest = max(texts, key=lambda i: widths[i])
        widths[widest] = max(widths[widest] - (_total(widths) - limit), 16)
    for index, row in enumerate([head, *rows] if head else rows):
        title = bool(head) and index == 0
        cells = [_lines(text, w, title and number) for text, w, number in zip(row, widths, numeric, strict=True)]
        style = styles[index - bool(head)] if styles and not title else ""
        for k in range(max(map(len, cells))):
            line = [
                text.rjust(w) if number else text.ljust(w)
                for text, w, number in zip((c[k] if k < len(c) else "" for c in cells), widths, numeric, strict=True)
            ]
            if style and line[0].strip():
                line[0] = styled(line[0], style)
            print(gap.join(line).rstrip())
        if title:
            print(gap.join("-" * w for w in widths))


def _lines(text: str, columns: int, name: bool) -> list[str]:
    """Return a cell's lines; a name is broken behind its underscores."""
    if len(text) <= columns:
        return [text]
    if not name:
        return textwrap.wrap(text, columns, break_on_hyphens=False)
    lines = [""]
    for part in text.replace("_", "_ ").split():
        if lines[-1] and len(lines[-1]) + len(part) > columns:
            lines.append("")
        lines[-1] += part
    return lines


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + 2 * (len(widths) - 1)


def _widths(rows: Sequence[Sequence[str]], head: Sequence[str]) -> list[int]:
    return [max(map(len, column)) for column in zip(*([head] if head else []), *rows, strict=True)]


def _is_number(text: str) -> bool:
    try:
        float(text or "0")
    except ValueError:
        return False
    return True


class Progress:
    """A line of progress on a terminal's stderr; nothing where stderr is not a terminal."""

    def __init__(self, total: float, label: str, unit: str = "s") -> None:
        self._total, self._label, self._unit = total, label, unit
        self._on = sys.stderr.isatty()

    def show(self, done: float) -> None:
        """Show how much is done."""
        share = min(max(done / self._total, 0.0), 1.0) if self._total > 0.0 else 1.0
        self._write(f"{self._bar(share)}  {min(done, self._total):5.1f} / {self._total:.1f} {self._unit}")

    def tick(self, elapsed: float) -> None:
        """Show that it goes on, where nobody knows how long."""
        self._write(f"{elapsed:.0f} {self._unit}")

    def _bar(self, share: float) -> str:
        done = round(30 * share)
        full, empty = ("█", "░") if (sys.stderr.encoding or "").lower().startswith("utf") else ("#", ".")
        return full * done + empty * (30 - done)

    def _write(self, text: str) -> None:
        if self._on:
            line = f"{self._label}  {text}"[: width(sys.stderr) - 1]
            sys.stderr.write("\r" + line.ljust(min(78, width(sys.stderr) - 1)))
            sys.stderr.flush()

    def end(self) -> None:
        """Leave the line empty."""
        if self._on:
            sys.stderr.write("\r" + " " * min(78, width(sys.stderr) - 1) + "\r")
            sys.stderr.flush()


@contextlib.contextmanager
def waiting(label: str) -> Iterator[None]:
    """Show on a terminal's stderr that something goes on, and for how long, from the second second on."""
    progress, done, begin = Progress(0.0, label), threading.Event(), time.monotonic()

    def tick() -> None:
        while not done.wait(1.0):
            progress.tick(time.monotonic() - begin)

    thread = threading.Thread(target=tick, name="progress", daemon=True)
    if sys.stderr.isatty():
        thread.start()
    try:
        yield
    finally:
        done.set()
        if thread.ident is not None:
            thread.join()
        progress.end()
