"""Reading one MCAP file record by record, whole or cut off, without its index.

The order is that of the file, which for our bags is the order of the `write` calls; readers that sort by log time lose
it. Whole files answer from their summary; for others one pass over the record heads finds out the same. Records come
from `mcap`; only messages inside a chunk are taken apart here, because they come by the thousand.
"""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Header, Metadata, MetadataIndex, Schema, Statistics
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from ik_controller.errors import BagError
from ik_controller.recording.segment import MAGIC

_HEAD = struct.Struct("<BQ")  # opcode, length of the content
_CHUNK_HEAD = struct.Struct("<QQQII")  # first time, last time, size, checksum, length of the compression's name
_FOOTER_SIZE = 9 + 20 + len(MAGIC)
_BUFFER = 1 << 18

# A file that ends inside one of these, or after them, has lost no message.
_AFTER_MESSAGES = {
    Opcode.MESSAGE_INDEX,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
    Opcode.STATISTICS,
    Opcode.SUMMARY_OFFSET,
    Opcode.DATA_END,
    Opcode.FOOTER,
}

DAMAGE = (
    CRCValidationError,
    McapError,
    zstandard.ZstdError,
    RuntimeError,  # lz4
    MemoryError,  # a size that cannot be true
    ValueError,
    KeyError,
    IndexError,
    struct.error,
)
"""What reading a damaged record or chunk may raise."""


def parse(record_type: Any, content: bytes) -> Any:
    """Return the record of that type (`mcap.records`) with that content."""
    return record_type.read(ReadDataStream(BytesIO(content)))


def decompress(chunk: Chunk) -> bytes:
    """Return the records of a chunk; raises one of `DAMAGE` if they are not what was written."""
    if not chunk.uncompressed_size:
        return b""
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    if length != chunk.uncompressed_size:
        raise ValueError("a chunk is shorter than it says")
    data: bytes = stream.read(length)
    return data


