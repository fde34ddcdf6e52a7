"""JointState reader and writer against rosbags and rclpy; bytes of any kind never raise anything but MessageError."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ik_controller.errors import MessageError
from ik_controller.messages import cdr
from ik_controller.messages.inputs import INPUTS

JOINTS = ("j1", "j2", "j3")

texts = st.text("ab1_/ é関🦾", max_size=9)
names = st.lists(texts, unique=True, max_size=9)
numbers = st.floats(-1e6, 1e6)


def joint_state(names, position, velocity=(), effort=(), stamp=0, frame="") -> bytes:
    arrays = [np.array(values, dtype=float) for values in (position, velocity, effort)]
    return cdr.encode(cdr.message(cdr.JOINT_STATE, cdr.header(stamp, frame), list(names), *arrays))


@given(data=st.data(), frame=texts)
def test_reader_finds_each_joint_whatever_its_place_and_company(data, frame):
    """Re-ordered, among others, with and without velocities and efforts; first and repeated messages."""
    everyone = data.draw(st.permutations([*JOINTS, *data.draw(names.filter(lambda n: not set(n) & set(JOINTS)))]))
    reader = cdr.JointStateReader(JOINTS)
    with_velocity, with_effort = data.draw(st.booleans()), data.draw(st.booleans())
    for stamp in (1, 10**18 + 7):
        values = data.draw(st.lists(numbers, min_size=len(everyone), max_size=len(everyone)))
        message = joint_state(
            everyone, values, values if with_velocity else (), values if with_effort else (), stamp, frame
        )
        expected = [values[everyone.index(name)] for name in JOINTS]
        np.testing.assert_array_equal(reader.read(message), expected)
        np.testing.assert_array_equal(cdr.JointStateReader(JOINTS).read(message), expected)


@given(st.lists(st.tuples(st.integers(0, 2**31 * 10**9 - 1), *[st.floats()] * 6), min_size=1, max_size=5), st.randoms())
def test_messages_are_told_from_others_by_any_bit(commands, random):
    """Stamps, numbers (NaN, −0.0) and all that is fixed; a block of several at once."""
    writer = cdr.JointStateWriter(JOINTS)
    stamps = [stamp for stamp, *_ in commands]
    positions, velocities = (np.array([numbers[i : i + 3] for numbers in commands]) for i in (1, 4))
    messages = list(map(writer.write, stamps, positions, velocities))
    assert writer.wrote(messages, stamps, positions, velocities)
    which, at = random.randrange(len(messages)), random.randrange(len(messages[0]))
    other = bytearray(messages[which])
    other[at] ^= 1 << random.randrange(8)
    for changed in (bytes(other), messages[which][:-1]):
        assert not writer.wrote([*messages[:which], changed, *messages[which + 1 :]], stamps, positions, velocities)


@given(
    names.filter(len),
    st.integers(0, 2**31 * 10**9 - 1),
    st.lists(st.floats(), min_size=9, max_size=9),
    st.lists(st.floats(), min_size=9, max_size=9),
)
def test_writer_writes_the_bytes_that_rosbags_would(names, stamp, position, velocity):
    n = len(names)
    writer = cdr.JointStateWriter(tuple(names))
    q, v = np.array(position[:n]), np.array(velocity[:n])
    message = writer.write(stamp, q, v)
    assert message == joint_state(names, q, v, (), stamp)
    assert writer.positions(message).tobytes() == q.tobytes()
    alone = cdr.JointStateWriter(tuple(names), velocities=False)
    assert alone.write(stamp, q, None) == joint_state(names, q, (), (), stamp)
    read = cdr.decode(cdr.JOINT_STATE, message)
    assert read.name == list(names)
    assert cdr.stamp_of(read) == stamp


REFUSED = {
    "missing": (joint_state(["j1", "j3"], [1, 2]), "joint(s) missing: j2; the message has: j1, j3"),
    "doubled": (joint_state(["j1", "j2", "j3", "j2"], [1, 2, 3, 4]), "joint(s) named twice: j2"),
    "too few positions": (joint_state(JOINTS, [1, 2]), "2 values in position for 3 names"),
    "no positions": (joint_state(JOINTS, [], [1, 2, 3]), "0 values in position for 3 names"),
    "wrong velocities": (joint_state(JOINTS, [1, 2, 3], [1, 2]), "2 values in velocity for 3 names"),
    "wrong efforts": (joint_state(JOINTS, [1, 2, 3], [], [1]), "1 values in effort for 3 names"),
    "NaN": (joint_state(JOINTS, [1, np.nan, 3]), "position of 'j2' is nan"),
    "infinite": (joint_state(JOINTS, [1, 2, -np.inf]), "position of 'j3' is -inf"),
    "absurd": (joint_state(JOINTS, [1e200, 2, 3]), "position of 'j1' is 1e+200"),
    "no bytes": (b"", "not a sensor_msgs/msg/JointState"),
    "cut off": (joint_state(JOINTS, [1, 2, 3])[:-9], "not a sensor_msgs/msg/JointState"),
}


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize(("message", "text"), REFUSED.values(), ids=REFUSED)
def test_reader_refuses_in_one_clear_line(message, text):
    """Before and after good messages, which are read as ever."""
    good = joint_state(JOINTS, [1, 2, 3])
    reader = cdr.JointStateReader(JOINTS)
    for _ in range(2):
        with pytest.raises(MessageError) as caught:
            reader.read(message)
        assert text in str(caught.value)
        assert "\n" not in str(caught.value)
        np.testing.assert_array_equal(reader.read(good), [1, 2, 3])


def test_big_endian_messages_of_the_joints_are_refused():
    swapped = cdr.STORE.serialize_cdr(
        cdr.decode(cdr.JOINT_STATE, joint_state(JOINTS, [1, 2, 3])), cdr.JOINT_STATE, little_endian=False
    )
    with pytest.raises(MessageError, match="big-endian"):
        cdr.JointStateReader(JOINTS).read(bytes(swapped))


def test_none_of_the_joints_is_no_error():
    """A gripper's states on the same topic."""
    reader = cdr.JointStateReader(JOINTS)
    assert reader.read(joint_state(["finger"], [0.1])) is None
    assert reader.read(joint_state([], [])) is None


