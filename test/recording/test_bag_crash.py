"""What a crash and a full disk cost: real processes killed by SIGKILL, a real file system without space."""

from __future__ import annotations

import errno
import itertools
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from bag_samples import ARRAY, wait_until
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from ik_controller.recording.reader import open_bag
from ik_controller.recording.recover import recover
from ik_controller.recording.segment import SegmentWriter
from ik_controller.recording.writer import RECORDER_METADATA, BagWriter

# A 1 kHz loop with five messages a cycle. It notes in shared memory, which outlives it, what it has handed over.
RECORDER = """
import mmap, struct, sys, time
from pathlib import Path
from ik_controller.recording.segment import SegmentWriter
from ik_controller.recording.writer import BagWriter

with open(sys.argv[2], "r+b") as file:
    shared = mmap.mmap(file.fileno(), 16)
writer = BagWriter(Path(sys.argv[1]))
channels = [writer.channel(f"/topic{i}", "std_msgs/msg/Float64MultiArray") for i in range(5)]
print("ready", flush=True)
number = 0
while True:
    now = time.monotonic_ns()
    for channel in channels:
        writer.write(channel, now, struct.pack("<q", number) * 30)
        number += 1
    shared[:16] = struct.pack("<qq", now, number)
    time.sleep(0.001)
"""


def kill_and_recover(folder: Path, run_for: float) -> None:
    """Kill a recorder after `run_for` [s]; less than 100 ms are lost, the rest is there in order and without gap."""
    note = folder / "note"
    note.write_bytes(bytes(16))
    bag = folder / "bag"
    child = subprocess.Popen(
        [sys.executable, "-c", RECORDER, str(bag), str(note)],
        stdout=subprocess.PIPE,
        cwd=Path(__file__).parents[2],
    )
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == b"ready\n"
        time.sleep(run_for)
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait(10.0)
        child.stdout.close()
    handed_until, number = struct.unpack("<qq", note.read_bytes())
    result = recover(bag)
    assert result.output is not None, f"nothing on disk after {run_for:.3f} s"
    found = list(open_bag(result.output).messages())
    assert [struct.unpack_from("<q", m.data)[0] for m in found] == list(range(len(found)))
    assert number - len(found) >= 0
    assert handed_until - found[-1].log_time_ns < 100_000_000, f"lost {number - len(found)} messages"
    with AnyReader([result.output]) as reader:
        assert sum(1 for _ in reader.messages()) == len(found)


@pytest.mark.parametrize("seed", range(5))
def test_killed_at_a_random_moment_loses_less_than_100_ms(tmp_path: Path, seed: int) -> None:
    kill_and_recover(tmp_path, random.Random(seed).uniform(0.15, 0.6))


@pytest.mark.soak
def test_killed_at_100_random_moments_loses_less_than_100_ms(tmp_path: Path) -> None:
    generator = random.Random(100)
    for number in range(100):
        folder = tmp_path / str(number)
        folder.mkdir()
        kill_and_recover(folder, generator.uniform(0.12, 1.5))
        shutil.rmtree(folder)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 3 MiB of its own."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(disk)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("cannot mount a tmpfs here")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


def fill_until_interrupted(writer: BagWriter, start: int = 0) -> int:
    """Write incompressible messages until the disk is full; return how many were handed over."""
    channel = writer.channel("/noise", "std_msgs/msg/Float64MultiArray")
    deadline = time.monotonic() + 30.0
    number = start
    while writer.status().state == "recording":
        for _ in range(20):
            writer.write(channel, number, struct.pack("<q", number) + os.urandom(500))
            number += 1
        time.sleep(0.002)
        assert time.monotonic() < deadline
    return number


def test_full_disk_seals_waits_and_goes_on_without_loss(small_disk: Path) -> None:
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(1_500_000))
    writer = BagWriter(small_disk / "bag", flush_interval=0.01)
    number = fill_until_interrupted(writer)
    wait_until(lambda: (small_disk / "bag" / "metadata.yaml").exists())
    status = writer.status()
    assert "No space left" in status.reason
    assert status.lost == 0
    # the full segment is sealed: everybody can read it now
    first = open_bag(small_disk / "bag" / "bag_0.mcap")
    assert first.complete
    with AnyReader([small_disk / "bag"]) as reader:
        assert sum(1 for _ in reader.messages()) == sum(topic.count or 0 for topic in first.topics) > 0
    ballast.unlink()
    channel = writer.channel("/noise", "std_msgs/msg/Float64MultiArray")
    wait_until(lambda: writer.status().state == "recording")
    writer.write(channel, number, struct.pack("<q", number))
    status = writer.close()
    assert (status.lost, status.segments, status.messages) == (0, 2, number + 1)
    found = [struct.unpack_from("<q", m.data)[0] for m in open_bag(small_disk / "bag").messages()]
    assert found == list(range(number + 1))


