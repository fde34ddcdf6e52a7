"""Target bags: the poses and twists of a bag as timed messages, whoever recorded them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ik_controller.errors import BagError, choices
from ik_controller.messages import cdr
from ik_controller.recording.reader import BagReader, open_bag
from ik_controller.recording.writer import BagWriter

_ROLE_OF_TYPE = {cdr.POSE: "target_pose", cdr.TWIST: "target_twist", cdr.TRAJECTORY: "target_trajectory"}


@dataclass(frozen=True)
class TimedTarget:
    """One target: `time` since the first one [ns] (by stamp, by arrival where unstamped), role, CDR bytes."""

    time: int
    role: str
    data: bytes


def read_targets(bag: BagReader, topics: Iterable[str] = ()) -> list[TimedTarget]:
    """Return the bag's targets in order of time; `topics`, or all of a target's type (those named target_… if any).

    Raises BagError where there is none.
    """
    wanted = set(topics)
    roles = {t.name: _ROLE_OF_TYPE[t.type_name] for t in bag.topics if t.type_name in _ROLE_OF_TYPE}
    for name in wanted - set(roles):
        raise BagError(f"bag '{bag.path}' has no targets on '{name}'; it has: {choices(roles)}")
    named = {name: role for name, role in roles.items() if name.rsplit("/", 1)[-1] == role}
    chosen = {name: roles[name] for name in wanted} or named or roles
    found = [
        (cdr.stamp_of(cdr.decode(_TYPE_OF_ROLE[chosen[m.topic]], m.data)) or m.log_time_ns, chosen[m.topic], m.data)
        for m in bag.messages(list(chosen))
    ] if chosen else []  # fmt: skip
    if not found:
        kinds = choices(sorted(_ROLE_OF_TYPE))
        raise BagError(f"bag '{bag.path}' has no targets: need messages of {kinds}; it has: {choices(roles)}")
    found.sort(key=lambda item: item[0])
    first = found[0][0]
    return [TimedTarget(time - first, role, data) for time, role, data in found]


_TYPE_OF_ROLE = {role: type_name for type_name, role in _ROLE_OF_TYPE.items()}


def load_targets(path: str | Path, topics: Iterable[str] = ()) -> list[TimedTarget]:
    """Return the targets of the bag at `path`; see `read_targets`."""
    return read_targets(open_bag(path), topics)


def write_targets(folder: Path, targets: Iterable[TimedTarget], start: int, node: str = "/ik_controller") -> None:
    """Write a bag of targets that begins at `start` [ns]; the messages' own stamps stay. Raises BagError."""
    writer = BagWriter(folder, patient=True)
    channels = {role: writer.channel(f"{node}/{role}", kind) for kind, role in _ROLE_OF_TYPE.items()}
    for target in targets:
        writer.write(channels[target.role], start + target.time, target.data)
    status = writer.close()
    if status.lost or status.state != "closed":
        raise BagError(f"bag '{folder}' is incomplete: {status.reason}")


def restamped(data: bytes, stamp: int) -> bytes:
    """Return a stamped message with another stamp [ns]; its header comes first in the bytes."""
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    order = "little" if data[1] == 1 else "big"
    return data[:4] + seconds.to_bytes(4, order) + nanoseconds.to_bytes(4, order) + data[12:]  # type: ignore[arg-type]
