"""Cut-off and damaged files: every complete chunk comes back, of our bags and of others'."""

from __future__ import annotations

import argparse
import itertools
import json
import random
from io import BytesIO
from pathlib import Path

import pytest
from bag_samples import ARRAY, write_bag
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from ik_controller.errors import BagError
from ik_controller.recording.reader import open_bag
from ik_controller.recording.recover import recover
from ik_controller.recording.schema import message_schema
from ik_controller.recording.segment import ChunkBuilder, SegmentWriter
from ik_controller.recording.writer import BagWriter
from ik_controller.verbs import recover as verb

Written = list[tuple[str, int, bytes]]


def contents(path: Path) -> Written:
    return [(m.topic, m.log_time_ns, m.data) for m in open_bag(path).messages()]


def chunk_indexes(data: bytes) -> list[ChunkIndex]:
    summary = make_reader(BytesIO(data)).get_summary()
    assert summary is not None
    return sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)


def others_bag(path: Path, compression: CompressionType, chunked: bool, profile: str = "") -> Written:
    """A file of the official writer: channels inside chunks, or no chunks at all."""
    written = []
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2000, compression=compression, use_chunking=chunked)
        writer.start(profile, "someone else")
        schema = writer.register_schema("state", "jsonschema", b"{}")
        channels = {topic: writer.register_channel(topic, "json", schema) for topic in ("/a", "/b")}
        writer.add_attachment(1, 2, "calibration", "text/plain", b"1 2 3")
        writer.add_metadata("site", {"hall": "7"})
        for k in range(400):
            topic = "/a" if k % 3 else "/b"
            data = json.dumps({"k": k, "random": random.Random(k).random()}).encode()
            writer.add_message(channels[topic], k, data, publish_time=k + 7, sequence=k)
            written.append((topic, k, data))
        writer.finish()
    return written


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_truncated_anywhere_every_complete_chunk_comes_back(tmp_path: Path, compression: str) -> None:
    """The chunks and where they end are taken from the official reader's view of the whole file.

    207 cuts in all, 162 of them at random places.
    """
    _, written = write_bag(tmp_path / "bag", 120, flush_interval=0.002, compression=compression)
    whole = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    indexes = chunk_indexes(whole)
    assert len(indexes) >= 5
    ends = [index.chunk_start_offset + index.chunk_length for index in indexes]
    sizes = [0]
    for message_counts in chunk_message_counts(whole):
        sizes.append(sizes[-1] + message_counts)
    assert sizes[-1] == len(written)
    generator = random.Random(7)
    # anywhere, and at the edges of chunks, where it is easy to be off by one
    cuts = [generator.randrange(1, len(whole)) for _ in range(54)] + [
        generator.choice(ends) + generator.choice([-1, 0, 1]) for _ in range(15)
    ]
    for number, cut in enumerate(cuts):
        source = tmp_path / f"cut{number}.mcap"
        source.write_bytes(whole[:cut])
        complete = sum(end <= cut for end in ends)
        least = most = sizes[complete]
        if complete < len(indexes):  # of the chunk in which it is cut there is what can be decompressed
            chunk = indexes[complete].chunk_start_offset
            most = least + whole_messages(written[least:], cut - chunk - 49 if compression == "none" else 1 << 20)
            least = most if compression == "none" else least
        bag = open_bag(source)
        assert not bag.complete
        expected = contents(source)
        assert least <= len(expected) <= most
        assert expected == written[: len(expected)]
        result = recover(source)
        assert result.messages == len(expected)
        assert source.read_bytes() == whole[:cut]
        if expected:
            assert result.output == tmp_path / f"cut{number}_recovered.mcap"
            assert open_bag(result.output).complete
            assert contents(result.output) == expected
            with result.output.open("rb") as file:
                assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) == len(expected)
        else:
            assert (result.output, result.exit_code) == (None, 1)
            assert not list(tmp_path.glob(f"cut{number}_*"))
        # what is not lost and not read is the bytes of the cut-off record
        assert result.lost_bytes == bag.lost_bytes < cut


def whole_messages(messages: Written, room: int) -> int:
    """How many messages stand whole in `room` bytes of a chunk's records."""
    ends = itertools.accumulate(31 + len(data) for _, _, data in messages)
    return sum(end <= room for end in ends)


