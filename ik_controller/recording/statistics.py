"""ErrorStatistics: RMS and largest tracking error of a run, in constant memory."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


_BLOCK = 256  # errors that are summed up at a stretch


class ErrorStatistics:
    """Sums up tracking errors (6,) (position [m], rotation [rad])."""

    def __init__(self) -> None:
        self._waiting: list[Array] = []
        self._count = 0
        self._squares = np.zeros(2)
        self._largest = np.zeros(2)

    def add(self, error: Array) -> None:
        """Take the error of one cycle, or of k (k, 6); one that is exactly zero means that there was no pose to follow,
        and is left out.
        """
        self._waiting.append(error.reshape(-1, 6))
        if len(self._waiting) == _BLOCK:
            self._sum_up()

    def _sum_up(self) -> None:
        if self._waiting:
            squares = np.square(np.concatenate(self._waiting)).reshape(-1, 2, 3).sum(axis=2)
            self._waiting = []
            self._count += int(squares.any(axis=1).sum())
            self._squares += squares.sum(axis=0)
            self._largest = np.fmax(self._largest, squares.max(axis=0))

    @property
    def count(self) -> int:
        """How many errors there were."""
        self._sum_up()
        return self._count

    def as_mapping(self) -> dict[str, float | None]:
        """Return position_rms_m, position_max_m, orientation_rms_rad, orientation_max_rad; None without any error."""
        some = self.count > 0
        result: dict[str, float | None] = {}
        for part, (name, unit) in enumerate((("position", "m"), ("orientation", "rad"))):
            square, largest = self._squares.item(part), self._largest.item(part)
            result[f"{name}_rms_{unit}"] = math.sqrt(square / self.count) if some else None
            result[f"{name}_max_{unit}"] = math.sqrt(largest) if some else None
        return result
