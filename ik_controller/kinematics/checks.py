"""Checks of arguments: arrays of the right shape and finite, or one clear line that names the argument."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ik_controller.errors import ArgumentError, choices

Array = NDArray[np.float64]


def check_array(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """Return `value` as a float array of `shape`, where None stands for any length but 0.

    Raises ArgumentError naming `name`: not numbers, another shape, empty, NaN or infinite values.
    """
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ArgumentError(f"{name}: need an array of numbers, got {value!r:.60}") from None
    fits = array.ndim == len(shape) and all(
        have == need if need is not None else have > 0 for have, need in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("*" if length is None else str(length) for length in shape)
        raise ArgumentError(f"{name}: need shape ({wanted}{',' if len(shape) == 1 else ''}), got {array.shape}")
    if not np.isfinite(array).all():
        raise ArgumentError(f"{name}: every value must be finite, got {array.ravel().tolist()}")
    return array


def check_number(value: float, name: str, *, minimum: float = -math.inf, exclusive: bool = False) -> float:
    """Return `value` as a finite float ≥ `minimum` (> with `exclusive`). Raises ArgumentError naming `name`."""
    number = float(check_array(value, name, ()))
    if number < minimum or (exclusive and number == minimum):
        raise ArgumentError(f"{name}: need a value {'>' if exclusive else '≥'} {minimum:g}, got {number:g}")
    return number


def check_choice(value: str, name: str, legal: Collection[str]) -> str:
    """Return `value` if it is one of `legal`. Raises ArgumentError naming `name` and the legal choices."""
    if value not in legal:
        raise ArgumentError(f"{name} '{value}' is unknown; legal: {choices(legal)}")
    return value
