"""Clock: one time line for messages whose stamps or arrivals are of several clocks, or of one that was set.

A message's time is its stamp, moved by a constant to the recorder's clock: the smallest delay seen between the two.
What has no stamp comes when it was recorded. Where the recorder's clock was set, its time goes on as the stamps do;
where the sender's was, its stamps get another constant.
"""

from __future__ import annotations

_TOLERANCE = 500_000_000  # [ns] by which the delay of one clock may vary from message to message


class Clock:
    """Give every message to `learn` first, in order, then again in the same order to `time`; times in ns."""

    def __init__(self) -> None:
        self._clocks: list[list[int]] = []  # smallest and largest delay of each clock, first and last stamp
        self._arrivals: list[int] = []  # first and last of messages without stamp
        self._restart()

    def _restart(self) -> None:
        self._shift = 0  # of the recorder's clock, where it was set
        self._log: int | None = None  # the last message's, moved by the shift
        self._stamps: dict[str, int] = {}

    def _arrival(self, topic: str, stamp: int, log: int) -> int:
        """Return when a message was recorded, jumps of the recorder's clock removed."""
        arrival = log - self._shift
        if self._log is not None:
            step = arrival - self._log
            since = stamp - self._stamps.get(topic, stamp) if stamp else -1
            if step < -_TOLERANCE or (step > _TOLERANCE and 0 < since <= _TOLERANCE):
                self._shift += step - (since if 0 < since <= _TOLERANCE else 0)
                arrival = log - self._shift
        self._log = arrival if self._log is None else max(arrival, self._log)
        if stamp:
            self._stamps[topic] = stamp
        return arrival

    def learn(self, topic: str, stamp: int, log: int) -> None:
        """Take one message's stamp (0: none) and the time at which it was recorded."""
        arrival = self._arrival(topic, stamp, log)
        if not stamp:
            self._arrivals = [min([arrival, *self._arrivals]), max([arrival, *self._arrivals])]
            return
        delay = arrival - stamp
        clock = self._clock(delay)
        if clock is None:
            self._clocks.append([delay, delay, stamp, stamp])
        else:
            clock[:] = min(clock[0], delay), max(clock[1], delay), min(clock[2], stamp), max(clock[3], stamp)

    def learned(self) -> tuple[int, int]:
        """Begin again with the first message, for `time`; return the earliest and the latest time of all."""
        self._restart()
        times = [stamp + clock[0] for clock in self._clocks for stamp in clock[2:]] + self._arrivals
        return min(times), max(times)

    def time(self, topic: str, stamp: int, log: int) -> int:
        """Return the message's time on the recorder's clock."""
        arrival = self._arrival(topic, stamp, log)
        clock = self._clock(arrival - stamp) if stamp else None
        return arrival if clock is None else stamp + clock[0]

    def _clock(self, delay: int) -> list[int] | None:
        for clock in self._clocks:
            if clock[0] - _TOLERANCE <= delay <= clock[1] + _TOLERANCE:
                return clock
        return None
