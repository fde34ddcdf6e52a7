"""Envelope: columns of numbers thinned out so that no peak is lost, in memory that does not grow with the run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Envelope:
    """Rows in buckets of `size` each: the first row of a bucket, and the smallest and largest value of each column.

    `size` starts at 1, and doubles whenever `capacity` buckets are full; `capacity` is even. NaN is no value: a bucket
    holds it only where all of its rows do. `masks` are bits that any row of the bucket has.
    """

    def __init__(self, columns: int, capacity: int) -> None:
        self.size = 1
        self.rows = 0
        self._capacity = capacity
        self._first, self._low, self._high = (np.full((capacity, columns), np.nan) for _ in range(3))
        self._masks = np.zeros(capacity, dtype=np.int64)

    def take(self, rows: Array, masks: NDArray[np.int64]) -> None:
        """Add rows (k, columns) with their bits (k,)."""
        if not len(rows):
            return
        while (self.rows + len(rows) - 1) // self.size >= self._capacity:
            self._halve()
        bucket = (self.rows + np.arange(len(rows))) // self.size
        starts = np.flatnonzero(np.diff(bucket, prepend=-1))
        to = bucket[starts]
        opens = starts[(self.rows + starts) % self.size == 0]
        self._first[bucket[opens]] = rows[opens]
        self._low[to] = np.fmin(self._low[to], np.fmin.reduceat(rows, starts, axis=0))
        self._high[to] = np.fmax(self._high[to], np.fmax.reduceat(rows, starts, axis=0))
        self._masks[to] |= np.bitwise_or.reduceat(masks, starts)
        self.rows += len(rows)

    def _halve(self) -> None:
        half = self._capacity // 2
        for table, merge in ((self._low, np.fmin), (self._high, np.fmax)):
            table[:half] = merge(table[::2], table[1::2])
            table[half:] = np.nan
        self._first[:half] = self._first[::2]
        self._masks[:half] = self._masks[::2] | self._masks[1::2]
        self._masks[half:] = 0
        self.size *= 2

    def __len__(self) -> int:
        return -(-self.rows // self.size)

    @property
    def first(self) -> Array:
        """The first row of each bucket."""
        return self._first[: len(self)]

    @property
    def low(self) -> Array:
        """The smallest values of each bucket."""
        return self._low[: len(self)]

    @property
    def high(self) -> Array:
        """The largest values of each bucket."""
        return self._high[: len(self)]

    @property
    def masks(self) -> NDArray[np.int64]:
        """The bits of each bucket."""
        return self._masks[: len(self)]
