"""The commands of docs/real_recordings.md, as written, where the recordings are; the long ones are soaks."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RECORDINGS = ROOT.parent / "shared" / "recordings"
ROBOTS = Path(sysconfig.get_path("purelib")) / "cmeel.prefix" / "share" / "example-robot-data"

FIRST, *BLOCKS = re.findall(
    r"^```sh\n(.*?)^```$", (ROOT / "docs" / "real_recordings.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
)


@pytest.mark.skipif(not RECORDINGS.exists() or not ROBOTS.exists(), reason="the recordings or the robots are not here")
@pytest.mark.parametrize(
    "block", [pytest.param(text, marks=[] if "kuka" in text else [pytest.mark.soak]) for text in BLOCKS]
)
def test_a_recording_goes_through_its_commands(block: str, tmp_path: Path) -> None:
    (tmp_path / "recordings").symlink_to(RECORDINGS)
    command = tmp_path / "bin" / "ik_controller"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m ik_controller.cli "$@"\n', encoding="utf-8")
    command.chmod(0o755)
    path = f"{command.parent}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}
    script = f"set -e\n{FIRST}{block}"
    done = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=1800, check=False
    )
    print(done.stdout)
    assert done.returncode == 0, done.stderr
    assert "bit-identical" in done.stdout
    assert list(tmp_path.glob("*.png"))


def test_there_is_a_block_for_each_recording() -> None:
    assert len(BLOCKS) == 5
