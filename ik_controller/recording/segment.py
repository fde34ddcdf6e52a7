"""One MCAP file, written chunk by chunk so that it can be sealed at any time, even after a failed write.

The records are those of the official `mcap` library. Only the two that come with every message (Message, MessageIndex)
are packed here, and the order of writing is ours, for two measured reasons. `mcap.writer.Writer` takes 7.3 µs of the
interpreter per message (5.9 to add, 1.4 in flushes that hold it for 340 µs on end), which a 1 kHz loop in the same
process feels; this takes about 1 µs. And once a write has failed, its books no longer match the file, so the file
cannot be sealed; here a chunk counts only once it is whole on disk.

Format: https://mcap.dev/spec (magic, header, schemas, channels, chunks each with its message indexes, summary, footer).
"""

from __future__ import annotations

import contextlib
import errno
import os
import struct
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from ik_controller.errors import BagError, choices
from ik_controller.recording.schema import ENCODING, MessageSchema

MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "ik_controller"
COMPRESSIONS = ("zstd", "lz4", "none")
MESSAGE_HEAD = struct.Struct("<BQHIQQ")  # opcode, length, channel id, sequence, log time, publish time
_INDEX_HEAD = struct.Struct("<BQHI")  # opcode, length, channel id, bytes of the entries
_ZSTD_LEVEL = 1  # for chunks of 50 ms, level 3 saves 1 % of the size for 1.3 times the time


PackedMessage = tuple[int, int, int, "bytes | memoryview"]
"""Channel id, sequence, log time [ns], data."""


