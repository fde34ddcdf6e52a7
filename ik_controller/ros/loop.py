"""Loop: cycles at absolute deadlines on the monotonic clock, with the ROS time that belongs to each.

Deadlines and times are those of an even grid, so the commands of a run are dt apart to the nanosecond. A cycle that is
late does not shift the next; after a longer hold-up the cycles that were due run one after the other. A process that
was stopped for longer than `STALL` does not catch up: the grid goes on from now and `on_stall` is told.
"""

from __future__ import annotations

import contextlib
import gc
import sys
import threading
import time
from collections.abc import Callable, Iterator

STALL = 100_000_000  # [ns]
_CLOCK_STEP = 10_000_000  # [ns] of the system clock beyond which the grid's times follow it
_CHECK = 1.0  # [s] between looks at the system clock


def clocks() -> tuple[int, int]:
    """Return the monotonic and the system time [ns] of one moment: by the tightest of three readings, as a process that
    is held up within one sees a clock jump.
    """
    readings = []
    for _ in range(3):
        monotonic, system = time.monotonic_ns(), time.time_ns()
        readings.append((time.monotonic_ns() - monotonic, monotonic, system))
    _, monotonic, system = min(readings)
    return monotonic, system


class Loop:
    """Runs `cycle(index, now, late)` every `period` [ns] until `stop` is set; `now` [ns] is system time on the grid."""

    def __init__(
        self, period: int, cycle: Callable[[int, int, int], None], on_stall: Callable[[int], None] | None = None
    ) -> None:
        self.period = period
        self.stop = False
        self.missed = 0  # cycles that began after the next one was due
        self.stalls = 0
        self.cycle = cycle
        self._on_stall = on_stall

    def run(self) -> None:
        """Run until `stop`."""
        period, cycle = self.period, self.cycle
        monotonic, sleep = time.monotonic_ns, time.sleep
        check_every = max(round(_CHECK * 1e9 / period), 1)
        start, epoch = clocks()
        index = 0
        while not self.stop:
            due = start + index * period
            wait = due - monotonic()
            if wait > 0:
                sleep(wait * 1e-9)
            late = monotonic() - due
            if late > period:
                self.missed += 1
                if late > STALL:
                    skipped = late // period
                    index += skipped
                    self.stalls += 1
                    if self._on_stall is not None:
                        self._on_stall(skipped)
                    continue
            cycle(index, epoch + index * period, late)
            index += 1
            if index % check_every == 0:
                then, system = clocks()
                step = system - then + start - epoch
                if abs(step) > _CLOCK_STEP:
                    epoch += step


_QUIET = threading.Lock()
_quiet_count = 0
_switch_interval = sys.getswitchinterval()


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Keep the interpreter for the loops while one runs: no collector at moments of its own choosing, quick switches.

    Each loop collects once a second at the end of a cycle instead.
    """
    global _quiet_count, _switch_interval
    with _QUIET:
        _quiet_count += 1
        if _quiet_count == 1:
            gc.collect()
            gc.freeze()
            gc.disable()
            _switch_interval = sys.getswitchinterval()
            sys.setswitchinterval(1e-4)  # a loop gets the interpreter back from other threads within 0.1 ms
    try:
        yield
    finally:
        with _QUIET:
            _quiet_count -= 1
            if _quiet_count == 0:
                sys.setswitchinterval(_switch_interval)
                gc.enable()
                gc.unfreeze()
