"""What people read fits the terminal: tables, errors, progress; plain where there is no terminal or NO_COLOR is set."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys

import pytest

from ik_controller.cli import VERBS, main
from ik_controller.share import bag_folder
from ik_controller.verbs import common

JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")


class Terminal(io.StringIO):
    """A text stream that says that it is a terminal."""

    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


def terminal(monkeypatch):
    """Put standard output and error on a terminal of 60 columns; return both. Not a fixture: pytest would take them."""
    streams = Terminal(), Terminal()
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    return streams


def longest(text: str) -> int:
    return max(map(len, text.splitlines()))


@pytest.mark.parametrize(
    "arguments",
    [
        ["solve", "--robot", "ur5e", "--pose", "0.4", "0.2", "0.4", "0", "1", "0", "0", "--all"],
        ["solve", "--robot", "panda", "--pose", "0.4", "0.2", "0.4", "1", "0", "0", "0", "--history"],
        ["report", str(bag_folder("ur5e_golden")), "-o", os.devnull],
        ["replay", str(bag_folder("ur5e_golden")), "--tolerance", "1e-9"],
        ["compare", str(bag_folder("ur5e_golden")), "--params", "gain.yaml"],
        ["doctor", "--robot", "ur5e"],
        ["import", "motion.txt", "-o", "imported"],
        ["recover", str(bag_folder("ur5e_golden")), "-o", "recovered"],
        ["--help"],
        *([name, "--help"] for name in VERBS),
    ],
    ids=lambda arguments: " ".join(arguments[:3:2]),
)
def test_output_in_a_pipe_is_plain_and_80_columns_wide(arguments, capsys, monkeypatch, tmp_path):
    monkeypatch.delenv("COLUMNS", raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")  # what else runs on this machine is not ours
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gain.yaml").write_text("gain: 20.0\n", encoding="utf-8")
    (tmp_path / "motion.txt").write_text("0 1 2 3 0 0 0 1\n0.01 1 2 3 0 0 0 1\n", encoding="utf-8")
    try:
        code = main(arguments)
    except SystemExit as left:
        code = left.code
    said = capsys.readouterr()
    assert (code, said.err) == (0, "")
    assert longest(said.out) <= 80
    assert "\x1b" not in said.out


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_speaks_json_and_says_a_mistake_in_one_line(name, capsys):
    parser = argparse.ArgumentParser()
    importlib.import_module(f"ik_controller.verbs.{name}").add_arguments(parser)
    assert "--json" in parser.format_help()
    with pytest.raises(SystemExit, match="2"):
        main([name, "--no-such-option"])
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1


def test_a_table_wraps_names_and_texts(capsys):
    rows = [("1", *(f"{k}.123456" for k in range(6))), ("2", *(f"-{k}.123456" for k in range(6)))]
    common.print_table(rows, ("solution", *JOINTS))
    lines = capsys.readouterr().out.splitlines()
    assert longest("\n".join(lines)) <= 80
    assert lines[-1].split() == list(rows[1])
    assert [line.split()[-1] for line in lines[:-3]][-1] == "joint"
    text = "the drive of a joint that has a very long name says no " * 4
    common.print_table([("error", text), ("ok", "all is well")])
    lines = capsys.readouterr().out.splitlines()
    assert longest("\n".join(lines)) <= 80
    assert " ".join(" ".join(lines[:-1]).split()) == f"error {text}".strip()


def test_on_a_terminal_it_is_as_wide_as_that_and_coloured(monkeypatch):
    out, err = terminal(monkeypatch)
    assert main(["replay", "/no/such/folder/with/a/name/that/is/rather/long/for/a/terminal"]) == 2
    assert longest(err.getvalue().replace("\x1b[31m", "").replace("\x1b[0m", "")) <= 60 + len("/no/such")
    assert err.getvalue().startswith("\x1b[31mik_controller replay:\x1b[0m")
    monkeypatch.setenv("NO_COLOR", "1")
    common.print_table([("error", "word " * 40)], styles=["bad"])
    assert "\x1b" not in out.getvalue()
    assert longest(out.getvalue()) <= 60


def test_progress_is_for_terminals_alone(monkeypatch):
    _, err = terminal(monkeypatch)
    bar = common.Progress(10.0, "streaming")
    bar.show(5.0)
    bar.end()
    shown = err.getvalue()
    assert "streaming" in shown
    assert "5.0 / 10.0 s" in shown
    assert all(len(part) <= 60 for part in shown.split("\r"))
    silent = io.StringIO()
    monkeypatch.setattr(sys, "stderr", silent)
    bar = common.Progress(10.0, "streaming")
    bar.show(5.0)
    bar.end()
    with common.waiting("replaying"):
        pass
    assert silent.getvalue() == ""
