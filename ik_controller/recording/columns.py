"""Columns: the messages of a chunk side by side, for who takes thousands of them apart at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import compiled
from ik_controller.recording.reader import Message
from ik_controller.recording.segment import MESSAGE_HEAD

Integers = NDArray[np.int64]

_HEAD, _MESSAGE = MESSAGE_HEAD.size, int(Opcode.MESSAGE)


class Columns(NamedTuple):
    """Messages (k) in the order of their records: `kind` of each, log time [ns], where its data begins and ends."""

    data: bytes
    kind: Integers
    time: Integers
    begin: Integers
    end: Integers

    @classmethod
    def of(cls, data: bytes, kinds: Integers) -> Columns | None:
        """Return the messages in records whose channels, by id, are of a kind above 0; None where the records make no
        sense somewhere.
        """
        rows = np.empty((len(data) // 9, 4), np.int64)
        count = _take_heads(np.frombuffer(data, np.uint8), kinds, rows)
        return None if count < 0 else cls(data, *rows[:count].T.copy())

    def part(self, which: slice | Integers) -> Columns:
        """Return some of the messages."""
        return Columns(self.data, self.kind[which], self.time[which], self.begin[which], self.end[which])

    def bytes_at(self, which: Integers) -> list[bytes]:
        """Return the data of some messages."""
        data = self.data
        return [
            data[begin:end] for begin, end in zip(self.begin[which].tolist(), self.end[which].tolist(), strict=True)
        ]

    def rows_at(self, which: Integers) -> NDArray[np.uint8] | None:
        """Return the data (j, length) of some messages as bytes; None where they are not of one length."""
        begin = self.begin[which]
        lengths = self.end[which] - begin
        length = int(lengths[0]) if lengths.size else 0
        if not length or (lengths != length).any():
            return None
        windows: NDArray[np.void] = np.ndarray((len(self.data) - length + 1,), f"V{length}", self.data, strides=(1,))
        return windows[begin].view(np.uint8).reshape(-1, length)

    def messages(self, topics: Sequence[str]) -> list[Message]:
        """Return the messages, with their topics by kind; their running numbers are 0."""
        kinds, times, everything = self.kind.tolist(), self.time.tolist(), np.arange(len(self.kind))
        return [
            Message(topics[kind], time, data, 0)
            for kind, time, data in zip(kinds, times, self.bytes_at(everything), strict=True)
        ]


@compiled
def _take_heads(data: NDArray[np.uint8], kinds: Integers, rows: Integers) -> int:
    """Write kind, log time, begin and end of the data of each message of a kind above 0; return how many, -1 where a
    record reaches beyond the others or its channel is unknown (kind -1).
    """
    position, count, size = 0, 0, data.shape[0]
    while position < size:
        if position + 9 > size:
            return -1
        length = _number(data, position + 1, 8)
        end = position + 9 + length
        if length < 0 or end > size:
            return -1
        if data[position] == _MESSAGE:
            if length < _HEAD - 9:
                return -1
            channel = _number(data, position + 9, 2)
            if channel >= kinds.shape[0] or kinds[channel] < 0:
                return -1
            if kinds[channel] > 0:
                rows[count, 0], rows[count, 1] = kinds[channel], _number(data, position + 15, 8)
                rows[count, 2], rows[count, 3] = position + _HEAD, end
                count += 1
        position = end
    return count


@compiled
def _number(data: NDArray[np.uint8], at: int, size: int) -> int:
    """Return the little-endian number of that many bytes."""
    value = np.int64(0)
    for k in range(size):
        value |= np.int64(data[at + k]) << np.int64(8 * k)
    return int(value)
