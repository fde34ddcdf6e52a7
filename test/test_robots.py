"""The bundled robots: kinematics against DH constants and another's URDF, limits against the makers' numbers."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ik_controller.robots import build_model, bundled_parameters, start_posture
from ik_controller.share import robot_folder, robot_names

ROOT = Path(__file__).parent.parent
PANDA_LOWER = [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]
PANDA_UPPER = [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]


def rotation_x(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])


def rotation_z(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def shift(x, y, z):
    result = np.eye(4)
    result[:3, 3] = x, y, z
    return result


def panda_by_dh(q):
    """Craig's modified DH, as Franka Emika publishes it: a, d, α in front of each joint; then flange, hand, tool."""
    right = math.pi / 2
    a = [0, 0, 0, 0.0825, -0.0825, 0, 0.088]
    d = [0.333, 0, 0.316, 0, 0.384, 0, 0]
    alpha = [0, -right, right, right, -right, right, right]
    pose = np.eye(4)
    for i in range(7):
        pose = pose @ rotation_x(alpha[i]) @ shift(a[i], 0, 0) @ rotation_z(q[i]) @ shift(0, 0, d[i])
    return pose @ shift(0, 0, 0.107) @ rotation_z(-math.pi / 4) @ shift(0, 0, 0.1034)


def ur5e_by_dh(q):
    """Classic DH, as Universal Robots publishes it; ROS's base_link is the DH base turned by half a turn."""
    right = math.pi / 2
    d = [0.1625, 0, 0, 0.1333, 0.0997, 0.0996]
    a = [0, -0.425, -0.3922, 0, 0, 0]
    alpha = [right, 0, 0, right, -right, 0]
    pose = rotation_z(math.pi)
    for i in range(6):
        pose = pose @ rotation_z(q[i]) @ shift(0, 0, d[i]) @ shift(a[i], 0, 0) @ rotation_x(alpha[i])
    return pose


def model(name):
    return build_model(bundled_parameters(name))


@pytest.mark.parametrize(("name", "by_dh"), [("panda", panda_by_dh), ("ur5e", ur5e_by_dh)])
def test_forward_kinematics_is_that_of_the_published_dh_constants(name, by_dh):
    robot = model(name)
    rng = np.random.default_rng(1)
    for q in rng.uniform(robot.lower, robot.upper, (200, robot.n)):
        np.testing.assert_allclose(robot.forward(q).homogeneous, by_dh(q), atol=1e-9)


def test_ur5e_has_the_makers_base_frame_too():
    q = np.array([0.1, -1.0, 1.2, -0.8, 0.5, 0.3])
    robot = build_model(bundled_parameters("ur5e").replace({"base_frame": "base"}))
    np.testing.assert_allclose(rotation_z(math.pi) @ robot.forward(q).homogeneous, ur5e_by_dh(q), atol=1e-9)


def test_panda_agrees_with_example_robot_data():
    robots = Path(pytest.importorskip("cmeel").__file__).parents[1] / "cmeel.prefix/share/example-robot-data/robots"
    urdf = robots / "panda_description" / "urdf" / "panda.urdf"
    if not urdf.is_file():
        pytest.skip("example-robot-data is not installed")
    theirs = pin.buildModelFromUrdf(str(urdf))
    data, robot = theirs.createData(), model("panda")
    flange = build_model(bundled_parameters("panda").replace({"tip_frame": "panda_hand"}))
    rng = np.random.default_rng(2)
    for q in rng.uniform(robot.lower, robot.upper, (50, 7)):
        full = pin.neutral(theirs)
        for name, value in zip(robot.joint_names, q, strict=True):
            full[theirs.joints[theirs.getJointId(name)].idx_q] = value
        pin.framesForwardKinematics(theirs, data, full)
        other = data.oMf[theirs.getFrameId("panda_hand")].homogeneous
        np.testing.assert_allclose(flange.forward(q).homogeneous, other, atol=1e-9)


