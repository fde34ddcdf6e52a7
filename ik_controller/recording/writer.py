"""The flight recorder's writer: `write` appends to a queue, one thread brings it to disk as a rosbag2 bag.

What the control loop may rely on: `write` never waits, never raises, takes half a microsecond (2 µs where the loop just
slept and caches are cold). What is written is in the kernel's hands at most `flush_interval` and some 10 ms later, in
the order of the `write` calls. The thread holds the interpreter while it packs messages, so it works in short slices,
each right after a `write`, when the loop is about to sleep; compression and disk do not hold the interpreter.

When the disk fails (full, read-only, folder gone, I/O error) the segment is sealed as it is and nothing more goes into
it. Messages wait in memory, at most `queue_bytes`; what exceeds that is lost and counted. As soon as a new segment can
be opened, recording goes on there, first with what waited. Gaps show in the messages' sequence numbers.
"""

from __future__ import annotations

import contextlib
import errno
import operator
import os
import shutil
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ik_controller.errors import BagError, choices
from ik_controller.recording import schema as ros_schema
from ik_controller.recording.bell import Bell
from ik_controller.recording.rosbag2 import FileMetadata, Qos, TopicMetadata, bag_information, write_metadata_yaml
from ik_controller.recording.segment import COMPRESSIONS, ChunkBuilder, Reserve, SegmentWriter

RECORDER_METADATA = "ik_controller.recorder"
"""Name of the metadata record with the recorder's own account: messages written, messages lost, the reason."""

_SLICE = 128  # messages packed at a stretch: about 0.1 ms of the interpreter
_BREATH = 0.005  # s that the thread waits for the loop's next cycle before it works anyway
_CHUNK_BYTES = 1 << 20
_RETRY = 0.5  # s between attempts to open a segment after a failure
_FREE_BYTES = 1 << 20  # disk space that a new segment needs after a failure, else it would fail again at once
_SMALL_BYTES = 32 << 10  # enough for metadata.yaml and the last records of a segment
_METADATA = 0  # in the queue, in place of a channel's number
_DATA = operator.itemgetter(3)
_NOTHING = -(1 << 62)  # a limit of the queue that takes no more messages
_OVERHEAD = 200  # bytes of Python objects that a waiting message takes beside its data


class Channel:
    """A topic of the bag being written. Made by `BagWriter.channel`."""

    __slots__ = ("id", "qos", "schema", "sequence", "topic")

    def __init__(self, id: int, topic: str, schema: ros_schema.MessageSchema, qos: str) -> None:
        self.id = id
        self.topic = topic
        self.schema = schema
        self.qos = qos
        self.sequence = 0


@dataclass(frozen=True)
class WriterStatus:
    """The recorder's account: `state` is "recording", "interrupted" or "closed", `reason` the last trouble or empty.

    messages and bytes are on disk (bytes: file size), `lost` messages are in no file and never will be, `waiting` ones
    are in memory. `segments` counts the files.
    """

    state: str
    reason: str
    messages: int
    bytes: int
    lost: int
    waiting: int
    segments: int


