"""Making a readable bag of one that was cut off, never sealed, or damaged: a new file, the original untouched.

Chunks are copied as they are and indexed anew, so any MCAP file comes through: any profile, compression or encoding,
with chunks or without. Of a chunk in which the file ends, what can be decompressed is taken: all whole messages where
there is no compression, those in the compressor's whole blocks (zstd 128 KiB, lz4 64 KiB) else.
"""

from __future__ import annotations

import contextlib
import errno
import shutil
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, Metadata

from ik_controller.errors import BagError
from ik_controller.recording.mcap_file import DAMAGE, McapFile, chunk_records, decompress, parse
from ik_controller.recording.reader import BagReader, open_bag, segment_paths
from ik_controller.recording.rosbag2 import FileMetadata, TopicMetadata, bag_information, write_metadata_yaml
from ik_controller.recording.segment import MESSAGE_HEAD, ChunkBuilder, SegmentWriter

_CHUNK_BYTES = 1 << 20  # where the source has no chunks
_LOOSE_HEAD = struct.Struct("<HIQQ")  # channel id, sequence, log time, publish time


@dataclass(frozen=True)
class Recovery:
    """What came out: messages readable now, bytes of the original that are not, and where they are.

    `output` is the original itself if it was whole, None if nothing was readable.
    """

    messages: int
    lost_bytes: int
    output: Path | None

    @property
    def exit_code(self) -> int:
        """0: all there; 3: some lost; 1: nothing readable."""
        if self.output is None:
            return 1
        return 3 if self.lost_bytes else 0


def recover(path: Path | str, output: Path | str | None = None) -> Recovery:
    """Write what is readable of a bag (folder or .mcap file) to `output`, by default `<name>_recovered` beside it.

    A whole bag is left as it is, unless an output is asked for. Raises BagError if there is no such bag, it is not
    MCAP, or the output exists or cannot be written.
    """
    path = Path(path)
    files = _sources(path)
    if output is None:
        messages = _count_if_whole(path, files)
        if messages is not None:
            return Recovery(messages, 0, path)
    target = Path(output) if output is not None else path.with_name(f"{path.stem}_recovered{path.suffix}")
    if target.exists():
        raise BagError(f"output '{target}' exists; a bag is never overwritten")
    try:
        parts = _recover_folder(files, target) if path.is_dir() else [_recover_file(file, target) for file in files]
    except OSError as error:
        raise BagError(f"cannot recover '{path}' into '{target}': {error.strerror}") from None
    messages = sum(part.file.count for part in parts)
    whole = bool(files) and all(file.complete for file in files)
    return Recovery(messages, sum(part.lost_bytes for part in parts), target if messages or whole else None)


class _Part(NamedTuple):
    """One recovered file: its line in metadata.yaml, its topics, what was lost."""

    file: FileMetadata
    topics: list[TopicMetadata]
    lost_bytes: int


def _sources(path: Path) -> list[McapFile]:
    """Open the files of a bag, damaged or not, but those in which there is nothing yet; raises BagError where there is
    no MCAP at all.
    """
    paths = segment_paths(path) if path.is_dir() else [path]
    if not paths:
        open_bag(path)  # raises if there is no bag of any kind
        raise BagError(f"bag '{path}' has no .mcap file; only MCAP can be recovered")
    return [McapFile(file, tolerant=True) for file in paths if not file.exists() or file.stat().st_size]


def _count_if_whole(path: Path, files: list[McapFile]) -> int | None:
    """Return the number of messages of a bag of which everything is readable, else None."""
    if not files or not all(file.complete for file in files):
        return None
    if path.is_dir() and not (path / "metadata.yaml").exists():
        return None
    try:
        return sum(1 for _ in BagReader(path, files).messages())
    except BagError:
        return None


def _recover_folder(files: list[McapFile], target: Path) -> list[_Part]:
    target.mkdir(parents=True)
    try:
        parts = [_recover_file(file, target / f"{target.name}_{number}.mcap") for number, file in enumerate(files)]
        parts = [part for part in parts if (target / part.file.name).exists()]
        if parts:
            topics: dict[tuple[str, str], TopicMetadata] = {}
            for topic in (topic for part in parts for topic in part.topics):
                key = topic.name, topic.type_name
                count = topic.count + (topics[key].count if key in topics else 0)
                topics[key] = replace(topic, count=count)
            information = bag_information(list(topics.values()), [part.file for part in parts])
            if not write_metadata_yaml(target, information):
                raise OSError(errno.EIO, "metadata.yaml cannot be written")
        else:
            target.rmdir()
    except OSError:
        shutil.rmtree(target, ignore_errors=True)
        raise
    return parts


