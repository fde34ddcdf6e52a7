"""The cycles of a recorded run, run again: from its inputs, events and cycle times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.controller import Step
from ik_controller.control.obstacles import SCENE_PARAMETERS, Scene
from ik_controller.errors import BagError, ParameterError
from ik_controller.messages import cdr
from ik_controller.messages.inputs import INPUTS
from ik_controller.recording.reader import BagReader, Message
from ik_controller.recording.run import RunInfo, RunWriter
from ik_controller.robots import build_model
from ik_controller.session import Session

Array = NDArray[np.float64]

_NEEDED = (*INPUTS, "events", "joint_commands", "command_output", "cycle")
_PASSIVE = frozenset(("joint_states", "joint_commands", "command_output"))  # they change nothing about what is followed
_TOGETHER = 64  # cycles that are worked out together at most


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
    """Replayed cycles (k) that followed a pose and were worked out together: their records as `cdr.decode_cycle` gives
    them, the recorded commands' bytes, and the commands and errors now.
    """

    records: list[tuple[int, ...]]
    recorded: list[bytes | None]
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
    for cycle in _run(bag, session, info, changes, output, together=False):
        assert isinstance(cycle, Cycle)
        yield cycle


def stretches(bag: BagReader, session: Session, info: RunInfo, changes: Mapping[str, Any]) -> Iterator[Cycle | Stretch]:
    """Run the recorded run as `cycles` does, for who need not look at the session after each cycle: that takes half the
    time.
    """
    return _run(bag, session, info, changes, None, together=True)


def _run(
    bag: BagReader,
    session: Session,
    info: RunInfo,
    changes: Mapping[str, Any],
    output: RunWriter | None,
    *,
    together: bool,
) -> Iterator[Cycle | Stretch]:
    role_of = {topic: role for role, topic in info.topics.items() if role in _NEEDED}
    present = {topic.name for topic in bag.topics}
    recorded: bytes | None = None
    sent: bytes | None = None
    new, take, run, passes = tuple.__new__, session.take, session.cycle, session.passes
    for messages, records in _between_targets(bag.messages([name for name in role_of if name in present]), role_of):
        expected = False
        count = passed = 0
        commands: list[bytes | None] = []
        others: list[bytes | None] = []
        for topic, now, data, _ in messages:
            role = role_of[topic]
            if role == "joint_commands":
                recorded = data
            elif role == "cycle":
                if together and not expected:
                    session.expect([record[1] for record in records])
                    expected = True
                index, at, _, late, work, _ = records[count]
                count += 1
                if expected and passes(at):
                    commands.append(recorded)
                    others.append(sent)
                else:
                    if commands:
                        yield Stretch(records[passed : count - 1], commands, others, *session.settle())
                        commands, others = [], []
                    # NamedTuple's own constructor takes twice as long
                    yield new(Cycle, (index, at, late, work, run(at), recorded, sent))
                    passed = count
                recorded = sent = None
            elif role == "command_output":
                sent = data
            elif role == "events":
                event = str(cdr.decode(cdr.STRING, data).data)
                session.apply(event)
                if changes:
                    session.set_parameters(session.parameters.replace(changes))
                if output is not None:
                    output.event(now, event)
            else:
                take(role, data, now)
                if output is not None:
                    output.write(role, now, data)
        if commands:
            yield Stretch(records[passed:count], commands, others, *session.settle())


def _between_targets(
    messages: Iterator[Message], role_of: Mapping[str, str]
) -> Iterator[tuple[list[Message], list[tuple[int, ...]]]]:
    """Yield the messages with their cycle records, decoded, in lists within which what changes the motion, targets and
    events, stands before the first cycle.
    """
    stretch: list[Message] = []
    records: list[tuple[int, ...]] = []
    decode = cdr.decode_cycle
    for message in messages:
        role = role_of[message[0]]
        if role == "cycle":
            records.append(decode(message[2]))
        elif len(records) == _TOGETHER or (records and role not in _PASSIVE):
            yield stretch, records
            stretch, records = [], []
        stretch.append(message)
    yield stretch, records
