"""Text logs: CSV and plain text, one sample a line, as poses, twists or joints; read line by line.

Which column is what is said by FIELD=COLUMN or FIELD=COLUMN:UNIT, or by names in order, or by the header's own names.
Fields: t; x y z; qx qy qz qw, or rx ry rz (rotation vector); vx vy vz wx wy wz; any other name is a joint's,
NAME.velocity its speed.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.errors import BagError, choices
from ik_controller.messages import cdr
from ik_controller.recording.samples import Sample, SampleWriter
from ik_controller.recording.target_bag import TimedTarget

Array = NDArray[np.float64]

UNITS = {
    "s": ("time", 1.0), "ms": ("time", 1e-3), "us": ("time", 1e-6), "ns": ("time", 1e-9),
    "m": ("length", 1.0), "cm": ("length", 1e-2), "mm": ("length", 1e-3),
    "rad": ("angle", 1.0), "deg": ("angle", math.pi / 180.0),
}  # fmt: skip

_POSITION, _QUATERNION, _VECTOR = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("rx", "ry", "rz")
_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
_TIME_NAMES = ("t", "time", "timestamp", "stamp", "time_s", "secs", "seconds")
_TUM = ("t", *_POSITION, *_QUATERNION)  # of 8 columns without names
_SPEED = re.compile(r"[._/ -](velocity|vel|speed|qd)$")
_NO_SPEED = re.compile(r"[._/ -](position|pos|angle|q)$")
_OTHER = re.compile(r"[._/ -](effort|torque|acceleration|acc|current|force|temperature)$")
_QUATERNION_TOLERANCE = 0.02  # of a quaternion's length, as few digits leave it


@dataclass(frozen=True)
class Columns:
    """What a line holds: `time`, `pose` (3 + 4 or 3 + 3 columns), `twist` (6), `joints` and `speeds` by joint name.

    `factors`: column → what brings its numbers to SI units.
    """

    time: int
    pose: tuple[int, ...] = ()
    twist: tuple[int, ...] = ()
    joints: dict[str, int] = field(default_factory=dict)
    speeds: dict[str, int] = field(default_factory=dict)
    factors: dict[int, float] = field(default_factory=dict)


class TextLog:
    """Files that follow each other, as TimedTargets of target_pose, target_twist or joint states (role joint_states).

    `lines` read, `skipped` ones that were not usable, `last_skipped` why; `gaps`: longest step of time [s].
    """

    def __init__(
        self, paths: Sequence[Path], columns: Sequence[str] = (), units: Sequence[str] = (), frame: str = "world"
    ) -> None:
        """Raises BagError: a file that cannot be read, a column or unit that is not known, no motion in the columns."""
        self.paths = list(paths)
        self.frame = frame
        self.lines = self.skipped = 0
        self.last_skipped = ""
        self.longest_gap = 0.0
        self._header, self._delimiter = _layout(self.paths[0])
        width = len(self._header) if self._header else len(next(self._rows(self.paths[0]))[1])
        self.columns = _columns(columns, self._header, width, _factors(units))

    def _rows(self, path: Path) -> Iterator[tuple[int, list[str]]]:
        """Yield line numbers and cells; comments, blank lines and the header left out."""
        try:
            with path.open(encoding="utf-8-sig", errors="replace", newline=None) as file:
                header = bool(self._header)
                for number, line in enumerate(file, start=1):
                    text = line.strip()
                    if not text or text.startswith(("#", "%")):
                        continue
                    if header:
                        header = False
                        continue
                    yield (
                        number,
                        next(csv.reader([text], delimiter=","))
                        if self._delimiter == ","
                        else _split(text, self._delimiter),
                    )
        except OSError as error:
            raise BagError(f"cannot read '{path}': {error.strerror}") from None

    def __iter__(self) -> Iterator[TimedTarget]:
        """Yield what the lines say; times [ns] as in the file. Lines that cannot be used are counted."""
        self.lines = self.skipped = 0
        writer = SampleWriter()
        last = -math.inf
        for path in self.paths:
            for number, cells in self._rows(path):
                self.lines += 1
                try:
                    time, samples = self._read(cells)
                except (ValueError, IndexError) as error:
                    self.skipped += 1
                    self.last_skipped = f"{path.name}:{number}: {error}"
                    continue
                self.longest_gap = max(self.longest_gap, time - last) if math.isfinite(last) else 0.0
                last = time
                stamp = round(time * 1e9)
                for sample in samples:
                    if sample.role == "joint_states":
                        data = self._joint_state(max(stamp, 0), *sample.values)
                    else:
                        data = writer.encode(sample._replace(stamp=max(stamp, 0)))
                    yield TimedTarget(stamp, sample.role, data)

    def _read(self, cells: list[str]) -> tuple[float, list[Sample]]:
        """Return the time [s] and the samples of one line. Raises ValueError, IndexError."""
        (time,) = self._numbers(cells, [self.columns.time]).tolist()
        if not 0.0 <= time < 9.2e9:
            raise ValueError(f"time {time:g} is none")
        samples = []
        if self.columns.joints:
            position = self._numbers(cells, self.columns.joints.values())
            speeds = self.columns.speeds
            speed = self._numbers(cells, [speeds[name] for name in self.columns.joints]) if speeds else np.empty(0)
            samples.append(Sample("joint_states", 0, "", (position, speed)))
        if self.columns.pose:
            samples.append(Sample("target_pose", 0, self.frame, _pose(self._numbers(cells, self.columns.pose))))
        if self.columns.twist:
            samples.append(Sample("target_twist", 0, self.frame, self._numbers(cells, self.columns.twist)))
        return time, samples

    def _joint_state(self, stamp: int, position: Array, speed: Array) -> bytes:
        names = list(self.columns.joints)
        return cdr.encode(cdr.message(cdr.JOINT_STATE, cdr.header(stamp, ""), names, position, speed, np.empty(0)))

    def _numbers(self, cells: list[str], columns: Iterable[int]) -> Array:
        """Return the numbers in these columns, in SI units. Raises ValueError, IndexError."""
        factors = self.columns.factors
        values = np.array([float(cells[column]) * factors[column] for column in columns])
        if not np.isfinite(values).all():
            raise ValueError("a value is not finite")
        return values


def _pose(numbers: Array) -> Array:
    if len(numbers) == 6:
        turn = pin.Quaternion(pin.exp3(numbers[3:])).coeffs()
    else:
        turn = numbers[3:]
        norm = float(np.linalg.norm(turn))
        if abs(norm - 1.0) > _QUATERNION_TOLERANCE:
            raise ValueError(f"the quaternion has norm {norm:.4g}")
        turn = turn / norm
    return np.concatenate((numbers[:3], turn))


def _layout(path: Path) -> tuple[list[str], str]:
    """Return the header's names, empty where there is none, and the delimiter: "," ";" tab, or "" for blanks."""
    try:
        with path.open(encoding="utf-8-sig", errors="replace", newline=None) as file:
            line = next((text for raw in file if (text := raw.strip()) and text[0] not in "#%"), "")
    except OSError as error:
        raise BagError(f"cannot read '{path}': {error.strerror}") from None
    if not line:
        raise BagError(f"'{path}' has no lines of data")
    delimiter = next((sign for sign in (",", ";", "\t") if sign in line), "")
    cells = next(csv.reader([line])) if delimiter == "," else _split(line, delimiter)
    return ([cell.strip() for cell in cells] if not any(map(_is_number, cells)) else []), delimiter


