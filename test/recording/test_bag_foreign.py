"""sqlite3 and ROS 1 bags, made by rosbags' writers and by a real robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_samples import JOINT_STATE, encode, joint_state
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from ik_controller.errors import BagError
from ik_controller.recording.reader import open_bag
from ik_controller.recording.recover import recover
from ik_controller.recording.schema import typestore

KUKA = Path(__file__).parents[3] / "shared" / "recordings" / "kuka-med7-bag"


def test_sqlite3_bag_reads_like_an_mcap(tmp_path: Path) -> None:
    data = [encode(joint_state(k, np.full(6, k / 7.0))) for k in range(20)]
    with Writer2(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/joint_states", JOINT_STATE, typestore=typestore())
        for k, item in enumerate(data):
            writer.write(connection, 100 + k, item)
    bag = open_bag(tmp_path / "bag")
    assert [(m.topic, m.log_time_ns, m.data) for m in bag.messages()] == [
        ("/joint_states", 100 + k, item) for k, item in enumerate(data)
    ]
    topic = bag.topic("/joint_states")
    assert (topic.type_name, topic.count) == (JOINT_STATE, 20)
    assert list(bag.messages(["/other"])) == []
    assert open_bag(tmp_path / "bag" / "bag.db3").topics == bag.topics
    with pytest.raises(BagError, match="not an MCAP"):
        recover(tmp_path / "bag" / "bag.db3")
    with pytest.raises(BagError, match="only MCAP can be recovered"):
        recover(tmp_path / "bag")


def test_ros_1_messages_arrive_as_ros_2_messages(tmp_path: Path) -> None:
    noetic = get_typestore(Stores.ROS1_NOETIC)
    header, time, state = (
        noetic.types[name] for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", JOINT_STATE)
    )
    with Writer1(tmp_path / "old.bag") as writer:
        connection = writer.add_connection("/joint_states", JOINT_STATE, typestore=noetic)
        for k in range(10):
            position = np.full(6, k / 7.0)
            names = [f"joint{i}" for i in range(6)]
            message = state(header(k, time(0, k), "base"), names, position, 2.0 * position, np.zeros(0))
            writer.write(connection, 100 + k, noetic.serialize_ros1(message, JOINT_STATE))
    bag = open_bag(tmp_path / "old.bag")
    assert [m.data for m in bag.messages()] == [encode(joint_state(k, np.full(6, k / 7.0))) for k in range(10)]
    assert bag.topic("/joint_states").count == 10


def test_a_real_robots_sqlite3_bag() -> None:
    if not KUKA.exists():
        pytest.skip("the shared recordings are not here")
    bag = open_bag(KUKA)
    states = list(bag.messages(["/joint_states"]))
    assert len(states) == bag.topic("/joint_states").count > 2000
    decoded = typestore().deserialize_cdr(states[0].data, JOINT_STATE)
    assert len(decoded.name) == len(decoded.position) == 7
