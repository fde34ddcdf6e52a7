"""CDR: decode and encode messages; any type by `rosbags`, JointState and the cycle record also by a fast path.

A JointState stream repeats all but its stamp and numbers, so its layout is worked out once by rosbags and then only
compared: 1.5 µs instead of 20.
"""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ik_controller.errors import MessageError, choices

Array = NDArray[np.float64]

STORE = get_typestore(Stores.ROS2_JAZZY)

JOINT_STATE = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/TwistStamped"
TRAJECTORY = "trajectory_msgs/msg/MultiDOFJointTrajectory"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
JOINT_JOG = "control_msgs/msg/JointJog"
MARKERS = "visualization_msgs/msg/MarkerArray"
STRING = "std_msgs/msg/String"
CYCLE = "std_msgs/msg/Int64MultiArray"

# Types beside those of ROS 2's common packages: name → definition.
EXTRA_TYPES = {
    JOINT_JOG: "std_msgs/Header header\nstring[] joint_names\nfloat64[] displacements\nfloat64[] velocities\n"
    "float64 duration\n",
}
for _name, _text in EXTRA_TYPES.items():
    STORE.register(get_types_from_msg(_text, _name))

_SECOND = 1_000_000_000
_STAMP = struct.Struct("<iI")
_NUMBER = np.dtype("<f8")
_ABSURD = 1e154  # no joint is there; the square is no number any more


def decode(type_name: str, data: bytes) -> Any:
    """Return the message in `data` as rosbags' dataclass. Raises MessageError where the bytes are not of that type."""
    try:
        return STORE.deserialize_cdr(data, type_name)
    except Exception as error:  # rosbags raises many kinds on bytes that are cut off or of another type
        reason = " ".join(str(error).split())
    if "size mismatch" in reason:
        for surplus in (4, 8, 12):  # rclpy's serialize_message leaves some behind the message
            with contextlib.suppress(Exception):
                return STORE.deserialize_cdr(data[:-surplus], type_name)
    raise MessageError(f"not a {type_name}: {reason}")


def encode(message: Any) -> bytes:
    """Return a rosbags message as CDR bytes, the same bytes for the same message always."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def message(type_name: str, *values: Any) -> Any:
    """Make a rosbags message of its fields in order."""
    return STORE.types[type_name](*values)


def header(stamp: int, frame: str) -> Any:
    """Make a std_msgs/Header of a stamp [ns] and a frame."""
    seconds, nanoseconds = divmod(stamp, _SECOND)
    return message("std_msgs/msg/Header", message("builtin_interfaces/msg/Time", seconds, nanoseconds), frame)


def pose_message(stamp: int, frame: str, pose: Any) -> bytes:
    """Return a PoseStamped of a `pin.SE3` as bytes."""
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(pose).tolist()
    point = message("geometry_msgs/msg/Point", x, y, z)
    orientation = message("geometry_msgs/msg/Quaternion", qx, qy, qz, qw)
    return encode(message(POSE, header(stamp, frame), message("geometry_msgs/msg/Pose", point, orientation)))


def twist_message(stamp: int, frame: str, twist: Array) -> bytes:
    """Return a TwistStamped of a twist (6,) (v, ω) as bytes."""
    linear = message("geometry_msgs/msg/Vector3", *twist[:3].tolist())
    angular = message("geometry_msgs/msg/Vector3", *twist[3:].tolist())
    return encode(message(TWIST, header(stamp, frame), message("geometry_msgs/msg/Twist", linear, angular)))


def stamp_at(data: bytes) -> tuple[int, int]:
    """Return seconds and nanoseconds of the header that begins a message's bytes, zeros where there is none."""
    if len(data) < 12:
        return 0, 0
    values = struct.unpack_from("<iI" if data[1] == 1 else ">iI", data, 4)
    return values[0], values[1]


def frame_of(data: bytes) -> str:
    """Return the frame in the header that begins a message's bytes, "" where there is none or it cannot be read."""
    order = "<I" if data[1:2] == b"\1" else ">I"
    try:
        (length,) = struct.unpack_from(order, data, 12)
        return data[16 : 15 + length].decode()
    except (struct.error, UnicodeDecodeError):
        return ""


def stamp_of(stamped: Any) -> int:
    """Return the header's stamp [ns]."""
    stamp = stamped.header.stamp
    return int(stamp.sec) * _SECOND + int(stamp.nanosec)


def _layout(data: bytes) -> tuple[int, int]:
    """Return the offsets of a little-endian JointState's position count's end and of its position numbers."""
    (frame_length,) = struct.unpack_from("<I", data, 12)
    at = 16 + frame_length
    at += -at % 4
    (names,) = struct.unpack_from("<I", data, at)
    at += 4
    for _ in range(names):
        at += -at % 4
        (length,) = struct.unpack_from("<I", data, at)
        at += 4 + length
    at += -at % 4 + 4
    return at, at + (4 - at) % 8  # numbers are aligned to 8 counted from behind the 4-byte CDR header


