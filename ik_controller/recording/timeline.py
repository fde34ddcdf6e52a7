"""Timeline: a run over time, collected from its replay as the cycles pass, in memory that does not grow with the run.

Signals are thinned out by `Envelope`, which keeps peaks; what held the arm back is counted cycle by cycle.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.status import SENTENCES, Code, Limit, Status
from ik_controller.errors import BagError
from ik_controller.parameters import ControllerParameters
from ik_controller.recording.cycles import Cycle
from ik_controller.recording.envelope import Envelope
from ik_controller.recording.reader import BagReader, open_bag
from ik_controller.recording.replay import Replay, replay
from ik_controller.recording.run import RunInfo
from ik_controller.recording.signals import BLOCK, Signals
from ik_controller.session import Session

Array = NDArray[np.float64]

CAPACITY = 16384  # buckets; a report of 10 minutes at 1 kHz shows 64 cycles in each, a demo's every cycle

_MOST_LANES = 60  # a lane is a bit of an int64; more different reasons share the last one
_MOST_EVENTS = 200
_BIN = 100  # [ns] of the histogram of periods
_BINS = 500_000  # so that it reaches to 50 ms


@dataclass
class Lane:
    """One thing that the arm did or that held it back: `cycles` with it, and the least share of the wanted speed."""

    name: str
    held: bool  # does it hold the arm back? Else it is what the arm was doing
    cycles: int = 0
    least_scale: float = 1.0


class Sink(Protocol):
    """Takes every row of a run's signals, a block at a time."""

    def begin(self, signals: Signals) -> None:
        """Prepare for rows with the columns of `signals`."""

    def take(self, rows: Array, states: Sequence[str]) -> None:
        """Take rows (k, columns), and for each what the arm did and what held it back, in words."""


