"""What a full disk costs the node's loop, measured on a real run at 1 kHz that records to a small file system."""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
import statistics
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from small_disk import small_disk

from ik_controller.messages import cdr
from ik_controller.recording.reader import open_bag
from ik_controller.recording.writer import RECORDER_METADATA
from ik_controller.verbs.bench import Graph, run_of_node

pytest.importorskip("rclpy")

_ROUNDS = 6
_PHASE = 4.0  # [s]
_SETTLE = 1.0  # [s] after a change that are left out: the recorder catches up
_LONG = 60.0  # [s] of a full disk, in which more waits than there is room for


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 128 MiB of its own."""
    with small_disk(tmp_path / "disk", 128) as folder:
        yield folder


def fill(disk: Path) -> None:
    """Take all the space there is; the node takes of it too meanwhile."""
    most = shutil.disk_usage(disk).free - 2_000_000
    with (disk / "ballast").open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, most)
    with (disk / "rest").open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))


def clear(disk: Path) -> None:
    (disk / "ballast").unlink()
    (disk / "rest").unlink()


@pytest.mark.soak
def test_a_full_disk_leaves_the_loop_alone_and_the_loss_is_the_one_reported(disk: Path) -> None:
    phases: list[tuple[bool, int, int]] = []  # full?, from and to [ns]
    with Graph(run_of_node(str(disk), record=True)) as graph:
        deadline = time.monotonic() + 120.0
        while sum(file.stat().st_size for file in disk.glob("*/*.mcap")) < 300_000:  # a second of the whole traffic
            assert time.monotonic() < deadline, "the node does not record"
            time.sleep(0.1)
        for full in (False, True) * _ROUNDS + (False,):
            if full:
                fill(disk)
            elif phases:
                clear(disk)
            begin = time.time_ns()
            time.sleep(_PHASE + _SETTLE)
            phases.append((full, begin + int(_SETTLE * 1e9), time.time_ns()))
        fill(disk)
        time.sleep(_LONG)
        clear(disk)
        time.sleep(3.0)
        for name in ("stream", "node", "sim"):
            graph.end(name)
    (folder,) = (path for path in disk.iterdir() if path.is_dir())
    bag = open_bag(folder)
    assert bag.complete

    work: list[np.ndarray] = []
    records = np.array([cdr.decode_cycle(m.data) for m in bag.messages(["/ik_controller/cycle"])])
    for _, begin, end in phases:
        times = records[:, 1]
        work.append(records[(times >= begin) & (times < end), 4] * 1e-3)
        assert len(work[-1]) > 0.9e3 * _PHASE  # nothing of these phases is lost
    high = [float(np.percentile(values, 99)) for values in work]
    ratios = [high[k] / (0.5 * (high[k - 1] + high[k + 1])) for k, phase in enumerate(phases) if phase[0]]
    with_space = statistics.median(high[::2])
    ratio = statistics.median(ratios)

    sequences: dict[str, list[int]] = defaultdict(list)
    for message in bag.messages():
        sequences[message.topic].append(message.sequence)
    found = sum(b - a - 1 for numbers in sequences.values() for a, b in itertools.pairwise(numbers))
    reported = int(bag.metadata(RECORDER_METADATA)["lost"])
    print(
        f"work p99 {with_space:.0f} us with space, times {ratio:.3f} on a full disk ({min(ratios):.2f} to "
        f"{max(ratios):.2f}); {len(bag.files)} segments; lost {reported}, found missing {found}"
    )
    with AnyReader([folder]) as reader:
        assert sum(1 for _ in reader.messages()) == sum(map(len, sequences.values()))
    assert found == reported > 0
    assert ratio < 1.1
