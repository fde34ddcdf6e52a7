"""Replay: run a recorded run again, offline, and compare every command bit for bit.

A run of ours is repeated from its inputs, events and cycle times. A bag without cycle records (somebody's targets, or
joint states alone) is run against the ideal arm at the configured rate instead; then there is nothing to compare with.
"""

from __future__ import annotations

import contextlib
import gc
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.controller import Step
from ik_controller.control.obstacles import SCENE_PARAMETERS, Scene
from ik_controller.control.status import Code
from ik_controller.errors import BagError, IkControllerError, ParameterError
from ik_controller.messages import cdr
from ik_controller.messages.commands import CommandWriter
from ik_controller.messages.inputs import INPUTS
from ik_controller.parameters import ControllerParameters
from ik_controller.recording.provenance import code, digest, software
from ik_controller.recording.reader import BagReader
from ik_controller.recording.run import RunInfo, RunWriter
from ik_controller.recording.statistics import ErrorStatistics
from ik_controller.recording.target_bag import TargetOptions
from ik_controller.robots import build_model, urdf_text
from ik_controller.session import Session

Array = NDArray[np.float64]

_NEEDED = (*INPUTS, "events", "joint_commands", "command_output", "cycle")
_BLOCK = 256  # cycles whose commands are compared at a stretch


@dataclass
class Replay:
    """What a replay found.

    `commands` compared; `identical` None where there was nothing to compare; `first_difference` the cycle's index, None
    where all are identical; `max_difference` [rad or m] in cycle `max_at`; `first_beyond` the tolerance; `…_s` are
    times [s] since the run's start. What differs as (then, now): `software` by name, `code`, `model` (of the robot as
    it is known here), `parameters` by name (changes).
    """

    commands: int = 0
    cycles: int = 0
    identical: bool | None = None
    first_difference: int | None = None
    first_difference_s: float | None = None
    max_difference: float = 0.0
    max_at: int | None = None
    first_beyond: int | None = None
    first_beyond_s: float | None = None
    tolerance: float = 0.0
    code: tuple[str, str] | None = None
    model: tuple[str, str] | None = None
    parameters: dict[str, tuple[Any, Any]] = field(default_factory=dict)
    duration: float = 0.0  # of the run [s]
    elapsed: float = 0.0  # of the replay [s]
    software: dict[str, tuple[str, str]] = field(default_factory=dict)
    errors: ErrorStatistics = field(default_factory=ErrorStatistics)
    missed: int = 0
    rejected: int = 0
    last_rejected: str = ""
    complete: bool = True

    @property
    def real_time_factor(self) -> float:
        """How many times faster than real time the replay ran."""
        return self.duration / self.elapsed if self.elapsed > 0.0 else 0.0

    def as_mapping(self) -> dict[str, Any]:
        """Return the keys of `replay --json`."""
        return {
            "commands": self.commands,
            "identical": self.identical,
            "first_difference": self.first_difference,
            "first_difference_s": self.first_difference_s,
            "max_difference": self.max_difference,
            "max_at": self.max_at,
            "tolerance": self.tolerance,
            "first_beyond_tolerance": self.first_beyond,
            "first_beyond_tolerance_s": self.first_beyond_s,
            "real_time_factor": self.real_time_factor,
            **self.errors.as_mapping(),
            "cycles": self.cycles,
            "complete": self.complete,
            "rejected": self.rejected,
            "last_rejected": self.last_rejected,
            "software": _then_and_now(self.software),
            **_then_and_now({"code": self.code, "model": self.model}),
            "parameters": _then_and_now(self.parameters),
        }


def _then_and_now(pairs: Mapping[str, tuple[Any, Any] | None]) -> dict[str, Any]:
    return {name: None if pair is None else {"then": pair[0], "now": pair[1]} for name, pair in pairs.items()}


