"""Bags as written: read back by us in file order, and by three other readers with equal counts and values."""

from __future__ import annotations

import itertools
import tempfile
import time
import tracemalloc
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_samples import ARRAY, JOINT_STATE, POSE, encode, evenly_chunked, joint_state, samples, wait_until, write_bag
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from ik_controller.errors import BagError
from ik_controller.recording.reader import open_bag
from ik_controller.recording.rosbag2 import Qos, new_bag_folder
from ik_controller.recording.schema import message_schema, typestore
from ik_controller.recording.writer import RECORDER_METADATA, BagWriter


def contents(path: Path) -> list[tuple[str, int, bytes]]:
    return [(m.topic, m.log_time_ns, m.data) for m in open_bag(path).messages()]


messages = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 2**64 - 1), st.binary(max_size=200)), min_size=0, max_size=60
)


@settings(deadline=None, max_examples=40)
@given(messages=messages, compression=st.sampled_from(["zstd", "lz4", "none"]), limit=st.sampled_from([None, 1, 4000]))
def test_reads_back_what_was_written_in_that_order(
    messages: list[tuple[int, int, bytes]], compression: str, limit: int | None
) -> None:
    """Any times, also equal or going back; any bytes; in one segment or many."""
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "bag"
        writer = BagWriter(folder, compression=compression, flush_interval=0.001, max_segment_bytes=limit)
        channels = [writer.channel(f"/topic{i}", JOINT_STATE) for i in range(4)]
        for index, log_time, data in messages:
            writer.write(channels[index], log_time, data)
        status = writer.close()
        assert (status.messages, status.lost, status.waiting, status.state) == (len(messages), 0, 0, "closed")
        expected = [(f"/topic{i}", log_time, data) for i, log_time, data in messages]
        assert contents(folder) == expected
        bag = open_bag(folder)
        assert bag.complete
        assert bag.lost_bytes == 0
        counts = Counter(topic for topic, _, _ in expected)
        assert {topic.name: topic.count for topic in bag.topics} == {
            f"/topic{i}": counts[f"/topic{i}"] for i in range(4)
        }
        some = ["/topic1", "/topic3"]
        assert [m.topic for m in bag.messages(some)] == [topic for topic, _, _ in expected if topic in some]
        for channel in channels:
            assert [m.sequence for m in bag.messages([channel.topic])] == list(range(1, counts[channel.topic] + 1))


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_rosbags_reads_equal_counts_and_values(tmp_path: Path, compression: str) -> None:
    _, written = write_bag(tmp_path / "bag", 50, compression=compression)
    # rosbags sorts by time; messages of equal time keep their order by offset
    with AnyReader([tmp_path / "bag"]) as reader:
        assert {name: info.msgcount for name, info in reader.topics.items()} == Counter(
            topic for topic, _, _ in written
        )
        read = [
            (c.topic, time, bytes(data), reader.deserialize(data, c.msgtype)) for c, time, data in reader.messages()
        ]
    assert sorted(item[:3] for item in read) == sorted(written)
    for topic, log_time, _, message in read:
        expected = samples((log_time - 10**18) // 10**6)[message.__msgtype__]
        assert encode(message) == encode(expected), topic


def test_mcap_ros2_reads_equal_counts_and_values(tmp_path: Path) -> None:
    _, written = write_bag(tmp_path / "bag", 30)
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        read = [(item.channel.topic, item.decoded_message) for item in reader.iter_decoded_messages()]
    assert Counter(topic for topic, _ in read) == Counter(topic for topic, _, _ in written)
    for number, message in enumerate(m for topic, m in read if topic == "/jointstate"):
        expected = samples(number)[JOINT_STATE]
        assert list(message.name) == expected.name
        assert list(message.position) == expected.position.tolist()
        assert list(message.effort) == []
        assert message.header.stamp.sec == expected.header.stamp.sec
    pose = next(m for topic, m in read if topic == "/posestamped")
    assert (pose.pose.orientation.y, pose.pose.orientation.w) == (0.6, 0.8)
    status = [m for topic, m in read if topic == "/diagnosticstatus"][-1]
    assert (status.values[0].key, status.values[0].value) == ("q̇ at limit", str(29.0 / 3.0))


def test_official_reader_finds_a_valid_indexed_file(tmp_path: Path) -> None:
    status, written = write_bag(tmp_path / "bag", 100, flush_interval=0.005)
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(written) == status.messages
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 1
        assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (
            min(t for _, t, _ in written),
            max(t for _, t, _ in written),
        )
        assert reader.get_header().profile == "ros2"
        assert sorted((c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()) == sorted(written)
        only = [m.data for _, _, m in reader.iter_messages(topics=["/posestamped"], log_time_order=False)]
        assert only == [data for topic, _, data in written if topic == "/posestamped"]
        for schema in summary.schemas.values():
            assert schema.encoding == "ros2msg"
            assert schema.data.decode() == message_schema(schema.name).text
        for channel in summary.channels.values():
            assert channel.message_encoding == "cdr"
            type_name = summary.schemas[channel.schema_id].name
            assert channel.metadata["topic_type_hash"] == message_schema(type_name).type_hash


def test_metadata_yaml_is_version_9_and_agrees_with_the_file(tmp_path: Path) -> None:
    qos = Qos(reliability="best_effort", durability="transient_local", depth=1)
    writer = BagWriter(tmp_path / "bag")
    channel = writer.channel('/odd "topic"', JOINT_STATE, qos)
    writer.channel("/silent", POSE)
    for k in range(3):
        writer.write(channel, 500 + 10 * k, encode(joint_state(k, np.zeros(2))))
    writer.close()
    outer = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    inner = yaml.safe_load(open_bag(tmp_path / "bag").metadata("rosbag2")["serialized_metadata"])
    for information in (outer, inner):
        assert information["version"] == 9
        assert information["storage_identifier"] == "mcap"
        assert information["relative_file_paths"] == ["bag_0.mcap"]
        assert information["starting_time"]["nanoseconds_since_epoch"] == 500
        assert information["duration"]["nanoseconds"] == 20
        assert information["message_count"] == 3
        topics = {t["topic_metadata"]["name"]: t for t in information["topics_with_message_count"]}
        assert {name: t["message_count"] for name, t in topics.items()} == {'/odd "topic"': 3, "/silent": 0}
        for topic in open_bag(tmp_path / "bag").topics:
            about = topics[topic.name]["topic_metadata"]
            assert about["offered_qos_profiles"] == yaml.safe_load(topic.qos)
            assert about["type_description_hash"] == topic.type_hash
            assert about["type"] == topic.type_name
    profile = topics['/odd "topic"']["topic_metadata"]["offered_qos_profiles"][0]
    assert (profile["reliability"], profile["durability"], profile["depth"]) == ("best_effort", "transient_local", 1)
    with Reader(tmp_path / "bag") as reader:
        assert len(list(reader.messages())) == 3


@pytest.mark.parametrize("options", [{"max_segment_bytes": 20_000}, {"max_segment_seconds": 0.05}])
def test_splitting_loses_nothing_and_every_segment_stands_alone(tmp_path: Path, options: dict[str, float]) -> None:
    status, written = write_bag(tmp_path / "bag", 300, flush_interval=0.002, **options)
    assert status.segments > 2
    assert contents(tmp_path / "bag") == written
    with AnyReader([tmp_path / "bag"]) as reader:
        assert sum(1 for _ in reader.messages()) == len(written)
    parts = [open_bag(tmp_path / "bag" / f"bag_{i}.mcap") for i in range(status.segments)]
    assert list(itertools.chain.from_iterable(contents(part.path) for part in parts)) == written
    for part in parts:
        assert part.complete
        assert part.metadata("ik_controller.test") == {"robot": "panda"}
        with Reader(part.path) as single:
            assert single.message_count == sum(topic.count or 0 for topic in part.topics)


def test_metadata_stands_where_it_was_written_and_the_last_counts(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag")
    writer.metadata("parameters", {"gain": "50"})
    writer.write(writer.channel("/a", ARRAY), 1, b"1")
    writer.metadata("parameters", {"gain": "60"})
    writer.close()
    bag = open_bag(tmp_path / "bag")
    assert bag.metadata("parameters") == {"gain": "60"}
    assert bag.metadata_names() == ["parameters", RECORDER_METADATA, "rosbag2"]
    assert bag.metadata(RECORDER_METADATA)["lost"] == "0"
    with pytest.raises(BagError, match=r"no metadata 'gains'; it has: parameters"):
        bag.metadata("gains")


def test_a_full_queue_loses_counts_and_shows_the_gap(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", queue_bytes=50_000, flush_interval=0.2)
    channel = writer.channel("/a", ARRAY)
    for k in range(1000):
        writer.write(channel, k, bytes(100))
    status = writer.close()
    assert status.lost > 0
    found = list(open_bag(tmp_path / "bag").messages())
    assert len(found) == status.messages == 1000 - status.lost
    assert [m.sequence for m in found] == [m.log_time_ns + 1 for m in found]
    assert open_bag(tmp_path / "bag").metadata(RECORDER_METADATA)["lost"] == str(status.lost)


def test_what_cannot_be_recorded_is_counted_and_the_rest_goes_on(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag")
    channel = writer.channel("/a", ARRAY)
    for log_time in (1, -5, 2**64, 2):
        writer.write(channel, log_time, b"data")
    status = writer.close()
    assert (status.messages, status.lost) == (2, 2)
    assert "a message cannot be recorded" in status.reason
    writer.write(channel, 3, b"late")
    assert writer.status().lost == 3
    assert [t for _, t, _ in contents(tmp_path / "bag")] == [1, 2]


def test_a_deleted_folder_is_noticed_and_recording_goes_on(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", flush_interval=0.005)
    channel = writer.channel("/a", ARRAY)
    for k in range(10):
        writer.write(channel, k, b"before")
    wait_until(lambda: writer.status().messages == 10)
    deadline = time.monotonic() + 20.0
    for file in (tmp_path / "bag").iterdir():
        file.unlink()
    (tmp_path / "bag").rmdir()
    total = 10
    while writer.status().segments < 1 or writer.status().lost < 10 or writer.status().messages < 1:
        writer.write(channel, total, b"after")
        total += 1
        time.sleep(0.002)
        assert time.monotonic() < deadline
    status = writer.close()
    found = contents(tmp_path / "bag")
    assert len(found) == status.messages == total - status.lost
    assert found[-1] == ("/a", total - 1, b"after")
    assert "gone" in status.reason


def test_bags_are_never_overwritten(tmp_path: Path) -> None:
    first, second = new_bag_folder(tmp_path, "run"), new_bag_folder(tmp_path, "run")
    assert first.name.startswith("run_2")
    assert first.name.endswith("_001")
    assert second.name.endswith("_002")
    BagWriter(first).close()
    with pytest.raises(BagError, match="is not empty; a bag is never overwritten"):
        BagWriter(first)
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="cannot record below"):
        new_bag_folder(tmp_path / "file")
    with pytest.raises(BagError, match="cannot write a bag into"):
        BagWriter(tmp_path / "file" / "bag")


def test_wrong_options_name_the_legal_ones(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="unknown compression 'gzip' of a bag; legal: zstd, lz4, none"):
        BagWriter(tmp_path / "bag", compression="gzip")
    with pytest.raises(BagError, match="unknown reliability 'sure' of a QoS; legal: reliable"):
        Qos(reliability="sure")
    writer = BagWriter(tmp_path / "bag")
    writer.channel("/a", ARRAY)
    with pytest.raises(BagError, match="topic '/a' is recorded as std_msgs/msg/Float64MultiArray"):
        writer.channel("/a", JOINT_STATE)
    writer.close()


def test_unreadable_bags_say_so_in_one_line(tmp_path: Path) -> None:
    def complaint(path: Path) -> str:
        with pytest.raises(BagError) as caught:
            open_bag(path)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    assert "there is no bag" in complaint(tmp_path / "nothing")
    (tmp_path / "folder").mkdir()
    assert "is empty: there is no .mcap or .db3 file in it" in complaint(tmp_path / "folder")
    (tmp_path / "empty.mcap").touch()
    assert "is empty" in complaint(tmp_path / "empty.mcap")
    (tmp_path / "text.mcap").write_text("time,x,y\n")
    assert "is not an MCAP file" in complaint(tmp_path / "text.mcap")
    (tmp_path / "folder" / "old_0.db3").write_bytes(b"SQLite format 3\0" + bytes(100))
    assert "cannot read bag" in complaint(tmp_path / "folder")
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n")
    assert "cannot read bag" in complaint(tmp_path / "old.bag")


def test_reading_needs_no_more_memory_for_a_longer_bag(tmp_path: Path) -> None:
    def peak(count: int) -> int:
        folder = tmp_path / f"bag{count}"
        writer = BagWriter(folder, patient=True, flush_interval=0.005)
        channel = writer.channel("/a", ARRAY)
        data = [np.random.default_rng(k).bytes(200) for k in range(100)]
        for k in range(count):
            writer.write(channel, k, data[k % 100])
        writer.close()
        even = evenly_chunked(folder, tmp_path / f"even{count}.mcap")
        tracemalloc.start()
        assert sum(1 for _ in open_bag(even).messages()) == count
        largest = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return largest

    # a pointer kept of each message would be 72 kB
    assert peak(12_000) < peak(3_000) + 40_000


def test_typestore_decodes_what_the_reader_yields(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 3)
    bag = open_bag(tmp_path / "bag")
    message = next(bag.messages(["/jointstate"]))
    decoded = typestore().deserialize_cdr(message.data, bag.topic("/jointstate").type_name)
    assert decoded.position.tolist() == samples(0)[JOINT_STATE].position.tolist()
    with pytest.raises(BagError, match="has no topic '/joints'; it has: /jointstate"):
        bag.topic("/joints")