def joint_order(wanted: Sequence[str], names: list[str]) -> list[int]:
    """Return where each wanted joint is among a message's `names`. Raises MessageError: missing or named twice."""
    missing = [name for name in wanted if name not in names]
    if missing:
        raise MessageError(f"joint(s) missing: {choices(missing)}; the message has: {choices(names)}")
    doubled = sorted({name for name in wanted if names.count(name) > 1})
    if doubled:
        raise MessageError(f"joint(s) named twice: {choices(doubled)}")
    return [names.index(name) for name in wanted]


def _parts(spans: Sequence[tuple[int, int]], length: int) -> struct.Struct:
    """Return what takes parts (begin, end) out of a message of that length; nothing is left out before the first."""
    ends = [begin for begin, _ in spans[1:]] + [length]
    return struct.Struct(
        "<" + "".join(f"{end - begin}s{to - end}x" for (begin, end), to in zip(spans, ends, strict=True))
    )


class StampedReader:
    """Reads stamp, frame and the numbers behind them of PoseStamped or TwistStamped messages."""

    def __init__(self, type_name: str, count: int) -> None:
        self._type = type_name
        self._count = count
        self._prefix = b""
        self._length = -1
        self._at = 0
        self._frame = ""

    def read(self, data: bytes) -> tuple[int, str, Array]:
        """Return (stamp [ns], frame, numbers (count,)). Raises MessageError where the bytes are not of the type."""
        if len(data) != self._length or data[1] != 1 or not data.startswith(self._prefix, 12):
            self._learn(data)
        seconds, nanoseconds = _STAMP.unpack_from(data, 4)
        return seconds * _SECOND + nanoseconds, self._frame, np.frombuffer(data, _NUMBER, self._count, self._at)

    def _learn(self, data: bytes) -> None:
        self._length = -1
        frame = decode(self._type, data).header.frame_id
        if data[1] != 1:
            raise MessageError("big-endian messages are not supported")
        (length,) = struct.unpack_from("<I", data, 12)
        end = 16 + length
        self._prefix, self._frame, self._length = data[12:end], frame, len(data)
        self._at = end + (4 - end) % 8


