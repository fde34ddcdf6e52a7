"""The demo as its user runs it: three processes, JSON with every key, a bag, a picture, a bit-identical replay."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from ik_controller.recording.reader import open_bag

ROOT = Path(__file__).resolve().parents[2]
REPLAY_KEYS = {"commands", "identical", "first_difference", "max_difference", "real_time_factor", "position_rms_m",
               "position_max_m", "orientation_rms_rad", "orientation_max_rad"}  # fmt: skip
KEYS = (REPLAY_KEYS - {"commands", "identical", "first_difference", "max_difference", "real_time_factor"}) | {
    "bag", "picture", "report", "cycles", "period_p50_us", "period_p99_us", "missed", "replay"}  # fmt: skip


def test_demo_with_targets_of_ones_own(tmp_path: Path) -> None:
    sys.path.insert(0, str(ROOT / "test" / "ros"))
    from rig import Process, figure_bag, next_domain

    targets = figure_bag(tmp_path / "targets", 2.0, "ur5e")
    command = [sys.executable, "-m", "ik_controller.cli", "demo", "--robot", "ur5e", "--targets", str(targets)]
    command += ["--duration", "1.5", "--rate", "250", "--output", "runs", "--json"]
    demo = Process(command, tmp_path, "demo", next_domain())
    try:
        code = demo.popen.wait(180.0)
    finally:
        demo.kill()
    assert code == 0, demo.err
    answer = json.loads(demo.out)
    assert set(answer) >= KEYS
    assert set(answer["replay"]) >= REPLAY_KEYS
    assert answer["replay"]["identical"] is True
    assert answer["cycles"] > 250
    assert answer["position_rms_m"] is not None
    assert (tmp_path / answer["picture"]).read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / answer["report"]).read_text(encoding="utf-8").startswith("<!doctype html>")
    bag = open_bag(tmp_path / answer["bag"])
    assert bag.complete
    poses = bag.topic("/ik_controller/target_pose")
    assert poses.count is not None
    assert 100 <= poses.count <= 151
    left = subprocess.run(["ps", "-e", "-o", "pid=,pgid="], capture_output=True, text=True, check=True).stdout
    groups = {int(line.split()[1]) for line in left.splitlines()}
    assert demo.popen.pid not in groups, "the demo left processes behind"
    assert os.path.exists(tmp_path / "runs" / "demo.log")
