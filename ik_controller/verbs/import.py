"""`ik_controller import`: turn text logs, or somebody's bag, into a bag of targets or joint states."""

from __future__ import annotations

import argparse
from pathlib import Path

from ik_controller.verbs.common import (
    add_json_argument,
    add_model_arguments,
    add_target_arguments,
    parameters_from,
    print_json,
    print_table,
    target_options_from,
)

HELP = "turn a CSV or text log, or anybody's bag, into a bag of targets"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.description = (
        "Text: a sample a line; poses and twists become targets, joints joint states. With a robot, or options for "
        "somebody's motion, the result is a bag of targets fitted to it, ready for `stream` and `demo --targets`."
    )
    parser.add_argument(
        "files", nargs="+", type=Path, metavar="FILE", help="text files that follow each other, or a bag"
    )
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="BAG", help="folder of the new bag")
    parser.add_argument(
        "--columns",
        nargs="+",
        default=(),
        metavar="FIELD=COLUMN",
        help="columns by name or number from 0: t, x y z, qx qy qz qw or rx ry rz (rotation vector), vx … wz, any "
        "joint, JOINT.velocity; with a unit of their own: t=3:ms; or names in order, - for none (unasked: the "
        "header's names, or TUM's 8 columns)",
    )
    parser.add_argument("--units", nargs="+", default=(), metavar="UNIT", help="s ms us ns, m cm mm, rad deg (SI)")
    add_target_arguments(parser, placing=True)
    add_model_arguments(parser)
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Convert and say what came out."""
    from ik_controller.recording.importing import import_files

    robot = parameters_from(arguments) if arguments.robot or arguments.urdf else None
    found = import_files(
        arguments.files,
        arguments.output,
        columns=arguments.columns,
        units=arguments.units,
        options=target_options_from(arguments),
        robot=robot,
    )
    if arguments.json:
        print_json(found)
        return 0
    rows = [(name.replace("_", " "), f"{value:.6g}" if isinstance(value, float) else f"{value}")
            for name, value in found.items() if value not in ("", [])]  # fmt: skip
    print_table(rows)
    return 0