def chunk_records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, and begin and end of the content, of each record of a decompressed chunk."""
    position, end = 0, len(data)
    while position < end:
        opcode, length = _HEAD.unpack_from(data, position)
        position += 9
        if position + length > end:
            raise ValueError("a record reaches beyond its chunk")
        yield opcode, position, position + length
        position += length


class McapFile:
    """What an MCAP file holds: channels, schemas, metadata; whether it is whole, and if not, what is lost.

    `counts` (messages by channel id) is None unless the summary says it.

    Raises BagError if there is no such file, it is empty or not MCAP; and if its records make no sense, unless
    `tolerant`, which takes in what it can.
    """

    def __init__(self, path: Path, *, tolerant: bool = False) -> None:
        self.path = path
        self.profile = ""
        self.library = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: dict[int, int] | None = None
        self.metadata: list[Metadata] = []
        self.complete = False
        self.lost_bytes = 0
        self._cut: int | None = None  # where a chunk begins in which the file ends
        try:
            with path.open("rb", buffering=_BUFFER) as file:
                self.size = os.fstat(file.fileno()).st_size
                self._open(file, tolerant)
        except OSError as error:
            raise BagError(f"cannot read bag '{path}': {error.strerror}") from None

    def _open(self, file: BinaryIO, tolerant: bool) -> None:
        magic = file.read(len(MAGIC))
        if not magic:
            raise BagError(f"bag '{self.path}' is empty")
        if not MAGIC.startswith(magic):
            raise BagError(f"'{self.path}' is not an MCAP file")
        try:
            if self._read_summary(file):
                return
        except DAMAGE as error:
            self._damaged(error, tolerant)
        try:
            self._scan(file)
        except DAMAGE as error:
            self._damaged(error, tolerant)

    def _damaged(self, error: Exception, tolerant: bool) -> None:
        self.complete = False
        if not tolerant:
            raise BagError(f"bag '{self.path}' is damaged ({error}); try `ik_controller recover`") from None

    def records(self, file: BinaryIO, start: int = len(MAGIC)) -> Iterator[tuple[int, int, int]]:
        """Yield opcode, offset and length of the content of each whole top-level record; stop where the file is cut.

        The file stands at the content; it may be read or left. Sets `lost_bytes` when the end is reached.
        """
        position = start
        while True:
            file.seek(position)
            head = file.read(9)
            opcode, length = _HEAD.unpack(head) if len(head) == 9 else (head[0] if head else 0, 0)
            # opcode 0 is none: blocks that a crash of the machine left unwritten read as zeros
            if len(head) < 9 or opcode == 0 or position + 9 + length > self.size:
                lossless = not head or opcode in _AFTER_MESSAGES
                self.lost_bytes = 0 if lossless else self.size - position
                self._cut = position if opcode == Opcode.CHUNK and len(head) == 9 else None
                return
            yield opcode, position + 9, length
            if opcode == Opcode.FOOTER:
                return
            position += 9 + length

    def cut_chunk(self, file: BinaryIO) -> bytes:
        """Return the records, as far as they can be decompressed, of a chunk in which the file is cut off; the last one
        may be cut off too. Empty where the file was not cut in a chunk, or `records` was not read to the end.
        """
        if self._cut is None:
            return b""
        file.seek(self._cut + 9)
        content = file.read()
        try:
            name = _CHUNK_HEAD.size + _CHUNK_HEAD.unpack_from(content)[-1]
            compression, data = content[_CHUNK_HEAD.size : name], content[name + 8 :]
            if compression == b"zstd":
                data = zstandard.ZstdDecompressor().decompressobj().decompress(data)
            elif compression == b"lz4":
                data = lz4.frame.LZ4FrameDecompressor().decompress(data)
            return data if compression in (b"zstd", b"lz4", b"") else b""
        except DAMAGE:
            return b""

    def _read_summary(self, file: BinaryIO) -> bool:
        """Read the summary of a whole file; False if there is none, or none that says everything."""
        if self.size < _FOOTER_SIZE + len(MAGIC):
            return False
        file.seek(self.size - _FOOTER_SIZE)
        tail = file.read()
        if tail[:9] != _HEAD.pack(Opcode.FOOTER, 20) or not tail.endswith(MAGIC):
            return False
        self.complete = True
        footer = parse(Footer, tail[9:29])
        if not footer.summary_start:
            return False
        statistics = None
        indexes = []
        for opcode, _, length in self.records(file, footer.summary_start):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._learn(opcode, file.read(length))
            elif opcode == Opcode.STATISTICS:
                statistics = parse(Statistics, file.read(length))
            elif opcode == Opcode.METADATA_INDEX:
                indexes.append(parse(MetadataIndex, file.read(length)))
        if statistics is None or len(self.channels) < statistics.channel_count:
            return False
        if len(indexes) < statistics.metadata_count:
            return False
        self.counts = dict(statistics.channel_message_counts)
        for index in indexes:
            file.seek(index.offset + 9)
            self.metadata.append(parse(Metadata, file.read(index.length - 9)))
        file.seek(len(MAGIC))
        opcode, length = _HEAD.unpack(file.read(9))
        self._learn(opcode, file.read(length))
        return True

    def _scan(self, file: BinaryIO) -> None:
        """Find out channels and metadata from the records themselves; counts would need every chunk."""
        self.counts, self.metadata = None, []
        chunk: tuple[int, int] | None = None
        indexed = False
        for opcode, offset, length in self.records(file):
            if opcode == Opcode.CHUNK:
                if chunk is not None and not indexed:
                    self._learn_chunk(file, *chunk)
                chunk, indexed = (offset, length), False
            elif opcode == Opcode.MESSAGE_INDEX:
                indexed = True
                if int.from_bytes(file.read(2), "little") not in self.channels and chunk is not None:
                    self._learn_chunk(file, *chunk)
            elif opcode in (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
                self._learn(opcode, file.read(length))
        if chunk is not None:
            self._learn_chunk(file, *chunk)
        with contextlib.suppress(*DAMAGE):
            self._learn_records(self.cut_chunk(file))

    def _learn_chunk(self, file: BinaryIO, offset: int, length: int) -> None:
        """Take in the channels that stand inside a chunk. A damaged chunk is for whoever reads its messages."""
        file.seek(offset)
        with contextlib.suppress(*DAMAGE):
            self._learn_records(decompress(parse(Chunk, file.read(length))))

    def _learn_records(self, data: bytes) -> None:
        for opcode, begin, end in chunk_records(data):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._learn(opcode, data[begin:end])

    def _learn(self, opcode: int, content: bytes) -> None:
        if opcode == Opcode.HEADER:
            header = parse(Header, content)
            self.profile, self.library = header.profile, header.library
        elif opcode == Opcode.SCHEMA:
            schema = parse(Schema, content)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse(Channel, content)
            self.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            self.metadata.append(parse(Metadata, content))
