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
from small_disk import small_disk as disk_of

from ik_controller.messages import cdr
from ik_controller.recording.reader import open_bag
from ik_controller.recording.recover import recover
from ik_controller.recording.replay import replay
from ik_controller.recording.segment import SegmentWriter
from ik_controller.recording.writer import RECORDER_METADATA, BagWriter

# Real runs at 1 kHz on the ideal arm, each in a process of its own, forked for every line "folder note" on stdin. What
# has been handed over, and how long the machine let no thread run, is noted in shared memory, which outlives it.
RECORDER = """
import mmap, os, signal, struct, sys, threading, time
from pathlib import Path
import numpy as np
from ik_controller.control.simulated_arm import SimulatedArm
from ik_controller.messages import cdr
from ik_controller.recording.run import RunWriter, default_topics
from ik_controller.robots import build_model, bundled_parameters
from ik_controller.session import Session

parameters = bundled_parameters("panda")
model = build_model(parameters)
session = Session(model, parameters)
session.warm_up()
encode = cdr.JointStateWriter(model.joint_names)
posture = np.array(parameters.posture)
home = model.forward(posture)

def run(folder, note):
    with open(note, "r+b") as file:
        shared = mmap.mmap(file.fileno(), 24)
    stall = 0

    def watch():
        nonlocal stall
        last = time.monotonic_ns()
        while True:
            time.sleep(0.005)
            now = time.monotonic_ns()
            stall, last = max(stall, now - last - 5_000_000), now

    threading.Thread(target=watch, daemon=True).start()
    writer = RunWriter(Path(folder), session, default_topics())
    arm = SimulatedArm(posture)
    now = time.monotonic_ns()
    writer.begin(session, now)
    index = 0
    while True:
        now = max(now + 1_000_000, time.monotonic_ns())
        pose = home.copy()
        pose.translation[1] += 0.05 * np.sin(0.002 * index) ** 2
        for role, data in (("joint_states", encode.write(now, *arm.measure())),
                           ("target_pose", cdr.pose_message(now, model.base_frame, pose))):
            writer.write(role, now, data)
            session.take(role, data, now)
        step = session.cycle(now)
        if step is not None:
            arm.command(step.position)
            writer.write("joint_commands", now, encode.write(now + session.period, step.position, step.velocity))
        arm.advance(session.dt)
        writer.cycle(index, now, int(session.status.code), 0, 0, int(step is not None))
        index += 1
        shared[:24] = struct.pack("<qqq", now, index, stall)
        time.sleep(max(0.0, now + 1_000_000 - time.monotonic_ns()) * 1e-9)

signal.signal(signal.SIGCHLD, signal.SIG_IGN)
for line in sys.stdin:
    child = os.fork()
    if child == 0:
        run(*line.rstrip("\\n").split("\\t"))
    print(child, flush=True)
"""


