"""What a node sent, as published or read back from its bag, and whether limits hold in it."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState

from ik_controller.control.status import Code
from ik_controller.messages.cdr import CYCLE_FIELDS
from ik_controller.ros.loop import STALL, clocks

_STARTED = clocks()  # monotonic and system time [ns] when the tests began


def stamp(message: Any) -> int:
    """Return a message's stamp [ns]."""
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def table(commands: list[JointState]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the stamps (k,) [ns], positions (k, n) and velocities (k, n) of commands."""
    stamps = np.array([stamp(c) for c in commands], dtype=np.int64)
    return stamps, np.array([c.position for c in commands]), np.array([c.velocity for c in commands])


def assert_limits_hold(commands: list[JointState], model: Any, period: int, restarts: int = 0) -> None:
    """Position, velocity and acceleration limits, in the positions themselves, for commands `period` [ns] apart.

    `restarts`: how often at most the node started anew from the measured position; there, at rest, the stream may have
    a gap in time and a step to what was measured.
    """
    stamps, q, v = table(commands)
    steps, dt = np.diff(stamps), period * 1e-9
    off_grid = steps % period != 0
    assert clock_was_set() or not off_grid.any(), steps[off_grid]
    assert np.count_nonzero(steps[~off_grid] != period) <= restarts
    assert (q >= model.lower - 1e-12).all()
    assert (q <= model.upper + 1e-12).all()
    differences = np.diff(q, axis=0) / dt
    new = ~v[1:].any(axis=1) & (np.abs(differences) > 1e-9 / dt).any(axis=1)
    assert np.count_nonzero(new) <= restarts
    assert not v[:-1][new].any()
    differences[new] = 0.0
    np.testing.assert_allclose(differences, v[1:], atol=1e-9 / dt)
    assert (np.abs(differences) <= model.velocity_limit * (1.0 + 1e-6) + 1e-9).all()
    accelerations = np.diff(differences, axis=0) / dt
    assert (np.abs(accelerations) <= model.acceleration_limit * (1.0 + 1e-6) + 1e-6).all()


def clock_was_set() -> bool:
    """Tell whether this machine's system clock was set since the tests began, as a virtual one's may be: commands are
    stamped in its time, and follow it.
    """
    passed, told = (now - then for now, then in zip(clocks(), _STARTED, strict=True))
    return abs(told - passed) > 5_000_000


def recorded(bag: Path, topic: str) -> list[Any]:
    """Return a bag's messages of a topic, read by rosbags."""
    with AnyReader([bag]) as reader:
        wanted = [c for c in reader.connections if c.topic == topic]
        return [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(wanted)]


def restarts_of(bag: Path) -> int:
    """Return how often at most the node of a bag started anew from the measured position: after it had been held up, or
    had missed the joint states.
    """
    cycles = [message.data.tolist() for message in recorded(bag, "/ik_controller/cycle")]
    due, code = CYCLE_FIELDS.index("time_ns"), CYCLE_FIELDS.index("code")
    after_another = list(itertools.pairwise(cycles))
    held_up = sum(after[due] - before[due] > STALL for before, after in after_another)
    missed = sum(before[code] != after[code] == Code.NO_FEEDBACK for before, after in after_another)
    return held_up + missed
