"""Importing: text logs and anybody's bags as bags of ours."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ik_controller.errors import BagError, ParameterError
from ik_controller.messages import cdr
from ik_controller.parameters import ControllerParameters
from ik_controller.recording.fit import Fitting
from ik_controller.recording.reader import open_bag
from ik_controller.recording.target_bag import TARGET_TYPES, TargetBag, TargetOptions, restamped, write_targets
from ik_controller.recording.text_log import TextLog
from ik_controller.recording.writer import BagWriter
from ik_controller.robots import build_model


def import_files(
    files: Sequence[Path],
    output: Path,
    *,
    columns: Sequence[str] = (),
    units: Sequence[str] = (),
    options: TargetOptions | None = None,
    robot: ControllerParameters | None = None,
) -> dict[str, Any]:
    """Write the text files, or the bag, as the bag `output`; with a robot or options: as fitted targets.

    Returns what `import --json` prints. Raises IkControllerError; no bag is left behind then.
    """
    options = options or TargetOptions()
    bag = len(files) == 1 and (files[0].is_dir() or _is_bag(files[0]))
    if output.exists():
        raise BagError(f"output '{output}' exists; a bag is never overwritten")
    if bag and (columns or units):
        raise BagError(f"--columns and --units are for text; '{files[0]}' is a bag")
    if options.fitting.place and robot is None:
        raise ParameterError("--to-start and --to-middle need --robot NAME, or --urdf FILE --tip FRAME")
    report: dict[str, Any] = {"output": str(output)}
    try:
        if bag:
            report |= _fitted(files[0], output, options, robot)
        elif robot is None and options.fitting == Fitting() and not options.twists and not options.sources:
            report |= _text(files, output, columns, units, options.frame or "world")
        else:
            output.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=output.parent) as folder:
                raw = Path(folder) / "raw"
                text = _text(files, raw, columns, units, options.frame or "world")
                report |= text | _fitted(raw, output, options, robot)
    except BaseException:
        shutil.rmtree(output, ignore_errors=True)
        raise
    return report


def _is_bag(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(16).startswith((b"\x89MCAP", b"SQLite format 3", b"#ROSBAG V"))
    except OSError as error:
        raise BagError(f"cannot read '{path}': {error.strerror}") from None


def _text(
    files: Sequence[Path], output: Path, columns: Sequence[str], units: Sequence[str], frame: str
) -> dict[str, Any]:
    log = TextLog(files, columns, units, frame)
    writer = BagWriter(output, patient=True)
    types = {**TARGET_TYPES, "joint_states": cdr.JOINT_STATE}
    channels: dict[str, Any] = {}
    first = last = None
    for target in log:
        if target.role not in channels:
            channels[target.role] = writer.channel("/" + target.role, types[target.role])
        first, last = target.time if first is None else first, target.time
        writer.write(channels[target.role], target.time, target.data)
    status = writer.close()
    if first is None or last is None:
        raise BagError(f"'{files[0]}': no line could be used: {log.last_skipped or 'there is none'}")
    if status.lost or status.state != "closed":
        raise BagError(f"bag '{output}' is incomplete: {status.reason}")
    return {
        "messages": status.messages,
        "lines": log.lines,
        "skipped": log.skipped,
        "last_skipped": log.last_skipped,
        "duration_s": (last - first) * 1e-9,
        "longest_gap_s": log.longest_gap,
        "topics": ["/" + role for role in channels],
        "joints": list(log.columns.joints),
    }


def _fitted(source: Path, output: Path, options: TargetOptions, robot: ControllerParameters | None) -> dict[str, Any]:
    model = home = None
    if robot is not None:
        model = build_model(robot)
        home = model.forward(np.array(robot.posture) if robot.posture else model.middle())
    bag = open_bag(source)
    targets = TargetBag(bag, options, model=model, home=home)
    start = min(message.log_time_ns for _, message in zip(range(1), bag.messages(), strict=False))
    write_targets(output, (replace(t, data=restamped(t.data, start + t.time)) for t in targets), start, node="")
    return {
        "messages": targets.count,
        "skipped_messages": targets.skipped,
        "last_skipped_message": targets.last_skipped,
        "duration_s": targets.duration * 1e-9,
        "topics": [f"/{role}" for role in sorted(targets.roles)],
    }
