"""The loop's grid: cycles dt apart, whatever holds the process up; in system time, also after the clock was set."""

from __future__ import annotations

import itertools

import pytest

from ik_controller.ros import loop
from ik_controller.ros.loop import Loop

PERIOD = 4_000_000
SECOND = 1_000_000_000


class Machine:
    """A machine's clocks [ns], which pass a little with every look at them; `held_up`: how long it then stands still at
    the look with that number; `set_at`: when its system clock is set on by how much.
    """

    def __init__(self, held_up: dict[int, int], set_at: tuple[int, int] = (1 << 62, 0)) -> None:
        self.now = 5 * SECOND
        self.looks = 0
        self._held_up, self._set_at = held_up, set_at

    def monotonic_ns(self) -> int:
        seen, self.looks = self.now, self.looks + 1
        self.now += 100 + self._held_up.get(self.looks, 0)
        return seen

    def time_ns(self) -> int:
        at, step = self._set_at
        now = self.monotonic_ns()
        return 1_790_000_000 * SECOND + now + (step if now >= at else 0)

    def sleep(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)


def times_of(machine: Machine, monkeypatch: pytest.MonkeyPatch, count: int) -> list[int]:
    """Return the times of a loop's cycles on the machine."""
    times: list[int] = []

    def cycle(index: int, now: int, late: int) -> None:
        times.append(now)
        running.stop = len(times) == count

    for name in ("monotonic_ns", "time_ns", "sleep"):
        monkeypatch.setattr(loop.time, name, getattr(machine, name))
    running = Loop(PERIOD, cycle)
    running.run()
    return times


def test_a_process_held_up_while_it_looks_at_the_clocks_stays_on_its_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    undisturbed = Machine({})
    times_of(undisturbed, monkeypatch, 300)
    for look in range(1, undisturbed.looks):  # the clocks are compared at the start and after a second, its 250th cycle
        times = times_of(Machine({look: 30_000_000}), monkeypatch, 300)
        assert {(b - a) % PERIOD for a, b in itertools.pairwise(times)} == {0}, look


def test_the_grid_follows_a_clock_that_was_set(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine({}, (5 * SECOND + SECOND // 2, 3 * SECOND))
    times = times_of(machine, monkeypatch, 600)
    steps = [b - a for a, b in itertools.pairwise(times) if b - a != PERIOD]
    assert steps == [pytest.approx(3 * SECOND + PERIOD, abs=1000)]
    assert times[-1] == pytest.approx(machine.time_ns(), abs=PERIOD)
