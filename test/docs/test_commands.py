"""Every command line of README.md, bags/README.md and docs/ is one that works: the offline ones are run, as written.

What needs ROS processes or colcon is run by test/ros, test/verbs and scripts/check_colcon.sh; here only its words are
checked, those of `ros2 launch` by test/ros/test_launch_files.py.
"""

from __future__ import annotations

import argparse
import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ik_controller.cli import ROS_VERBS, VERBS, split

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "bags" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PAGES.remove(ROOT / "docs" / "real_recordings.md")  # by test_real_recordings.py
RUNNING = ("sim", "stream", "demo", "view", "teleop")  # verbs that talk ROS; see test/verbs and test/ros
ELSEWHERE = ("pip", "colcon", "ros2")


def lines():
    """Yield every command line with its page, comments and continuations removed; also `ik_controller …` in text."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for block in re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
            for line in block.replace("\\\n", " ").splitlines():
                if command := line.split("  #")[0].split(" # ")[0].strip():
                    yield pytest.param(command, id=f"{page.name}: {command}")
        for command in re.findall(r"`(ik_controller [a-z]+ [^`]*)`", text):
            yield pytest.param(command, id=f"{page.name}: {command}")


@pytest.mark.parametrize("command", list(lines()))
def test_command(command, tmp_path):
    words = shlex.split(command)
    if words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
        return
    if words[0] in ELSEWHERE:
        return
    if words[0] == "python":
        assert (ROOT / words[1]).is_file()
        return
    assert words[0] == "ik_controller"
    assert words[1] in VERBS
    if words[1] in RUNNING:
        parser = argparse.ArgumentParser()
        module = importlib.import_module(f"ik_controller.verbs.{words[1]}")
        module.add_arguments(parser)
        own, ros = split(words[2:])
        parser.parse_args(own)  # its words are right
        assert not ros or words[1] in ROS_VERBS
        return
    shutil.copytree(ROOT / "bags", tmp_path / "bags")
    (tmp_path / "FILE").write_text("gain: 20.0\n", encoding="utf-8")
    (tmp_path / "my_arm.yaml").write_text("robot: panda\n", encoding="utf-8")
    (tmp_path / "fr2_desk_groundtruth.txt").write_text("0 1 2 3 0 0 0 1\n0.01 1 2 3 0 0 0 1\n", encoding="utf-8")
    (tmp_path / "log.csv").write_text("time,px,py,pz,rx,ry,rz\n0,1,2,3,0,0,90\n", encoding="utf-8")
    (tmp_path / "motion.txt").write_text("0 1 2 3 0 0 0 1\n0.01 1 2 3 0 0 0 1\n", encoding="utf-8")
    shutil.copytree(ROOT / "bags" / "ur5e_golden", tmp_path / "BAG")
    process = subprocess.run(
        [sys.executable, "-m", "ik_controller.cli", *words[1:]],
        cwd=tmp_path,
        env={**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"},  # what else runs on this machine is not ours
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert process.returncode == 0, process.stderr
    assert process.stdout