@pytest.mark.parametrize(("compression", "block"), [("zstd", 128 << 10), ("lz4", 64 << 10), ("none", 1)])
def test_of_a_chunk_that_is_cut_off_the_whole_blocks_come_back(tmp_path: Path, compression: str, block: int) -> None:
    """One chunk of 1 MB, as others' recorders write them, cut at nine tenths."""
    writer = SegmentWriter(tmp_path / "whole.mcap", compression=compression)
    writer.add_topic(1, "/noise", message_schema(ARRAY), "")
    chunk, generator = ChunkBuilder(), random.Random(9)
    messages = [generator.randbytes(1000) for _ in range(1000)]  # of a size that compression does not change
    for number, data in enumerate(messages):
        chunk.add(1, number, number, number, data)
    writer.add_chunk(chunk)
    writer.seal()
    source = tmp_path / "cut.mcap"
    source.write_bytes((tmp_path / "whole.mcap").read_bytes()[: 9 * chunk.size // 10])
    found = [data for _, _, data in contents(source)]
    result = recover(source)
    assert result.messages == len(found) >= (0.89 * chunk.size - block) // 1031
    assert found == messages[: len(found)]
    assert result.output is not None
    assert [data for _, _, data in contents(result.output)] == found
    assert result.exit_code == 3


def test_messages_of_an_unknown_channel_cost_only_themselves(tmp_path: Path) -> None:
    """As where the record of a channel was in a chunk that is damaged."""
    writer = SegmentWriter(tmp_path / "bag.mcap")
    writer.add_topic(1, "/known", message_schema(ARRAY), "")
    chunk = ChunkBuilder()
    for number in range(100):
        chunk.add(1 if number != 60 else 2, number, number, number, b"data")
    writer.add_chunk(chunk)
    writer.seal()
    found = open_bag(tmp_path / "bag.mcap").messages()
    assert [next(found).log_time_ns for _ in range(60)] == list(range(60))
    with pytest.raises(BagError, match=r"channel 2, which is unknown.*ik_controller recover"):
        next(found)
    result = recover(tmp_path / "bag.mcap")
    assert (result.messages, result.lost_bytes, result.exit_code) == (99, 35, 3)
    assert result.output is not None
    assert [m.log_time_ns for m in open_bag(result.output).messages()] == [*range(60), *range(61, 100)]


def chunk_message_counts(data: bytes) -> list[int]:
    """Messages of each chunk, from the sizes of its message indexes: 15 bytes of head, 16 a message."""
    return [(index.message_index_length - 15 * len(index.message_index_offsets)) // 16 for index in chunk_indexes(data)]


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_other_writers_files_come_back(tmp_path: Path, compression: CompressionType, chunked: bool) -> None:
    source = tmp_path / "other.mcap"
    written = others_bag(source, compression, chunked)
    assert contents(source) == written
    assert recover(source).output == source
    whole = source.read_bytes()
    generator = random.Random(8)
    for number, cut in enumerate(generator.randrange(len(whole) // 4, len(whole)) for _ in range(10)):
        part = tmp_path / f"cut{number}.mcap"
        part.write_bytes(whole[:cut])
        result = recover(part)
        assert result.output is not None
        found = contents(result.output)
        assert found == written[: len(found)] == contents(part)
        assert len(found) == result.messages >= len(written) * cut // len(whole) // 2
        assert open_bag(result.output).metadata("site") == {"hall": "7"}
        with result.output.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert reader.get_header().library == "someone else"
            assert [a.data for a in reader.iter_attachments()] == [b"1 2 3"]
            times = [(m.log_time, m.publish_time, m.sequence) for _, _, m in reader.iter_messages()]
            assert times == [(k, k + 7, k) for k in range(len(found))]


def test_a_damaged_chunk_costs_only_itself(tmp_path: Path) -> None:
    _, written = write_bag(tmp_path / "bag", 100, flush_interval=0.002)
    source = tmp_path / "bag" / "bag_0.mcap"
    data = bytearray(source.read_bytes())
    indexes, counts = chunk_indexes(bytes(data)), chunk_message_counts(bytes(data))
    broken = len(indexes) // 2
    data[indexes[broken].chunk_start_offset + indexes[broken].chunk_length - 20] ^= 0x40
    source.write_bytes(data)
    with pytest.raises(BagError, match=r"is damaged .* try `ik_controller recover`"):
        contents(source)
    result = recover(tmp_path / "bag")
    before = sum(counts[:broken])
    assert result.exit_code == 3
    assert result.lost_bytes == indexes[broken].chunk_length
    assert result.output == tmp_path / "bag_recovered"
    assert contents(result.output) == written[:before] + written[before + counts[broken] :]


def test_damage_in_the_summary_loses_no_message(tmp_path: Path) -> None:
    _, written = write_bag(tmp_path / "bag", 20)
    source = tmp_path / "bag" / "bag_0.mcap"
    data = bytearray(source.read_bytes())
    data[-30] ^= 0xFF  # a byte of the footer's offset of the summary
    source.write_bytes(data)
    result = recover(source)
    assert (result.messages, result.lost_bytes, result.exit_code) == (len(written), 0, 0)
    assert result.output is not None
    assert contents(result.output) == written


def test_zeros_at_the_end_are_not_read_as_records(tmp_path: Path) -> None:
    """A machine that lost power may leave the file longer than what was written."""
    _, written = write_bag(tmp_path / "bag", 50, flush_interval=0.002)
    source = tmp_path / "bag" / "bag_0.mcap"
    cut = chunk_indexes(source.read_bytes())[2].chunk_start_offset
    source.write_bytes(source.read_bytes()[:cut] + bytes(5000))
    result = recover(source)
    assert result.lost_bytes == 5000
    assert result.output is not None
    found = contents(result.output)
    assert found == written[: len(found)]
    assert found


def test_a_split_bag_without_its_end_becomes_a_folder_that_rosbags_reads(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    status, written = write_bag(folder, 200, flush_interval=0.002, max_segment_bytes=20_000)
    last = folder / f"bag_{status.segments - 1}.mcap"
    last.write_bytes(last.read_bytes()[:-100])
    (folder / "metadata.yaml").unlink()
    assert not open_bag(folder).complete
    result = recover(folder)
    assert result.output == tmp_path / "bag_recovered"
    assert contents(result.output) == written
    with AnyReader([result.output]) as reader:
        assert sum(1 for _ in reader.messages()) == result.messages == len(written)
    assert open_bag(result.output).metadata("ik_controller.test") == {"robot": "panda"}
    with pytest.raises(BagError, match="exists; a bag is never overwritten"):
        recover(folder)


def run_verb(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    return verb.run(parser.parse_args(arguments))


def test_verb_tells_by_exit_code_and_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, written = write_bag(tmp_path / "bag", 20, flush_interval=0.002)
    source = tmp_path / "bag" / "bag_0.mcap"

    def answer(*arguments: str) -> tuple[int, dict[str, object]]:
        code = run_verb(*arguments, "--json")
        return code, json.loads(capsys.readouterr().out)

    assert answer(str(tmp_path / "bag")) == (
        0,
        {"messages": len(written), "lost_bytes": 0, "output": str(tmp_path / "bag")},
    )
    cut = chunk_indexes(source.read_bytes())[-1].chunk_start_offset + 50
    (tmp_path / "cut.mcap").write_bytes(source.read_bytes()[:cut])
    code, content = answer(str(tmp_path / "cut.mcap"), "--output", str(tmp_path / "new" / "out.mcap"))
    assert (code, content["lost_bytes"]) == (3, 50)
    assert content["messages"] == len(contents(tmp_path / "new" / "out.mcap"))
    (tmp_path / "head.mcap").write_bytes(source.read_bytes()[:60])
    assert answer(str(tmp_path / "head.mcap"))[0] == 1
    assert run_verb(str(tmp_path / "bag")) == 0
    assert "is whole" in capsys.readouterr().out


def test_no_bag_is_an_error_and_an_empty_run_is_whole(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="cannot read bag"):
        recover(tmp_path / "nothing.mcap")
    (tmp_path / "text.mcap").write_text("hello")
    with pytest.raises(BagError, match="is not an MCAP file"):
        recover(tmp_path / "text.mcap")
    (tmp_path / "killed").mkdir()
    (tmp_path / "killed" / "killed_0.mcap").touch()  # a recorder that was killed while it opened its file
    for path in (tmp_path / "killed", tmp_path / "killed" / "killed_0.mcap"):
        assert recover(path).exit_code == 1
    assert [file.name for file in tmp_path.rglob("*_recovered*")] == []
    writer = BagWriter(tmp_path / "bag")
    writer.channel("/a", ARRAY)
    writer.close()
    result = recover(tmp_path / "bag")
    assert (result.messages, result.exit_code, result.output) == (0, 0, tmp_path / "bag")
