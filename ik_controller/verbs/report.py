"""`ik_controller report`: a recorded run as a page for the browser, as a picture, or as a table of all signals."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ik_controller.errors import IkControllerError
from ik_controller.verbs.common import (
    add_json_argument,
    add_model_arguments,
    parameters_from,
    print_json,
    print_table,
    print_text,
    styled,
    waiting,
)

HELP = "show a recorded run: a page for the browser, a picture, or a table of all signals"

_PAGE = "report.html"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("bag", help="bag folder or .mcap file")
    parser.add_argument(
        "-o", "--output", metavar="FILE", help=f"page to write: one HTML file that loads nothing ({_PAGE})"
    )
    parser.add_argument("--png", metavar="FILE", help="picture to write: path and errors")
    parser.add_argument("--csv", metavar="FILE", help="table to write: every signal of every cycle")
    parser.add_argument("--parquet", metavar="FILE", help="the same as Parquet (needs pyarrow)")
    add_model_arguments(parser, default="panda", note="for a bag of targets, which is run on the ideal arm")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Replay the bag and write what was asked for."""
    from ik_controller.recording.export import CsvSink, ParquetSink
    from ik_controller.recording.picture import draw
    from ik_controller.recording.timeline import collect
    from ik_controller.report.page import write_page
    from ik_controller.report.summary import facts, headline

    files = {name: getattr(arguments, name) for name in ("output", "png", "csv", "parquet")}
    if not any(files.values()):
        files["output"] = _PAGE
    asked = {name: Path(file) for name, file in files.items() if file}
    for name, file in asked.items():
        if not file.absolute().parent.is_dir():
            raise IkControllerError(f"--{name} {file}: there is no folder '{file.parent}'")
        if file.is_dir():
            raise IkControllerError(f"--{name} {file}: this is a folder, need a file")
    kinds: dict[str, Any] = {"csv": CsvSink, "parquet": ParquetSink}
    sinks = [kinds[name](file) for name, file in asked.items() if name in kinds]
    try:
        with waiting("replaying"):
            collected = collect(arguments.bag, robot=parameters_from(arguments), sinks=sinks)
    finally:
        for sink in sinks:
            sink.close()
    if "output" in asked:
        write_page(collected, asked["output"])
    if "png" in asked:
        draw(collected.timeline, asked["png"], collected.bag.path.name)
    if arguments.json:
        names = {"output": "report", "png": "picture"}
        written = {names.get(name, name): str(file) for name, file in asked.items()}
        print_json({**written, "headline": headline(collected), **collected.replay.as_mapping()})
        return 0
    found = facts(collected)
    print_text(styled(headline(collected), "bold"))
    print_table(
        [(fact.name, f"{fact.value}{_joined(fact.text)}") for fact in found],
        styles=["" if fact.good is None else "good" if fact.good else "warn" for fact in found],
    )
    for file in asked.values():
        print(file)
    return 0


def _joined(text: str) -> str:
    return f" {text}" if text.startswith("of ") else f"; {text}"
