"""Reading a bag message by message, in the order it was written, in memory that does not grow with its length."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import BinaryIO, NamedTuple

import yaml
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema

from ik_controller.errors import BagError, choices
from ik_controller.recording.mcap_file import DAMAGE, McapFile, decompress, parse
from ik_controller.recording.segment import MESSAGE_HEAD

_PADDING = bytes(MESSAGE_HEAD.size)


class Message(NamedTuple):
    """One recorded message: data as serialized (CDR), log time in ns, and the writer's running number on the topic."""

    topic: str
    log_time_ns: int
    data: bytes
    sequence: int


class Records(NamedTuple):
    """Records as they stand in a file, decompressed. `names`: topics by channel id, None for one to leave out; `cut`:
    the last record may be cut off.
    """

    path: Path
    data: bytes
    names: dict[int, str | None]
    cut: bool = False

    def messages(self) -> Iterator[list[Message]]:
        """Yield the messages, all at once. Raises BagError behind them where the records make no sense further on."""
        batch: list[Message] = []
        try:
            _take_messages(self.data, self.names, batch)
        except DAMAGE as error:
            yield batch
            if not self.cut:
                raise _damaged(self.path, error) from None
        else:
            yield batch


@dataclass(frozen=True)
class Topic:
    """A topic of a bag. `count` is None where only reading the whole bag would tell (a cut-off bag).

    `type_name` is "pkg/msg/Type", `schema` its definition, `type_hash` RIHS01, `qos` YAML text; each "" where unknown.
    """

    name: str
    type_name: str
    count: int | None
    qos: str
    type_hash: str
    schema: str
    encoding: str