class ChunkBuilder:
    """The messages of one chunk, packed as MCAP records in the order of `extend`."""

    __slots__ = ("_parts", "entries", "size")

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all messages."""
        self._parts: list[bytes | memoryview] = []
        self.entries: dict[int, list[int]] = {}  # channel id -> log time, offset, log time, offset, …
        self.size = 0

    @property
    def count(self) -> int:
        """How many messages there are."""
        return len(self._parts) // 2

    def extend(self, messages: Iterable[PackedMessage]) -> None:
        """Append messages. Raises struct.error at the first with a number that does not fit; those before it are in."""
        pack, append, entries, size = MESSAGE_HEAD.pack, self._parts.append, self.entries, self.size
        try:
            for channel_id, sequence, log_time, data in messages:
                length = len(data)
                head = pack(5, 22 + length, channel_id, sequence & 0xFFFFFFFF, log_time, log_time)
                append(head)
                append(data)
                index = entries.get(channel_id)
                if index is None:
                    index = entries[channel_id] = []
                index += (log_time, size)
                size += 31 + length
        finally:
            self.size = size

    def add(self, channel_id: int, sequence: int, log_time: int, publish_time: int, data: bytes) -> None:
        """Append one message with a publish time of its own."""
        head = MESSAGE_HEAD.pack(5, 22 + len(data), channel_id, sequence, log_time, publish_time)
        self._parts += (head, data)
        self.entries.setdefault(channel_id, []).extend((log_time, self.size))
        self.size += 31 + len(data)

    def pack(self) -> bytes:
        """Return all message records as one block."""
        return b"".join(self._parts)


class SegmentWriter:
    """Writes one new MCAP file. Every method raises OSError if the disk does; what was whole before stays whole.

    Raises BagError on an unknown compression, FileExistsError rather than overwrite.
    """

    def __init__(self, path: Path, *, profile: str = "ros2", library: str = LIBRARY, compression: str = "zstd") -> None:
        if compression not in COMPRESSIONS:
            raise BagError(f"unknown compression '{compression}' of a bag; legal: {choices(COMPRESSIONS)}")
        self.path = path
        self.size = 0
        self.start = 0
        self.end = 0
        self.messages = 0
        self.counts: dict[int, int] = {}
        self.channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._compression = "" if compression == "none" else compression
        self._zstd = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
        # The summary as it grows, already packed: it lives as long as the run, so it must be small.
        self._chunk_indexes = bytearray()
        self._other_indexes = {Opcode.METADATA_INDEX: bytearray(), Opcode.ATTACHMENT_INDEX: bytearray()}
        self._chunks = self._metadata = self._attachments = 0
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        try:
            self._write(MAGIC + _packed(Header(profile=profile, library=library)))
        except OSError:
            self.abandon()
            raise

    @property
    def summary_size(self) -> int:
        """Bytes that sealing will need, at most."""
        fixed = sum(len(schema.data) + len(schema.name) + 64 for schema in self._schemas.values())
        fixed += sum(
            len(c.topic) + 64 + sum(len(k) + len(v) + 8 for k, v in c.metadata.items()) for c in self.channels.values()
        )
        others = sum(len(index) for index in self._other_indexes.values())
        return fixed + len(self._chunk_indexes) + others + 10 * len(self.counts) + 1024

    def add_topic(self, channel_id: int, topic: str, schema: MessageSchema, qos: str) -> None:
        """Write the channel of a ROS topic as rosbag2 does; `qos` is YAML text."""
        known = next((record for record in self._schemas.values() if record.name == schema.name), None)
        record = known or Schema(id=channel_id, name=schema.name, encoding=ENCODING, data=schema.text.encode())
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": schema.type_hash}
        self.add_channel(
            Channel(id=channel_id, topic=topic, message_encoding="cdr", schema_id=record.id, metadata=metadata), record
        )

    def add_channel(self, channel: Channel, schema: Schema | None) -> None:
        """Write a channel and, if new, its schema; outside of chunks, so that a damaged chunk hurts no other."""
        records = [] if schema is None or schema.id in self._schemas else [schema]
        self._write(_packed(*records, channel))
        if schema is not None:
            self._schemas[schema.id] = schema
        self.channels[channel.id] = channel

    def add_metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Write a metadata record."""
        offset, length = self._write(_packed(Metadata(name=name, metadata=dict(mapping))))
        self._other_indexes[Opcode.METADATA_INDEX] += _packed(MetadataIndex(offset=offset, length=length, name=name))
        self._metadata += 1

    def add_attachment(self, attachment: Attachment) -> None:
        """Write an attachment record."""
        offset, length = self._write(_packed(attachment))
        index = AttachmentIndex(
            offset=offset,
            length=length,
            log_time=attachment.log_time,
            create_time=attachment.create_time,
            data_size=len(attachment.data),
            name=attachment.name,
            media_type=attachment.media_type,
        )
        self._other_indexes[Opcode.ATTACHMENT_INDEX] += _packed(index)
        self._attachments += 1

    def add_chunk(self, chunk: ChunkBuilder) -> None:
        """Compress and write the messages of a chunk with their indexes, in one piece."""
        data = chunk.pack()
        if self._compression == "zstd":
            compressed = self._zstd.compress(data)
        elif self._compression == "lz4":
            compressed = lz4.frame.compress(data)
        else:
            compressed = data
        record = Chunk(
            compression=self._compression,
            data=compressed,
            message_start_time=min((min(values[::2]) for values in chunk.entries.values()), default=0),
            message_end_time=max((max(values[::2]) for values in chunk.entries.values()), default=0),
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        self.add_packed_chunk(record, chunk.entries)

    def add_packed_chunk(self, chunk: Chunk, entries: Mapping[int, list[int]]) -> None:
        """Write a chunk as it is, with indexes for `entries`: channel id -> log time, offset, log time, offset, …"""
        block = bytearray(_packed(chunk))
        chunk_length = len(block)
        offsets = {}
        for channel_id, values in entries.items():
            offsets[channel_id] = self.size + len(block)
            size = 8 * len(values)
            block += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel_id, size)
            block += struct.pack(f"<{len(values)}Q", *values)
        offset, length = self._write(block)
        self._chunk_indexes += _packed(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=offset,
                chunk_length=chunk_length,
                message_index_offsets=offsets,
                message_index_length=length - chunk_length,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        self._chunks += 1
        count = sum(len(values) for values in entries.values()) // 2
        if count:
            first = not self.messages
            self.start = chunk.message_start_time if first else min(self.start, chunk.message_start_time)
            self.end = chunk.message_end_time if first else max(self.end, chunk.message_end_time)
        self.messages += count
        for channel_id, values in entries.items():
            self.counts[channel_id] = self.counts.get(channel_id, 0) + len(values) // 2

    def is_linked(self) -> bool:
        """Tell whether the file still has a name: a deleted file takes writes without complaint."""
        return os.fstat(self._file).st_nlink > 0

    def seal(self) -> None:
        """Write summary and footer and close the file. After OSError the file is as before and still open."""
        statistics = Statistics(
            attachment_count=self._attachments,
            channel_count=len(self.channels),
            channel_message_counts={key: self.counts[key] for key in sorted(self.counts)},
            chunk_count=self._chunks,
            message_count=self.messages,
            message_end_time=self.end,
            message_start_time=self.start,
            metadata_count=self._metadata,
            schema_count=len(self._schemas),
        )
        data_end = _packed(DataEnd(data_section_crc=0))
        summary_start = self.size + len(data_end)
        summary = bytearray()
        offsets = bytearray()
        groups: list[tuple[Opcode, bytes | bytearray]] = [
            (Opcode.SCHEMA, _packed(*self._schemas.values())),
            (Opcode.CHANNEL, _packed(*self.channels.values())),
            (Opcode.STATISTICS, _packed(statistics)),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            *self._other_indexes.items(),
        ]
        for opcode, group in groups:
            if group:
                place = SummaryOffset(
                    group_opcode=opcode, group_start=summary_start + len(summary), group_length=len(group)
                )
                offsets += _packed(place)
                summary += group
        offsets_start = summary_start + len(summary)
        summary += offsets
        # The footer's checksum covers the summary and the footer's own first fields.
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offsets_start)
        crc = zlib.crc32(head, zlib.crc32(summary))
        footer = _packed(Footer(summary_start=summary_start, summary_offset_start=offsets_start, summary_crc=crc))
        self._write(data_end + summary + footer + MAGIC)
        self.close()

    def close(self) -> None:
        """Close the file as it is; a file that was not sealed can be recovered."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def abandon(self) -> None:
        """Close and delete the file."""
        self.close()
        with contextlib.suppress(OSError):
            self.path.unlink()

    def _write(self, data: bytes | bytearray) -> tuple[int, int]:
        """Append data whole, or not at all and raise OSError; return offset and length."""
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self._file, view) :]
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self.size)
                os.lseek(self._file, self.size, os.SEEK_SET)
            raise
        offset = self.size
        self.size += len(data)
        return offset, len(data)


class Reserve:
    """Disk space held back, so that a segment can still be sealed when the disk is full: an unnamed file."""

    def __init__(self) -> None:
        self._file = -1
        self._size = 0

    def hold(self, folder: Path, size: int) -> None:
        """Hold at least `size` bytes of the folder's disk. Raises OSError if it is full."""
        if size <= self._size or not hasattr(os, "O_TMPFILE"):
            return
        try:
            if self._file < 0:
                self._file = os.open(folder, os.O_TMPFILE | os.O_WRONLY | os.O_CLOEXEC, 0o600)
            os.posix_fallocate(self._file, 0, 2 * size)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT):
                raise
        self._size = 2 * size  # also where the file system knows no unnamed files: not to try again with every chunk

    def release(self) -> None:
        """Give the space back."""
        if self._file >= 0:
            os.close(self._file)
        self._file = -1
        self._size = 0


def _packed(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    block: bytes = builder.end()
    return block