class StampedWriter:
    """Writes PoseStamped or TwistStamped messages of one frame."""

    def __init__(self, empty: bytes, count: int) -> None:
        """`empty`: a message of the frame; `count` numbers end it."""
        self._buffer = bytearray(empty)
        self._at = len(empty) - 8 * count

    def write(self, stamp: int, numbers: Array) -> bytes:
        """Return the message's bytes; `stamp` [ns], numbers (count,)."""
        _STAMP.pack_into(self._buffer, 4, stamp // _SECOND, stamp % _SECOND)
        self._buffer[self._at :] = numbers.tobytes()
        return bytes(self._buffer)


class JointStateReader:
    """Reads the positions of given joints out of JointState messages, in any order and whatever else is there."""

    def __init__(self, joint_names: tuple[str, ...]) -> None:
        self._names = joint_names
        self._length = -1
        self._last = bytearray()  # the message that is read, and its positions: views are slow to make
        self._values = np.zeros(0)
        self._at = 0
        self._order: NDArray[np.intp] | None = None  # None: as in the message, all of them
        self._parts = struct.Struct("")  # header, frame and names, with all counts: all but stamp and numbers
        self._learned: tuple[bytes, ...] = ()
        self._mask = np.zeros(0, np.uint8)  # 255 at these bytes, 0 at the others

    def read(self, data: bytes) -> Array | None:
        """Return positions (n,) [rad or m] in the order of the joint names; None where none of them is in the message.

        Raises MessageError: names missing or doubled, arrays of the wrong length, a value that is not finite.
        """
        # Is all but stamp and numbers as in the message learned from?
        known = len(data) == self._length and self._parts.unpack(data) == self._learned
        if not known and not self._learn(data):
            return None
        self._last[:] = data
        values: Array = self._values.copy() if self._order is None else self._values[self._order]
        if not math.hypot(*values.tolist()) < _ABSURD:  # or not a number
            index = int(np.argmax(np.fmax(np.abs(values), np.where(np.isnan(values), np.inf, 0.0))))
            raise MessageError(f"position of '{self._names[index]}' is {values[index]}: need finite values")
        return values

    def read_all(self, rows: NDArray[np.uint8]) -> Array | None:
        """Return what `read` does of each of the messages (k, length), as (k, n); None where one is not just like the
        last that was read, or in error.
        """
        if self._length < 0:  # none has been read
            with contextlib.suppress(MessageError):
                self._learn(rows[0].tobytes())
        if rows.shape[1] != self._length or ((rows ^ np.frombuffer(self._last, np.uint8)) & self._mask).any():
            return None
        count = self._values.size
        values: Array = rows[:, self._at : self._at + 8 * count].copy().view(_NUMBER)
        if self._order is not None:
            values = values.take(self._order, axis=1)
        return values if np.abs(values).max(initial=0.0) < _ABSURD / count else None

    def _learn(self, data: bytes) -> bool:
        self._length = -1
        content = decode(JOINT_STATE, data)
        names, count = content.name, len(content.name)
        if not set(self._names) & set(names):
            return False
        order = joint_order(self._names, names)
        for field in ("position", "velocity", "effort"):
            length = len(getattr(content, field))
            if length != count and (length or field == "position"):
                raise MessageError(f"{length} values in {field} for {count} names")
        if data[1] != 1:
            raise MessageError("big-endian JointState messages are not supported")
        end, at = _layout(data)
        in_order = tuple(names) == self._names
        self._order = None if in_order else np.array(order, dtype=np.intp)
        self._last, self._at = bytearray(data), at
        self._values = np.frombuffer(self._last, _NUMBER, count, at)
        behind = at + 8 * count  # the count of velocities, their numbers, the count of efforts
        efforts = behind + 4
        if len(content.velocity):
            efforts += (4 - efforts) % 8 + 8 * len(content.velocity)
        fixed = (0, 4), (12, end), (behind, behind + 4), (efforts, efforts + 4)
        self._parts = _parts(fixed, len(data))
        self._mask = np.zeros(len(data), np.uint8)
        for begin, stop in fixed:
            self._mask[begin:stop] = 255
        self._learned = self._parts.unpack(data)
        self._length = len(data)
        return True


class JointStateWriter:
    """Writes JointState messages with positions and velocities of fixed joints, or positions alone."""

    def __init__(self, joint_names: tuple[str, ...], velocities: bool = True) -> None:
        n = len(joint_names)
        speeds = np.zeros(n if velocities else 0)
        empty = message(JOINT_STATE, header(0, ""), list(joint_names), np.zeros(n), speeds, np.zeros(0))
        self._buffer = bytearray(encode(empty))
        self._position = _layout(bytes(self._buffer))[1]
        after = self._position + 8 * n + 4
        self._velocity = after + (4 - after) % 8
        self._size = 8 * n

    def write(self, stamp: int, position: Array, velocity: Array | None) -> bytes:
        """Return the message's bytes; `stamp` [ns], position (n,) [rad or m], velocity (n,) [rad/s or m/s], None where
        only positions are written.
        """
        buffer, size = self._buffer, self._size
        _STAMP.pack_into(buffer, 4, stamp // _SECOND, stamp % _SECOND)
        buffer[self._position : self._position + size] = position.tobytes()
        if velocity is not None:
            buffer[self._velocity : self._velocity + size] = velocity.tobytes()
        return bytes(buffer)

    def wrote(self, messages: Sequence[bytes], stamps: Sequence[int], positions: Array, velocities: Array) -> bool:
        """Tell whether messages (k) are what `write` returns for the stamps, positions (k, n) and velocities, to the
        bit.
        """
        size = len(self._buffer)
        if any(len(data) != size for data in messages):
            return False
        rows = np.frombuffer(b"".join(messages), np.uint8).reshape(-1, size)
        written = np.tile(np.frombuffer(self._buffer, np.uint8), (len(rows), 1))
        seconds, nanoseconds = np.divmod(np.array(stamps, dtype=np.int64), _SECOND)
        written[:, 4:8] = seconds.astype("<i4")[:, None].view(np.uint8)
        written[:, 8:12] = nanoseconds.astype("<u4")[:, None].view(np.uint8)
        for at, values in ((self._position, positions), (self._velocity, velocities)):
            written[:, at : at + self._size] = values.astype(_NUMBER, copy=False).view(np.uint8)
        return rows.tobytes() == written.tobytes()

    def positions(self, data: bytes) -> Array:
        """Return the positions (n,) in a message that `write` made."""
        return np.frombuffer(data, _NUMBER, self._size // 8, self._position)

    def velocities(self, data: bytes) -> Array:
        """Return the velocities (n,) in a message that `write` made."""
        return np.frombuffer(data, _NUMBER, self._size // 8, self._velocity)


# The record of one cycle is a std_msgs/Int64MultiArray, so that any reader of bags can open it.
CYCLE_FIELDS = ("index", "time_ns", "code", "late_ns", "work_ns", "published")
_CYCLE = struct.Struct("<4sIII4x6q")
_CYCLE_VALUES = struct.Struct("<20x6q")  # of the same length


def encode_cycle(index: int, time: int, code: int, late: int, work: int, published: int) -> bytes:
    """Return a cycle record: number, scheduled time [ns], status code, lateness [ns], work [ns], published or not."""
    return _CYCLE.pack(b"\0\1\0\0", 0, 0, 6, index, time, code, late, work, published)


def decode_cycle(data: bytes) -> tuple[int, int, int, int, int, int]:
    """Return the fields of a cycle record in the order of CYCLE_FIELDS. Raises MessageError if it is none."""
    try:
        values: tuple[int, int, int, int, int, int] = _CYCLE_VALUES.unpack(data)
    except struct.error:
        raise MessageError(f"not a cycle record: {len(data)} bytes, need {_CYCLE.size}") from None
    return values


def decode_cycles(rows: NDArray[np.uint8]) -> NDArray[np.int64] | None:
    """Return the fields (k, 6) of cycle records (k, length); None where they are none."""
    return rows[:, 20:].copy().view("<i8") if rows.shape[1] == _CYCLE.size else None
