"""Text logs become bags: columns by name, number or order, units, rotations, unusable lines; real recordings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ik_controller import cli
from ik_controller.errors import BagError
from ik_controller.messages import cdr
from ik_controller.recording.fit import Fitting
from ik_controller.recording.importing import import_files
from ik_controller.recording.reader import open_bag
from ik_controller.recording.replay import replay
from ik_controller.recording.target_bag import TargetOptions
from ik_controller.robots import bundled_parameters

RECORDINGS = Path(__file__).parents[3] / "shared" / "recordings"


def poses_in(bag: Path) -> list[tuple[int, pin.SE3]]:
    reader = cdr.StampedReader(cdr.POSE, 7)
    read = [reader.read(m.data) for m in open_bag(bag).messages(["/target_pose"])]
    return [(stamp, pin.XYZQUATToSE3(numbers.copy())) for stamp, _, numbers in read]


def write(path: Path, text: str) -> Path:
    path.write_text(text, newline="")
    return path


def test_the_same_motion_however_it_is_written(tmp_path: Path) -> None:
    turn = pin.exp3(np.array([0.3, -0.2, 0.9]))
    pose = pin.SE3(turn, np.array([0.1, 0.2, 0.3]))
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(pose).tolist()
    rx, ry, rz = np.degrees(pin.log3(turn)).tolist()
    logs = {
        "tum": (f"# time x y z\n1.5 {x} {y} {z} {qx} {qy} {qz} {qw}\n", [], []),
        "named": (f"qw,qx,qy,qz,note,time,x,y,z\r\n{qw},{qx},{qy},{qz},-,1.5,{x},{y},{z}\r\n", [], []),
        "numbers": (
            f"0;{1e3 * x};{1e3 * y};{1e3 * z};{rx};{ry};{rz};1500\n",
            ["t=7", "x=1", "y=2", "z=3", "rx=4", "ry=5", "rz=6"],
            ["ms", "mm", "deg"],
        ),
        "order": (
            f"1500 9 {x} {y} {z} {-qw} {-qx} {-qy} {-qz}\n",
            ["t", "-", "x", "y", "z", "qw", "qx", "qy", "qz"],
            ["ms"],
        ),
        "own units": (
            f"t,px,py,pz,rx,ry,rz\n1.5,{x},{1e3 * y},{z},{rx},{ry},{rz}\n",
            ["t=t", "x=px", "y=py:mm", "z=pz", "rx=rx:deg", "ry=ry:deg", "rz=rz:deg"],
            [],
        ),
    }
    for name, (text, columns, units) in logs.items():
        file = write(tmp_path / f"{name}.txt", text)
        import_files([file], tmp_path / name, columns=columns, units=units)
        ((stamp, found),) = poses_in(tmp_path / name)
        assert stamp == 1_500_000_000, name
        np.testing.assert_allclose(found.homogeneous, pose.homogeneous, atol=1e-9, err_msg=name)


def test_joints_by_their_header(tmp_path: Path) -> None:
    text = "t,a_position,b.pos,a_velocity,b.velocity,b_effort\n0.1,1,2,3,4,5\n0.2,1.5,2.5,3,4,5\n"
    report = import_files([write(tmp_path / "log.csv", text)], tmp_path / "bag")
    assert report["joints"] == ["a", "b"]
    message = cdr.decode(cdr.JOINT_STATE, next(open_bag(tmp_path / "bag").messages()).data)
    assert (message.name, message.position.tolist(), message.velocity.tolist()) == (["a", "b"], [1, 2], [3, 4])


def test_lines_that_cannot_be_used_are_counted(tmp_path: Path) -> None:
    good = "{} 0 0 0 0 0 0 1\n"
    text = good.format(1) + "2 nan 0 0 0 0 0 1\n3 0 0\n4 0 0 0 0 0 0 0\nend of log\n\n" + good.format(5)
    report = import_files([write(tmp_path / "log.txt", text)], tmp_path / "bag")
    assert (report["messages"], report["skipped"], report["lines"]) == (2, 4, 6)
    assert "log.txt:5" in report["last_skipped"]


@pytest.mark.parametrize(
    ("text", "columns", "complaint"),
    [
        ("1 2 3\n", [], "3 columns without names"),
        ("t,x,y,z\n1,2,3,4\n", [], "without qx"),
        ("t,x\n1,2\n", ["t=t", "x=speed"], "no column 'speed'; there are: t, x"),
        ("t,x\n1,2\n", ["t=t", "x"], "names in order, or FIELD=COLUMN"),
        ("a,b\n1,2\n", ["a=a"], "which column is the time t"),
        ("t,a\n1,2\n", ["t=t", "a=a", "b.velocity=a"], "position and velocity"),
        ("t,a\n1,x\n", [], "no line could be used"),
        ("# nothing\n", [], "no lines of data"),
    ],
)
def test_mistakes_are_told_and_leave_no_bag(tmp_path: Path, text: str, columns: list[str], complaint: str) -> None:
    file = write(tmp_path / "log.txt", text)
    with pytest.raises(BagError, match=complaint):
        import_files([file], tmp_path / "bag", columns=columns)
    assert not (tmp_path / "bag").exists()


def test_verb(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path / "log.txt", "".join(f"{0.01 * k} {0.001 * k} 0 0 0 0 0 1\n" for k in range(100)))
    bag = str(tmp_path / "bag")
    arguments = ["import", str(file), "-o", bag, "--robot", "panda", "--to-start", "--twists", "--json"]
    assert cli.main(arguments) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["topics"] == ["/target_pose", "/target_twist"]
    assert cli.main(["replay", bag, "--robot", "panda", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["position_rms_m"] < 1e-3  # it starts at full speed
    assert cli.main(arguments) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert cli.main(["import", str(file), "-o", bag + "2", "--units", "inch"]) == 2
    assert "inch" in capsys.readouterr().err
    # somebody's bag may be fitted again
    assert cli.main(["import", bag, "-o", bag + "3", "--scale", "0.5"]) == 0
    assert poses_in(Path(bag + "3"))[-1][1].translation[0] < 0.6


@pytest.mark.skipif(not RECORDINGS.exists(), reason="the shared recordings are not here")
def test_a_real_arms_joints_are_its_tools_poses(tmp_path: Path) -> None:
    """The robot's own forward kinematics, of another calibration, is the independent path."""
    files = sorted((RECORDINGS / "ur3e-rtde").glob("L?L?.csv"))
    names = ("x", "y", "z", "rx", "ry", "rz")
    columns = ["t=timestamp", *[f"{name}=actual_TCP_pose_{k}" for k, name in enumerate(names)]]
    report = import_files(files, tmp_path / "poses", columns=columns)
    assert (report["lines"], report["skipped"]) == (225, 0)
    assert report["longest_gap_s"] == pytest.approx(0.04, abs=1e-6)
    table = np.genfromtxt(files[0], delimiter=",", names=True)
    found = poses_in(tmp_path / "poses")
    for k in (0, 20):
        row = table[k]
        np.testing.assert_allclose(found[k][1].translation, [row[f"actual_TCP_pose_{i}"] for i in range(3)])
        turned = pin.log3(found[k][1].rotation.T @ pin.exp3(np.array([row[f"actual_TCP_pose_{i}"] for i in (3, 4, 5)])))
        assert np.linalg.norm(turned) < 1e-9


@pytest.mark.skipif(not RECORDINGS.exists(), reason="the shared recordings are not here")
def test_a_hands_motion_runs_on_an_arm(tmp_path: Path) -> None:
    columns = [
        "t=0",
        "x=1",
        "y=2",
        "z=3",
        "vx=4",
        "vy=5",
        "vz=6",
        "qw=10",
        "qx=11",
        "qy=12",
        "qz=13",
        "wx=14",
        "wy=15",
        "wz=16",
    ]
    import_files([RECORDINGS / "unscrewing-300hz" / "02.txt"], tmp_path / "bag", columns=columns)
    targets = TargetOptions(fitting=Fitting(place="start"))
    ur5e = bundled_parameters("ur5e").replace({"rate": 250.0, "acceleration_limits": [40.0] * 6})
    ur5e = ur5e.replace({"posture": (*ur5e.posture[:5], 3.1)})  # the hand turns by 6.6 rad
    result = replay(open_bag(tmp_path / "bag"), robot=ur5e, targets=targets)
    assert result.rejected == 0
    assert result.errors.as_mapping()["position_rms_m"] < 5e-3
