"""`ik_controller teleop`: move the tool by hand, with the keyboard or a joystick."""

from __future__ import annotations

import argparse
from pathlib import Path

from ik_controller.errors import ParameterError, choices
from ik_controller.verbs.common import add_json_argument, print_json

HELP = "move the tool by hand: keyboard, or a gamepad or SpaceMouse by a mapping file"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("--node", default="ik_controller", metavar="NAME", help="the node to steer (ik_controller)")
    parser.add_argument("--linear", type=float, metavar="M/S", help="speed of the tool (0.1, or the mapping's)")
    parser.add_argument("--angular", type=float, metavar="RAD/S", help="its rate of turn (0.4, or the mapping's)")
    parser.add_argument("--frame", choices=("base", "tool"), default="base", help="frame of the motion at the start")
    parser.add_argument("--joy", metavar="FILE", help="mapping of a joystick: a file, or one of config/joy by name")
    parser.add_argument("--topic", default="joy", metavar="TOPIC", help="topic of its sensor_msgs/Joy (joy)")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Steer until the user ends it."""
    for name in ("linear", "angular"):
        value = getattr(arguments, name)
        if value is not None and not 0.0 < value < 100.0:
            raise ParameterError(f"--{name} {value:g}: need a positive speed")
    from ik_controller.ros.joystick import load
    from ik_controller.ros.teleop import teleop

    mapping = None if arguments.joy is None else load(_mapping_file(arguments.joy))
    linear = arguments.linear or (0.1 if mapping is None else mapping.linear_speed)
    angular = arguments.angular or (0.4 if mapping is None else mapping.angular_speed)
    teleop(arguments.node, linear, angular, arguments.frame, mapping, arguments.topic, arguments.ros_arguments)
    if arguments.json:
        print_json({"ended": True})
    return 0


def _mapping_file(given: str) -> Path:
    """Return the mapping file: as given, or a bundled one by its name."""
    from ik_controller.share import share_folder

    if Path(given).is_file():
        return Path(given)
    folder = share_folder() / "config" / "joy"
    bundled = folder / f"{given}.yaml"
    if not bundled.is_file():
        names = sorted(file.stem for file in folder.glob("*.yaml"))
        raise ParameterError(f"--joy {given}: no such file; bundled mappings: {choices(names)}")
    return bundled
