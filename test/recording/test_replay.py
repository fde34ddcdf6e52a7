"""Replay: bit for bit, what-if, a new bag that replays again, foreign bags, damaged ones, golden ones, memory."""

from __future__ import annotations

import resource
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from bag_samples import evenly_chunked

from ik_controller import cli
from ik_controller.errors import BagError, ParameterError
from ik_controller.messages import cdr
from ik_controller.messages.inputs import INPUTS
from ik_controller.recording.cycles import Cycle, session_of
from ik_controller.recording.reader import open_bag
from ik_controller.recording.replay import replay
from ik_controller.recording.run import METADATA, RunInfo, RunWriter
from ik_controller.recording.target_bag import Source, TargetBag, TargetOptions, TimedTarget, write_targets
from ik_controller.recording.writer import BagWriter
from ik_controller.robots import build_model, bundled_parameters
from ik_controller.session import Session

BAGS = Path(__file__).resolve().parents[2] / "bags"
PANDA = bundled_parameters("panda").replace({"rate": 200.0})
MODEL = build_model(PANDA)
START = 1_700_000_000_000_000_000


def sine(seconds: float, frame: str = "panda_link0") -> list[TimedTarget]:
    """Poses and twists at 100 Hz: the tool swings by 5 cm."""
    home = MODEL.forward(np.array(PANDA.posture))
    targets = []
    for index in range(round(100 * seconds)):
        time = index * 10_000_000
        pose = home.copy()
        pose.translation = home.translation + np.array([0.0, 0.05 * np.sin(0.06 * index) ** 3, 0.0])
        rate = 0.05 * 3.0 * np.sin(0.06 * index) ** 2 * np.cos(0.06 * index) * 6.0
        twist = np.array([0.0, rate, 0.0, 0.0, 0.0, 0.0])
        targets.append(TimedTarget(time, "target_pose", cdr.pose_message(START + time, frame, pose)))
        targets.append(TimedTarget(time, "target_twist", cdr.twist_message(START + time, frame, twist)))
    return targets


@pytest.fixture(scope="module")
def targets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with targets only."""
    folder = tmp_path_factory.mktemp("bags") / "targets"
    write_targets(folder, sine(2.0), START)
    return folder


@pytest.fixture(scope="module")
def run(targets: Path) -> Path:
    """A bag of a run: the targets on the ideal arm."""
    folder = targets.parent / "run"
    result = replay(open_bag(targets), robot=PANDA, output=folder)
    assert result.identical is None
    assert result.commands > 400
    return folder


def altered(run: Path, folder: Path, change) -> Path:
    """Copy a run; `change(number, message)` returns the new bytes or None to leave a message out."""
    bag = open_bag(run)
    writer = BagWriter(folder, patient=True)
    for name in bag.metadata_names():
        if name == METADATA:
            writer.metadata(name, bag.metadata(name))
    channels = {topic.name: writer.channel(topic.name, topic.type_name) for topic in bag.topics}
    counts: dict[str, int] = {}
    for message in bag.messages():
        number = counts[message.topic] = counts.get(message.topic, -1) + 1
        data = change(number, message)
        if data is not None:
            writer.write(channels[message.topic], message.log_time_ns, data)
    writer.close()
    return folder


def test_targets_alone_run_on_the_ideal_arm_and_are_followed(targets: Path) -> None:
    result = replay(open_bag(targets), robot=PANDA)
    assert (result.identical, result.first_difference, result.rejected) == (None, None, 0)
    errors = result.errors.as_mapping()
    assert errors["position_rms_m"] < 2e-4
    assert errors["orientation_rms_rad"] < 1e-4
    assert 2.0 < result.duration < 2.5


def test_a_run_replays_bit_identically_and_so_does_the_replays_bag(run: Path, tmp_path: Path) -> None:
    result = replay(open_bag(run), output=tmp_path / "again")
    assert result.identical is True
    assert result.max_difference == 0.0
    assert result.real_time_factor > 0.0
    again = replay(open_bag(tmp_path / "again"))
    assert again.identical is True
    assert (again.commands, again.cycles) == (result.commands, result.cycles)
    old, new = ([m.data for m in open_bag(b).messages(["/joint_commands"])] for b in (run, tmp_path / "again"))
    assert old == new


def test_a_recording_that_begins_while_the_arm_moves(run: Path, tmp_path: Path) -> None:
    bag, half = open_bag(run), tmp_path / "half"
    session, info = session_of(bag, {})
    role_of = {topic: role for role, topic in info.topics.items()}
    encode = cdr.JointStateWriter(MODEL.joint_names)
    writer, begun = RunWriter(half, session, info.topics, patient=True), False
    for topic, now, data, _ in bag.messages():
        role = role_of[topic]
        if role == "cycle":
            number, time, code, late, work, published = cdr.decode_cycle(data)
            step = session.cycle(time)
            if begun:
                writer.write("joint_commands", time, encode.write(time + session.period, step.position, step.velocity))
                writer.cycle(number, time, code, late, work, published)
            elif number == 200:
                writer.begin(session, time + 1)
                begun = True
        elif role == "events":
            session.apply(str(cdr.decode(cdr.STRING, data).data))
        elif role in INPUTS:
            session.take(role, data, now)
            if begun:
                writer.write(role, now, data)
    writer.close()
    whole, result = replay(bag), replay(open_bag(half))
    assert result.identical is True
    assert result.commands == result.cycles == whole.cycles - 201
    assert result.duration == pytest.approx((result.cycles - 1) / PANDA.rate, abs=1e-9)
    moved = altered(half, tmp_path / "moved", lambda k, m: bytes([*m.data[:-1], m.data[-1] ^ 1])
                    if (m.topic, k) == ("/joint_commands", 100) else m.data)  # fmt: skip
    assert replay(open_bag(moved)).first_difference_s == pytest.approx(100 / PANDA.rate, abs=1e-9)


@pytest.mark.parametrize("place", [-1, -57, 4], ids=["a velocity", "a position", "the stamp"])
def test_one_changed_byte_is_found_in_its_cycle(run: Path, tmp_path: Path, place: int) -> None:
    """`place` of the byte: in the last velocity, in the positions' numbers, in the stamp."""
    cycles: list[int] = []

    def change(number, message):
        if message.topic.endswith("/cycle"):
            cycles.append(cdr.decode_cycle(message.data)[0])
        if message.topic == "/joint_commands" and number == 123:
            data = bytearray(message.data)
            data[place - (12 if place == -1 else 0)] ^= 1
            change.before = len(cycles)
            return bytes(data)
        return message.data

    bag = altered(run, tmp_path / "changed", change)
    result = replay(open_bag(bag))
    assert result.identical is False
    assert result.first_difference == cycles[change.before]


