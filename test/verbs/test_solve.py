"""The verb `solve`: what it prints, for people and programs, and its exit codes."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import ik_controller
from ik_controller.errors import IkControllerError
from ik_controller.robots import build_model, with_bundled
from ik_controller.verbs import solve

PANDA_Q = (0.4, -0.5, 0.3, -1.9, 0.2, 1.6, 0.5)
UR5E_Q = (0.3, -1.0, 1.2, -0.4, 0.8, 0.5)


def pose_text(robot, q):
    return [repr(float(x)) for x in pin.SE3ToXYZQUAT(build_model(with_bundled({"robot": robot})).forward(q))]


def run(capsys, *words):
    parser = argparse.ArgumentParser()
    solve.add_arguments(parser)
    code = solve.run(parser.parse_args(list(words)))
    return code, capsys.readouterr().out


def test_json_has_the_promised_keys_and_a_solution(capsys):
    code, out = run(capsys, "--robot", "panda", "--pose", *pose_text("panda", PANDA_Q), "--json", "--history")
    answer = json.loads(out)
    assert code == 0
    assert {
        "converged", "reason", "q", "solutions", "position_error_m", "orientation_error_rad", "iterations", "history",
    } <= set(answer)  # fmt: skip
    model = build_model(with_bundled({"robot": "panda"}))
    reached = model.forward(answer["q"])
    assert np.allclose(reached.homogeneous, model.forward(PANDA_Q).homogeneous, atol=3e-6)
    assert answer["history"][-1]["q"] == answer["q"]


def test_all_solutions_in_closed_form(capsys):
    words = ("--robot", "ur5e", "--pose", *pose_text("ur5e", UR5E_Q), "--method", "analytic", "--all")
    code, out = run(capsys, *words, "--json", "--no-limits")
    answer = json.loads(out)
    assert code == 0
    assert len(answer["solutions"]) in (4, 8)
    assert min(np.abs(np.array(q) - UR5E_Q).max() for q in answer["solutions"]) < 1e-9
    code, out = run(capsys, *words)
    assert code == 0
    assert "pan_joint" in out  # names are wrapped to fit


def test_unreachable_is_answered_with_no_and_the_closest(capsys):
    words = ("--robot", "panda", "--pose", "3", "0", "0", "0", "0", "0", "1")
    code, out = run(capsys, *words)
    assert code == 1
    assert "unreachable" in out
    assert "closest" in out
    code, out = run(capsys, *words, "--json")
    assert code == 1
    assert json.loads(out)["solutions"] == []


def test_negative_numbers_with_exponents_are_numbers(capsys):
    code, _ = run(
        capsys, "--robot", "panda", "--pose", "0.4", "-1e-3", "0.5", "1", "0", "-1e-17", "0", "--axes", "xyz",
        "--start", *map(str, PANDA_Q), "--method", "newton", "--step", "0.75",
    )  # fmt: skip
    assert code == 0


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--pose", "0", "0", "0", "0", "0", "0", "0"), "quaternion"),
        (("--pose", "0", "0", "0", "0", "0", "0", "1", "--start", "0", "0"), "q0"),
        (("--pose", "0", "0", "0", "0", "0", "0", "1", "--method", "guess"), "newton"),
        (("--pose", "0", "0", "0", "0", "0", "0", "1", "--robot", "marvin"), "panda"),
        (("--pose", "0", "0", "0", "0", "0", "0", "1", "--method", "analytic"), "closed form"),
    ],
)
def test_bad_input_names_what_is_wrong(capsys, words, named):
    with pytest.raises(IkControllerError, match=named):
        run(capsys, *words)


def test_the_verb_itself(tmp_path):
    """The command as a user runs it, in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(Path(ik_controller.__file__).parents[1])}

    def command(*pose):
        words = [sys.executable, "-m", "ik_controller.cli", "solve", "--robot", "panda", "--json", "--pose", *pose]
        return subprocess.run(words, capture_output=True, text=True, timeout=120, cwd=tmp_path, env=environment)

    good = command(*pose_text("panda", PANDA_Q))
    assert (good.returncode, good.stderr) == (0, "")
    assert json.loads(good.stdout)["converged"]
    bad = command(*7 * ["0"])
    assert (bad.returncode, bad.stdout, bad.stderr.count("\n")) == (2, "", 1)
