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
        """Take one cycle's error; one that is exactly zero means that there was no pose to follow, and is left out."""
        x, y, z, a, b, c = error.tolist()  # plain floats: six numbers are too few for NumPy
        position, rotation = x * x + y * y + z * z, a * a + b * b + c * c
        if position == 0.0 and rotation == 0.0:
            return
        self.count += 1
        self._squares[0] += position
        self._squares[1] += rotation
        if position > self._largest[0]:
            self._largest[0] = position
        if rotation > self._largest[1]:
            self._largest[1] = rotation

    def as_mapping(self) -> dict[str, float | None]:
        """Return position_rms_m, position_max_m, orientation_rms_rad, orientation_max_rad; None without any error."""
        result: dict[str, float | None] = {}
        for part, (name, unit) in enumerate((("position", "m"), ("orientation", "rad"))):
            some = self.count > 0
            result[f"{name}_rms_{unit}"] = math.sqrt(self._squares[part] / self.count) if some else None
            result[f"{name}_max_{unit}"] = math.sqrt(self._largest[part]) if some else None
        return result
