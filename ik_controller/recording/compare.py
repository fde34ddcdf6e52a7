"""Compare: what two runs are like, and where they part, cycle by cycle, in memory that does not grow.

A run is its recorded commands; errors and statuses come from repeating it. A run under new parameters is what the
replay commands instead.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.status import Code, Limit
from ik_controller.errors import BagError, choices
from ik_controller.kinematics.model import RobotModel
from ik_controller.messages import cdr
from ik_controller.recording.cycles import cycles, session_of
from ik_controller.recording.reader import BagReader
from ik_controller.recording.statistics import ErrorStatistics
from ik_controller.session import Session

Array = NDArray[np.float64]


class Row(NamedTuple):
    """One cycle of a run: time since its start [ns], number, the command's position and velocity (n,) (None where there
    is none), error (6,), status code.
    """

    time: int
    number: int
    position: Array | None
    velocity: Array | None
    error: Array
    code: Code


class Measured:
    """The figures of one run, summed up as its cycles pass; joint units are rad or m as the joints are."""

    def __init__(self, model: RobotModel, dt: float) -> None:
        self._model = model
        self._dt = dt
        self.errors = ErrorStatistics()
        self.cycles = self.missed = self.rejected = 0
        self.times: dict[str, int] = {}
        self.limited = self.damped = 0
        self._last: tuple[Array, Array | None] | None = None  # velocity and acceleration of the last command
        self._sums = {"acceleration": 0.0, "jerk": 0.0}
        self._most = {"acceleration": 0.0, "jerk": 0.0, "velocity_share": 0.0, "acceleration_share": 0.0}
        self._counts = {"acceleration": 0, "jerk": 0}
        self._margin, self._margin_joint = math.inf, ""
        self._manipulability = [math.inf, 0.0]
        self._commands = 0
        self._path = [0.0, 0.0]
        self._tool: Any | None = None

    def add(self, row: Row, limited: bool, damped: bool) -> Any | None:
        """Take the next cycle; return the commanded tool's pose as `pin.SE3`, None without a command."""
        self.cycles += 1
        name = row.code.name.lower()
        self.times[name] = self.times.get(name, 0) + 1
        self.limited += limited
        self.damped += damped
        if row.code is Code.TRACKING:
            self.errors.add(row.error)
        if row.position is None or row.velocity is None:
            self._last = self._tool = None
            return None
        self._smoothness(row.velocity)
        return self._closeness(row.position, row.velocity)

    def _smoothness(self, velocity: Array) -> None:
        acceleration = None
        if self._last is not None:
            acceleration = (velocity - self._last[0]) / self._dt
            self._note("acceleration", acceleration)
            share = float((np.abs(acceleration) / self._model.acceleration_limit).max())
            self._most["acceleration_share"] = max(self._most["acceleration_share"], share)
            if self._last[1] is not None:
                self._note("jerk", (acceleration - self._last[1]) / self._dt)
        self._last = velocity, acceleration

    def _note(self, name: str, values: Array) -> None:
        self._sums[name] += float(values.dot(values)) / values.size
        self._counts[name] += 1
        self._most[name] = max(self._most[name], float(np.abs(values).max()))

    def _closeness(self, q: Array, velocity: Array) -> Any:
        model = self._model
        self._commands += 1
        margins = np.fmin(q - model.lower, model.upper - q)
        joint = int(np.argmin(margins))
        if margins[joint] < self._margin:
            self._margin, self._margin_joint = float(margins[joint]), model.joint_names[joint]
        share = float((np.abs(velocity) / model.velocity_limit).max())
        self._most["velocity_share"] = max(self._most["velocity_share"], share)
        jacobian = model.jacobian(q)
        square = jacobian @ jacobian.T if model.n >= 6 else jacobian.T @ jacobian
        value = math.sqrt(max(float(np.linalg.det(square)), 0.0))
        self._manipulability[0] = min(self._manipulability[0], value)
        self._manipulability[1] += value
        tool = model.forward(q)
        if self._tool is not None:
            self._path[0] += float(np.linalg.norm(tool.translation - self._tool.translation))
            self._path[1] += float(np.linalg.norm(pin.log3(self._tool.rotation.T @ tool.rotation)))
        self._tool = tool
        return tool

    def as_mapping(self) -> dict[str, Any]:
        """Return the figures by name; None where there was nothing to measure."""
        some = self._commands > 0
        figures: dict[str, Any] = {
            "cycles": self.cycles,
            "commands": self._commands,
            "duration_s": self.cycles * self._dt,
            **self.errors.as_mapping(),
            "tool_path_m": self._path[0],
            "tool_path_rad": self._path[1],
        }
        for name in ("acceleration", "jerk"):
            count = self._counts[name]
            figures[f"{name}_rms"] = math.sqrt(self._sums[name] / count) if count else None
            figures[f"{name}_max"] = self._most[name] if count else None
        figures |= {
            "velocity_share_max": self._most["velocity_share"],
            "acceleration_share_max": self._most["acceleration_share"],
            "limit_margin_min": self._margin if some and math.isfinite(self._margin) else None,
            "limit_margin_joint": self._margin_joint,
            "manipulability_min": self._manipulability[0] if some else None,
            "manipulability_mean": self._manipulability[1] / self._commands if some else None,
            "limited_s": self.limited * self._dt,
            "damped_s": self.damped * self._dt,
            **{f"{code.name.lower()}_s": self.times.get(code.name.lower(), 0) * self._dt for code in Code},
            "missed": self.missed,
            "rejected": self.rejected,
        }
        return figures