class Cycle(NamedTuple):
    """One replayed cycle: its record, the Step (None where nothing was commanded) and the recorded command's bytes."""

    number: int
    time: int
    late: int
    work: int
    step: Step | None
    recorded: bytes | None
    sent: bytes | None = None  # the command as sent, where that was not a JointState


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
    recorded.
    """
    role_of = {topic: role for role, topic in info.topics.items() if role in _NEEDED}
    present = {topic.name for topic in bag.topics}
    recorded: bytes | None = None
    sent: bytes | None = None
    new, decode_cycle, take, run = tuple.__new__, cdr.decode_cycle, session.take, session.cycle
    for topic, now, data, _ in bag.messages([name for name in role_of if name in present]):
        role = role_of[topic]
        if role == "cycle":
            index, at, _, late, work, _ = decode_cycle(data)
            # NamedTuple's own constructor takes twice as long
            yield new(Cycle, (index, at, late, work, run(at), recorded, sent))
            recorded = sent = None
        elif role == "joint_commands":
            recorded = data
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


def replay(
    bag: BagReader,
    *,
    changes: Mapping[str, Any] | None = None,
    robot: ControllerParameters | None = None,
    output: Path | None = None,
    targets: TargetOptions | None = None,
    tolerance: float = 0.0,
    watch: Callable[[Iterator[Cycle], Session], Iterator[Cycle]] | None = None,
) -> Replay:
    """Replay a bag and compare; see the module.

    `changes`: parameters to change, for a what-if run. `robot`: the parameters for a bag that holds no run of ours, and
    `targets` how its motion is taken; with sources, a run of ours is taken as somebody's motion too. `tolerance`:
    beyond which a difference is noted as such [rad or m]. `output`: folder of a new bag with the replayed run. `watch`
    sees the cycles of a run of ours pass. Raises BagError, ParameterError, ModelError.
    """
    changed = dict(changes or {})
    if RunInfo.of(bag) is None or (targets is not None and targets.sources):
        if robot is None:
            raise BagError(f"bag '{bag.path}' holds no run of ik_controller: name the robot to run its targets on")
        from ik_controller.recording.ideal_run import run_on_ideal_arm

        return run_on_ideal_arm(bag, robot.replace(changed), targets, output)
    session, info = session_of(bag, changed)
    result = Replay(identical=True, complete=bag.complete, tolerance=tolerance)
    _note_provenance(result, info, session)
    writer = None
    if output is not None:
        writer = RunWriter(output, session, info.topics, patient=True)
    encode = cdr.JointStateWriter(session.model.joint_names)
    other = other_output(session)
    comparison = _Comparison(result, encode, other)
    first = last = 0
    before: Array | None = None
    tracking = Code.TRACKING
    session.warm_up()
    gc.collect()
    gc.freeze()  # what is there by now need not be looked through again and again while cycles pass
    begin = time.perf_counter()
    passing = cycles(bag, session, info, changed, writer)
    for cycle in passing if watch is None else watch(passing, session):
        number, last, late, work, step, recorded, _ = cycle
        first = first or last
        result.cycles += 1
        if late > session.period:
            result.missed += 1
        stamp = last + session.period
        if step is not None or recorded is not None:
            comparison.add(cycle, stamp, last - first)
        if step is not None and step.status.code is tracking:
            result.errors.add(tracking_error(session, step, before))
        before = None if step is None else step.position
        if writer is not None:
            if step is not None:
                writer.write("joint_commands", last, encode.write(stamp, step.position, step.velocity))
                if other is not None:
                    writer.write("command_output", last, other.write(step.position, step.velocity))
            writer.cycle(number, last, int(session.status.code), late, work, int(step is not None))
    comparison.look()
    result.elapsed = time.perf_counter() - begin
    gc.unfreeze()
    result.duration = (last - first) * 1e-9
    if not result.commands:  # nothing was compared, so nothing is known
        result.identical = None
    result.rejected, result.last_rejected = sum(session.rejected.values()), session.last_rejected
    if writer is not None:
        writer.close()
    return result


def tracking_error(session: Session, step: Step, before: Array | None) -> Array:
    """Return the last cycle's error (6,) of the tool, in joint space by forward kinematics; `before` (n,): the joints
    as commanded before that cycle.
    """
    reference = session.reference
    if reference is None or reference.joints is None or before is None:
        return step.error
    target, tool = session.model.forward(reference.joints), session.model.forward(before)
    return np.concatenate((target.translation - tool.translation, pin.log3(target.rotation @ tool.rotation.T)))


def other_output(session: Session) -> CommandWriter | None:
    """Return what writes the commands of a run that does not send them as JointState, else None."""
    parameters = session.parameters
    if parameters.command_output == "joint_state":
        return None
    names, velocities = session.model.joint_names, parameters.trajectory_velocities
    return CommandWriter(parameters.command_output, names, session.period, velocities)


def _note_provenance(result: Replay, info: RunInfo, session: Session) -> None:
    """Note what is not as it was when the run was recorded."""
    versions = software()
    result.software = {
        name: (then, versions.get(name, "none"))
        for name, then in info.software.items()
        if then not in (versions.get(name), "unknown")  # that of a run from a folder that was not installed
    }
    if info.code and info.code != code():
        result.code = info.code, code()
    then, now = info.parameters.as_mapping(), session.parameters.as_mapping()
    result.parameters = {name: (then[name], value) for name, value in now.items() if then[name] != value}
    try:
        known = urdf_text(info.parameters)
    except IkControllerError:  # the run's own model is in the bag; the robot may be unknown here
        known = None
    if known is not None and digest(known) != digest(info.urdf):
        result.model = digest(info.urdf), digest(known)


class _Comparison:
    """Compares commands bit for bit, a block of cycles at a time: one that is the same as a whole needs no closer
    look.
    """

    def __init__(self, result: Replay, encode: cdr.JointStateWriter, other: CommandWriter | None) -> None:
        self._result = result
        self._encode = encode
        self._other = other
        self._waiting: list[tuple[Cycle, int, int]] = []

    def add(self, cycle: Cycle, stamp: int, since: int) -> None:
        """Take a cycle with a command, recorded or replayed: the command's stamp, the time since the run's start
        [ns].
        """
        self._waiting.append((cycle, stamp, since))
        if len(self._waiting) == _BLOCK:
            self.look()

    def look(self) -> None:
        """Compare what has been added since the last look."""
        block, self._waiting = self._waiting, []
        self._result.commands += len(block)
        if block and not self._same(block):
            for entry in block:
                if not self._same([entry]):
                    self._note(entry[0], entry[2] * 1e-9)

    def _same(self, block: list[tuple[Cycle, int, int]]) -> bool:
        steps = [cycle.step for cycle, _, _ in block if cycle.step is not None]
        recorded = [cycle.recorded for cycle, _, _ in block if cycle.recorded is not None]
        if not len(block) == len(steps) == len(recorded):
            return False
        positions, velocities = [step.position for step in steps], [step.velocity for step in steps]
        if not self._encode.wrote(recorded, [stamp for _, stamp, _ in block], positions, velocities):
            return False
        sent = None if self._other is None else map(self._other.write, positions, velocities)
        return sent is None or [cycle.sent for cycle, _, _ in block] == list(sent)

    def _note(self, cycle: Cycle, at: float) -> None:
        """Note that the command of a cycle, `at` [s] after the run's start, is another."""
        result = self._result
        if result.first_difference is None:
            result.first_difference, result.first_difference_s = cycle.number, at
        result.identical = False
        difference = float("inf")
        if cycle.step is not None and cycle.recorded is not None:
            with contextlib.suppress(ValueError):  # another kind of message
                difference = float(np.abs(cycle.step.position - self._encode.positions(cycle.recorded)).max())
        if difference > result.max_difference:
            result.max_difference, result.max_at = difference, cycle.number
        if difference > result.tolerance and result.first_beyond is None:
            result.first_beyond, result.first_beyond_s = cycle.number, at


def describe_software(differences: Mapping[str, tuple[str, str]]) -> str:
    """Return the versions that differ, as one line: "numpy 2.2.6 then, 2.4.6 now; …"."""
    return "; ".join(f"{name} {then} then, {now} now" for name, (then, now) in differences.items())