def _split(text: str, delimiter: str) -> list[str]:
    return text.split(delimiter) if delimiter else text.split()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _factors(units: Sequence[str]) -> dict[str, float]:
    factors = {"time": 1.0, "length": 1.0, "angle": 1.0}
    for unit in units:
        if unit not in UNITS:
            raise BagError(f"--units {unit}: unknown; there are: {choices(UNITS)}")
        kind, factor = UNITS[unit]
        factors[kind] = factor
    return factors


def _columns(given: Sequence[str], header: list[str], width: int, units: dict[str, float]) -> Columns:
    """Return which column is what; raises BagError."""
    own: dict[int, float] = {}  # factors of columns with a unit of their own
    if not given:
        fields = _from_header(header) if header else dict(zip(_TUM, range(8), strict=True)) if width == 8 else {}
        if not fields:
            raise BagError(
                f"{width} columns without names: say what they are, as in --columns t x y z qx qy qz qw "
                "(- leaves one out) or --columns t=0 x=1"
            )
    elif all("=" in item for item in given):
        fields = {}
        for item in given:
            name, _, column = item.partition("=")
            head, colon, unit = column.rpartition(":")
            if colon and column not in header and unit in UNITS:
                column = head
                own[_index(column, header, width)] = UNITS[unit][1]
            fields[name] = _index(column, header, width)
    elif any("=" in item for item in given):
        raise BagError("--columns: either names in order, or FIELD=COLUMN for all")
    else:
        if len(given) > width:
            raise BagError(f"--columns: {len(given)} names for {width} columns")
        fields = {name: index for index, name in enumerate(given) if name != "-"}
    return _sorted_out(fields, header, units, own)


