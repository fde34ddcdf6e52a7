"""`ik_controller demo`: the main job as three processes over DDS, then its replay, a table, a picture and a report."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ik_controller.errors import BagError, IkControllerError
from ik_controller.verbs.common import (
    Progress,
    add_json_argument,
    add_model_arguments,
    parameters_from,
    print_json,
    print_table,
    waiting,
)
from ik_controller.verbs.processes import PATIENCE, Processes, private_graph, start_arm
from ik_controller.verbs.replay import error_rows, verdict

HELP = "stream recorded targets to a simulated arm over ROS 2, record, replay, and show the result"

_SETTLE = 0.5  # [s] from the last target to the end, in which the arm comes to rest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    add_model_arguments(parser, default="panda")
    parser.add_argument("--targets", metavar="BAG", help="bag of poses to stream (a figure-eight for the robot)")
    parser.add_argument("--duration", type=float, metavar="S", help="only the first seconds of the targets")
    parser.add_argument("--rate", type=float, metavar="HZ", help="control cycles a second (the robot's parameter)")
    parser.add_argument(
        "-o", "--output", default="runs", metavar="FOLDER", help="folder for bag, picture and report (runs)"
    )
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the demo; 0 where the replay is bit-identical, else 1."""
    from ik_controller.recording.reader import open_bag
    from ik_controller.recording.target_bag import TargetBag
    from ik_controller.share import bag_folder

    values = {} if arguments.rate is None else {"rate": arguments.rate}
    parameters = parameters_from(arguments, values)
    if arguments.targets is None and not parameters.robot:
        raise BagError("no targets for this robot: give --targets BAG")
    targets_bag = Path(arguments.targets) if arguments.targets else bag_folder(f"{parameters.robot}_figure_eight")
    length = TargetBag(open_bag(targets_bag)).duration * 1e-9
    if arguments.duration is not None:
        if not arguments.duration > 0.0:
            raise BagError(f"--duration {arguments.duration:g}: need a positive time")
        length = min(length, arguments.duration)
    output = Path(arguments.output)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise IkControllerError(f"--output {output}: {error.strerror}") from None
    bag = _run_processes(arguments, targets_bag, length, output)
    result = _replayed(bag, output)
    if arguments.json:
        print_json(result)
    else:
        _show(result)
    return 0 if result["replay"]["identical"] else 1


def _run_processes(arguments: argparse.Namespace, targets: Path, length: float, output: Path) -> Path:
    """Run simulated arm, node and streamer until the targets end; return the run's bag."""
    before = set(output.iterdir())
    processes = Processes(output / "demo.log", private_graph())
    settings = {"rate": None if arguments.rate is None else float(arguments.rate), "record_folder": str(output)}
    try:
        start_arm(processes, arguments, settings)
        pace = ["--duration", f"{length}", "--patience", f"{PATIENCE:g}"]
        processes.start("stream", ["ik_controller.cli", "stream", str(targets), *pace, "--json"])
        _wait_for_stream(processes, length)
        time.sleep(_SETTLE)
        processes.end("node", "sim")
    finally:
        processes.close()
    new = [folder for folder in set(output.iterdir()) - before if folder.is_dir()]
    if len(new) != 1:
        raise IkControllerError(f"the node recorded {len(new)} bags, expected one; see {processes.log}")
    return new[0]


def _wait_for_stream(processes: Processes, length: float) -> None:
    bar = Progress(length, "streaming")
    start = time.monotonic()
    while (code := processes.poll("stream")) is None:
        processes.check("sim", "node")
        elapsed = time.monotonic() - start
        if elapsed > length + 2.0 * PATIENCE:
            raise IkControllerError(f"the targets have not been sent after {elapsed:.0f} s; see {processes.log}")
        bar.show(elapsed)
        time.sleep(0.1)
    bar.end()
    if code != 0:
        raise IkControllerError(f"the stream process failed: {processes.last_line()} (all of it: {processes.log})")


def _replayed(bag: Path, output: Path) -> dict[str, Any]:
    from ik_controller.recording.picture import draw
    from ik_controller.recording.reader import open_bag
    from ik_controller.recording.replay import replay
    from ik_controller.recording.timeline import collect
    from ik_controller.report.page import write_page

    with waiting("replaying"):
        replayed = replay(open_bag(bag))  # timed, without anybody watching
        run = collect(bag)
        median, high = run.timeline.period_percentiles()
        errors = replayed.errors.as_mapping()
        rms = errors["position_rms_m"]
        title = f"{bag.name}: position error {1e6 * rms:.2f} µm RMS" if rms is not None else bag.name
        picture, page = output / "report.png", output / "report.html"
        draw(run.timeline, picture, title)
        write_page(run, page)
    return {
        "bag": str(bag),
        "picture": str(picture),
        "report": str(page),
        "cycles": replayed.cycles,
        "period_p50_us": median,
        "period_p99_us": high,
        "missed": replayed.missed,
        **errors,
        "rejected": replayed.rejected,
        "last_rejected": replayed.last_rejected,
        "replay": replayed.as_mapping(),
    }


def _show(result: dict[str, Any]) -> None:
    again = result["replay"]
    rows = [
        ("cycles", f"{result['cycles']}"),
        ("period", f"p50 {result['period_p50_us']:.1f} µs, p99 {result['period_p99_us']:.1f} µs"),
        ("missed deadlines", f"{result['missed']}"),
        *error_rows(result),
        ("replay", verdict(again["identical"], again["first_difference"], again["max_difference"])),
        ("replay speed", f"{again['real_time_factor']:.1f} × real time"),
    ]
    if result["rejected"]:
        rows.append(("rejected", f"{result['rejected']}"))
    print_table(rows)
    if result["rejected"]:
        print(f"last rejected: {result['last_rejected']}")
    print(f"bag      {result['bag']}")
    print(f"picture  {result['picture']}")
    print(f"report   {result['report']}  (open it in a browser)")
