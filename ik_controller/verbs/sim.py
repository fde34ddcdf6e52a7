"""`ik_controller sim`: a simulated arm as a ROS process."""

from __future__ import annotations

import argparse

from ik_controller.errors import ParameterError
from ik_controller.verbs.common import add_json_argument, add_model_arguments, parameters_from, print_json

HELP = "simulate an arm: joint_commands in, joint_states out, until Ctrl-C"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    add_model_arguments(parser, default="panda")
    parser.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="joint_states a second (1000)")
    parser.add_argument(
        "--start",
        type=float,
        nargs="+",
        metavar="Q",
        help="joints at the start (the robot's posture)",
    )
    parser.add_argument("--delay", type=float, default=0.0, metavar="S", help="delay of a command [s]")
    parser.add_argument("--lag", type=float, default=0.0, metavar="S", help="time constant of a first-order lag [s]")
    parser.add_argument(
        "--noise", type=float, default=0.0, metavar="RAD", help="deviation of the measurement [rad or m]"
    )
    parser.add_argument(
        "--quantisation", type=float, default=0.0, metavar="RAD", help="step of the measurement [rad or m]"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run until SIGINT or SIGTERM."""
    import numpy as np

    from ik_controller.robots import build_model, start_posture

    if not 1.0 <= arguments.rate <= 2000.0:
        raise ParameterError(f"--rate {arguments.rate:g}: need 1 to 2000 Hz")
    options = {name: getattr(arguments, name) for name in ("delay", "lag", "noise", "quantisation")}
    for name, value in options.items():
        if not 0.0 <= value < 60.0:
            raise ParameterError(f"--{name} {value:g}: need 0 or more")
    parameters = parameters_from(arguments)
    model = build_model(parameters)
    q = np.array(arguments.start or parameters.posture or start_posture(model), dtype=float)
    if q.shape != (model.n,) or not np.isfinite(q).all():
        raise ParameterError(f"--start: need {model.n} finite values for {', '.join(model.joint_names)}")
    from ik_controller.ros.arm import simulate

    counts = simulate(model, q, arguments.rate, arguments.ros_arguments, seed=arguments.seed, **options)
    if arguments.json:
        print_json(counts)
    return 0