def _index(column: str, header: list[str], width: int) -> int:
    if column in header:
        return header.index(column)
    if column.isdecimal() and int(column) < width:
        return int(column)
    names = choices(header[:40]) + (", …" if len(header) > 40 else "") if header else f"0 to {width - 1}"
    raise BagError(f"--columns: there is no column '{column}'; there are: {names}")


def _from_header(header: list[str]) -> dict[str, int]:
    """Take the names as they are: known fields, else joints; leading signs and words such as "position" left out."""
    known = {*_POSITION, *_QUATERNION, *_VECTOR, *_TWIST}
    fields: dict[str, int] = {}
    for index, raw in enumerate(header):
        name = raw.strip(" -#\"'")
        low = name.lower()
        low = low[1:] if low in ("tx", "ty", "tz") else low
        if low in _TIME_NAMES:
            fields.setdefault("t", index)
        elif low in known:
            fields.setdefault(low, index)
        elif _SPEED.search(low):
            fields[name[: _SPEED.search(low).start()] + ".velocity"] = index  # type: ignore[union-attr]
        elif not _OTHER.search(low):
            fields[_NO_SPEED.sub("", name)] = index
    poses = all(name in fields for name in _POSITION)
    if poses:  # other columns of such a file are hardly joints
        fields = {name: index for name, index in fields.items() if name == "t" or name in known}
    return fields


def _sorted_out(fields: dict[str, int], header: list[str], units: dict[str, float], own: dict[int, float]) -> Columns:
    kinds = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), "length") | {"t": "time"}
    factors = {
        column: 1.0 if name in _QUATERNION else units[kinds.get(name, "angle")] for name, column in fields.items()
    }
    left = dict(fields)
    if "t" not in left:
        raise BagError(f"--columns: which column is the time t? There are: {choices(header or left)}")
    time = left.pop("t")

    def group(*names: str) -> tuple[int, ...]:
        there = [name for name in names if name in left]
        if not there:
            return ()
        missing = [name for name in names if name not in left]
        if missing:
            raise BagError(f"--columns: {choices(there)} without {choices(missing)}")
        return tuple(left.pop(name) for name in names)

    turn = _VECTOR if "rx" in left else _QUATERNION
    pose = group(*_POSITION, *turn) if any(name in left for name in (*_POSITION, *turn)) else ()
    twist = group(*_TWIST)
    speeds = {name.removesuffix(".velocity"): left.pop(name) for name in list(left) if name.endswith(".velocity")}
    if speeds and set(speeds) != set(left):
        odd = sorted(set(speeds) ^ set(left))
        raise BagError(f"--columns: position and velocity are needed of every joint, or position alone: {choices(odd)}")
    if not (pose or twist or left):
        raise BagError("--columns: neither poses, nor twists, nor joints")
    return Columns(time, pose, twist, left, speeds, factors | own)
