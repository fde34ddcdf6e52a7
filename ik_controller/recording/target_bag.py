"""Target bags: anybody's recorded motion as timed targets, message by message, in memory that does not grow.

The bag is read twice: once for its clocks, its length and its extent, and then for its targets in the order of time.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.errors import BagError, MessageError, choices
from ik_controller.kinematics.model import RobotModel
from ik_controller.messages import cdr
from ik_controller.recording.clock import Clock
from ik_controller.recording.fit import Fit, Fitting
from ik_controller.recording.reader import BagReader
from ik_controller.recording.samples import (
    ODOMETRY,
    OF_JOINTS,
    ROLES_OF_TYPE,
    TF,
    TRANSFORM,
    Sample,
    SampleWriter,
    converter,
)
from ik_controller.recording.writer import BagWriter

Array = NDArray[np.float64]

TARGET_TYPES = {
    "target_pose": cdr.POSE,
    "target_twist": cdr.TWIST,
    "target_trajectory": cdr.TRAJECTORY,
    "target_joints": cdr.JOINT_STATE,
}

# What is taken unasked: the first of these kinds that the bag has.
_PREFERRED = ((cdr.POSE, cdr.TWIST, cdr.TRAJECTORY), (ODOMETRY, TRANSFORM, TF), OF_JOINTS)
_WINDOW = 500_000_000  # [ns] by which messages may stand in the wrong order in the bag
_WAITING = 20_000  # targets that may wait for their turn
_NEAR = 0.2  # [s] between two poses of which a twist is made


@dataclass(frozen=True)
class TimedTarget:
    """One target: `time` since the first one [ns], role, CDR bytes."""

    time: int
    role: str
    data: bytes


class Source(NamedTuple):
    """Which topic plays which role; `child` is the frame that moves, of a topic of transforms."""

    role: str
    topic: str
    child: str = ""

    @classmethod
    def parse(cls, text: str) -> Source:
        """Read ROLE=TOPIC or ROLE=TOPIC:FRAME. Raises BagError."""
        role, equals, rest = text.partition("=")
        topic, _, child = rest.partition(":")
        if not equals or not topic or role not in TARGET_TYPES:
            raise BagError(f"--map {text}: need ROLE=TOPIC or ROLE=TOPIC:FRAME; roles: {choices(TARGET_TYPES)}")
        return cls(role, topic, child)


@dataclass(frozen=True)
class TargetOptions:
    """How a bag's motion is taken: `sources` (none: what fits), `frame` in which its poses are (empty: as they say),
    `fitting`; `twists`: make them of neighbouring poses; `max_gap` [s]: longer pauses are shortened to it.
    """

    sources: tuple[Source, ...] = ()
    frame: str = ""
    fitting: Fitting = field(default_factory=Fitting)
    twists: bool = False
    max_gap: float = math.inf


class TargetBag:
    """The targets of a bag, to be iterated as often as wanted: TimedTargets in the order of time.

    `roles` that there are; `duration` [ns]; `count` of targets' messages; `skipped` messages that could not be used,
    `last_skipped` why; `first_pose` as fitted (a `pin.SE3`), its `first_frame`, and `first_joints` (n,), None where
    there is none.
    """

    def __init__(
        self,
        bag: BagReader,
        options: TargetOptions | None = None,
        *,
        model: RobotModel | None = None,
        home: Any | None = None,
    ) -> None:
        """`model`: for joint recordings; `home`: the tool's pose (`pin.SE3`) at the arm's start, for placing.

        Raises BagError where the bag has no targets, or it is not clear which.
        """
        self.bag = bag
        self.options = options or TargetOptions()
        self._model = model
        self._home = home
        self._sources = _chosen(bag, self.options.sources)
        self.roles: set[str] = set()
        self.count = self.skipped = 0
        self.last_skipped = ""
        self.first_pose: Any | None = None
        self.first_joints: Array | None = None
        self.first_frame = ""
        self._first: Any | None = None  # first pose as recorded
        self._low, self._high = np.full(3, math.inf), np.full(3, -math.inf)
        self._clock = Clock()
        self.duration = 0
        self._survey()

    # -- the first reading

    def _survey(self) -> None:
        for message, samples in self._messages():
            self._clock.learn(message.topic, samples[0].stamp, message.log_time_ns)
            for sample in samples:
                self._see(sample)
        if not self.count:
            why = f": {self.last_skipped}" if self.skipped else ""
            topics = choices(source.topic for source in self._sources)
            raise BagError(f"bag '{self.bag.path}': nothing on {topics} can be used{why}")
        if self._first is not None:
            fit = self._new_fit()
            pose = pin.SE3ToXYZQUAT(self._first)
            self.first_pose = pin.XYZQUATToSE3(pose if fit is None else fit.pose(pose))
        start, end = self._clock.learned()
        self.duration = end - start

    def _see(self, sample: Sample) -> None:
        self.count += 1
        if self._first is None and self.first_joints is None:
            self.first_joints = sample.q
        self.roles.add(sample.role)
        if self.options.twists and sample.role == "target_pose":
            self.roles.add("target_twist")
        poses = {"target_pose": lambda: [sample.values], "target_trajectory": lambda: [p.pose for p in sample.values]}
        for pose in poses.get(sample.role, list)():
            if self._first is None and _usable(pose):
                self._first = _placement(pose)
                self.first_frame = self._frame() or sample.frame
                self.first_joints = sample.q
            self._low, self._high = np.fmin(self._low, pose[:3]), np.fmax(self._high, pose[:3])

    def _messages(self) -> Iterator[tuple[Any, list[Sample]]]:
        """Yield the messages that hold something for us, and what."""
        converters: dict[str, list[Any]] = {}
        for source in self._sources:
            kind = self.bag.topic(source.topic).type_name
            converters.setdefault(source.topic, []).append(converter(kind, source.role, source.child, self._model))
        for message in self.bag.messages(list(converters)):
            samples: list[Sample] = []
            try:
                for convert in converters[message.topic]:
                    samples += convert(message.data)
            except MessageError as error:
                self.skipped += 1
                self.last_skipped = f"{message.topic}: {error}"
            if samples:
                yield message, samples

    # -- the second

    def __iter__(self) -> Iterator[TimedTarget]:
        """Yield the targets in the order of time."""
        samples = _ordered(self._timed())
        if self.options.twists:
            samples = _with_twists(samples)
        writer, fit, frame = SampleWriter(), self._new_fit(), self._frame()
        longest = self.options.max_gap * 1e9
        last = removed = 0
        for time, sample in samples:
            if time - last > longest:
                removed += round(time - last - longest)
            last = max(time, last)
            yield TimedTarget(time - removed, sample.role, _encoded(sample, writer, fit, frame))

    def _timed(self) -> Iterator[tuple[int, Sample]]:
        start, _ = self._clock.learned()
        careful = self.options.twists or not self.options.fitting.idle
        skipped = self.skipped
        for message, samples in self._messages():
            time = self._clock.time(message.topic, samples[0].stamp, message.log_time_ns) - start
            for sample in samples:
                if not careful or sample.role != "target_pose" or _usable(sample.values):
                    yield time, sample
        self.skipped = skipped  # counted by the first reading

    def _frame(self) -> str:
        """Return the frame that all targets get, empty: their own."""
        placed = self.options.fitting.place and self._model is not None
        return self._model.base_frame if placed and self._model is not None else self.options.frame

    def _new_fit(self) -> Fit | None:
        fitting = self.options.fitting
        if fitting.idle or self._first is None:
            return None
        middle = 0.5 * (self._low + self._high) if fitting.place == "middle" else self._first.translation
        return Fit(fitting, middle, self._first, self._home)


def _chosen(bag: BagReader, sources: Sequence[Source]) -> list[Source]:
    """Return the sources asked for, or else what fits. Raises BagError."""
    for source in sources:
        bag.topic(source.topic)  # raises where there is none
    if sources:
        return list(sources)
    filled = [topic for topic in bag.topics if topic.type_name in ROLES_OF_TYPE and topic.count != 0]
    named = [
        Source(name, topic.name)
        for topic in filled
        if (name := topic.name.rsplit("/", 1)[-1]) in TARGET_TYPES and topic.type_name == TARGET_TYPES[name]
    ]
    if named:
        return named
    for kinds in _PREFERRED:
        topics: dict[str, list[str]] = {}
        for topic in filled:
            if topic.type_name in kinds:
                topics.setdefault(ROLES_OF_TYPE[topic.type_name][0], []).append(topic.name)
        for role, names in topics.items():
            states = [name for name in names if name.rsplit("/", 1)[-1] == "joint_states"]
            topics[role] = names = states if len(states) == 1 else names
            if len(names) > 1:
                raise BagError(
                    f"bag '{bag.path}' has several topics that can be {role}: {choices(names)}; "
                    f"say which: --map {role}={names[0]}"
                )
        if topics:
            return [Source(role, names[0]) for role, names in topics.items()]
    there = choices(f"{topic.name} ({topic.type_name})" for topic in bag.topics)
    raise BagError(f"bag '{bag.path}' has neither targets nor joint states; it has: {there}")


def _ordered(samples: Iterable[tuple[int, Sample]]) -> Iterator[tuple[int, Sample]]:
    """Yield in the order of time what stands at most a window out of it."""
    waiting: list[tuple[int, int, Sample]] = []
    latest = -_WINDOW
    for number, (time, sample) in enumerate(samples):
        heapq.heappush(waiting, (time, number, sample))
        latest = max(latest, time)
        while waiting[0][0] < latest - _WINDOW or len(waiting) > _WAITING:
            due, _, first = heapq.heappop(waiting)
            yield due, first
    while waiting:
        due, _, first = heapq.heappop(waiting)
        yield due, first


def _with_twists(samples: Iterable[tuple[int, Sample]]) -> Iterator[tuple[int, Sample]]:
    """Add to each pose the twist from the pose before it to the one after it; drop the twists that there were."""
    before: tuple[int, Sample] | None = None
    now: tuple[int, Sample] | None = None
    for time, sample in samples:
        if sample.role == "target_twist":
            continue
        if sample.role != "target_pose" or (now is not None and time <= now[0]):
            if sample.role != "target_pose":
                yield time, sample
            continue
        if now is not None:
            yield from _pose_and_twist(before, now, (time, sample))
        before, now = now, (time, sample)
    if now is not None:
        yield from _pose_and_twist(before, now, None)


def _pose_and_twist(
    before: tuple[int, Sample] | None, now: tuple[int, Sample], after: tuple[int, Sample] | None
) -> Iterator[tuple[int, Sample]]:
    yield now
    near = [other for other in (before, after) if other is not None and abs(other[0] - now[0]) <= _NEAR * 1e9]
    twist = np.zeros(6)
    if near:
        ends = (near[0], near[1] if len(near) == 2 else now)
        (t0, s0), (t1, s1) = sorted(ends, key=lambda end: end[0])
        turn = pin.log3(_placement(s1.values).rotation @ _placement(s0.values).rotation.T)
        twist = np.concatenate((s1.values[:3] - s0.values[:3], turn)) / ((t1 - t0) * 1e-9)
    yield now[0], Sample("target_twist", now[1].stamp or 0, now[1].frame, twist)


def _usable(pose: Array) -> bool:
    """Tell whether numbers (7,) are a pose: finite, the quaternion of unit length within 1e-3."""
    return bool(np.isfinite(pose).all()) and abs(float(np.linalg.norm(pose[3:])) - 1.0) <= 1e-3


def _placement(pose: Array) -> Any:
    numbers = np.array(pose, dtype=float)
    numbers[3:] /= np.linalg.norm(numbers[3:])
    return pin.XYZQUATToSE3(numbers)


def _encoded(sample: Sample, writer: SampleWriter, fit: Fit | None, frame: str) -> bytes:
    if sample.role == "target_joints" and sample.data is not None:
        return sample.data
    if sample.data is not None and fit is None and frame in ("", sample.frame):
        return sample.data
    values = sample.values
    if fit is not None:
        if sample.role == "target_pose":
            values = fit.pose(values)
        elif sample.role == "target_twist":
            values = fit.twist(values)
        else:
            values = [
                p._replace(pose=fit.pose(p.pose), twist=None if p.twist is None else fit.twist(p.twist)) for p in values
            ]
    return writer.encode(sample._replace(values=values, frame=frame or sample.frame))


def write_targets(folder: Path, targets: Iterable[TimedTarget], start: int, node: str = "/ik_controller") -> None:
    """Write a bag of targets that begins at `start` [ns]; the messages' own stamps stay. Raises BagError."""
    writer = BagWriter(folder, patient=True)
    channels: dict[str, Any] = {}
    for target in targets:
        if target.role not in channels:
            channels[target.role] = writer.channel(f"{node}/{target.role}", TARGET_TYPES[target.role])
        writer.write(channels[target.role], start + target.time, target.data)
    status = writer.close()
    if status.lost or status.state != "closed":
        raise BagError(f"bag '{folder}' is incomplete: {status.reason}")


def restamped(data: bytes, stamp: int) -> bytes:
    """Return a stamped message with another stamp [ns]; its header comes first in the bytes."""
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    order = "little" if data[1] == 1 else "big"
    return data[:4] + seconds.to_bytes(4, order) + nanoseconds.to_bytes(4, order) + data[12:]  # type: ignore[arg-type]