def _recover_file(source: McapFile, target: Path) -> _Part:
    """Copy what is readable into one new file; no file is left behind if that is nothing, or the disk fails."""
    target.parent.mkdir(parents=True, exist_ok=True)
    writer = SegmentWriter(target, profile=source.profile, library=source.library, compression="zstd")
    try:
        for channel in source.channels.values():
            writer.add_channel(channel, source.schemas.get(channel.schema_id))
        with source.path.open("rb", buffering=1 << 18) as stream:
            lost = _copy(source, stream, writer) + source.lost_bytes
        file = FileMetadata(target.name, writer.start, writer.end, writer.messages)
        topics = [
            TopicMetadata(
                name=channel.topic,
                type_name=source.schemas[channel.schema_id].name if channel.schema_id in source.schemas else "",
                qos=channel.metadata.get("offered_qos_profiles", ""),
                type_hash=channel.metadata.get("topic_type_hash", ""),
                count=writer.counts.get(channel.id, 0),
                encoding=channel.message_encoding,
            )
            for channel in source.channels.values()
        ]
        if source.profile == "ros2":
            writer.add_metadata("rosbag2", {"serialized_metadata": bag_information(topics, [file])})
        writer.seal()
    except BaseException:
        writer.abandon()
        raise
    if not file.count and not source.complete:
        target.unlink()
    return _Part(file, topics, lost)


def _copy(source: McapFile, stream: BinaryIO, writer: SegmentWriter) -> int:
    """Copy the data section, record by record; return the bytes of damaged records."""
    lost = 0
    loose = ChunkBuilder()  # messages that stand outside of chunks
    for opcode, _, length in source.records(stream):
        if loose.count and (opcode != Opcode.MESSAGE or loose.size >= _CHUNK_BYTES):
            writer.add_chunk(loose)
            loose.clear()
        if opcode == Opcode.DATA_END:
            break
        if opcode not in (Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA, Opcode.ATTACHMENT):
            continue
        content = stream.read(length)
        try:
            if opcode == Opcode.MESSAGE:
                channel_id, sequence, log_time, publish_time = _LOOSE_HEAD.unpack_from(content)
                if channel_id not in source.channels:
                    raise ValueError("a message of an unknown channel")
                loose.add(channel_id, sequence, log_time, publish_time, content[_LOOSE_HEAD.size :])
            elif opcode == Opcode.CHUNK:
                chunk = parse(Chunk, content)
                data = decompress(chunk)
                entries = _entries(data)
                if entries.keys() <= source.channels.keys():
                    writer.add_packed_chunk(chunk, entries)
                else:
                    lost += _take_known(data, source, loose)
            elif opcode == Opcode.METADATA:
                record = parse(Metadata, content)
                if record.name != "rosbag2":  # made anew: it counts the messages
                    writer.add_metadata(record.name, record.metadata)
            else:
                writer.add_attachment(parse(Attachment, content))
        except DAMAGE:
            lost += 9 + length
    else:
        with contextlib.suppress(*DAMAGE):  # its last message is cut off too
            _take_known(source.cut_chunk(stream), source, loose)
        if loose.count:
            writer.add_chunk(loose)
    return lost


def _entries(data: bytes) -> dict[int, list[int]]:
    """Return the message index of a decompressed chunk: channel id -> log time, offset, log time, offset, …"""
    entries: dict[int, list[int]] = {}
    for opcode, begin, _ in chunk_records(data):
        if opcode == Opcode.MESSAGE:
            _, _, channel_id, _, log_time, _ = MESSAGE_HEAD.unpack_from(data, begin - 9)
            values = entries.setdefault(channel_id, [])
            values.append(log_time)
            values.append(begin - 9)
    return entries


def _take_known(data: bytes, source: McapFile, loose: ChunkBuilder) -> int:
    """Take the messages of known channels among these records; return the bytes of the others.

    Raises one of DAMAGE where a record is cut off, after those before it.
    """
    lost = 0
    for opcode, begin, end in chunk_records(data):
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, log_time, publish_time = _LOOSE_HEAD.unpack_from(data, begin)
            if channel_id in source.channels:
                loose.add(channel_id, sequence, log_time, publish_time, data[begin + _LOOSE_HEAD.size : end])
            else:
                lost += end - begin + 9
    return lost
