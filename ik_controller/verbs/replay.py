"""`ik_controller replay`: run a recorded run again, offline, and compare every command."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ik_controller.errors import ParameterError
from ik_controller.verbs.common import (
    add_json_argument,
    add_model_arguments,
    add_params_argument,
    add_target_arguments,
    parameters_from,
    print_json,
    print_table,
    target_options_from,
    values_from,
)

if TYPE_CHECKING:
    from ik_controller.recording.replay import Replay

HELP = "run a recorded run again, offline, and compare every command bit for bit"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("bag", help="bag folder or .mcap file")
    add_params_argument(parser, "whose values replace the recorded ones (what if)")
    parser.add_argument("-o", "--output", metavar="BAG", help="folder of a new bag with the replayed run")
    parser.add_argument(
        "--tolerance", type=float, default=0.0, metavar="T", help="largest difference that passes [rad or m] (0: bits)"
    )
    add_target_arguments(parser, placing=True)
    add_model_arguments(parser, default="panda")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Replay, print, and return 0 where all commands are identical or within the tolerance, else 1."""
    from ik_controller.recording.reader import open_bag
    from ik_controller.recording.replay import replay

    if not arguments.tolerance >= 0.0:
        raise ParameterError(f"--tolerance {arguments.tolerance}: need 0 or more")
    changes = values_from(arguments)
    output = Path(arguments.output) if arguments.output else None
    robot, targets = parameters_from(arguments, changes), target_options_from(arguments)
    result = replay(
        open_bag(arguments.bag),
        changes=changes,
        robot=robot,
        targets=targets,
        output=output,
        tolerance=arguments.tolerance,
    )
    if arguments.json:
        print_json(result.as_mapping())
    else:
        rows = [("cycles", f"{result.cycles}"), ("commands", f"{result.commands}")]
        if result.identical is not None:
            rows.append(("verdict", verdict(result.identical, result.first_difference, result.max_difference)))
        rows.append(("speed", f"{result.real_time_factor:.1f} × real time"))
        rows += error_rows(result.errors.as_mapping())
        print_table(rows)
        if not result.complete:
            print("The bag is cut off: this is what can be read of it.")
        if result.identical is False:
            _explain(result)
        if output is not None:
            print(f"The replayed run is in {output}")
    # Without a tolerance every byte counts, also those of stamps and velocities.
    close = arguments.tolerance > 0.0 and result.max_difference <= arguments.tolerance
    within = result.identical is not False or close
    return 0 if within or changes else 1


def _explain(result: Replay) -> None:
    """Print where the replay left the recorded run, and what is not as it was then."""
    from ik_controller.recording.replay import describe_software

    print(
        f"It starts to differ at {result.first_difference_s:.3f} s; the largest difference is in cycle {result.max_at}."
    )
    if result.tolerance > 0.0:
        if result.first_beyond is None:
            print(f"All of it is within the tolerance {result.tolerance:g}.")
        else:
            print(f"Beyond {result.tolerance:g} from cycle {result.first_beyond} ({result.first_beyond_s:.3f} s) on.")
    if result.software:
        print("Recorded with other software: " + describe_software(result.software))
    if result.code is not None:
        print(f"Recorded with other code of ik_controller: {result.code[0]} then, {result.code[1]} now")
    if result.model is not None:
        then, now = result.model
        print(f"The robot's model here is another: {then} then, {now} now; the recorded one is used")
    for name, (then, now) in result.parameters.items():
        print(f"parameter {name}: {then} then, {now} now")


def verdict(identical: bool, first_difference: int | None, max_difference: float) -> str:
    """Return the verdict in words."""
    if identical:
        return "bit-identical"
    return f"differs from cycle {first_difference}, at most by {max_difference:.3g}"


def error_rows(errors: dict[str, float | None]) -> list[tuple[str, str]]:
    """Return the table rows of the tracking errors."""
    rows = []
    for name, unit, factor, shown in (("position", "m", 1e6, "µm"), ("orientation", "rad", 1e6, "µrad")):
        rms, largest = errors[f"{name}_rms_{unit}"], errors[f"{name}_max_{unit}"]
        if rms is not None and largest is not None:
            rows.append((f"{name} error", f"RMS {factor * rms:.3f} {shown}, max {factor * largest:.3f} {shown}"))
    return rows