class Run:
    """A recorded run, or its replay, with `changes` to the parameters; iterate once over `rows`."""

    def __init__(self, bag: BagReader, changes: Mapping[str, Any] | None = None, *, replayed: bool = False) -> None:
        """Raises BagError where the bag holds no run of ours, ParameterError for changes that do not fit."""
        self.bag = bag
        self._changes = dict(changes or {})
        self._replayed = replayed or bool(self._changes)
        self.session, self._info = session_of(bag, self._changes)
        self.measured = Measured(self.session.model, self.session.dt)

    @property
    def session_period(self) -> int:
        """Return the period of a cycle [ns]."""
        return self.session.period

    def rows(self) -> Iterator[tuple[Row, Any | None]]:
        """Yield each cycle with its tool's pose, and measure it."""
        session: Session = self.session
        encode = cdr.JointStateWriter(session.model.joint_names)
        first: int | None = None
        for cycle in cycles(self.bag, session, self._info, self._changes):
            first = cycle.time if first is None else first
            position = velocity = None
            if cycle.recorded is not None and not self._replayed:
                position, velocity = encode.positions(cycle.recorded), encode.velocities(cycle.recorded)
            elif cycle.step is not None and self._replayed:
                position, velocity = cycle.step.position, cycle.step.velocity
            status = session.status
            error = np.zeros(6) if cycle.step is None else cycle.step.error
            row = Row(cycle.time - first, cycle.number, position, velocity, error, status.code)
            self.measured.missed += cycle.late > session.period
            yield row, self.measured.add(row, status.limit is not Limit.NONE, status.damped)
        self.measured.rejected = sum(session.rejected.values())


@dataclass
class Difference:
    """Where a signal of two runs first differs, and where most: cycle of the first run, time [s], value."""

    first_cycle: int | None = None
    first_s: float | None = None
    largest: float = 0.0
    largest_s: float | None = None

    def add(self, row: Row, value: float) -> None:
        """Take the difference in one cycle."""
        if value > 0.0 or math.isnan(value):
            if self.first_cycle is None:
                self.first_cycle, self.first_s = row.number, row.time * 1e-9
            if value > self.largest:
                self.largest, self.largest_s = value, row.time * 1e-9


