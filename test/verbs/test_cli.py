"""The command line: help, usage mistakes, exit codes, one line on stderr; replay, report, recover, sim, stream."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ik_controller.cli import VERBS, main
from ik_controller.messages import cdr
from ik_controller.recording.reader import open_bag
from ik_controller.recording.replay import replay
from ik_controller.recording.target_bag import TimedTarget, write_targets
from ik_controller.robots import build_model, bundled_parameters

ROOT = Path(__file__).resolve().parents[2]
START = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `targets`, `run`, and bags that are none: cut off, not MCAP, empty."""
    folder = tmp_path_factory.mktemp("bags")
    parameters = bundled_parameters("panda").replace({"rate": 200.0})
    model = build_model(parameters)
    pose = model.forward(np.array(parameters.posture))
    targets = []
    for index in range(1200):
        pose.translation[1] = 0.03 * (1.0 - np.cos(0.05 * index))
        time = index * 10_000_000
        targets.append(TimedTarget(time, "target_pose", cdr.pose_message(START + time, "panda_link0", pose)))
    write_targets(folder / "targets", targets, START)
    replay(open_bag(folder / "targets"), robot=parameters, output=folder / "run")
    data = (folder / "run" / "run_0.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(data[: len(data) * 8 // 10])
    (folder / "text.mcap").write_text("this is no bag")
    (folder / "empty").mkdir()
    (folder / "no.yaml").write_text("gains: 3.0\n")
    (folder / "slow.yaml").write_text("/**:\n  ros__parameters:\n    gain: 10.0\n")
    return folder


def run_main(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Return exit code, stdout, stderr; usage mistakes leave by SystemExit."""
    try:
        code = main(list(arguments))
    except SystemExit as left:
        code = left.code
    said = capsys.readouterr()
    return code, said.out, said.err


def one_line(text: str) -> str:
    (line,) = text.splitlines()
    assert line.startswith("ik_controller")
    return line


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_every_verb(capsys: pytest.CaptureFixture[str], verb: str) -> None:
    code, out, err = run_main(capsys, verb, "--help")
    assert (code, err) == (0, "")
    assert out.startswith(f"usage: ik_controller {verb}")


def test_as_a_process(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "ik_controller.cli", "replay", "no_such_bag"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "no_such_bag" in one_line(done.stderr)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["fly"], ["fly", "demo", "replay"]),
        ([], ["VERB"]),
        (["replay"], ["bag"]),
        (["replay", "BAG", "--tolerance", "small"], ["--tolerance"]),
        (["replay", "RUN", "--tolerance", "-1"], ["--tolerance"]),
        (["replay", "no_such_bag"], ["no_such_bag"]),
        (["replay", "text.mcap"], ["text.mcap", "MCAP"]),
        (["replay", "empty"], ["empty"]),
        (["replay", "RUN", "--params", "no_such.yaml"], ["no_such.yaml"]),
        (["replay", "RUN", "--params", "no.yaml"], ["'gains'", "gain"]),
        (["replay", "RUN", "--output", "targets"], ["targets", "overwritten"]),
        (["replay", "targets", "--robot", "pandabear"], ["pandabear", "ur5e"]),
        (["report", "no_such_bag"], ["no_such_bag"]),
        (["report", "targets", "--robot", "pandabear"], ["pandabear", "ur5e"]),
        (["report", "text.mcap"], ["text.mcap"]),
        (["report", "RUN", "-o", "no_such_folder/x.html"], ["--output", "no_such_folder"]),
        (["report", "RUN", "--csv", "no_such_folder/x.csv"], ["--csv", "no_such_folder"]),
        (["report", "RUN", "--csv", "empty"], ["--csv", "empty", "folder"]),
        (["report", "RUN", "--png", "no_such_folder/x.png"], ["no_such_folder"]),
        (["recover", "no_such_bag"], ["no_such_bag"]),
        (["recover", "text.mcap"], ["text.mcap"]),
        (["sim", "--robot", "pandabear"], ["pandabear", "ur5e"]),
        (["sim", "--rate", "0"], ["--rate", "2000"]),
        (["sim", "--lag", "-1"], ["--lag"]),
        (["sim", "--ros-args", "-r", "__ns:=/a b"], ["__ns:=/a b"]),
        (["replay", "RUN", "--ros-args", "-r", "__ns:=/a"], ["--ros-args", "sim"]),
        (["sim", "--start", "0", "0"], ["--start", "panda_joint7"]),
        (["sim", "--urdf", "x.urdf"], ["--tip"]),
        (["sim", "--urdf", "x.urdf", "--tip", "tool"], ["x.urdf"]),
        (["stream", "no_such_bag"], ["no_such_bag"]),
        (["stream", "targets", "--map", "target_pose=/nothing"], ["/nothing", "/ik_controller/target_pose"]),
        (["stream", "targets", "--duration", "-1"], ["--duration"]),
        (["stream", "targets", "--duration", "nan"], ["--duration"]),
        (["stream", "targets", "--node", "no name"], ["no name"]),
        (["stream", "targets", "--patience", "0.1"], ["/ik_controller", "running"]),
        (["demo", "--targets", "no_such_bag"], ["no_such_bag"]),
        (["demo", "--robot", "pandabear"], ["pandabear", "ur5e"]),
        (["demo", "--targets", "targets", "--duration", "0"], ["--duration"]),
        (["demo", "--targets", "targets", "--rate", "5"], ["rate", "100"]),
        (["demo", "--targets", "targets", "--output", "no.yaml"], ["no.yaml"]),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(
    bags: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    named: list[str],
) -> None:
    monkeypatch.chdir(bags)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    code, out, err = run_main(capsys, *("run" if a == "RUN" else a for a in arguments))
    assert (code, out) == (2, "")
    line = one_line(err)
    for name in named:
        assert name in line


def test_replay(bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, output = str(bags / "run"), str(tmp_path / "again")
    code, out, err = run_main(capsys, "replay", run, "--json", "--output", output)
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert (answer["identical"], answer["first_difference"], answer["max_difference"]) == (True, None, 0.0)
    assert set(answer) >= {"commands", "real_time_factor", "position_rms_m", "position_max_m", "orientation_rms_rad",
                           "orientation_max_rad"}  # fmt: skip
    code, out, _ = run_main(capsys, "replay", output)
    assert code == 0
    assert "bit-identical" in out
    code, out, _ = run_main(capsys, "replay", run, "--params", str(bags / "slow.yaml"))
    assert code == 0  # a what-if run is meant to differ
    assert "differs from cycle" in out
    code, out, _ = run_main(capsys, "replay", str(bags / "cut.mcap"))
    assert code == 0
    assert "cut off" in out
    assert "bit-identical" in out
    code, out, _ = run_main(capsys, "replay", str(bags / "targets"), "--json")
    assert code == 0
    assert json.loads(out)["identical"] is None


def test_replay_of_a_changed_bag_is_no(bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from ik_controller.recording.writer import BagWriter

    source = open_bag(bags / "run")
    writer = BagWriter(tmp_path / "changed", patient=True)
    writer.metadata("ik_controller.run", source.metadata("ik_controller.run"))
    channels = {topic.name: writer.channel(topic.name, topic.type_name) for topic in source.topics}
    number = 0
    for message in source.messages():
        data = message.data
        if message.topic == "/joint_commands":
            number += 1
            if number == 100:
                changed = bytearray(data)
                changed[-12] ^= 1  # the lowest bits of a velocity
                data = bytes(changed)
        writer.write(channels[message.topic], message.log_time_ns, data)
    writer.close()
    code, out, _ = run_main(capsys, "replay", str(tmp_path / "changed"), "--json")
    assert code == 1
    answer = json.loads(out)
    assert answer["identical"] is False
    assert answer["first_difference"] > 0
    code, _, _ = run_main(capsys, "replay", str(tmp_path / "changed"), "--tolerance", "1e-3")
    assert code == 0


def test_report(bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = {"report": tmp_path / "report.html", "picture": tmp_path / "report.png", "csv": tmp_path / "run.csv"}
    names = ["-o", files["report"], "--png", files["picture"], "--csv", files["csv"]]
    code, out, err = run_main(capsys, "report", str(bags / "run"), *map(str, names), "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert {name: answer[name] for name in files} == {name: str(file) for name, file in files.items()}
    assert answer["headline"].startswith("It tracked within")
    assert answer["identical"] is True
    assert files["picture"].read_bytes().startswith(b"\x89PNG")
    assert files["report"].read_text(encoding="utf-8").startswith("<!doctype html>")
    assert files["csv"].read_text(encoding="utf-8").startswith("time_s,tool_x_m,")


def test_report_of_targets_alone_and_without_pyarrow(
    bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, _ = run_main(capsys, "report", str(bags / "targets"))
    assert code == 0
    assert out.splitlines()[-1] == "report.html"
    assert "nothing to compare" in out
    assert Path("report.html").is_file()
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    code, out, err = run_main(capsys, "report", str(bags / "run"), "--parquet", "run.parquet")
    assert (code, out) == (2, "")
    assert "pip install" in one_line(err)


def test_recover(bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "whole.mcap"
    code, out, _ = run_main(capsys, "recover", str(bags / "cut.mcap"), "--output", str(output), "--json")
    answer = json.loads(out)
    assert code == (3 if answer["lost_bytes"] else 0)  # the cut may fall between two chunks
    assert answer["output"] == str(output)
    assert answer["messages"] > 0
    assert answer["lost_bytes"] >= 0
    assert replay(open_bag(output)).identical is True
