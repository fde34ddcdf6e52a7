"""`ik_controller recover BAG`: make a readable bag of one that was cut off, never sealed, or damaged."""

from __future__ import annotations

import argparse
from pathlib import Path

from ik_controller.verbs.common import add_json_argument, print_json

HELP = "make a readable bag of one that was cut off or damaged"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.description = (
        "Write what is readable of BAG into a new bag with a new index; BAG stays untouched. Any MCAP will do. "
        "Exit code 0: all of it; 3: some of it is lost; 1: nothing is readable."
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag folder or .mcap file")
    parser.add_argument(
        "-o", "--output", type=Path, help="the new bag (default: BAG_recovered, and none if BAG is whole)"
    )
    add_json_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Recover and say what came out."""
    from ik_controller.recording.recover import recover

    result = recover(args.bag, args.output)
    if args.json:
        output = None if result.output is None else str(result.output)
        print_json({"messages": result.messages, "lost_bytes": result.lost_bytes, "output": output})
    elif result.output is None:
        print(f"{args.bag}: nothing is readable ({result.lost_bytes} bytes lost)")
    elif result.output == args.bag:
        print(f"{args.bag} is whole: {result.messages} messages; nothing to do")
    else:
        print(f"{result.messages} messages recovered, {result.lost_bytes} bytes lost: {result.output}")
    return result.exit_code
