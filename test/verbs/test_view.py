"""`ik_controller view`: a recorded run on the page; mistakes are named."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from ik_controller.cli import main

ROOT = Path(__file__).parents[2]
BAGS = ROOT / "bags"


def test_a_recorded_run_is_served(tmp_path):
    pytest.importorskip("viser")
    command = [
        sys.executable,
        "-m",
        "ik_controller.cli",
        "view",
        "--bag",
        str(BAGS / "panda_golden"),
        "--port",
        "0",
        "--json",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        try:
            assert process.stdout is not None
            url = json.loads(process.stdout.readline())["url"]
            with urllib.request.urlopen(url, timeout=60.0) as answer:
                page = answer.read()
            assert b"<html" in page
            process.send_signal(signal.SIGINT)
            assert process.wait(60.0) == 0
        finally:
            process.kill()


def test_the_run_on_the_page_is_the_run_in_the_bag():
    pytest.importorskip("viser")
    from ik_controller.recording.reader import open_bag
    from ik_controller.recording.replay import replay
    from ik_controller.view.playback import Run

    run = Run(BAGS / "panda_golden")
    known = replay(open_bag(BAGS / "panda_golden")).as_mapping()
    assert np.linalg.norm(run.errors[:, :3], axis=1).max() == pytest.approx(known["position_max_m"])  # no peak is lost
    assert len(run.times) == len(run.joints) == len(run.sentences)
    assert (np.diff(run.times) > 0.0).all()


def test_without_its_extra_the_verb_says_what_to_install(monkeypatch, capsys):
    for name in [name for name in sys.modules if name.startswith("ik_controller.view.page")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", "--bag", "x"]) == 2
    assert "pip install 'ik_controller[view]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--bag", "nowhere"], "nowhere"),
        (["--port", "99999"], "--port 99999"),
        (["--sim", "--robot", "r2d2"], "bundled robots"),
        (["--sim", "--robot", "panda", "--tip", "x"], "there are: panda_link0"),
        (["--bag", str(BAGS / "panda_figure_eight")], "holds no run"),
    ],
)
def test_mistakes_are_one_line(arguments, named, capsys):
    pytest.importorskip("viser")
    assert main(["view", *arguments]) == 2
    error = capsys.readouterr().err
    assert named in error
    assert len(error.strip().splitlines()) == 1