def test_disk_that_stays_full_loses_what_it_says(small_disk: Path) -> None:
    writer = BagWriter(small_disk / "bag", flush_interval=0.01, queue_bytes=300_000)
    number = fill_until_interrupted(writer)
    channel = writer.channel("/noise", "std_msgs/msg/Float64MultiArray")
    for _ in range(2000):
        writer.write(channel, number, bytes(508))
        number += 1
    status = writer.close()
    bag = open_bag(small_disk / "bag")
    assert bag.complete
    found = [m.sequence for m in bag.messages()]
    assert found == list(range(1, len(found) + 1))
    assert status.lost == number - len(found) > 2000
    assert status.state == "closed"
    with AnyReader([small_disk / "bag"]) as reader:
        assert sum(1 for _ in reader.messages()) == len(found)
    information = yaml.safe_load((small_disk / "bag" / "metadata.yaml").read_text())
    custom = information["rosbag2_bagfile_information"]["custom_data"]
    assert custom[f"{RECORDER_METADATA}.lost"] == str(status.lost)
    assert "No space left" in custom[f"{RECORDER_METADATA}.reason"]


def test_space_that_returns_late_leaves_gaps_of_the_reported_size(small_disk: Path) -> None:
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(1_500_000))
    writer = BagWriter(small_disk / "bag", flush_interval=0.01, queue_bytes=100_000)
    number = fill_until_interrupted(writer)
    channel = writer.channel("/noise", "std_msgs/msg/Float64MultiArray")
    for _ in range(3000):
        writer.write(channel, number, bytes(100))
        number += 1
    ballast.unlink()
    wait_until(lambda: writer.status().state == "recording" and writer.status().waiting == 0)
    writer.write(channel, number, b"after")
    status = writer.close()
    bag = open_bag(small_disk / "bag")
    found = [m.sequence for m in bag.messages()]
    gaps = [b - a - 1 for a, b in itertools.pairwise(found) if b != a + 1]
    assert sum(gaps) == status.lost > 0
    assert found[-1] == number + 1
    assert bag.metadata(RECORDER_METADATA)["lost"] == str(status.lost)
    with (small_disk / "bag" / "bag_1.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) == sum(
            topic.count or 0 for topic in open_bag(small_disk / "bag" / "bag_1.mcap").topics
        )


def test_a_disk_that_hangs_does_not_make_write_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = threading.Event()
    real = os.write

    def slow(file: int, data: bytes) -> int:
        gate.wait(30.0)
        return real(file, data)

    writer = BagWriter(tmp_path / "bag", flush_interval=0.005)
    channel = writer.channel("/a", ARRAY)
    monkeypatch.setattr(os, "write", slow)
    for k in range(5000):
        writer.write(channel, k, b"data")
    status = writer.close(timeout=0.05)
    assert (status.state, status.messages, status.waiting) == ("recording", 0, 5000)
    gate.set()
    wait_until(lambda: writer.status().state == "closed")
    assert [m.log_time_ns for m in open_bag(tmp_path / "bag").messages()] == list(range(5000))


def test_an_input_output_error_costs_a_segment_not_a_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.write
    failures = []

    def failing(file: int, data: bytes) -> int:
        if len(failures) == 0:
            failures.append(real(file, data[: len(data) // 2]))  # half a chunk is on disk, then the error
            return failures[0]
        if len(failures) == 1:
            failures.append(-1)
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return real(file, data)

    writer = BagWriter(tmp_path / "bag", flush_interval=0.005)
    channel = writer.channel("/a", ARRAY)
    writer.write(channel, 0, b"data")
    wait_until(lambda: writer.status().messages == 1)
    monkeypatch.setattr(os, "write", failing)
    for k in range(1, 100):
        writer.write(channel, k, b"data")
    wait_until(lambda: writer.status().segments == 2 and writer.status().messages == 100)
    status = writer.close()
    assert (status.lost, status.reason) == (0, "Input/output error")
    assert open_bag(tmp_path / "bag" / "bag_0.mcap").complete
    assert [m.log_time_ns for m in open_bag(tmp_path / "bag").messages()] == list(range(100))


def test_a_recorder_that_fails_itself_says_so_and_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = BagWriter(tmp_path / "bag", flush_interval=0.005)
    channel = writer.channel("/a", ARRAY)
    writer.write(channel, 0, b"data")
    wait_until(lambda: writer.status().messages == 1)
    monkeypatch.setattr(SegmentWriter, "add_chunk", lambda self, chunk: 1 // 0)
    writer.write(channel, 1, b"data")
    wait_until(lambda: writer.status().state == "closed")
    writer.write(channel, 2, b"data")
    status = writer.close()
    assert (status.messages, status.lost) == (1, 2)
    assert "ZeroDivisionError" in status.reason
    assert open_bag(tmp_path / "bag").complete