class BagReader:
    """A bag of one or more MCAP files. Made by `open_bag`.

    `complete` is False if a file was cut off; `lost_bytes` says how many bytes at its end hold no whole record.
    """

    def __init__(self, path: Path, files: list[McapFile]) -> None:
        self.path = path
        self.files = files
        self.complete = all(file.complete for file in files)
        self.lost_bytes = sum(file.lost_bytes for file in files)
        self.topics = _topics(files)

    def topic(self, name: str) -> Topic:
        """Return the topic of that name; raises BagError if there is none."""
        for topic in self.topics:
            if topic.name == name:
                return topic
        raise BagError(f"bag '{self.path}' has no topic '{name}'; it has: {choices(t.name for t in self.topics)}")

    def metadata(self, name: str) -> dict[str, str]:
        """Return the last metadata record of that name; raises BagError if there is none."""
        found = {record.name: record.metadata for file in self.files for record in file.metadata}
        if name not in found:
            raise BagError(f"bag '{self.path}' has no metadata '{name}'; it has: {choices(found)}")
        return dict(found[name])

    def metadata_names(self) -> list[str]:
        """Return the names of all metadata records."""
        return list(dict.fromkeys(record.name for file in self.files for record in file.metadata))

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Yield the messages (of these topics, or all) in file order, up to where a cut-off bag ends, be it in a chunk.

        Raises BagError at a damaged chunk.
        """
        # Flattened in C: a generator within a generator would take as long as the reading itself.
        return chain.from_iterable(batch for records in self.records(topics) for batch in records.messages())

    def records(self, topics: Collection[str] | None = None) -> Iterator[Records]:
        """Yield the records that the messages (of these topics, or all) stand in, chunk by chunk."""
        return chain.from_iterable(_file_records(file, topics) for file in self.files)


def open_bag(path: Path | str) -> BagReader:
    """Open a bag: a rosbag2 folder (MCAP or sqlite3), an .mcap or .db3 file, or a ROS 1 .bag file.

    Raises BagError if it is missing, empty or none of these.
    """
    path = Path(path)
    if not path.exists():
        raise BagError(f"there is no bag '{path}'")
    if not path.is_dir():
        return _foreign(path) if _is_foreign(path) else BagReader(path, [McapFile(path)])
    paths = segment_paths(path)
    if not paths:
        for other in sorted(path.iterdir()):
            if other.is_file() and _is_foreign(other):
                return _foreign(path if (path / "metadata.yaml").exists() else other)
        raise BagError(f"bag '{path}' is empty: there is no .mcap or .db3 file in it")
    # A recorder killed while it opened a segment leaves an empty file behind.
    filled = [file for file in paths if file.stat().st_size]
    return BagReader(path, [McapFile(file) for file in filled or paths])


def _is_foreign(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(16).startswith((b"SQLite format 3", b"#ROSBAG V"))
    except OSError as error:
        raise BagError(f"cannot read bag '{path}': {error.strerror}") from None


def _foreign(path: Path) -> BagReader:
    from ik_controller.recording.foreign import ForeignBag

    return ForeignBag(path)


def segment_paths(folder: Path) -> list[Path]:
    """Return the MCAP files of a bag folder: in the order of metadata.yaml, then those it does not know, by number."""
    found = sorted(folder.glob("*.mcap"), key=lambda path: [int(n) for n in re.findall(r"\d+", path.name)])
    try:
        information = yaml.safe_load((folder / "metadata.yaml").read_text(encoding="utf-8"))
        listed = [
            folder / Path(name).name for name in information["rosbag2_bagfile_information"]["relative_file_paths"]
        ]
    except (OSError, yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError):
        listed = []  # a killed recorder had no time for it
    known = [path for path in listed if path in found]
    return known + [path for path in found if path not in known]


def _damaged(path: Path, error: Exception) -> BagError:
    return BagError(f"bag '{path}' is damaged ({error}); try `ik_controller recover`")


def _file_records(file: McapFile, topics: Collection[str] | None) -> Iterator[Records]:
    """Yield the records of a file chunk by chunk."""
    try:
        with file.path.open("rb", buffering=1 << 18) as stream:
            yield from _stream_records(file, stream, topics)
    except OSError as error:
        raise BagError(f"cannot read bag '{file.path}': {error.strerror}") from None
    except DAMAGE as error:
        raise _damaged(file.path, error) from None


def _stream_records(file: McapFile, stream: BinaryIO, topics: Collection[str] | None) -> Iterator[Records]:
    names = {
        channel.id: channel.topic if topics is None or channel.topic in topics else None
        for channel in file.channels.values()
    }
    for opcode, _, length in file.records(stream):
        if opcode == Opcode.CHUNK:
            yield Records(file.path, decompress(parse(Chunk, stream.read(length))), names)
        elif opcode == Opcode.MESSAGE:
            yield Records(file.path, b"\x05" + length.to_bytes(8, "little") + stream.read(length), names)
        elif opcode == Opcode.DATA_END:
            return
    if file.complete:
        raise ValueError("records end before the summary")
    yield Records(file.path, file.cut_chunk(stream), names, cut=True)


def _take_messages(data: bytes, names: dict[int, str | None], batch: list[Message]) -> None:
    """Append the messages among these records to `batch`; `names`: topics by channel id, None for one to leave out.

    Raises one of DAMAGE where the records make no sense from there on.
    """
    unpack, new, append = MESSAGE_HEAD.unpack_from, tuple.__new__, batch.append
    position, end = 0, len(data)
    data += _PADDING  # so that a message head can be read at any record
    try:
        while position < end:
            opcode, length, channel_id, sequence, log_time, _ = unpack(data, position)
            begin = position + 31
            position += 9 + length
            if opcode != 5:  # a schema or channel among the messages; McapFile knows them
                continue
            if position > end or length < 22:
                raise ValueError("a message reaches beyond its chunk")
            name = names[channel_id]
            if name is not None:
                # NamedTuple's own constructor would take half of the time of this loop
                append(new(Message, (name, log_time, data[begin:position], sequence)))
    except KeyError:
        raise ValueError(f"a message of channel {channel_id}, which is unknown") from None


def _topics(files: list[McapFile]) -> list[Topic]:
    """Merge the channels of all files: the same topic may have another id in every file."""
    merged: dict[tuple[str, str], tuple[Channel, Schema | None, int | None]] = {}
    for file in files:
        for channel in file.channels.values():
            schema = file.schemas.get(channel.schema_id)
            key = channel.topic, schema.name if schema is not None else ""
            count = None if file.counts is None else file.counts.get(channel.id, 0)
            before = merged[key][2] if key in merged else 0
            total = None if count is None or before is None else before + count
            merged[key] = channel, schema, total
    return [
        Topic(
            name=name,
            type_name=type_name,
            count=count,
            qos=channel.metadata.get("offered_qos_profiles", ""),
            type_hash=channel.metadata.get("topic_type_hash", ""),
            schema=schema.data.decode("utf-8", "replace") if schema is not None else "",
            encoding=channel.message_encoding,
        )
        for (name, type_name), (channel, schema, count) in merged.items()
    ]
