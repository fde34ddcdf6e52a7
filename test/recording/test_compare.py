"""Compare: figures against theory and an independent calculation, differences where they were made, bounds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ik_controller import cli
from ik_controller.errors import BagError
from ik_controller.messages import cdr
from ik_controller.recording.compare import Run, compare, measure, violations
from ik_controller.recording.reader import open_bag
from ik_controller.recording.replay import replay
from ik_controller.recording.run import RunInfo
from ik_controller.recording.target_bag import TimedTarget, write_targets
from ik_controller.robots import build_model, bundled_parameters

PANDA = bundled_parameters("panda").replace({"rate": 200.0})
MODEL = build_model(PANDA)
START = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """1.5 s of poses that swing by 5 cm, on the ideal arm."""
    folder = tmp_path_factory.mktemp("compare")
    home = MODEL.forward(np.array(PANDA.posture))
    targets = []
    for index in range(150):
        pose = home.copy()
        pose.translation = home.translation + np.array([0.0, 0.05 * np.sin(0.04 * index) ** 2, 0.0])
        data = cdr.pose_message(START + index * 10_000_000, "panda_link0", pose)
        targets.append(TimedTarget(index * 10_000_000, "target_pose", data))
    write_targets(folder / "targets", targets, START)
    replay(open_bag(folder / "targets"), robot=PANDA, output=folder / "run")
    return folder / "run"


def test_a_run_equals_itself(run: Path) -> None:
    result = compare(Run(open_bag(run)), Run(open_bag(run), replayed=True))
    assert result.identical
    assert result.a == result.b
    assert result.compared == result.a["cycles"] > 300


def test_figures_are_those_of_the_commands(run: Path) -> None:
    """Worked out from the bag by NumPy, without the code under test."""
    bag = open_bag(run)
    messages = [cdr.decode(cdr.JOINT_STATE, m.data) for m in bag.messages(["/joint_commands"])]
    q, v = (np.array([getattr(m, name) for m in messages]) for name in ("position", "velocity"))
    acceleration = np.diff(v, axis=0) * 200.0
    jerk = np.diff(acceleration, axis=0) * 200.0
    found = measure(bag)
    assert found["acceleration_rms"] == pytest.approx(np.sqrt((acceleration**2).mean()))
    assert found["acceleration_max"] == pytest.approx(np.abs(acceleration).max())
    assert found["jerk_rms"] == pytest.approx(np.sqrt((jerk**2).mean()))
    assert found["jerk_max"] == pytest.approx(np.abs(jerk).max())
    assert found["velocity_share_max"] == pytest.approx((np.abs(v) / MODEL.velocity_limit).max())
    margins = np.minimum(q - MODEL.lower, MODEL.upper - q)
    assert found["limit_margin_min"] == pytest.approx(margins.min())
    assert found["limit_margin_joint"] == MODEL.joint_names[margins.min(axis=0).argmin()]
    measures = [np.prod(np.linalg.svd(MODEL.jacobian(row), compute_uv=False)) for row in q]
    assert found["manipulability_min"] == pytest.approx(min(measures))
    assert found["manipulability_mean"] == pytest.approx(np.mean(measures))
    tools = np.array([MODEL.forward(row).translation for row in q])
    assert found["tool_path_m"] == pytest.approx(np.linalg.norm(np.diff(tools, axis=0), axis=1).sum())
    assert sum(found[f"{name}_s"] for name in ("waiting", "holding", "tracking", "stopping")) == pytest.approx(
        found["duration_s"]
    )


def test_other_parameters_part_the_runs_and_bounds_tell(run: Path, tmp_path: Path) -> None:
    slow = compare(Run(open_bag(run)), Run(open_bag(run), {"gain": 10.0}))
    assert not slow.identical
    assert slow.b["position_rms_m"] > 3.0 * slow.a["position_rms_m"]
    joint, position = slow.signals["panda_joint1.position"], slow.signals["position"]
    assert 0 <= position.first_cycle <= joint.first_cycle
    assert 0.0 < joint.largest <= position.largest
    tool = slow.signals["tool_position_m"]
    assert 1e-3 < tool.largest < 5e-2
    lines = slow.violations({"position_rms_m": 1e-6, "tool_position_m": 1.0}, {"limit_margin_min": 9.0})
    assert len(lines) == 2
    with pytest.raises(BagError, match=r"unknown figure 'speed'; there are: .*position_rms_m"):
        slow.violations({"speed": 1.0}, {})


def test_a_difference_is_found_in_its_cycle(run: Path, tmp_path: Path) -> None:
    from test_replay import altered

    def change(number, message):
        if message.topic == "/joint_commands" and number == 123:
            data = bytearray(message.data)
            data[-12 - 8 * 7 - 6] ^= 1  # in the last position
            return bytes(data)
        return message.data

    other = altered(run, tmp_path / "changed", change)
    result = compare(Run(open_bag(run)), Run(open_bag(other)))
    differing = {name: d.first_cycle for name, d in result.signals.items() if d.first_cycle is not None}
    # of the tool only where the last joint's bit is seen in its pose
    assert set(differing) - {"tool_position_m", "tool_orientation_rad"} == {"position", "panda_joint7.position"}
    commands = [m.data for m in open_bag(run).messages(["/joint_commands"])]
    assert differing["position"] == len(commands) - (len(commands) - 123)


def test_nan_and_missing_figures_break_their_bounds() -> None:
    values = {"a": float("nan"), "b": None, "c": 1.0}
    assert len(violations(values, {"a": 1.0, "b": 1.0, "c": 1.0}, {"a": 1.0, "c": 1.0})) == 3


def test_different_arms_cannot_be_compared(run: Path, tmp_path: Path) -> None:
    ur5e = Path(__file__).resolve().parents[2] / "bags" / "ur5e_golden"
    if RunInfo.of(open_bag(ur5e)) is None:
        pytest.skip("no golden run")
    with pytest.raises(BagError, match="different arms: panda_joint1"):
        compare(Run(open_bag(run)), Run(open_bag(ur5e)))


def test_verb(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "slow.yaml").write_text("gain: 10.0\n")
    slow = [str(run), "--params", str(tmp_path / "slow.yaml")]
    assert cli.main(["compare", str(run), str(run)]) == 0
    assert "identical in all of" in capsys.readouterr().out
    assert cli.main(["compare", *slow, "--max", "position_rms_m=1.0", "--min", "manipulability_min=0"]) == 0
    table = capsys.readouterr().out
    assert "panda_joint7.velocity" in table
    assert cli.main(["compare", *slow, "--max", "position_rms_m=1e-6", "--json"]) == 1
    content = json.loads(capsys.readouterr().out)
    assert content["broken"][0].startswith("position_rms_m is ")
    assert content["b"]["position_rms_m"] > content["a"]["position_rms_m"]
    assert content["signals"]["status"]["first_cycle"] is None or content["signals"]["status"]["largest"] == 1.0
    assert cli.main(["compare", *slow, "--max", "nonsense"]) == 2
    assert "NAME=VALUE" in capsys.readouterr().err