def test_panda_names_and_limits_are_the_makers():
    robot = model("panda")
    assert robot.joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert robot.base_frame == "panda_link0"
    assert robot.tip_frame == "panda_hand_tcp"
    np.testing.assert_array_equal(robot.lower, PANDA_LOWER)
    np.testing.assert_array_equal(robot.upper, PANDA_UPPER)
    np.testing.assert_array_equal(robot.velocity_limit, [2.175] * 4 + [2.61] * 3)
    np.testing.assert_array_equal(robot.acceleration_limit, [15, 7.5, 10, 12.5, 15, 20, 20])
    assert not robot.assumptions


def test_ur5e_names_and_limits_are_the_makers():
    robot = model("ur5e")
    names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    assert robot.joint_names == tuple(f"{name}_joint" for name in names)
    assert (robot.base_frame, robot.tip_frame) == ("base_link", "tool0")
    reach = np.array([2, 2, 1, 2, 2, 2]) * math.pi
    np.testing.assert_array_equal(robot.lower, -reach)
    np.testing.assert_array_equal(robot.upper, reach)
    np.testing.assert_array_equal(robot.velocity_limit, [math.pi] * 6)
    assert not robot.assumptions


@pytest.mark.parametrize("name", robot_names())
def test_the_posture_is_a_good_place_to_start(name):
    robot = model(name)
    posture = np.array(bundled_parameters(name).posture)
    margin = np.minimum(posture - robot.lower, robot.upper - posture)
    assert (margin > 0.3).all(), "away from the limits"
    assert np.linalg.svd(robot.jacobian(posture), compute_uv=False)[-1] > 0.04, "away from singularities"
    assert robot.forward(posture).rotation[2, 2] < -0.999, "the tool looks down"


def test_an_arm_without_a_posture_starts_where_it_can_move():
    robot, panda = model("ur5e"), model("panda")
    assert np.linalg.svd(robot.jacobian(robot.middle()), compute_uv=False)[-1] < 1e-6, "stretched"
    start = start_posture(robot)
    assert np.linalg.svd(robot.jacobian(start), compute_uv=False)[-1] > 0.1
    assert ((robot.lower < start) & (start < robot.upper)).all()
    assert robot.forward(start).translation[2] > 0.1
    np.testing.assert_array_equal(start_posture(robot), start)
    np.testing.assert_array_equal(start_posture(panda), panda.middle())  # no bad place


@pytest.mark.parametrize("name", robot_names())
def test_links_have_looks_and_do_not_touch_in_the_posture(name):
    path = str(robot_folder(name) / "robot.urdf")
    kinematic, solids, looks = pin.buildModelsFromUrdf(path)
    assert looks.ngeoms >= 2 * (kinematic.njoints - 1)
    for i, one in enumerate(solids.geometryObjects):
        for j, other in enumerate(solids.geometryObjects[:i]):
            if abs(one.parentJoint - other.parentJoint) > 1:  # neighbours overlap where they are jointed
                solids.addCollisionPair(pin.CollisionPair(j, i))
    posture = np.array(bundled_parameters(name).posture)
    data = solids.createData()
    pin.computeDistances(kinematic, kinematic.createData(), solids, data, posture)
    assert min(result.min_distance for result in data.distanceResults) > 0.005


def test_urdf_files_are_what_the_generator_writes(tmp_path):
    # The script writes below its own folder's parent, so a copy of it leaves the repo alone.
    script = tmp_path / "scripts" / "make_robots.py"
    script.parent.mkdir()
    script.write_text((ROOT / "scripts" / "make_robots.py").read_text(encoding="utf-8"), encoding="utf-8")
    for name in robot_names():
        (tmp_path / "config" / name).mkdir(parents=True)
    subprocess.run([sys.executable, str(script)], check=True)
    for name in robot_names():
        written = (tmp_path / "config" / name / "robot.urdf").read_text(encoding="utf-8")
        assert written == (ROOT / "config" / name / "robot.urdf").read_text(encoding="utf-8")
