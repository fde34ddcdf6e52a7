"""SimulatedArm: how an arm follows its command stream: ideal, or delayed, lagging, noisy and quantised."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SimulatedArm:
    """Takes commands, gives measurements; `advance` moves it on by dt.

    The command passes a delay [s], then a first-order lag with time constant `lag` [s]; the measurement gets Gaussian
    noise of standard deviation `noise` [rad or m] and is rounded to multiples of `quantisation` [rad or m].
    """

    def __init__(
        self,
        q: Array,
        *,
        delay: float = 0.0,
        lag: float = 0.0,
        noise: float = 0.0,
        quantisation: float = 0.0,
        seed: int = 0,
    ) -> None:
        """Start at rest at q (n,); all options zero make an ideal arm that is where it was commanded to be."""
        self._q = np.array(q, dtype=float)
        self._command = self._q
        self._previous = self._q
        self._delay, self._lag, self._noise, self._quantisation = delay, lag, noise, quantisation
        self._pending: deque[tuple[float, Array]] = deque()
        self._time = 0.0
        self._velocity = np.zeros_like(self._q)
        self._random = np.random.default_rng(seed)

    def command(self, q: Array) -> None:
        """Take a position command (n,)."""
        self._pending.append((self._time + self._delay, q))

    def advance(self, dt: float) -> None:
        """Move on by dt [s]."""
        self._time += dt
        while self._pending and self._pending[0][0] <= self._time + 1e-12:
            self._command = self._pending.popleft()[1]
        self._previous = self._q
        share = 1.0 - math.exp(-dt / self._lag) if self._lag > 0.0 else 1.0
        self._q = self._command if share == 1.0 else self._q + share * (self._command - self._q)
        self._velocity = (self._q - self._previous) / dt

    def measure(self) -> tuple[Array, Array]:
        """Return measured (position (n,), velocity (n,))."""
        q = self._q
        if self._noise > 0.0:
            q = q + self._random.normal(0.0, self._noise, q.size)
        if self._quantisation > 0.0:
            q = np.round(q / self._quantisation) * self._quantisation
        return q, self._velocity
