"""Replay: run a recorded run again, offline, and compare every command bit for bit.

A run of ours is repeated from its inputs, events and cycle times. A bag without cycle records (somebody's targets, or
joint states alone) is run against the ideal arm at the configured rate instead; then there is nothing to compare with.
"""

from __future__ import annotations

import contextlib
import gc
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.controller import Step
from ik_controller.control.status import Code
from ik_controller.errors import BagError, IkControllerError
from ik_controller.kinematics.accelerate import HAS_NUMBA
from ik_controller.messages import cdr
from ik_controller.messages.commands import CommandWriter
from ik_controller.parameters import ControllerParameters
from ik_controller.recording.cycles import Cycle, Stretch, cycles, session_of, stretches, warm_up
from ik_controller.recording.provenance import code, digest, software
from ik_controller.recording.reader import BagReader
from ik_controller.recording.run import RunInfo, RunWriter
from ik_controller.recording.statistics import ErrorStatistics
from ik_controller.recording.target_bag import TargetOptions
from ik_controller.robots import urdf_text
from ik_controller.session import Session

Array = NDArray[np.float64]

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
    comparison = _Comparison(result, encode, other, session.period)
    first = last = 0
    before: Array | None = None
    tracking, period = Code.TRACKING, session.period
    together = HAS_NUMBA and writer is None and watch is None
    warm_up(session) if together else session.warm_up()
    gc.collect()
    gc.freeze()  # what is there by now need not be looked through again and again while cycles pass
    begin = time.perf_counter()
    passing: Iterator[Cycle | Stretch]
    if together:
        passing = stretches(bag, session, info, changed)
    else:
        each = cycles(bag, session, info, changed, writer)
        passing = each if watch is None else watch(each, session)
    for cycle in passing:
        if result.cycles == 0:
            first = comparison.first = cycle.records[0, 1].item() if isinstance(cycle, Stretch) else cycle.time
        if isinstance(cycle, Stretch):
            last = cycle.records[-1, 1].item()
            result.cycles += len(cycle.records)
            result.missed += int((cycle.records[:, 3] > period).sum())
            comparison.add_stretch(cycle)
            result.errors.add(cycle.error)
            before = cycle.position[-1]
            continue
        number, last, late, work, step, recorded, _ = cycle
        result.cycles += 1
        result.missed += late > period
        if step is not None or recorded is not None:
            comparison.add(cycle)
        if step is not None and step.status.code is tracking:
            result.errors.add(tracking_error(session, step, before))
        before = None if step is None else step.position
        if writer is not None:
            if step is not None:
                writer.write("joint_commands", last, encode.write(last + period, step.position, step.velocity))
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
    look. `first`: when the run began [ns].
    """

    def __init__(self, result: Replay, encode: cdr.JointStateWriter, other: CommandWriter | None, period: int) -> None:
        """`period`: how long after a cycle's start [ns] its command is stamped."""
        self._result = result
        self._encode = encode
        self._other = other
        self._period = period
        self.first = 0
        self._begin()

    def _begin(self) -> None:
        self._cycles: list[Sequence[int]] = []  # number and time [ns]
        self._recorded: list[bytes | None] = []
        self._sent: list[bytes | None] = []
        self._positions: list[Array] = []  # one cycle behind the other
        self._velocities: list[Array] = []

    def add(self, cycle: Cycle) -> None:
        """Take a cycle with a command, recorded or replayed."""
        if cycle.step is None or cycle.recorded is None:
            self.look()
            self._result.commands += 1
            self._note(cycle.number, cycle.time, math.inf)
            return
        self._cycles.append((cycle.number, cycle.time))
        self._recorded.append(cycle.recorded)
        self._sent.append(cycle.sent)
        self._take(cycle.step.position, cycle.step.velocity)

    def add_stretch(self, stretch: Stretch) -> None:
        """Take cycles that all have a command."""
        self._cycles += stretch.records[:, :2].tolist()
        self._recorded += stretch.recorded
        self._sent += stretch.sent
        self._take(stretch.position.ravel(), stretch.velocity.ravel())

    def _take(self, positions: Array, velocities: Array) -> None:
        self._positions.append(positions)
        self._velocities.append(velocities)
        if len(self._cycles) >= _BLOCK:
            self.look()

    def look(self) -> None:
        """Compare what has been added since the last look."""
        count = len(self._cycles)
        if not count:
            return
        self._result.commands += count
        positions = np.concatenate(self._positions).reshape(count, -1)
        velocities = np.concatenate(self._velocities).reshape(count, -1)
        if not self._same(slice(count), positions, velocities):
            for k, (number, time) in enumerate(self._cycles):
                if not self._same(slice(k, k + 1), positions, velocities):
                    self._note(number, time, self._difference(self._recorded[k], positions[k]))
        self._begin()

    def _same(self, part: slice, positions: Array, velocities: Array) -> bool:
        recorded = [data for data in self._recorded[part] if data is not None]
        stamps = [time + self._period for _, time in self._cycles[part]]
        positions, velocities = positions[part], velocities[part]
        if len(recorded) < len(stamps) or not self._encode.wrote(recorded, stamps, positions, velocities):
            return False
        return self._other is None or self._sent[part] == list(map(self._other.write, positions, velocities))

    def _difference(self, recorded: bytes | None, position: Array) -> float:
        with contextlib.suppress(ValueError):  # another kind of message
            if recorded is not None:
                return float(np.abs(position - self._encode.positions(recorded)).max())
        return math.inf

    def _note(self, number: int, time: int, difference: float) -> None:
        """Note that the command of a cycle that began at `time` [ns] is another."""
        result, at = self._result, (time - self.first) * 1e-9
        if result.first_difference is None:
            result.first_difference, result.first_difference_s = number, at
        result.identical = False
        if difference > result.max_difference:
            result.max_difference, result.max_at = difference, number
        if difference > result.tolerance and result.first_beyond is None:
            result.first_beyond, result.first_beyond_s = number, at


def describe_software(differences: Mapping[str, tuple[str, str]]) -> str:
    """Return the versions that differ, as one line: "numpy 2.2.6 then, 2.4.6 now; …"."""
    return "; ".join(f"{name} {then} then, {now} now" for name, (then, now) in differences.items())