def test_a_message_of_the_learned_length_and_names_is_still_held_to_its_counts():
    """6 velocities and 8 efforts for 7 names are as long as 7 and 7."""
    joints = tuple(f"joint{i}" for i in range(7))
    good, bad = (joint_state(joints, np.arange(7.0), np.zeros(v), np.zeros(14 - v)) for v in (7, 6))
    assert len(good) == len(bad)
    reader = cdr.JointStateReader(joints)
    np.testing.assert_array_equal(reader.read(good), np.arange(7.0))
    with pytest.raises(MessageError, match="6 values in velocity for 7 names"):
        reader.read(bad)
    np.testing.assert_array_equal(reader.read(good), np.arange(7.0))


def outcome(read, *arguments):
    """Return the bytes of what was read, None for nothing, or the error's line."""
    try:
        values = read(*arguments)
    except MessageError as error:
        return one_line(error)
    if isinstance(values, np.ndarray):
        assert np.isfinite(values).all()
        return values.tobytes()
    return None


def one_line(error):
    assert "\n" not in str(error)
    return str(error)


@settings(max_examples=300)
@given(data=st.data())
def test_damaged_messages_raise_nothing_but_message_errors(data):
    good = joint_state(["j2", "j1", "x", "j3"], [1, 2, 3, 4], [1, 2, 3, 4], [], 5, "base")
    reader = cdr.JointStateReader(JOINTS)
    reader.read(good)
    damaged = bytearray(good)
    for _ in range(data.draw(st.integers(0, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    damaged = bytes(damaged[: data.draw(st.one_of(st.just(len(damaged)), st.integers(0, len(damaged))))])
    # One reader knows the layout, the other does not.
    assert outcome(reader.read, damaged) == outcome(cdr.JointStateReader(JOINTS).read, damaged)
    np.testing.assert_array_equal(reader.read(good), [2, 1, 4])


@settings(max_examples=200)
@given(st.sampled_from(sorted({*INPUTS.values(), cdr.STRING, cdr.CYCLE})), st.binary(max_size=200))
@example(cdr.TRAJECTORY, b"\0\1\0\0" + b"\xff" * 40)
@example(cdr.JOINT_STATE, b"\0\1\0\0" + b"\0" * 12 + b"\xff\xff\xff\x7f")
def test_garbage_raises_nothing_but_message_errors(type_name, data):
    for attempt in (data, b"\0\1\0\0" + data):
        result = outcome(cdr.decode, type_name, attempt)
        assert result is None or type_name in result


integers = st.integers(-(2**63), 2**63 - 1)


@given(st.tuples(*[integers] * 6))
def test_cycle_records_round_trip_and_are_plain_messages(values):
    data = cdr.encode_cycle(*values)
    assert cdr.decode_cycle(data) == values
    message = cdr.decode(cdr.CYCLE, data)
    assert tuple(message.data) == values
    assert cdr.encode(message) == data
    with pytest.raises(MessageError, match="not a cycle record"):
        cdr.decode_cycle(data[:-1])


RCLPY = """
    import sys
    from rclpy.serialization import serialize_message, deserialize_message
    from sensor_msgs.msg import JointState
    for count in (0, 4):
        for effort in (0, 4):
            message = JointState(name=["j2", "x", "j1", "j3"], position=[2.0, 9.0, 1.0, 3.0])
            message.header.frame_id = "base"
            message.velocity, message.effort = [0.5] * count, [0.25] * effort
            print(bytes(serialize_message(message)).hex())
    back = deserialize_message(bytes.fromhex(sys.argv[1]), JointState)
    print(list(back.name), list(back.position), list(back.velocity), back.header.stamp.sec, back.header.stamp.nanosec)
"""


def test_rclpy_reads_ours_and_we_read_rclpys():
    """The real rclpy, in a process of its own; its bytes may have padding of any value and some more at the end."""
    pytest.importorskip("rclpy")
    ours = cdr.JointStateWriter(("a", "bcdef")).write(3_000_000_005, np.array([0.1, -2.5]), np.array([1.5, 0.0]))
    command = [sys.executable, "-c", textwrap.dedent(RCLPY), ours.hex()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    *theirs, read = done.stdout.splitlines()
    assert read == "['a', 'bcdef'] [0.1, -2.5] [1.5, 0.0] 3 5"
    assert len(theirs) == 4
    reader = cdr.JointStateReader(JOINTS)
    for line in theirs:
        for _ in range(2):
            np.testing.assert_array_equal(reader.read(bytes.fromhex(line)), [1.0, 2.0, 3.0])
