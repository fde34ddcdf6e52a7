"""`ik_controller stream`: send the targets of a bag to a running node."""

from __future__ import annotations

import argparse

from ik_controller.errors import ParameterError
from ik_controller.verbs.common import (
    Progress,
    add_json_argument,
    add_model_arguments,
    add_target_arguments,
    model_from,
    print_json,
    target_options_from,
)

HELP = "send the poses and twists of a bag to a running node, at their own pace"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("bag", help="bag of poses, twists, transforms, odometry, trajectories or joints")
    parser.add_argument("--node", default="ik_controller", metavar="NAME", help="the node to send to (ik_controller)")
    parser.add_argument("--duration", type=float, metavar="S", help="only the first seconds")
    parser.add_argument("--loop", action="store_true", help="start again at the end, until Ctrl-C")
    parser.add_argument("--patience", type=float, default=10.0, metavar="S", help="how long to wait for the node (10)")
    add_target_arguments(parser)
    add_model_arguments(parser)
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Stream and print how much."""
    from ik_controller.recording.reader import open_bag
    from ik_controller.recording.target_bag import TargetBag

    if arguments.duration is not None and not arguments.duration >= 0.0:
        raise ParameterError(f"--duration {arguments.duration:g}: need 0 or more seconds")
    model = model_from(arguments) if arguments.robot or arguments.urdf else None
    targets = TargetBag(open_bag(arguments.bag), target_options_from(arguments), model=model)
    length = targets.duration * 1e-9 if arguments.duration is None else arguments.duration
    from ik_controller.ros.streamer import stream

    bar = Progress(length, "streaming")
    sent = stream(
        targets,
        arguments.node.rstrip("/"),
        arguments.ros_arguments,
        duration=arguments.duration,
        loop=arguments.loop,
        patience=arguments.patience,
        progress=bar.show,
    )
    bar.end()
    if arguments.json:
        print_json({"sent": sent})
    else:
        print(f"{sent} targets sent to {arguments.node}")
    return 0
