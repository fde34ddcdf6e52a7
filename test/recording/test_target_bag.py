"""Anybody's bags as targets: every type, in any storage; clocks that jump, stamps that repeat; fitted to an arm."""

from __future__ import annotations

import itertools
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from bag_samples import evenly_chunked, make
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ik_controller.errors import BagError
from ik_controller.messages import cdr
from ik_controller.recording.clock import Clock
from ik_controller.recording.fit import Fitting
from ik_controller.recording.reader import open_bag
from ik_controller.recording.replay import replay
from ik_controller.recording.samples import JOINT_TRAJECTORY, ODOMETRY, TF, TRANSFORM
from ik_controller.recording.schema import typestore
from ik_controller.recording.target_bag import Source, TargetBag, TargetOptions
from ik_controller.recording.writer import BagWriter
from ik_controller.robots import build_model, bundled_parameters

PANDA = bundled_parameters("panda").replace({"rate": 200.0})
MODEL = build_model(PANDA)
HOME = MODEL.forward(np.array(PANDA.posture))
BASE = "panda_link0"
START = 1_700_000_000_000_000_000
STEP = 10_000_000


def joints(k: int) -> tuple[np.ndarray, np.ndarray]:
    """A slow swing of all joints: positions and velocities at sample k of 100 Hz."""
    phase = 0.02 * k
    return np.array(PANDA.posture) + 0.1 * (1.0 - np.cos(phase)), np.full(7, 0.1 * np.sin(phase) * 2.0)


def vector(values: Any, kind: str = "Vector3") -> Any:
    return make(f"geometry_msgs/msg/{kind}", *map(float, values))


def turn(pose: pin.SE3, sign: float = 1.0) -> Any:
    return make("geometry_msgs/msg/Quaternion", *(sign * pin.SE3ToXYZQUAT(pose)[3:]).tolist())


def transform(k: int, child: str = "tool", parent: str = BASE) -> Any:
    pose = MODEL.forward(joints(k)[0])
    body = make("geometry_msgs/msg/Transform", vector(pose.translation), turn(pose, (-1.0) ** k))  # signs that flip
    return make(TRANSFORM, cdr.header(START + k * STEP, parent), child, body)


def joint_state(k: int, extra: tuple[str, ...] = ()) -> Any:
    """Joints of this arm in an order of its own, among those of another."""
    q, v = joints(k)
    names = [*extra, *MODEL.joint_names[::-1]]
    position = np.concatenate((np.full(len(extra), 9.0), q[::-1]))
    velocity = np.concatenate((np.full(len(extra), 9.0), v[::-1]))
    return make(cdr.JOINT_STATE, cdr.header(START + k * STEP, ""), names, position, velocity, np.empty(0))


def odometry(k: int) -> Any:
    q, v = joints(k)
    pose, twist = MODEL.forward(q), MODEL.jacobian(q) @ v
    body = make("geometry_msgs/msg/Pose", vector(pose.translation, "Point"), turn(pose))
    own = [pose.rotation.T @ part for part in (twist[:3], twist[3:])]  # in the moving frame, as nav_msgs says
    speed = make("geometry_msgs/msg/Twist", *map(vector, own))
    return make(
        ODOMETRY,
        cdr.header(START + k * STEP, BASE),
        "tool",
        make("geometry_msgs/msg/PoseWithCovariance", body, np.zeros(36)),
        make("geometry_msgs/msg/TwistWithCovariance", speed, np.zeros(36)),
    )


def duration(nanoseconds: int) -> Any:
    return make("builtin_interfaces/msg/Duration", nanoseconds // 10**9, nanoseconds % 10**9)


def joint_trajectory(_: int) -> Any:
    points = [
        make("trajectory_msgs/msg/JointTrajectoryPoint", *joints(k), np.empty(0), np.empty(0), duration(k * STEP))
        for k in range(0, 150, 10)
    ]
    return make(JOINT_TRAJECTORY, cdr.header(0, ""), list(MODEL.joint_names), points)


KINDS = {
    "pose": (cdr.POSE, lambda k: cdr.decode(cdr.POSE, cdr.pose_message(START + k * STEP, BASE, pose_of(k))), 150),
    "odometry": (ODOMETRY, odometry, 150),
    "transform": (TRANSFORM, transform, 150),
    "tf": (TF, lambda k: make(TF, [transform(k), transform(0, "camera")]), 150),
    "joints": (cdr.JOINT_STATE, lambda k: joint_state(k, ("left_1", "left_2")), 150),
    "joint trajectory": (JOINT_TRAJECTORY, joint_trajectory, 1),
}


def pose_of(k: int) -> pin.SE3:
    return MODEL.forward(joints(k)[0])


def write(path: Path, storage: str, type_name: str, messages: list[Any]) -> Path:
    """Write a bag with the topic /motion; rosbags' writers, which are not ours."""
    if storage == "ros1":
        store, path = get_typestore(Stores.ROS1_NOETIC), path.with_suffix(".bag")
        if type_name == TF:
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", TF))
        with Writer1(path) as writer:
            connection = writer.add_connection("/motion", type_name, typestore=store)
            for k, message in enumerate(messages):
                writer.write(connection, START + k * STEP, store.serialize_ros1(as_ros1(message, store), type_name))
        return path
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer2(path, version=9, storage_plugin=plugin) as writer2:
        link = writer2.add_connection("/motion", type_name, typestore=typestore())
        for k, message in enumerate(messages):
            writer2.write(link, START + k * STEP, typestore().serialize_cdr(message, type_name))
    return path


def as_ros1(value: Any, store: Any) -> Any:
    """The same message of ROS 1, whose Header has a sequence number."""
    if isinstance(value, list):
        return [as_ros1(item, store) for item in value]
    if not hasattr(value, "__msgtype__"):
        return value
    fields = [as_ros1(getattr(value, name), store) for name in value.__dataclass_fields__ if name != "__msgtype__"]
    kind = store.types[value.__msgtype__]
    return kind(0, *fields) if value.__msgtype__ == "std_msgs/msg/Header" else kind(*fields)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "ros1"])
