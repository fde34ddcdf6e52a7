"""The cycles of a recorded run, run again: from its inputs, events and cycle times."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.controller import Step
from ik_controller.control.obstacles import SCENE_PARAMETERS, Scene
from ik_controller.errors import BagError, ParameterError
from ik_controller.messages import cdr
from ik_controller.messages.inputs import INPUTS
from ik_controller.recording.columns import Columns
from ik_controller.recording.reader import BagReader, Message, Records
from ik_controller.recording.run import RunInfo, RunWriter
from ik_controller.robots import build_model
from ik_controller.session import Session

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_NEEDED = (*INPUTS, "events", "joint_commands", "command_output", "cycle")
_NEVER = -(1 << 62)  # [ns]


class Cycle(NamedTuple):
    """One replayed cycle: its record, the Step (None where nothing was commanded) and the recorded command's bytes."""

    number: int
    time: int
    late: int
    work: int
    step: Step | None
    recorded: bytes | None
    sent: bytes | None = None  # the command as sent, where that was not a JointState


class Stretch(NamedTuple):
    """Replayed cycles (k) that followed a pose and were worked out together: their records, in the order of
    `cdr.CYCLE_FIELDS`, the recorded commands' bytes, and the commands and errors now.
    """

    records: Integers  # (k, 6)
    recorded: list[bytes]
    sent: list[bytes | None]
    position: Array  # (k, n)
    velocity: Array  # (k, n)
    error: Array  # (k, 6)


def session_of(bag: BagReader, changes: Mapping[str, Any]) -> tuple[Session, RunInfo]:
    """Return a session as the bag's run began, with `changes` to its parameters. Raises BagError for a foreign bag."""
    info = RunInfo.of(bag)
    if info is None:
        raise BagError(f"bag '{bag.path}' holds no run of ik_controller")
    parameters = info.parameters.replace(changes)
    if parameters.rate != info.parameters.rate:
        raise ParameterError(
            f"rate = {parameters.rate:g}: a recorded run is replayed at its own, {info.parameters.rate:g} Hz"
        )
    # What may not touch is in the recorded state, and its files may be elsewhere; a what-if run may name others.
    scene = None if set(changes) & set(SCENE_PARAMETERS) else Scene()
    return Session(build_model(parameters, info.urdf), parameters, scene), info


def cycles(
    bag: BagReader, session: Session, info: RunInfo, changes: Mapping[str, Any], output: RunWriter | None = None
) -> Iterator[Cycle]:
    """Run the recorded run through `session` and yield cycle by cycle; `changes` stay in force whatever was
    recorded; `output` gets the inputs and events.
    """
    run = _Run(session, info, changes, output)
    return run.one_by_one(bag.messages(run.topics_in(bag)))


def stretches(bag: BagReader, session: Session, info: RunInfo, changes: Mapping[str, Any]) -> Iterator[Cycle | Stretch]:
    """Run the recorded run as `cycles` does, for who need not look at the session after each cycle: that takes a
    fraction of the time where there is Numba.
    """
    run = _Run(session, info, changes)
    for records in bag.records(run.topics_in(bag)):
        yield from run.chunk(records)


def warm_up(session: Session) -> None:
    """Have compiled what `stretches` takes; the session is left as it is."""
    session.warm_up(together=True)
    Columns.of(b"", np.zeros(1, np.int64))


class _Steady(NamedTuple):
    """Cycles (k) that all have a command, and what else came to them; no events."""

    records: Integers  # (k, 6)
    recorded: list[bytes]  # commands
    sent: list[bytes | None]  # and what was sent instead
    targets: list[tuple[int, Message]]  # after how many of the cycles
    joints: Array  # (j, n) of joint states
    arrivals: list[int]  # theirs [ns]
    states: list[int]  # how many of them came before each cycle
    fresh: list[bool]  # is the last of them, in each cycle?