@dataclass
class Timeline:
    """A run's signals, statuses and events; `watch` is for `replay`. `sinks` get every row.

    After the replay: `signals` names the columns of `envelope`; `lanes` are the bits of its masks; `events`: (time [s],
    text) of what was changed while it ran; `session` is the replayed one.
    """

    sinks: Sequence[Sink] = ()
    capacity: int = CAPACITY
    lanes: list[Lane] = field(default_factory=list)
    events: list[tuple[float, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.cycles = 0
        self.worked = False  # has any cycle cost time? One that was simulated has not
        self.first_time = 0  # of the first cycle [ns]
        self._kept: dict[Any, tuple[int, list[Lane]]] = {}
        self._periods = np.zeros(_BINS, dtype=np.int64)
        self._last_start: int | None = None
        self._longest = 0
        self._words: dict[int, str] = {}

    def watch(self, cycles: Iterator[Cycle], session: Session) -> Iterator[Cycle]:
        """Pass the cycles on and note what they show."""
        self.session = session
        self.signals = signals = Signals(session.model)
        self.envelope = Envelope(len(signals.names), self.capacity)
        for sink in self.sinks:
            sink.begin(signals)
        starts = np.zeros(BLOCK, dtype=np.int64)
        count = 0
        parameters: ControllerParameters | None = None
        for cycle in cycles:
            if self.cycles == 0:
                self.first_time = cycle.time
            elapsed = cycle.time - self.first_time
            if session.parameters is not parameters:
                self._note_change(elapsed, parameters, session.parameters)
                parameters = session.parameters
            status = session.status
            mask, lanes = self._lanes_of(status)
            for lane in lanes:
                lane.cycles += 1
                if status.scale < lane.least_scale:
                    lane.least_scale = status.scale
            start = starts[count] = cycle.time + cycle.late
            signals.write(count, elapsed, int(start), cycle.work, cycle.step, session, mask)
            self.worked = self.worked or cycle.work > 0
            self.cycles += 1
            count += 1
            if count == BLOCK:
                self._take(count, starts)
                count = 0
            yield cycle
        self._take(count, starts)

    def _take(self, count: int, starts: NDArray[np.int64]) -> None:
        if not count:
            return
        rows, masks = self.signals.finish(count, self.session.dt), self.signals.masks[:count]
        self.envelope.take(rows, masks)
        before = starts[:1] if self._last_start is None else np.array([self._last_start])
        periods = np.diff(np.concatenate((before, starts[:count])))[self._last_start is None :]
        self._last_start = int(starts[count - 1])
        if len(periods):
            self._longest = max(self._longest, int(periods.max()))
            bins = np.clip(np.round(periods / _BIN), 0, _BINS - 1).astype(np.int64)
            found, counts = np.unique(bins, return_counts=True)
            self._periods[found] += counts
        if self.sinks:
            states = [self.words(mask) for mask in masks.tolist()]
            for sink in self.sinks:
                sink.take(rows, states)

    # -- statuses

    def _lanes_of(self, status: Status) -> tuple[int, list[Lane]]:
        key = (status.code, status.limit, status.joint, status.pair, status.damped, status.feasible, status.closest,
               status.reason)  # fmt: skip
        found = self._kept.get(key)
        if found is None:
            if len(self._kept) > 10_000:  # reasons with numbers in them
                self._kept.clear()
            numbers = [self._lane(name, held) for name, held in reasons(status, self.session.model.joint_names)]
            mask = sum(1 << number for number in set(numbers))
            found = self._kept[key] = mask, [self.lanes[number] for number in set(numbers)]
        return found

    def _lane(self, name: str, held: bool) -> int:
        names = [lane.name for lane in self.lanes]
        if name in names:
            return names.index(name)
        if len(names) >= _MOST_LANES:
            name, held = "other", True
            if names[-1] == name:
                return len(names) - 1
        self.lanes.append(Lane(name, held))
        return len(self.lanes) - 1

    def words(self, mask: int) -> str:
        """Return the lanes of a mask as one text: "tracking; velocity limit of 'joint2'"."""
        text = self._words.get(mask)
        if text is None:
            text = "; ".join(lane.name for bit, lane in enumerate(self.lanes) if mask >> bit & 1)
            self._words[mask] = text
        return text

    def _note_change(self, elapsed: int, old: ControllerParameters | None, new: ControllerParameters) -> None:
        if old is None or len(self.events) >= _MOST_EVENTS:
            return
        before, after = old.as_mapping(), new.as_mapping()
        for name, value in after.items():
            if value != before[name]:
                self.events.append((elapsed * 1e-9, f"{name}: {before[name]} → {value}"))

    # -- timing

    def period_percentiles(self) -> tuple[float, float]:
        """Return the median and 99th percentile of the loop's period [µs], within 0.1; NaN below two cycles."""
        reached = np.cumsum(self._periods)
        if not reached[-1]:
            return float("nan"), float("nan")
        at = [float(np.searchsorted(reached, share * reached[-1])) * _BIN * 1e-3 for share in (0.5, 0.99)]
        return at[0], at[1]

    @property
    def longest_period(self) -> float:
        """The longest period of the loop [µs]."""
        return self._longest * 1e-3

    # -- columns

    def first(self, name: str) -> Array:
        """Return a column's first value of each bucket."""
        return self.envelope.first[:, self.signals.indices[name]]

    def low(self, name: str) -> Array:
        """Return a column's smallest value of each bucket."""
        return self.envelope.low[:, self.signals.indices[name]]

    def high(self, name: str) -> Array:
        """Return a column's largest value of each bucket."""
        return self.envelope.high[:, self.signals.indices[name]]

    @property
    def duration(self) -> float:
        """From the first cycle to the end of the last [s]."""
        time = self.envelope.high[:, 0]
        return float(time[-1]) + self.session.dt if len(time) else 0.0


def reasons(status: Status, joint_names: Sequence[str]) -> list[tuple[str, bool]]:
    """Return what a status says as (short text, whether it holds the arm back), the first what the arm does."""
    found = [(SENTENCES[status.code].split(":")[0], status.code in (Code.NO_FEEDBACK, Code.FAULT))]
    if status.reason:
        found.append((status.reason[:80], True))
    if status.limit is not Limit.NONE:
        found.append((_limit(status, joint_names), True))
    if status.damped:
        found.append(("near a singularity, damped", True))
    if status.closest:
        found.append(("target out of reach", True))
    elif not status.feasible:
        found.append(("direction not kept within the limits", True))
    return found


def _limit(status: Status, joint_names: Sequence[str]) -> str:
    name = status.limit.value
    if status.pair:
        return f"{name}: {' and '.join(status.pair)}"
    if status.limit in (Limit.OBSTACLE, Limit.SELF_COLLISION):
        return f"{name} near"
    return f"{name} limit of '{joint_names[status.joint]}'" if status.joint >= 0 else f"{name} limit"


@dataclass(frozen=True)
class Run:
    """A run as a report sees it: what its replay found, what its bag says, whether only the targets were recorded."""

    bag: BagReader
    timeline: Timeline
    replay: Replay
    info: RunInfo
    simulated: bool


def collect(
    path: Path | str,
    robot: ControllerParameters | None = None,
    sinks: Sequence[Sink] = (),
) -> Run:
    """Replay a bag and collect its timeline; a bag that is no run of ours is run on the ideal arm of `robot` first.

    Raises BagError, ParameterError, ModelError.
    """
    bag = open_bag(path)
    timeline = Timeline(sinks)
    if RunInfo.of(bag) is not None:
        return _collected(bag, bag, timeline, replay(bag, watch=timeline.watch), simulated=False)
    with tempfile.TemporaryDirectory(prefix="ik_controller-") as folder:
        run = Path(folder) / "run"
        first = replay(bag, robot=robot, output=run)
        again = replay(open_bag(run), watch=timeline.watch)
        again.rejected, again.last_rejected = first.rejected, first.last_rejected
        return _collected(bag, open_bag(run), timeline, again, simulated=True)


def _collected(bag: BagReader, run: BagReader, timeline: Timeline, result: Replay, *, simulated: bool) -> Run:
    info = RunInfo.of(run)
    if info is None or not timeline.cycles:
        raise BagError(f"bag '{bag.path}' holds no cycle of a run: there is nothing to report")
    return Run(bag, timeline, result, info, simulated)
