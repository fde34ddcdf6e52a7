"""`ik_controller report`: a picture of a recorded run."""

from __future__ import annotations

import argparse
from pathlib import Path

from ik_controller.errors import IkControllerError
from ik_controller.verbs.common import add_json_argument, print_json

HELP = "draw a recorded run: path and errors over time"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("bag", help="bag folder or .mcap file of a run")
    parser.add_argument("--png", metavar="FILE", default="report.png", help="picture to write (report.png)")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Replay the bag and draw it."""
    from ik_controller.recording.reader import open_bag
    from ik_controller.recording.replay import replay
    from ik_controller.recording.timeline import Timeline, draw

    picture = Path(arguments.png)
    if not picture.absolute().parent.is_dir():
        raise IkControllerError(f"--png {picture}: there is no folder '{picture.parent}'")
    timeline = Timeline()
    bag = open_bag(arguments.bag)
    result = replay(bag, watch=timeline.watch)
    draw(timeline, picture, bag.path.name)
    if arguments.json:
        print_json({"picture": arguments.png, **result.as_mapping()})
    else:
        print(arguments.png)
    return 0
