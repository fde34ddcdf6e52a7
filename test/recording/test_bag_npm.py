"""Bags as Foxglove reads them: @mcap/core and @foxglove/rosmsg2-serialization, in Node (`npm ci` in test/npm)."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_samples import write_bag
from rosbags.highlevel import AnyReader

from ik_controller.recording.reader import open_bag

NPM = Path(__file__).resolve().parents[1] / "npm"
GOLDEN = Path(__file__).resolve().parents[2] / "bags" / "panda_golden"

pytestmark = pytest.mark.skipif(
    shutil.which("node") is None or not (NPM / "node_modules" / "@mcap").is_dir(),
    reason="no Node, or no packages: npm ci in test/npm",
)


def read(file: Path) -> dict[str, Any]:
    done = subprocess.run(
        ["node", NPM / "read_bag.mjs", file], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    content: dict[str, Any] = json.loads(done.stdout)
    assert content["profile"] == "ros2"
    topics: dict[str, Any] = content["topics"]
    return topics


def plain(value: Any) -> Any:
    """A rosbags message as JSON values; 64-bit integers and what is not finite as text, as the script writes them."""
    if isinstance(value, np.ndarray):
        texts = value.dtype.kind in "iu" and value.dtype.itemsize == 8
        return [str(item) if texts else plain(item) for item in value.tolist()]
    if isinstance(value, list):
        return [plain(item) for item in value]
    if hasattr(value, "__msgtype__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__ if name[0].islower()}
    if isinstance(value, float) and not np.isfinite(value):
        return {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}[str(value)]
    return value


def assert_equal_to_rosbags(bag: Path) -> None:
    expected: dict[str, list[Any]] = {}
    with AnyReader([bag]) as reader:
        for connection, time, data in reader.messages():
            message = plain(reader.deserialize(data, connection.msgtype))
            expected.setdefault(connection.topic, []).append([str(time), message])
    found: dict[str, list[Any]] = {}
    for file in sorted(bag.glob("*.mcap")):
        for topic, messages in read(file).items():
            found.setdefault(topic, []).extend(messages)
    assert {topic: len(messages) for topic, messages in found.items()} == {
        topic: len(messages) for topic, messages in expected.items()
    }
    for topic, messages in expected.items():
        assert found[topic] == messages, topic


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_every_type_we_use_has_equal_counts_and_values(tmp_path: Path, compression: str) -> None:
    _, written = write_bag(tmp_path / "bag", 30, compression=compression, max_segment_bytes=30_000)
    assert_equal_to_rosbags(tmp_path / "bag")
    assert len(written) == sum(1 for _ in open_bag(tmp_path / "bag").messages())


def test_a_whole_run(tmp_path: Path) -> None:
    if not GOLDEN.exists():
        pytest.skip("no golden run")
    assert_equal_to_rosbags(GOLDEN)