class _Run:
    """Runs what was recorded through a session."""

    def __init__(
        self, session: Session, info: RunInfo, changes: Mapping[str, Any], output: RunWriter | None = None
    ) -> None:
        self._session, self._changes, self._output = session, changes, output
        self._role_of = {topic: role for role, topic in info.topics.items() if role in _NEEDED}
        self._topics = ["", *self._role_of]  # by kind of message
        self._kind_of = {role: kind for kind, role in enumerate(self._role_of.values(), 1)}
        self._recorded: bytes | None = None  # the command of the cycle to come
        self._sent: bytes | None = None

    def topics_in(self, bag: BagReader) -> list[str]:
        """Return the topics of a bag that matter here."""
        return [topic.name for topic in bag.topics if topic.name in self._role_of]

    def one_by_one(self, messages: Iterable[Message]) -> Iterator[Cycle]:
        """Run each message and cycle for itself."""
        session, output, role_of = self._session, self._output, self._role_of
        for topic, now, data, _ in messages:
            role = role_of[topic]
            if role == "joint_commands":
                self._recorded = data
            elif role == "cycle":
                index, at, _, late, work, _ = cdr.decode_cycle(data)
                yield Cycle(index, at, late, work, session.cycle(at), self._recorded, self._sent)
                self._recorded = self._sent = None
            elif role == "command_output":
                self._sent = data
            elif role == "events":
                event = str(cdr.decode(cdr.STRING, data).data)
                session.apply(event)
                if self._changes:
                    session.set_parameters(session.parameters.replace(self._changes))
                if output is not None:
                    output.event(now, event)
            else:
                session.take(role, data, now)
                if output is not None:
                    output.write(role, now, data)

    def chunk(self, records: Records) -> Iterator[Cycle | Stretch]:
        """Run the messages of a chunk: those of its last cycles together, as many as have a command and no event."""
        kinds = np.full(max(records.names, default=0) + 1, -1)
        for channel, topic in records.names.items():
            kinds[channel] = 0 if topic is None else self._topics.index(topic)
        columns = Columns.of(records.data, kinds)
        if columns is None:
            for messages in records.messages():
                yield from self.one_by_one(messages)
            return
        ends, commands, sent, events = (
            self._where(columns, role) for role in ("cycle", "joint_commands", "command_output", "events")
        )
        odd = (_count(commands, ends) != 1) | (_count(events, ends) > 0)
        if sent.size:
            odd |= _count(sent, ends) != 1
        begin, end = np.max(ends[odd], initial=-1) + 1, np.max(ends, initial=-1) + 1
        yield from self.one_by_one(columns.part(slice(begin)).messages(self._topics))
        whole = columns.part(slice(begin, end))
        steady = self._steady(whole)
        if steady is None:
            yield from self.one_by_one(whole.messages(self._topics))
        else:
            yield from self._together(steady)
            self._recorded = self._sent = None
        yield from self.one_by_one(columns.part(slice(end, None)).messages(self._topics))

    def _where(self, columns: Columns, role: str) -> Integers:
        return np.flatnonzero(columns.kind == self._kind_of.get(role, -1))

    def _steady(self, columns: Columns) -> _Steady | None:
        """Take whole cycles apart that have a command each and no event; None where they have to be run one by one."""
        session = self._session
        ends, states = self._where(columns, "cycle"), self._where(columns, "joint_states")
        commands, sent = self._where(columns, "joint_commands"), self._where(columns, "command_output")
        rows, joint_rows = columns.rows_at(ends), columns.rows_at(states)
        records = None if rows is None else cdr.decode_cycles(rows)
        joints = None if joint_rows is None else session.joint_states(joint_rows)
        if records is None or joints is None or (np.diff(records[:, 1]) < 0).any():  # a clock was set back
            return None
        before = np.searchsorted(states, ends)
        arrivals = columns.time[states]
        known = np.append(_NEVER if session.feedback_arrival is None else session.feedback_arrival, arrivals)
        others = np.delete(np.arange(len(columns.kind)), np.concatenate((ends, states, commands, sent)))
        return _Steady(
            records,
            columns.bytes_at(commands),
            [*columns.bytes_at(sent)] or [None] * len(commands),
            list(zip(np.searchsorted(ends, others).tolist(), columns.part(others).messages(self._topics), strict=True)),
            joints,
            arrivals.tolist(),
            before.tolist(),
            session.is_fresh(records[:, 1] - known[before]).tolist(),
        )

    def _together(self, steady: _Steady) -> Iterator[Cycle | Stretch]:
        """Run cycles, those between two targets together as far as that can be."""
        done = 0
        for count, message in steady.targets:
            yield from self._between(steady, done, count)
            self._session.take(self._role_of[message.topic], message.data, message.log_time_ns)
            done = count
        yield from self._between(steady, done, len(steady.records))
        self._session.measure(steady.joints[-1], steady.arrivals[-1])

    def _between(self, steady: _Steady, begin: int, end: int) -> Iterator[Cycle | Stretch]:
        """Run cycles without targets between them."""
        session, recorded, sent = self._session, steady.recorded, steady.sent
        if begin < end and all(steady.fresh[begin:end]):
            gone = session.cycles(steady.records[begin:end, 1].tolist())
            if gone is not None:
                part = slice(begin, begin + len(gone[0]))
                yield Stretch(steady.records[part], recorded[part], sent[part], *gone)
                begin = part.stop
        for k in range(begin, end):
            state = steady.states[k] - 1
            if state >= 0:
                session.measure(steady.joints[state], steady.arrivals[state])
            number, at, _, late, work, _ = steady.records[k].tolist()
            yield Cycle(number, at, late, work, session.cycle(at), recorded[k], sent[k])


def _count(indices: Integers, ends: Integers) -> Integers:
    """Return how many of the messages there are in each cycle, whose records are at `ends`."""
    return np.bincount(np.searchsorted(ends, indices), minlength=ends.size + 1)[: ends.size]