def test_it_says_where_it_left_the_run_and_where_the_tolerance(run: Path, tmp_path: Path) -> None:
    """Bits of rising weight are changed in three commands."""

    def change(number, message):
        if message.topic == "/joint_commands" and number in (50, 60, 70):
            data = bytearray(message.data)
            positions = encode.positions(data)
            positions[6] += {50: 1e-12, 60: 1e-6, 70: 1e-8}[number]
            return bytes(data)
        return message.data

    encode = cdr.JointStateWriter(MODEL.joint_names)
    result = replay(open_bag(altered(run, tmp_path / "changed", change)), tolerance=1e-9)
    first, largest = result.first_difference, result.max_at
    assert result.max_difference == pytest.approx(1e-6)
    assert (largest - first, result.first_beyond) == (10, largest)
    assert result.first_difference_s == pytest.approx(first / 200.0)
    assert result.first_beyond_s == pytest.approx(largest / 200.0)


def test_what_made_the_run_is_compared_with_what_is_here(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = open_bag(run)
    info = RunInfo.of(bag)
    same = replay(bag)
    assert (same.software, same.code, same.model, same.parameters) == ({}, None, None, {})
    monkeypatch.setattr("ik_controller.recording.replay.code", lambda: "other")
    monkeypatch.setattr("ik_controller.recording.replay.software", lambda: {**info.software, "numpy": "0.1"})
    monkeypatch.setattr("ik_controller.recording.replay.urdf_text", lambda _: "<robot/>")
    other = replay(bag, changes={"gain": 20.0})
    assert other.software == {"numpy": (info.software["numpy"], "0.1")}
    assert other.code == (info.code, "other")
    assert other.model is not None
    assert other.parameters == {"gain": ([50.0], [20.0])}
    (tmp_path / "gain.yaml").write_text("gain: 20.0\n")
    assert cli.main(["replay", str(run), "--params", str(tmp_path / "gain.yaml"), "--tolerance", "1e-9"]) == 0
    said = capsys.readouterr().out
    for words in ("numpy", "0.1 now", "other now", "The robot's model here is another", "parameter gain: [50.0] then"):
        assert words in said


def test_a_model_that_is_not_the_recorded_one_is_damage(run: Path, tmp_path: Path) -> None:
    bag = open_bag(run)
    writer = BagWriter(tmp_path / "bag", patient=True)
    record = bag.metadata(METADATA)
    writer.metadata(METADATA, {**record, "urdf": record["urdf"].replace("0.333", "0.334", 1)})
    writer.close()
    with pytest.raises(BagError, match="model is not the one that was recorded"):
        RunInfo.of(open_bag(tmp_path / "bag"))


def test_a_missing_command_is_a_difference(run: Path, tmp_path: Path) -> None:
    drop = lambda number, m: None if m.topic == "/joint_commands" and number == 50 else m.data  # noqa: E731
    result = replay(open_bag(altered(run, tmp_path / "changed", drop)))
    assert result.identical is False
    assert result.first_difference is not None
    assert result.max_difference == float("inf")


def test_a_missing_input_is_a_difference(run: Path, tmp_path: Path) -> None:
    drop = lambda number, m: None if m.topic.endswith("target_pose") and number == 90 else m.data  # noqa: E731
    result = replay(open_bag(altered(run, tmp_path / "changed", drop)))
    assert result.identical is False
    assert 0.0 < result.max_difference < 1e-2


def test_what_if(run: Path) -> None:
    same = replay(open_bag(run), changes={"gain": 50.0})
    assert same.identical is True
    slow = replay(open_bag(run), changes={"feed_forward": False, "gain": 10.0})
    assert slow.identical is False
    assert slow.errors.as_mapping()["position_rms_m"] > 10.0 * same.errors.as_mapping()["position_rms_m"]
    with pytest.raises(ParameterError, match="gains"):
        replay(open_bag(run), changes={"gains": 1.0})
    with pytest.raises(ParameterError, match="damping"):
        replay(open_bag(run), changes={"damping": -1.0})


def test_a_bag_of_joint_states_alone_runs_as_tool_poses(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "joints", patient=True)
    channel = writer.channel("/joint_states", cdr.JOINT_STATE)
    encode = cdr.JointStateWriter(MODEL.joint_names[::-1])  # in an order of its own
    home = np.array(PANDA.posture)
    for index in range(200):
        time = START + index * 10_000_000
        q = home + 0.1 * (1.0 - np.cos(0.03 * index))
        writer.write(channel, time, encode.write(time, q[::-1].copy(), np.zeros(MODEL.n)))
    writer.close()
    result = replay(open_bag(tmp_path / "joints"), robot=PANDA, output=tmp_path / "run")
    assert result.identical is None
    assert result.errors.as_mapping()["position_rms_m"] < 2e-2  # poses without twists are trailed
    first = next(open_bag(tmp_path / "run").messages(["/joint_commands"]))
    np.testing.assert_array_equal(cdr.JointStateReader(MODEL.joint_names).read(first.data), home)
    assert replay(open_bag(tmp_path / "run")).identical is True


def test_recorded_joints_are_followed_as_joints_from_where_they_begin(tmp_path: Path) -> None:
    """The last joint was counted from another turn."""
    writer = BagWriter(tmp_path / "joints", patient=True)
    channel = writer.channel("/joint_states", cdr.JOINT_STATE)
    encode = cdr.JointStateWriter(MODEL.joint_names)
    home, turn = np.array(PANDA.posture) + 0.2, np.array([0.0] * 6 + [2.0 * np.pi])
    for index in range(200):
        q, v = home + 0.1 * (1.0 - np.cos(0.03 * index)), np.full(MODEL.n, 0.3 * np.sin(0.03 * index))
        writer.write(channel, START + index * 10_000_000, encode.write(START + index * 10_000_000, q + turn, v))
    writer.close()
    bag, targets = open_bag(tmp_path / "joints"), TargetOptions(sources=(Source.parse("target_joints=/joint_states"),))
    result = replay(bag, robot=PANDA, targets=targets, output=tmp_path / "run")
    # between two samples, 10 ms, the target stands: 3 mrad of every joint at 0.3 rad/s
    assert 0.0 < result.errors.as_mapping()["position_max_m"] < 4e-3
    commands = [m.data for m in open_bag(tmp_path / "run").messages(["/joint_commands"])]
    np.testing.assert_allclose(encode.positions(commands[0]), home, atol=1e-12)
    np.testing.assert_allclose(encode.positions(commands[-1]), q, atol=4e-3)
    again = replay(open_bag(tmp_path / "run"))
    assert again.identical is True
    assert again.errors.as_mapping() == result.errors.as_mapping()


def test_a_bag_that_fits_nothing_is_told(tmp_path: Path) -> None:
    write_targets(tmp_path / "map", sine(0.1, frame="map"), START)
    with pytest.raises(BagError, match="'map' is unknown; legal: "):
        replay(open_bag(tmp_path / "map"), robot=PANDA)
    with pytest.raises(BagError, match="name the robot"):
        replay(open_bag(tmp_path / "map"))
    writer = BagWriter(tmp_path / "other")
    writer.write(writer.channel("/words", cdr.STRING), START, cdr.encode(cdr.message(cdr.STRING, "no")))
    writer.close()
    with pytest.raises(BagError, match="neither targets nor joint states"):
        replay(open_bag(tmp_path / "other"), robot=PANDA)
    with pytest.raises(BagError, match="never overwritten"):
        replay(open_bag(tmp_path / "map"), robot=PANDA, output=tmp_path / "other")


def test_targets_of_chosen_topics(targets: Path) -> None:
    only = TargetOptions(sources=(Source.parse("target_twist=/ik_controller/target_twist"),))
    assert {t.role for t in TargetBag(open_bag(targets), only)} == {"target_twist"}
    nothing = TargetOptions(sources=(Source.parse("target_twist=/nothing"),))
    with pytest.raises(BagError, match=r"no topic '/nothing'; it has: /ik_controller/target_pose"):
        TargetBag(open_bag(targets), nothing)


def test_a_cut_off_run_replays_as_far_as_it_is_whole(tmp_path: Path) -> None:
    write_targets(tmp_path / "targets", sine(15.0), START)  # long enough for several chunks
    whole = replay(open_bag(tmp_path / "targets"), robot=PANDA, output=tmp_path / "run")
    (file,) = (tmp_path / "run").glob("*.mcap")
    data = file.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) * 8 // 10])
    result = replay(open_bag(cut))
    assert result.identical is True
    assert result.complete is False
    assert 0 < result.commands < whole.commands


