"""What rosbag2 (Jazzy) writes beside the messages: the folder, QoS text, and metadata.yaml version 9.

The YAML is written by hand: it is a fixed form, and a YAML library would hold the interpreter for tens of milliseconds
beside a 1 kHz loop. The QoS text of a channel and of metadata.yaml must mean the same, or readers skip the topic.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ik_controller.errors import BagError, choices

METADATA_VERSION = 9
NO_START_TIME = 2**63 - 1  # what rosbag2 writes for a bag without messages

_LEGAL = {
    "reliability": ("reliable", "best_effort", "system_default"),
    "durability": ("volatile", "transient_local", "system_default"),
    "history": ("keep_last", "keep_all", "system_default"),
}


@dataclass(frozen=True)
class Qos:
    """Quality of service under which a topic was published; raises BagError on an unknown policy."""

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 10

    def __post_init__(self) -> None:
        for policy, legal in _LEGAL.items():
            if getattr(self, policy) not in legal:
                raise BagError(f"unknown {policy} '{getattr(self, policy)}' of a QoS; legal: {choices(legal)}")

    @property
    def text(self) -> str:
        """YAML as rosbag2 stores it with a channel (`offered_qos_profiles`). No deadline, no lifespan: infinite."""
        infinite = "\n    sec: 9223372036\n    nsec: 854775807\n"
        return (
            f"- history: {self.history}\n  depth: {self.depth}\n"
            f"  reliability: {self.reliability}\n  durability: {self.durability}\n"
            f"  deadline:{infinite}  lifespan:{infinite}"
            f"  liveliness: automatic\n  liveliness_lease_duration:{infinite}"
            "  avoid_ros_namespace_conventions: false"
        )


@dataclass(frozen=True)
class TopicMetadata:
    """One topic in metadata.yaml; `qos` is the YAML text of the channel, `type_name` "pkg/msg/Type"."""

    name: str
    type_name: str
    qos: str
    type_hash: str
    count: int
    encoding: str = "cdr"


@dataclass(frozen=True)
class FileMetadata:
    """One file of a bag: name, earliest and latest log time [ns], messages, messages by channel id, bytes."""

    name: str
    start: int
    end: int
    count: int
    counts: Mapping[int, int] = field(default_factory=dict)
    size: int = 0


def new_bag_folder(parent: Path, prefix: str = "run") -> Path:
    """Make and return a folder that did not exist: `<parent>/<prefix>_2026-11-22_001`, `…_002`, …

    Raises BagError if the parent folder cannot be made or written.
    """
    day = datetime.date.today().isoformat()
    number = 1
    while True:
        folder = parent / f"{prefix}_{day}_{number:03d}"
        try:
            parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir()
            return folder
        except FileExistsError:
            if not parent.is_dir():
                raise BagError(f"cannot record below '{parent}': it is not a folder") from None
            number += 1
        except OSError as error:
            raise BagError(f"cannot record below '{parent}': {error.strerror}") from None


def bag_information(
    topics: Sequence[TopicMetadata], files: Sequence[FileMetadata], custom: Mapping[str, str] | None = None
) -> str:
    """Return what rosbag2 says about a bag, as YAML: the `serialized_metadata` of the `rosbag2` record of an MCAP."""
    filled = [file for file in files if file.count]
    start = min((file.start for file in filled), default=NO_START_TIME)
    end = max((file.end for file in filled), default=start)
    lines = [
        f"version: {METADATA_VERSION}",
        "storage_identifier: mcap",
        f"duration:\n  nanoseconds: {end - start}",
        f"starting_time:\n  nanoseconds_since_epoch: {start}",
        f"message_count: {sum(file.count for file in files)}",
        "topics_with_message_count:" + ("" if topics else " []"),
    ]
    for topic in topics:
        qos = "\n" + textwrap.indent(topic.qos.strip(), " " * 8) if topic.qos.strip() else " []"
        lines += [
            f"  - topic_metadata:\n      name: {_quoted(topic.name)}\n      type: {_quoted(topic.type_name)}",
            f"      serialization_format: {_quoted(topic.encoding)}\n      offered_qos_profiles:{qos}",
            f"      type_description_hash: {_quoted(topic.type_hash)}\n    message_count: {topic.count}",
        ]
    lines += ['compression_format: ""\ncompression_mode: ""', "relative_file_paths:" + ("" if files else " []")]
    lines += [f"  - {_quoted(file.name)}" for file in files]
    lines += ["files:" + ("" if files else " []")]
    for file in files:
        lines += [
            f"  - path: {_quoted(file.name)}",
            f"    starting_time:\n      nanoseconds_since_epoch: {file.start if file.count else NO_START_TIME}",
            f"    duration:\n      nanoseconds: {file.end - file.start if file.count else 0}",
            f"    message_count: {file.count}",
        ]
    lines += ["custom_data:" + ("" if custom else " ~")]
    lines += [f"  {_quoted(key)}: {_quoted(value)}" for key, value in (custom or {}).items()]
    lines += ["ros_distro: jazzy"]
    return "\n".join(lines)


def write_metadata_yaml(folder: Path, information: str) -> bool:
    """Write metadata.yaml with what `bag_information` returned; a disk that fails keeps the old one: False."""
    draft = folder / "metadata.yaml.draft"
    try:
        text = "rosbag2_bagfile_information:\n" + textwrap.indent(information, "  ") + "\n"
        draft.write_text(text, encoding="utf-8")
        draft.replace(folder / "metadata.yaml")
        return True
    except OSError:
        with contextlib.suppress(OSError):
            draft.unlink()
        return False


def _quoted(text: str) -> str:
    """A JSON string is a YAML string, whatever it holds."""
    return json.dumps(text, ensure_ascii=False)