@pytest.mark.parametrize("kind", KINDS)
def test_every_type_in_every_storage_is_the_same_motion(tmp_path: Path, kind: str, storage: str) -> None:
    type_name, message, count = KINDS[kind]
    path = write(tmp_path / "bag", storage, type_name, [message(k) for k in range(count)])
    child = ":tool" if kind == "tf" else ""
    role = "target_trajectory" if count == 1 else "target_pose"
    options = TargetOptions(sources=(Source.parse(f"{role}=/motion{child}"),))
    targets = TargetBag(open_bag(path), options, model=MODEL)
    assert targets.skipped == 0
    np.testing.assert_allclose(targets.first_pose.homogeneous, pose_of(0).homogeneous, atol=1e-12)
    found = [t for t in targets if t.role == role]
    if count > 1:
        reader = cdr.StampedReader(cdr.POSE, 7)
        assert [t.time for t in found] == [k * STEP for k in range(count)]
        for k in (1, 77, 149):
            stamp, frame, numbers = reader.read(found[k].data)
            assert (stamp, frame) == (START + k * STEP, BASE)
            np.testing.assert_allclose(pin.XYZQUATToSE3(numbers.copy()).homogeneous, pose_of(k).homogeneous, atol=1e-9)
    result = replay(open_bag(path), robot=PANDA, targets=options)
    errors = result.errors.as_mapping()
    assert result.rejected == 0
    # with the twists that odometry and joints have, targets are followed; without them they are trailed
    assert errors["position_rms_m"] < (1e-4 if kind in ("odometry", "joints") else 5e-3)


def test_what_is_meant_must_be_clear(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", patient=True)
    for topic in ("/left/pose", "/right/pose"):
        writer.write(writer.channel(topic, cdr.POSE), START, cdr.pose_message(START, BASE, HOME))
    tf = cdr.encode(make(TF, [transform(0), transform(0, "camera")]))
    writer.write(writer.channel("/tf", TF), START, tf)
    writer.write(writer.channel("/joint_states", cdr.JOINT_STATE), START, cdr.encode(joint_state(0)))
    writer.close()
    bag = open_bag(tmp_path / "bag")

    def options(text: str) -> TargetOptions:
        return TargetOptions(sources=(Source.parse(text),))

    with pytest.raises(BagError, match="several topics that can be target_pose: /left/pose, /right/pose; say which"):
        TargetBag(bag)
    assert TargetBag(bag, options("target_pose=/right/pose")).count == 1
    with pytest.raises(BagError, match=r"several frames: .*there are: camera, tool"):
        TargetBag(bag, options("target_pose=/tf"))
    with pytest.raises(BagError, match="TwistStamped can"):
        TargetBag(bag, options("target_twist=/left/pose"))
    with pytest.raises(BagError, match="needs a robot"):
        TargetBag(bag, options("target_pose=/joint_states"))
    with pytest.raises(BagError, match=r"need ROLE=TOPIC.*roles: target_pose"):
        options("pose=/left/pose")


def times_of(entries: list[tuple[int, int]]) -> list[int]:
    """Times [ms since the first] of messages given as (stamp, log) in ms."""
    clock = Clock()
    for stamp, log in entries:
        clock.learn("/a", stamp * 10**6, log * 10**6)
    start, end = clock.learned()
    times = [(clock.time("/a", stamp * 10**6, log * 10**6) - start) // 10**6 for stamp, log in entries]
    assert max(times) == (end - start) // 10**6
    return times


def test_clock_late_and_bursting_arrivals_keep_the_senders_spacing() -> None:
    entries = [(1000 + 10 * k, 5000 + 10 * k + (k * 37) % 90) for k in range(200)]
    assert times_of(entries) == [10 * k for k in range(200)]


@pytest.mark.parametrize("jump", [-3_600_000, 7_200_000])
def test_clock_of_sender_or_recorder_may_be_set(jump: int) -> None:
    def shifted(stamp_jump: int, log_jump: int) -> list[tuple[int, int]]:
        late = [10_000_000 + 10 * k for k in range(100)]
        return [(t + stamp_jump * (k >= 50), t + 3 + log_jump * (k >= 50)) for k, t in enumerate(late)]

    steady = [10 * k for k in range(100)]
    assert times_of(shifted(jump, 0)) == steady
    assert times_of(shifted(0, jump)) == steady
    if jump < 0:  # both, as on one machine; forward that is a pause like any other
        both = times_of(shifted(jump, jump))
        assert both[:50] == steady[:50]
        assert all(0 <= b - a <= 10 for a, b in itertools.pairwise(both))


def test_repeated_stamps_gaps_and_unstamped_messages() -> None:
    assert times_of([(100, 200), (100, 201), (110, 210), (900, 1000)]) == [0, 0, 10, 800]
    assert times_of([(0, 200), (0, 215), (0, 230)]) == [0, 15, 30]


def poses(tmp_path: Path, entries: list[tuple[int, int]]) -> Path:
    """A bag of poses along x, 1 mm a step, stamps and log times given in ms."""
    writer = BagWriter(tmp_path / "poses", patient=True)
    channel = writer.channel("/p", cdr.POSE)
    for k, (stamp, log) in enumerate(entries):
        pose = pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.001 * k])), np.array([0.001 * k, 2.0, 3.0]))
        writer.write(channel, log * 10**6, cdr.pose_message(stamp * 10**6, "room", pose))
    writer.close()
    return tmp_path / "poses"


