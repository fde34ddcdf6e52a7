"""Endings: a process of ours ends by SIGINT or SIGTERM with exit code 0, whenever they come and however often.

A terminal and a launch file both send SIGINT, so that a process hears it twice: maybe before it has come up, and when
it is all but gone. Python by itself then ends with a traceback, or by the signal.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
from collections.abc import Callable
from typing import Any, NoReturn


def on_signal(handler: Callable[..., Any]) -> None:
    """Call `handler(number, frame)` on SIGINT and SIGTERM. It may not take a lock: the main thread may hold it."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def end_when_told() -> None:
    """End at once on a signal, for as long as there is nothing to be put in order first."""
    on_signal(lambda *_: os._exit(0))


def leave(code: int) -> NoReturn:
    """End now. Python would give signals back their deadly meaning, and then take seconds to take Numba and all its
    objects apart; a launch file kills who does not end.
    """
    gc.collect()  # what holds a ROS node goes, so that others see it leave
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # its reader has gone, or it is closed
            stream.flush()
    os._exit(code)
