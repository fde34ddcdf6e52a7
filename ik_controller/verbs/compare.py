"""`ik_controller compare`: two runs, or a run and its replay under other parameters, side by side."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from ik_controller.errors import ParameterError
from ik_controller.verbs.common import add_json_argument, add_params_argument, print_json, print_table, values_from

HELP = "compare two runs, or a run with its replay under other parameters"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.description = (
        "Tracking, smoothness, closeness to limits and time in each status of both, and per signal the first and the "
        "largest difference. Exit code 1 where a bound of --max or --min on the second run is broken."
    )
    parser.add_argument("a", metavar="A", help="bag of a run")
    parser.add_argument("b", nargs="?", metavar="B", help="bag of another run (none: A's own replay)")
    add_params_argument(parser, "for the replay of B, or of A where there is no B")
    for name, word in (("max", "largest"), ("min", "smallest")):
        parser.add_argument(
            f"--{name}",
            nargs="+",
            default=(),
            metavar="NAME=VALUE",
            help=f"{word} value that passes, of a figure of B or of a signal's difference",
        )
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Compare, print, and return 1 where a bound is broken."""
    from ik_controller.recording.compare import Run, compare
    from ik_controller.recording.reader import open_bag

    most, least = bounds("--max", arguments.max), bounds("--min", arguments.min)
    changes = values_from(arguments)
    replayed = arguments.b is None
    second = open_bag(arguments.a if replayed else arguments.b)
    result = compare(Run(open_bag(arguments.a)), Run(second, changes, replayed=replayed or bool(changes)))
    broken = result.violations(most, least)
    if arguments.json:
        print_json({**result.as_mapping(), "broken": broken})
    else:
        _show(result.as_mapping())
        for line in broken:
            print(f"BROKEN   {line}")
    return 1 if broken else 0


def bounds(option: str, items: Sequence[str]) -> dict[str, float]:
    """Return name → value of NAME=VALUE items. Raises ParameterError."""
    found = {}
    for item in items:
        name, _, text = item.partition("=")
        try:
            found[name] = float(text)
        except ValueError:
            raise ParameterError(f"{option} {item}: need NAME=VALUE") from None
    return found


def _show(content: dict[str, Any]) -> None:
    rows = []
    for name, one in content["a"].items():
        two = content["b"][name]
        if (one or two) or name.endswith(("_min", "_max")):
            change = ""
            if isinstance(one, (int, float)) and isinstance(two, (int, float)) and one and one != two:
                change = f"{100.0 * (two - one) / abs(one):+.2f} %"
            rows.append((name, _text(one), _text(two), change))
    print_table(rows, ("figure", "A", "B", "change"))
    print()
    if content["identical"]:
        print(f"identical in all of {content['compared']} cycles")
        return
    signals = [
        (name, f"{d['first_cycle']}", f"{d['first_s']:.3f}", f"{d['largest']:.4g}", f"{d['largest_s'] or 0.0:.3f}")
        for name, d in content["signals"].items()
        if d["first_cycle"] is not None
    ]
    print_table(signals or [("none", "", "", "", "")], ("signal", "first cycle", "at [s]", "largest", "at [s]"))
    print(f"{content['compared']} cycles compared")


def _text(value: Any) -> str:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