class BagWriter:
    """Writes `<folder>/<name>_0.mcap`, `…_1.mcap` and metadata.yaml; the folder must be new or empty.

    A segment ends after `max_segment_bytes` or `max_segment_seconds` of log time (None: never). Raises BagError if the
    folder cannot be made or is not empty, or the compression is unknown; afterwards trouble is in `status()` alone.
    `write` is for one thread, the others for any. Where no loop must be kept, as in conversions, `patient` makes
    `write` wait for room in the queue, as long as the disk takes what is written.
    """

    def __init__(
        self,
        folder: Path,
        *,
        compression: str = "zstd",
        flush_interval: float = 0.05,
        max_segment_bytes: int | None = None,
        max_segment_seconds: float | None = None,
        queue_bytes: int = 64 << 20,
        patient: bool = False,
    ) -> None:
        if compression not in COMPRESSIONS:
            raise BagError(f"unknown compression '{compression}' of a bag; legal: {choices(COMPRESSIONS)}")
        self.folder = folder
        self._compression = compression
        self._flush_interval = flush_interval
        self._max_bytes = max_segment_bytes
        self._max_duration = None if max_segment_seconds is None else int(max_segment_seconds * 1e9)
        self._limit = queue_bytes
        self._patient = patient
        self._lock = threading.Lock()  # for channels and the books; the queue needs none
        self._channels: list[Channel] = []
        self._metadata: dict[str, dict[str, str]] = {}
        self._queue: deque[tuple[int, int, int, Any]] = deque()  # channel id, sequence, log time, data
        # One thread only adds to each of these, so none needs a lock.
        self._bytes_in = self._bytes_out = self._metadata_in = self._metadata_out = self._refused = self._lost = 0
        self._closing = threading.Event()
        self._bell = Bell()
        self._segment: SegmentWriter | None = None
        self._known = 0  # channels that the open segment has
        self._chunk = ChunkBuilder()
        self._sealed: list[FileMetadata] = []
        self._index = 0
        self._reserve = Reserve()
        self._retry_at = 0.0
        self._state = "recording"
        self._reason = ""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise BagError(f"bag folder '{folder}' is not empty; a bag is never overwritten")
            self._open_segment()
        except OSError as error:
            raise BagError(f"cannot write a bag into '{folder}': {error.strerror}") from None
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()

    # -- for the control loop ------------------------------------------------------------------------------------------

    def channel(self, topic: str, type_name: str, qos: Qos | None = None) -> Channel:
        """Return the channel for a topic of a ROS message type; the same one when asked again.

        Raises BagError if the type is unknown or the topic has another type.
        """
        schema = ros_schema.message_schema(type_name)
        with self._lock:
            for known in self._channels:
                if known.topic == topic:
                    if known.schema != schema:
                        raise BagError(f"topic '{topic}' is recorded as {known.schema.name}, not as {schema.name}")
                    return known
            channel = Channel(len(self._channels) + 1, topic, schema, (qos or Qos()).text)
            self._channels.append(channel)
            return channel

    def write(self, channel: Channel, log_time_ns: int, data: bytes | memoryview) -> None:
        """Queue one message as CDR; its bytes must not change any more. Never waits, never raises; see the module."""
        channel.sequence += 1
        if self._bytes_in - self._bytes_out > self._limit and not self._wait_for_room():
            self._refused += 1
            return
        self._bytes_in += len(data) + _OVERHEAD
        self._queue.append((channel.id, channel.sequence, log_time_ns, data))
        if self._bell.awaited:
            self._bell.ring()

    def _wait_for_room(self) -> bool:
        while self._patient and self._state == "recording" and not self._closing.is_set():
            time.sleep(_BREATH)
            if self._bytes_in - self._bytes_out <= self._limit:
                return True
        return False

    def metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Queue a metadata record, in order with the messages. Every later segment repeats the last of each name."""
        self._metadata_in += 1
        self._queue.append((_METADATA, 0, 0, (name, {str(key): str(value) for key, value in mapping.items()})))

    def status(self) -> WriterStatus:
        """Return the recorder's account of now."""
        with self._lock:
            segment, sealed = self._segment, list(self._sealed)
        messages = sum(part.count for part in sealed) + (segment.messages if segment is not None else 0)
        size = sum(part.size for part in sealed) + (segment.size if segment is not None else 0)
        return WriterStatus(
            state=self._state,
            reason=self._reason,
            messages=messages,
            bytes=size,
            lost=self._refused + self._lost,
            waiting=len(self._queue) + self._chunk.count,
            segments=len(sealed) + (segment is not None),
        )

    def close(self, timeout: float = 10.0) -> WriterStatus:
        """Write what waits, seal the bag, return the last status. What is written afterwards counts as lost.

        If the disk hangs for longer than `timeout` [s], the status returned still says "recording" or "interrupted".
        """
        self._limit = _NOTHING
        self._closing.set()
        self._thread.join(timeout)
        return self.status()

    # -- the thread ----------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._record()
        except Exception as error:  # nothing foreseen: stop, count, say so
            self._reason = f"the recorder failed: {error!r}"
            self._limit = _NOTHING
        self._finish()

    def _record(self) -> None:
        """Once per flush interval: take what waits, slice by slice, and bring it to disk; at the end all of it."""
        pause = self._flush_interval
        while not self._closing.wait(pause):
            moved = _SLICE
            while moved == _SLICE and not self._closing.is_set() and self._chunk.size < _CHUNK_BYTES:
                self._await_loop()
                moved = self._drain()
            behind = moved == _SLICE
            if self._chunk.count:
                self._await_loop()
                behind &= self._flush()
            pause = 0.0 if behind else self._flush_interval
        alive = True
        while alive and (self._queue or self._chunk.count):
            self._drain()
            if self._chunk.size >= _CHUNK_BYTES or not self._queue:
                alive = not self._chunk.count or self._flush(at_once=True)

    def _await_loop(self) -> None:
        """Wait until the next `write`: the loop that called it is about to sleep and needs no interpreter then."""
        if not self._patient:
            self._bell.wait(_BREATH)

    def _drain(self) -> int:
        """Pack a slice of the queue into the chunk; return how many."""
        items = [self._queue.popleft() for _ in range(min(_SLICE, len(self._queue)))]
        begin = 0
        if self._metadata_in > self._metadata_out:
            for place, item in enumerate(items):
                if item[0] == _METADATA:
                    self._pack(items[begin:place])
                    self._metadata_out += 1
                    self._add_metadata(*item[3])
                    begin = place + 1
        self._pack(items[begin:])
        return len(items)

    def _pack(self, items: list[tuple[int, int, int, Any]]) -> None:
        self._bytes_out += sum(map(len, map(_DATA, items))) + _OVERHEAD * len(items)
        messages = iter(items)
        while not self._packs_all(messages):
            self._lost += 1  # the one that does not fit; go on with the next

    def _packs_all(self, messages: Iterator[tuple[int, int, int, Any]]) -> bool:
        try:
            self._chunk.extend(messages)
        except Exception as error:  # a time that is no 64-bit number
            self._reason = f"a message cannot be recorded: {error}"
            return False
        return True

    def _flush(self, at_once: bool = False) -> bool:
        """Bring the chunk to disk, into a new segment where there is none; False: it stays in memory."""
        if self._segment is None and not at_once and time.monotonic() < self._retry_at:
            return False
        try:
            segment = self._segment or self._open_segment()
            self._add_channels(segment)
            segment.add_chunk(self._chunk)
        except OSError as error:
            self._interrupt(error)
            return False
        self._chunk.clear()
        try:
            if not segment.is_linked():
                raise FileNotFoundError(errno.ENOENT, "the bag's folder is gone")
            self._reserve.hold(self.folder, segment.summary_size + _SMALL_BYTES)
        except OSError as error:
            self._interrupt(error)
            return True
        full = self._max_bytes is not None and segment.size >= self._max_bytes
        if full or (self._max_duration is not None and segment.end - segment.start >= self._max_duration):
            self._seal()
        return True

    def _add_metadata(self, name: str, mapping: dict[str, str]) -> None:
        self._metadata[name] = mapping
        if self._chunk.count:
            self._flush()
        if self._segment is not None:
            try:
                self._segment.add_metadata(name, mapping)
            except OSError as error:
                self._interrupt(error)

    def _add_channels(self, segment: SegmentWriter) -> None:
        """Tell the segment the channels that came since it was opened."""
        for channel in self._channels[self._known :]:
            segment.add_topic(channel.id, channel.topic, channel.schema, channel.qos)
            self._known += 1

    def _open_segment(self) -> SegmentWriter:
        """Open the next segment and repeat the metadata in it; raises OSError and leaves no file behind."""
        self.folder.mkdir(parents=True, exist_ok=True)
        if self._state == "interrupted" and shutil.disk_usage(self.folder).free < _FREE_BYTES:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        path = self.folder / f"{self.folder.name}_{self._index}.mcap"
        segment = SegmentWriter(path, compression=self._compression)
        try:
            self._reserve.hold(self.folder, segment.summary_size + _SMALL_BYTES)
            for name, mapping in self._metadata.items():
                segment.add_metadata(name, mapping)
            if self._index:  # if the process is killed in this one, what was lost before is known all the same
                segment.add_metadata(RECORDER_METADATA, self._account())
        except OSError:
            segment.abandon()
            raise
        self._known = 0
        self._index += 1
        self._segment = segment
        self._state = "recording"
        return segment

    def _interrupt(self, error: OSError) -> None:
        """The disk failed: seal what is there; `_flush` tries a new segment from time to time."""
        self._state = "interrupted"
        self._reason = error.strerror or str(error)
        self._retry_at = time.monotonic() + _RETRY
        if self._segment is not None:
            self._seal()
        with contextlib.suppress(OSError):
            self._reserve.hold(self.folder, _SMALL_BYTES)  # for the last metadata.yaml, if no space ever returns

    def _seal(self) -> None:
        """Close the open segment as well as the disk allows and bring metadata.yaml up to date."""
        self._reserve.release()
        segment = self._segment
        if segment is not None:
            part = FileMetadata(
                segment.path.name, segment.start, segment.end, segment.messages, segment.counts, segment.size
            )
            with self._lock:
                self._segment = None
                self._sealed.append(part)
            self._forget_deleted()
            try:
                segment.add_metadata(RECORDER_METADATA, self._account())
                segment.add_metadata("rosbag2", {"serialized_metadata": self._information([part])})
                segment.seal()
            except OSError as error:
                self._reason = f"{segment.path.name} is not sealed: {error.strerror}"
                segment.close()
        write_metadata_yaml(self.folder, self._information(self._sealed))

    def _forget_deleted(self) -> None:
        """Move messages in files that somebody deleted from the written to the lost."""
        gone = [part for part in self._sealed if not (self.folder / part.name).exists()]
        with self._lock:
            self._sealed = [part for part in self._sealed if part not in gone]
            self._lost += sum(part.count for part in gone)

    def _finish(self) -> None:
        """Count what could not be written, seal, and say so."""
        waiting = sum(item[0] != _METADATA for item in self._queue)
        self._queue.clear()
        self._lost += self._chunk.count + waiting
        self._chunk.clear()
        if self._segment is not None:
            with contextlib.suppress(OSError):
                self._add_channels(self._segment)
        self._seal()
        self._state = "closed"

    # -- the bag's own account -----------------------------------------------------------------------------------------

    def _account(self) -> dict[str, str]:
        status = self.status()
        return {"messages": str(status.messages), "lost": str(status.lost), "reason": status.reason}

    def _information(self, sealed: list[FileMetadata]) -> str:
        topics = [
            TopicMetadata(
                name=channel.topic,
                type_name=channel.schema.name,
                qos=channel.qos,
                type_hash=channel.schema.type_hash,
                count=sum(part.counts.get(channel.id, 0) for part in sealed),
            )
            for channel in self._channels
        ]
        custom = {f"{RECORDER_METADATA}.{key}": value for key, value in self._account().items()}
        return bag_information(topics, sealed, custom)