@pytest.fixture
def runs() -> Iterator[subprocess.Popen[str]]:
    """The process that starts runs."""
    process = subprocess.Popen(
        [sys.executable, "-c", RECORDER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    yield process
    process.kill()
    process.communicate()


def kill_recover_replay(runs: subprocess.Popen[str], folder: Path, run_for: float) -> tuple[float, float]:
    """Kill a run after `run_for` [s]: at most 100 ms are lost, the rest replays bit for bit, also by another reader.

    Return what was lost and for how long the machine let no thread of the run go on [ms].
    """
    note = folder / "note"
    note.write_bytes(bytes(24))
    bag = folder / "bag"
    assert runs.stdin is not None
    assert runs.stdout is not None
    runs.stdin.write(f"{bag}\t{note}\n")
    runs.stdin.flush()
    child = int(runs.stdout.readline())
    try:
        wait_until(lambda: struct.unpack("<qqq", note.read_bytes())[1] > 0)
        time.sleep(run_for)
    finally:
        os.kill(child, signal.SIGKILL)
    wait_until(lambda: not Path(f"/proc/{child}/stat").exists())
    until, count, stall = struct.unpack("<qqq", note.read_bytes())
    result = recover(bag)
    assert result.output is not None, f"nothing on disk after {run_for:.3f} s"
    found = open_bag(result.output)
    cycles = [cdr.decode_cycle(m.data) for m in found.messages(["/ik_controller/cycle"])]
    assert [cycle[0] for cycle in cycles] == list(range(len(cycles)))
    # the loop may have closed one more cycle than it could note
    assert count + 1 >= len(cycles) > 0
    assert until - cycles[-1][1] < 100_000_000 + stall, f"lost {count - len(cycles)} cycles"
    replayed = replay(found)
    assert replayed.identical is True
    assert replayed.cycles == len(cycles)
    with AnyReader([result.output]) as reader:
        assert sum(1 for _ in reader.messages()) == result.messages
    return (until - cycles[-1][1]) * 1e-6, stall * 1e-6


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs fork and /proc")
def test_killed_at_ten_random_moments(runs: subprocess.Popen[str], tmp_path: Path) -> None:
    generator = random.Random(10)
    for number in range(10):
        folder = tmp_path / str(number)
        folder.mkdir()
        kill_recover_replay(runs, folder, generator.uniform(0.12, 0.5))


@pytest.mark.soak
def test_killed_at_100_random_moments(runs: subprocess.Popen[str], tmp_path: Path) -> None:
    generator = random.Random(100)
    losses = []
    for number in range(100):
        folder = tmp_path / str(number)
        folder.mkdir()
        losses.append(kill_recover_replay(runs, folder, generator.uniform(0.12, 1.5)))
        shutil.rmtree(folder)
    lost = sorted(loss for loss, _ in losses)
    stalled = sum(stall > 5.0 for _, stall in losses)
    print(
        f"100 killed and recovered: lost {lost[50]:.0f} ms in the middle, {lost[-1]:.0f} ms at most; "
        f"the machine stalled {stalled} of them, for {max(stall for _, stall in losses):.0f} ms at most"
    )


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 3 MiB of its own."""
    with disk_of(tmp_path / "disk", 3) as disk:
        yield disk


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


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ENOENT])
def test_whatever_the_disk_says_recording_goes_on_when_it_is_well_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """Full, over quota, read-only, broken, gone: nothing can be written nor opened, for a while."""
    ill = threading.Event()
    real_write, real_open = os.write, os.open

    def write(file: int, data: bytes) -> int:
        if ill.is_set():
            raise OSError(number, os.strerror(number))
        return real_write(file, data)

    def open_(path: os.PathLike[str], flags: int, *rest: int, **options: int) -> int:
        if ill.is_set() and str(path).startswith(str(tmp_path)) and flags & (os.O_WRONLY | os.O_RDWR):
            raise OSError(number, os.strerror(number))
        return real_open(path, flags, *rest, **options)

    monkeypatch.setattr(os, "write", write)
    monkeypatch.setattr(os, "open", open_)
    writer = BagWriter(tmp_path / "bag", flush_interval=0.005, queue_bytes=100_000)
    channel = writer.channel("/a", ARRAY)
    for k in range(100):
        writer.write(channel, k, b"data")
    wait_until(lambda: writer.status().messages == 100)
    ill.set()
    writer.write(channel, 100, b"data")
    wait_until(lambda: writer.status().state == "interrupted")
    assert os.strerror(number) in writer.status().reason
    for k in range(101, 2000):
        writer.write(channel, k, b"data")
    assert writer.status().lost > 0
    ill.clear()
    wait_until(lambda: writer.status().state == "recording" and writer.status().waiting == 0)
    writer.write(channel, 2000, b"data")
    status = writer.close()
    bag = open_bag(tmp_path / "bag")
    found = [m.log_time_ns for m in bag.messages()]
    assert found[:101] == list(range(101))
    assert found[-1] == 2000
    assert 2001 - len(found) == status.lost == int(bag.metadata(RECORDER_METADATA)["lost"])
    # the loss is also known to a segment that was never sealed
    account = open_bag(tmp_path / "bag" / f"bag_{status.segments - 1}.mcap").files[0].metadata[0]
    assert (account.name, account.metadata["lost"]) == (RECORDER_METADATA, str(status.lost))


def test_a_slow_disk_loses_nothing_that_fits_into_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.write
    held: list[float] = []

    def slow(file: int, data: bytes) -> int:
        held.append(0.3)
        time.sleep(0.3)
        return real(file, data)

    writer = BagWriter(tmp_path / "bag", flush_interval=0.005)
    channel = writer.channel("/a", ARRAY)
    monkeypatch.setattr(os, "write", slow)
    number = 0
    while len(held) < 3:
        writer.write(channel, number, b"data")
        number += 1
        time.sleep(0.0005)
    status = writer.close(timeout=60.0)
    assert (status.state, status.lost, status.messages) == ("closed", 0, number)
    assert [m.log_time_ns for m in open_bag(tmp_path / "bag").messages()] == list(range(number))
