"""The command line: `ik_controller VERB …`. Each verb is a module of `ik_controller.verbs`, imported when asked for.

Exit codes of every verb: 0 success, 1 "ran, and the answer is no", 2 bad usage or input (one line on stderr).
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys

from ik_controller.endings import end_when_told, leave
from ik_controller.errors import IkControllerError, choices
from ik_controller.verbs.common import print_error

VERBS = (
    "demo",
    "replay",
    "report",
    "solve",
    "doctor",
    "recover",
    "bench",
    "sim",
    "stream",
    "view",
    "teleop",
    "import",
    "compare",
)
ROS_VERBS = ("sim", "stream", "view", "teleop")  # are ROS processes: they take `--ros-args …` as every node does


class _Parser(argparse.ArgumentParser):
    """argparse, but a usage mistake is one line."""

    def error(self, message: str) -> None:  # type: ignore[override]
        print_error(self.prog, f"{message} (see {self.prog} --help)")
        self.exit(2)


def split(given: list[str]) -> tuple[list[str], list[str]]:
    """Return the verb's own words and those for ROS: `--ros-args` and what follows it, up to `--`, as often as it
    comes.
    """
    own: list[str] = []
    ros: list[str] = []
    inside = False
    for word in given:
        inside = inside or word == "--ros-args"
        (ros if inside else own).append(word)
        inside = inside and word != "--"
    return own, ros


def main(arguments: list[str] | None = None) -> int:
    """Run one verb and return the exit code."""
    given, ros = split(sys.argv[1:] if arguments is None else arguments)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # a terminal without µ or × shows a question mark, and no traceback
    if given[:1] == ["--version"]:
        from ik_controller import __version__

        print(__version__)
        return 0
    verb = given[0] if given and given[0] in VERBS else None
    parser = _Parser(prog="ik_controller", description="Closed-loop inverse kinematics for ROS 2 arms.")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for name in VERBS if verb is None else (verb,):
        module = importlib.import_module(f"ik_controller.verbs.{name}")
        module.add_arguments(verbs.add_parser(name, help=module.HELP, description=module.HELP))
    options = parser.parse_args(given)
    options.ros_arguments = ros
    if ros and options.verb not in ROS_VERBS:
        parser.error(f"{options.verb} takes no --ros-args; these do: {choices(ROS_VERBS)}")
    try:
        module = importlib.import_module(f"ik_controller.verbs.{options.verb}")
        return int(module.run(options))
    except IkControllerError as error:
        print_error(f"ik_controller {options.verb}", str(error))
        return 2
    except BrokenPipeError:  # the reader of our output has gone, as in `… | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        return 0 if options.verb in ROS_VERBS else 130


def run() -> None:
    """Be the process `ik_controller`."""
    if sys.argv[1:2] and sys.argv[1] in ROS_VERBS:
        end_when_told()
        leave(main())
    sys.exit(main())


if __name__ == "__main__":
    run()