@dataclass
class Comparison:
    """Figures of both runs and, by signal, their differences; `compared` cycles."""

    a: dict[str, Any] = field(default_factory=dict)
    b: dict[str, Any] = field(default_factory=dict)
    signals: dict[str, Difference] = field(default_factory=dict)
    compared: int = 0

    @property
    def identical(self) -> bool:
        """Tell whether no signal differs in any cycle."""
        same = self.a["cycles"] == self.b["cycles"]
        return self.compared > 0 and same and all(d.first_cycle is None for d in self.signals.values())

    def violations(self, most: Mapping[str, float], least: Mapping[str, float]) -> list[str]:
        """Return what is beyond the bounds, a line each. Names are figures of run B, or signals (their largest
        difference). Raises BagError for an unknown name.
        """
        values = {**self.b, **{name: d.largest for name, d in self.signals.items()}}
        return violations(values, most, least)

    def as_mapping(self) -> dict[str, Any]:
        """Return what `compare --json` prints."""
        return {
            "compared": self.compared,
            "identical": self.identical,
            "a": self.a,
            "b": self.b,
            "signals": {name: vars(difference) for name, difference in self.signals.items()},
        }


def violations(values: Mapping[str, Any], most: Mapping[str, float], least: Mapping[str, float]) -> list[str]:
    """Return which values are above `most` or below `least`, a line each. Raises BagError for an unknown name."""
    lines = []
    for bounds, word, sign in ((most, "at most", 1.0), (least, "at least", -1.0)):
        for name, bound in bounds.items():
            if name not in values or isinstance(values[name], str):
                legal = sorted(key for key, value in values.items() if not isinstance(value, str))
                raise BagError(f"unknown figure '{name}'; there are: {choices(legal)}")
            value = values[name]
            if value is None:
                lines.append(f"{name} was not measured, need {word} {bound:g}")
            elif not sign * value <= sign * bound:
                lines.append(f"{name} is {value:.6g}, need {word} {bound:g}")
    return lines


def measure(bag: BagReader, changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the figures of a run's replay, with `changes`. Raises BagError, ParameterError."""
    run = Run(bag, changes, replayed=True)
    for _ in run.rows():
        pass
    return run.measured.as_mapping()


def compare(a: Run, b: Run) -> Comparison:
    """Compare two runs of the same joints; cycles are paired by time since the run's start.

    Raises BagError where the joints differ.
    """
    names = a.session.model.joint_names
    if names != b.session.model.joint_names:
        raise BagError(f"the runs are of different arms: {choices(names)} and {choices(b.session.model.joint_names)}")
    result = Comparison()
    signals = ("position", "velocity", "tool_position_m", "tool_orientation_rad", "tracking_error", "status")
    per_joint = [f"{name}.{kind}" for kind in ("position", "velocity") for name in names]
    result.signals = {name: Difference() for name in (*signals, *per_joint)}
    half = a.session_period // 2
    others = b.rows()
    other = next(others, None)
    for row, tool in a.rows():
        while other is not None and other[0].time < row.time - half:
            other = next(others, None)
        if other is None or other[0].time > row.time + half:
            continue
        result.compared += 1
        _differ(result.signals, names, (row, tool), other)
    for _ in others:
        pass
    result.a, result.b = a.measured.as_mapping(), b.measured.as_mapping()
    return result


def _differ(signals: dict[str, Difference], names: tuple[str, ...], one: tuple[Row, Any], two: tuple[Row, Any]) -> None:
    row, tool = one
    other, other_tool = two
    signals["status"].add(row, float(row.code is not other.code))
    signals["tracking_error"].add(row, float(np.abs(row.error - other.error).max()))
    if row.position is None or other.position is None or row.velocity is None or other.velocity is None:
        if (row.position is None) is not (other.position is None):
            signals["position"].add(row, math.inf)
        return
    for kind, left, right in (
        ("position", row.position, other.position),
        ("velocity", row.velocity, other.velocity),
    ):
        gaps = np.abs(left - right)
        largest = float(gaps.max())
        if largest > 0.0:
            signals[kind].add(row, largest)
            for name, gap in zip(names, gaps.tolist(), strict=True):
                signals[f"{name}.{kind}"].add(row, gap)
    if row.position is not other.position and (row.position != other.position).any():
        signals["tool_position_m"].add(row, float(np.linalg.norm(tool.translation - other_tool.translation)))
        turn = pin.log3(tool.rotation.T @ other_tool.rotation)
        signals["tool_orientation_rad"].add(row, float(np.linalg.norm(turn)))
