"""Bell: one thread waits until another one comes by, which pays nothing while nobody waits."""

from __future__ import annotations

import contextlib
import threading


class Bell:
    """`wait` for whom it concerns; `if bell.awaited: bell.ring()` for who comes by."""

    __slots__ = ("_silent", "awaited")

    def __init__(self) -> None:
        self.awaited = False
        self._silent = threading.Lock()  # held while the bell is silent
        self._silent.acquire()

    def ring(self) -> None:
        """Wake who waits."""
        self.awaited = False
        with contextlib.suppress(RuntimeError):  # rung already, by another thread
            self._silent.release()

    def wait(self, timeout: float) -> None:
        """Wait until the next ring, at most `timeout` [s]."""
        self._silent.acquire(blocking=False)  # forget a ring that came too late last time
        self.awaited = True
        self._silent.acquire(timeout=timeout)
        self.awaited = False
