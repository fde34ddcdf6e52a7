"""ErrorStatistics: RMS and largest tracking error of a run, in constant memory."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class ErrorStatistics:
    """Sums up tracking errors (6,) (position [m], rotation [rad])."""

    def __init__(self) -> None:
        self.count = 0
        self._squares = [0.0, 0.0]
        self._largest = [0.0, 0.0]

    def add(self, error: Array) -> None:
        """Take one cycle's error."""
        self.count += 1
        for part, values in enumerate((error[:3], error[3:])):
            square = float(values.dot(values))
            self._squares[part] += square
            if square > self._largest[part]:
                self._largest[part] = square

    def as_mapping(self) -> dict[str, float | None]:
        """Return position_rms_m, position_max_m, orientation_rms_rad, orientation_max_rad; None without any error."""
        result: dict[str, float | None] = {}
        for part, (name, unit) in enumerate((("position", "m"), ("orientation", "rad"))):
            some = self.count > 0
            result[f"{name}_rms_{unit}"] = math.sqrt(self._squares[part] / self.count) if some else None
            result[f"{name}_max_{unit}"] = math.sqrt(self._largest[part]) if some else None
        return result