def test_targets_come_in_order_and_long_pauses_can_be_shortened(tmp_path: Path) -> None:
    entries = [(1000 + 10 * (k ^ 1), 1000 + 10 * k) for k in range(100)] + [(61_000, 61_005), (61_010, 61_015)]
    bag = open_bag(poses(tmp_path, entries))
    times = [t.time // 10**6 for t in TargetBag(bag)]
    assert times == sorted(times)
    assert times[-2] - times[-3] > 50_000
    short = [t.time // 10**6 for t in TargetBag(bag, TargetOptions(max_gap=0.5))]
    assert short[-2] - short[-3] == 500
    assert short[-1] - short[-2] == 10


def test_twists_are_those_of_the_motion(tmp_path: Path) -> None:
    bag = open_bag(poses(tmp_path, [(1000 + 10 * k, 1000 + 10 * k) for k in range(50)]))
    found = [t for t in TargetBag(bag, TargetOptions(twists=True)) if t.role == "target_twist"]
    assert len(found) == 50
    reader = cdr.StampedReader(cdr.TWIST, 6)
    for target in found:
        np.testing.assert_allclose(reader.read(target.data)[2], [0.1, 0, 0, 0, 0, 0.1], atol=1e-9)


@pytest.mark.parametrize("place", ["start", "middle"])
def test_a_motion_is_fitted_to_the_arm(tmp_path: Path, place: str) -> None:
    bag = open_bag(poses(tmp_path, [(1000 + 10 * k, 1000 + 10 * k) for k in range(101)]))
    fitting = Fitting(scale=2.0, turn=0.5, offset=(0.0, 0.1, 0.0), place=place)
    targets = TargetBag(bag, TargetOptions(fitting=fitting), model=MODEL, home=HOME)
    reader = cdr.StampedReader(cdr.POSE, 7)
    read = [reader.read(t.data) for t in targets]
    assert {frame for _, frame, _ in read} == {BASE}
    first, last = (pin.XYZQUATToSE3(read[k][2].copy()) for k in (0, -1))
    np.testing.assert_allclose(last.translation - first.translation, [0.2, 0.0, 0.0], atol=1e-12)
    shift = [0.0 if place == "start" else -0.1, 0.1, 0.0]
    np.testing.assert_allclose(first.translation - HOME.translation, shift, atol=1e-12)
    np.testing.assert_allclose(first.rotation, HOME.rotation, atol=1e-12)
    np.testing.assert_allclose(pin.log3(last.rotation @ first.rotation.T), [0.0, 0.0, 0.05], atol=1e-9)


def test_an_unknown_frame_is_told_with_its_remedy(tmp_path: Path) -> None:
    bag = poses(tmp_path, [(1000 + 10 * k, 1000 + 10 * k) for k in range(5)])
    with pytest.raises(BagError, match=r"'room' is unknown; legal: .* --frame says"):
        replay(open_bag(bag), robot=PANDA)
    assert replay(open_bag(bag), robot=PANDA, targets=TargetOptions(frame=BASE)).rejected == 0


def test_memory_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    def peak(count: int) -> int:
        folder = tmp_path / str(count)
        folder.mkdir()
        written = poses(folder, [(1000 + 10 * k, 1000 + 10 * k) for k in range(count)])
        bag = open_bag(evenly_chunked(written, folder / "chunks.mcap", 100))
        tracemalloc.start()
        assert sum(1 for _ in TargetBag(bag)) == count
        largest = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return largest

    peak(100)  # what is loaded on first use
    assert peak(4000) < peak(1000) + 3000 * 20  # a list of their times alone would take twice that