def test_a_run_in_which_nothing_can_be_compared_gets_no_verdict(run: Path, tmp_path: Path) -> None:
    inputs = lambda number, m: None if m.topic.endswith(("/cycle", "joint_commands")) else m.data  # noqa: E731
    nothing = replay(open_bag(altered(run, tmp_path / "inputs", inputs)))
    assert (nothing.commands, nothing.identical, nothing.max_difference) == (0, None, 0.0)


def test_memory_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    """Memory follows the largest chunk, so all chunks are made alike here; both bags have several."""
    peaks = []
    for seconds in (3.0, 12.0):
        folder = tmp_path / f"{seconds}"
        write_targets(folder / "targets", sine(seconds), START)
        replay(open_bag(folder / "targets"), robot=PANDA, output=folder / "run")
        bag = open_bag(evenly_chunked(folder / "run", folder / "even.mcap"))
        replay(bag)  # what is kept once is kept by now
        tracemalloc.start()
        assert replay(bag).identical
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # 7200 messages more: a pointer kept of each would be 58 kB
    assert peaks[1] < peaks[0] + 40_000


@pytest.mark.soak
def test_memory_stays_flat_over_two_million_cycles(tmp_path: Path) -> None:
    """33 minutes at 1 kHz, made on the ideal arm and replayed; resident memory is looked at twenty times."""
    cycles, period = 2_000_000, 100_000_000
    home = MODEL.forward(np.array(PANDA.posture))

    def swing() -> Iterator[TimedTarget]:
        for time in range(0, cycles * 1_000_000, period):
            angle = 2e-9 * time
            pose, twist = home.copy(), np.zeros(6)
            pose.translation = home.translation + np.array([0.0, 0.05 * np.sin(angle), 0.0])
            twist[1] = 0.1 * np.cos(angle)
            yield TimedTarget(time, "target_pose", cdr.pose_message(START + time, MODEL.base_frame, pose))
            yield TimedTarget(time, "target_twist", cdr.twist_message(START + time, MODEL.base_frame, twist))

    resident: list[float] = []

    def look(passing: Iterator[Cycle], _: Session) -> Iterator[Cycle]:
        for number, cycle in enumerate(passing):
            if number % (cycles // 20) == 0:
                pages = int(Path("/proc/self/statm").read_text().split()[1])
                resident.append(pages * resource.getpagesize() * 1e-6)
            yield cycle

    write_targets(tmp_path / "targets", swing(), START)
    replay(open_bag(tmp_path / "targets"), robot=bundled_parameters("panda"), output=tmp_path / "run")
    result = replay(open_bag(tmp_path / "run"), watch=look)
    assert result.identical is True
    assert result.cycles >= cycles
    print(
        f"{result.cycles} cycles, {result.real_time_factor:.1f} x real time; "
        f"resident {resident[1]:.1f} MB after a twentieth, {max(resident[1:]):.1f} MB at most"
    )
    assert max(resident[1:]) < resident[1] + 4.0  # a pointer kept of each cycle would be 16 MB


@pytest.mark.parametrize("robot", ["panda", "ur5e"])
def test_golden_runs(robot: str) -> None:
    golden = BAGS / f"{robot}_golden"
    if not golden.exists():
        pytest.skip(f"no {golden.name} in bags/")
    bag = open_bag(golden)
    result = replay(bag)
    assert result.commands > 1000
    assert result.max_difference <= 1e-9
    if not result.software:
        assert result.identical is True
    info = RunInfo.of(bag)
    assert info is not None
    assert info.parameters.robot == robot
    assert result.errors.as_mapping()["position_rms_m"] < 1e-4
