"""Messages and bags for the tests of recording, made with rosbags' own encoder."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ik_controller.recording.reader import open_bag
from ik_controller.recording.schema import message_schema, typestore
from ik_controller.recording.segment import ChunkBuilder, SegmentWriter
from ik_controller.recording.writer import BagWriter, WriterStatus

JOINT_STATE = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/TwistStamped"
DIAGNOSTIC = "diagnostic_msgs/msg/DiagnosticStatus"
MULTI_DOF = "trajectory_msgs/msg/MultiDOFJointTrajectory"
ARRAY = "std_msgs/msg/Float64MultiArray"


def make(type_name: str, *values: Any) -> Any:
    """A message object of that type."""
    return typestore().types[type_name](*values)


def header(stamp_ns: int) -> Any:
    stamp = make("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
    return make("std_msgs/msg/Header", stamp, "base")


def joint_state(stamp_ns: int, position: np.ndarray) -> Any:
    names = [f"joint{i}" for i in range(len(position))]
    return make(JOINT_STATE, header(stamp_ns), names, position, 2.0 * position, np.zeros(0))


def vector(x: float, y: float, z: float, kind: str = "Vector3") -> Any:
    return make(f"geometry_msgs/msg/{kind}", x, y, z)


def twist(x: float) -> Any:
    return make("geometry_msgs/msg/Twist", vector(x, 1.0, 2.0), vector(3.0, 4.0, 5.0))


def quaternion() -> Any:
    return make("geometry_msgs/msg/Quaternion", 0.0, 0.6, 0.0, 0.8)


def samples(number: int) -> dict[str, Any]:
    """One message of each type we use, different for each number."""
    now, x = 10**9 * number, float(number) / 3.0
    pose = make("geometry_msgs/msg/Pose", vector(x, 1.0, 2.0, "Point"), quaternion())
    transform = make("geometry_msgs/msg/Transform", vector(x, 1.0, 2.0), quaternion())
    duration = make("builtin_interfaces/msg/Duration", number, 5)
    point = make("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint", [transform], [twist(x)], [twist(-x)], duration)
    value = make("diagnostic_msgs/msg/KeyValue", "q̇ at limit", str(x))
    layout = make("std_msgs/msg/MultiArrayLayout", [make("std_msgs/msg/MultiArrayDimension", "a", 3, 3)], 0)
    return {
        JOINT_STATE: joint_state(now, np.linspace(x, 1.0, 7)),
        POSE: make(POSE, header(now), pose),
        TWIST: make(TWIST, header(now), twist(x)),
        DIAGNOSTIC: make(DIAGNOSTIC, 1, "ik_controller", "near a singularity", "arm", [value]),
        MULTI_DOF: make(MULTI_DOF, header(now), ["tool"], [point]),
        ARRAY: make(ARRAY, layout, np.array([x, -x, np.inf])),
    }


def encode(message: Any) -> bytes:
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


def write_bag(folder: Path, count: int, **options: Any) -> tuple[WriterStatus, list[tuple[str, int, bytes]]]:
    """Write `count` messages of each type in turn, 1 ms apart, in at least five chunks; return status and messages."""
    writer = BagWriter(folder, patient=True, **options)
    writer.metadata("ik_controller.test", {"robot": "panda"})
    written = []
    for number in range(count):
        for type_name, message in samples(number).items():
            channel = writer.channel("/" + type_name.split("/")[-1].lower(), type_name)
            written.append((channel.topic, 10**18 + number * 10**6, encode(message)))
            writer.write(channel, written[-1][1], written[-1][2])
        if number % max(count // 5, 1) == 0:
            wait_until(lambda: writer.status().messages == len(written))
    return writer.close(), written


def wait_until(condition: Callable[[], bool], seconds: float = 30.0) -> None:
    """Wait for a condition, or fail."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.002)


def evenly_chunked(source: Path, target: Path, count: int = 500) -> Path:
    """Copy a bag into one file with `count` messages a chunk: how a recorder cuts them depends on the disk's speed."""
    bag = open_bag(source)
    writer = SegmentWriter(target)
    ids = {}
    for number, topic in enumerate(bag.topics, start=1):
        ids[topic.name] = number
        writer.add_topic(number, topic.name, message_schema(topic.type_name), topic.qos)
    for name in bag.metadata_names():
        writer.add_metadata(name, bag.metadata(name))
    chunk = ChunkBuilder()
    for message in bag.messages():
        chunk.add(ids[message.topic], message.sequence, message.log_time_ns, message.log_time_ns, message.data)
        if chunk.count == count:
            writer.add_chunk(chunk)
            chunk.clear()
    writer.add_chunk(chunk)
    writer.seal()
    return target
