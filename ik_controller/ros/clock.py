"""SimulatedLoop: cycles by the time that /clock tells, for use_sim_time.

The cycles that a tick of the clock makes due run one after the other, on a grid of the period as in `Loop`; so the
commands of a run are dt apart in simulated time, whatever speed it runs at. While the clock stands there are no cycles.
Where it jumps back, or ahead by more than `JUMP`, the grid begins anew and `on_jump` is told first.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable

from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from ik_controller.ros.polling import PolledGroup, PolledSubscription

JUMP = 1_000_000_000  # [ns] of simulated time between two ticks that is caught up with
STANDS = 0.5  # [s] without a tick after which the clock counts as standing
_IDLE = 0.1  # [s] between calls of `on_idle` while it stands
_TIME = struct.Struct("<iI")


class SimulatedLoop:
    """Runs `cycle(index, now, late)` for every `period` [ns] of simulated time until `stop` is set.

    `on_jump(now)` is told of jumps, `on_idle()` is called while no cycles run: before the first tick, and while the
    clock stands (`stands`).
    """

    def __init__(
        self,
        node: Node,
        period: int,
        cycle: Callable[[int, int, int], None],
        on_jump: Callable[[int], None],
        on_idle: Callable[[], None],
    ) -> None:
        self.period = period
        self.stop = False
        self.missed = 0
        self.stalls = 0  # jumps
        self.stands = True
        self.cycle = cycle
        self._on_jump = on_jump
        self._on_idle = on_idle
        self._node = node
        self._clock = PolledSubscription(node, PolledGroup(), Clock, "/clock", 100, reliable=False)

    def run(self) -> None:
        """Run until `stop`."""
        try:
            self._run()
        finally:
            self._node.destroy_subscription(self._clock.subscription)

    def _run(self) -> None:
        period = self.period
        due: int | None = None
        index = 0
        last, seen = -1, time.monotonic()
        while not self.stop:
            data = self._clock.take()
            if data is None:
                waited = time.monotonic() - seen
                if waited > STANDS:
                    self.stands = True
                    self._on_idle()
                    time.sleep(_IDLE)
                else:
                    time.sleep(2e-4)
                continue
            seconds, nanoseconds = _TIME.unpack_from(data, 4)
            now = seconds * 1_000_000_000 + nanoseconds
            if now == last:
                continue  # it stands, and says so
            seen, self.stands = time.monotonic(), False
            if due is None or now < last or now - last > JUMP:
                if due is not None:
                    self.stalls += 1
                    self._on_jump(now)
                due = now
            last = now
            while due <= now and not self.stop:
                self.cycle(index, due, 0)
                index += 1
                due += period
