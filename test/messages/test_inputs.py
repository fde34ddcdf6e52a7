"""From messages to targets: frames, and every bad input of issue 2 that concerns messages."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import wire
from hypothesis import given, settings
from hypothesis import strategies as st
from motions import bundled, difference

from ik_controller import ControllerParameters
from ik_controller.control.targets import Targets
from ik_controller.errors import MessageError
from ik_controller.messages.inputs import INPUTS, Inputs

NOW = 1_790_000_000 * 10**9
POSE = [0.3, 0.1, 0.5, 0.6, 0.0, 0.8, 0.0]
BASE = "panda_link0"


@pytest.fixture
def inputs(panda):
    return Taking(panda)


class Taking:
    """Inputs of the Panda with the targets behind them."""

    def __init__(self, robot):
        self.robot, self.targets = robot, Targets(ControllerParameters())
        self.inputs = Inputs(robot.model, self.targets, ControllerParameters())

    def take(self, role, data, q="home"):
        self.inputs.take(role, data, NOW, self.robot.home if isinstance(q, str) else q, np.zeros(7))

    def reference(self):
        return self.targets.reference(NOW, 1e-3)


def placement(reference):
    return pin.SE3(reference.rotation, reference.position)


def test_a_pose_in_the_base_frame_is_taken_as_it_is(inputs):
    inputs.take("target_pose", wire.pose(POSE, BASE))
    assert np.abs(difference(placement(inputs.reference()), pin.XYZQUATToSE3(np.array(POSE)))).max() < 1e-15


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("length", [1.0, 1.0009, 0.9991])
def test_a_quaternion_is_taken_with_either_sign_and_normalized(inputs, sign, length):
    inputs.take("target_pose", wire.pose([*POSE[:3], *(sign * length * np.array(POSE[3:]))], BASE))
    reference = inputs.reference()
    np.testing.assert_allclose(reference.rotation, pin.XYZQUATToSE3(np.array(POSE)).rotation, atol=1e-15)
    np.testing.assert_allclose(reference.rotation @ reference.rotation.T, np.eye(3), atol=1e-15)


def test_targets_in_a_moving_frame_go_by_the_commanded_joints(inputs, panda):
    """The pose of the hand in its own frame is where the hand is; a twist turns with it."""
    inputs.take("target_pose", wire.pose([0, 0, 0, 0, 0, 0, 1], panda.model.tip_frame))
    home = panda.model.forward(panda.home)
    assert np.abs(difference(placement(inputs.reference()), home)).max() < 1e-12
    inputs.targets.clear()
    inputs.take("target_twist", wire.twist([0.1, 0.2, 0.3, -0.4, 0.5, 0.6], panda.model.tip_frame))
    expected = np.append(home.rotation @ [0.1, 0.2, 0.3], home.rotation @ [-0.4, 0.5, 0.6])
    np.testing.assert_allclose(inputs.reference().twist, expected, atol=1e-12)


def test_a_moving_frame_needs_a_joint_state_first(inputs, panda):
    with pytest.raises(MessageError, match="moves with the arm, and no joint state has come"):
        inputs.take("target_pose", wire.pose(POSE, panda.model.tip_frame), None)
    inputs.take("target_pose", wire.pose(POSE, BASE), None)
    assert inputs.reference() is not None


def test_a_way_to_the_first_point_needs_a_joint_state_first(inputs):
    with pytest.raises(MessageError, match="no joint state has come yet"):
        inputs.take("target_joint_trajectory", wire.joint_trajectory([(1, [0] * 7, [])], SEVEN), None)


def test_a_trajectory_is_placed_in_its_frame_and_time(inputs):
    points = [(0.0, [POSE], []), (0.5, [[0.4, 0.1, 0.5, *POSE[3:]]], [[0.1, 0, 0, 0, 0, 0]])]
    inputs.take("target_trajectory", wire.trajectory(points, BASE, NOW + 10**9, ["panda_hand_tcp"]))
    at = inputs.targets.reference(NOW + 10**9 + 500_000_000, 1e-3)
    np.testing.assert_allclose(at.position, [0.4, 0.1, 0.5], atol=1e-12)
    inputs.take("target_trajectory", wire.trajectory(points, BASE, 0))  # zero stamp: from now on
    at = inputs.targets.reference(NOW + 500_000_000, 1e-3)
    np.testing.assert_allclose(at.position, [0.4, 0.1, 0.5], atol=1e-12)


def test_joint_targets_are_matched_by_name(inputs, panda):
    names = list(panda.model.joint_names)
    order = [3, 0, 6, 2, 5, 1, 4]
    shuffled = [names[i] for i in order]
    values, rates = np.linspace(-0.5, 0.5, 7), np.linspace(1, 2, 7)
    extra = wire.joints([*shuffled, "finger"], [*values[order], 9.0], [*rates[order], 9.0])
    inputs.take("target_joints", extra)
    np.testing.assert_array_equal(inputs.reference().joints, values)
    np.testing.assert_array_equal(inputs.reference().joint_velocity, rates)
    inputs.take("target_joints", wire.joints(shuffled, values[order]))
    np.testing.assert_array_equal(inputs.reference().joint_velocity, np.zeros(7))


ZERO, NAN = [0.0] * 6, float("nan")
SEVEN = [f"panda_joint{i}" for i in range(1, 8)]
BAD = {
    "NaN in a position": ("target_pose", wire.pose([NAN, *POSE[1:]], BASE), "must be finite"),
    "infinite position": ("target_pose", wire.pose([np.inf, *POSE[1:]], BASE), "must be finite"),
    "NaN in a quaternion": ("target_pose", wire.pose([*POSE[:6], NAN], BASE), "must be finite"),
    "zero quaternion": ("target_pose", wire.pose([*POSE[:3], 0, 0, 0, 0], BASE), "the quaternion is zero"),
    "quaternion off unit": ("target_pose", wire.pose([*POSE[:3], 0.6, 0, 0.802, 0], BASE), "need 1 within 0.001"),
    "huge quaternion": ("target_pose", wire.pose([*POSE[:3], 1e200, 0, 0, 0], BASE), "need 1 within 0.001"),
    "empty frame": ("target_pose", wire.pose(POSE, ""), "frame_id is empty; legal: panda"),
    "unknown frame": ("target_pose", wire.pose(POSE, "map"), "frame_id 'map' is unknown; legal: panda"),
    "NaN twist": ("target_twist", wire.twist([NAN, *ZERO[1:]], BASE), "must be finite"),
    "infinite twist": ("target_twist", wire.twist([*ZERO[1:], -np.inf], BASE), "must be finite"),
    "twist in an empty frame": ("target_twist", wire.twist(ZERO, ""), "frame_id is empty"),
    "no points": ("target_trajectory", wire.trajectory([], BASE), "the trajectory has no points"),
    "foreign names": ("target_trajectory", wire.trajectory([(0, [POSE], [])], BASE, 0, ["base"]), "need none, or"),
    "two transforms": ("target_trajectory", wire.trajectory([(0, [POSE] * 2, [])], BASE), "point 0 has 2 transforms"),
    "no transform": ("target_trajectory", wire.trajectory([(0, [], [])], BASE), "point 0 has 0 transforms"),
    "two velocities": (
        "target_trajectory", wire.trajectory([(0, [POSE], [ZERO] * 2)], BASE), "point 0 has 2 velocities"),
    "times that fall": (
        "target_trajectory", wire.trajectory([(1, [POSE], []), (1, [POSE], [])], BASE), "point 1: time_from_start"),
    "NaN in a later point": (
        "target_trajectory", wire.trajectory([(0, [POSE], []), (1, [POSE], [[NAN] * 6])], BASE), "must be finite"),
    "trajectory in an unknown frame": (
        "target_trajectory", wire.trajectory([(0, [POSE], [])], "odom"), "frame_id 'odom' is unknown"),
    "joints missing": ("target_joints", wire.joints(SEVEN[:6], [0] * 6), "joint(s) missing: panda_joint7"),
    "joints unknown": ("target_joints", wire.joints(["a", "b"], [0, 0]), "none of the joints panda_joint1"),
    "joints doubled": ("target_joints", wire.joints([*SEVEN, SEVEN[0]], [0] * 8), "named twice: panda_joint1"),
    "joint NaN": ("target_joints", wire.joints(SEVEN, [0, 0, NAN, 0, 0, 0, 0]), "position of 'panda_joint3' is nan"),
    "joint velocity NaN": ("target_joints", wire.joints(SEVEN, [0] * 7, [NAN] * 7), "velocity is not finite"),
    "wrong lengths": ("target_joints", wire.joints(SEVEN, [0] * 6), "6 values in position for 7 names"),
    "wrong velocities": ("target_joints", wire.joints(SEVEN, [0] * 7, [0] * 6), "6 values in velocity for 7 names"),
    "trajectory of the past": (
        "target_trajectory", wire.trajectory([(1, [POSE], [])], BASE, NOW - 3 * 10**9), "ended 2.0 s ago"),
    "path: no points": ("target_joint_trajectory", wire.joint_trajectory([], SEVEN), "the trajectory has no points"),
    "path: joint missing": (
        "target_joint_trajectory", wire.joint_trajectory([(1, [0] * 6, [])], SEVEN[:6]), "missing: panda_joint7"),
    "path: joint doubled": (
        "target_joint_trajectory", wire.joint_trajectory([(1, [0] * 8, [])], [*SEVEN, SEVEN[0]]), "named twice"),
    "path: positions missing": (
        "target_joint_trajectory", wire.joint_trajectory([(1, [], [0] * 7)], SEVEN), "point 0 has 0 positions, need 7"),
    "path: velocities missing": (
        "target_joint_trajectory", wire.joint_trajectory([(1, [0] * 7, [0])], SEVEN), "point 0 has 1 velocities"),
    "path: NaN": (
        "target_joint_trajectory", wire.joint_trajectory([(1, [0] * 7, []), (2, [NAN] * 7, [])], SEVEN),
        "point 1: positions must be finite"),
    "path: times that fall": (
        "target_joint_trajectory", wire.joint_trajectory([(1, [0] * 7, [])] * 2, SEVEN), "point 1: time_from_start"),
    "path of the past": (
        "target_joint_trajectory", wire.joint_trajectory([(1, [0] * 7, [])], SEVEN, NOW - 2 * 10**9), "ended 1.0 s"),
    "jog: unknown joint": ("target_joint_jog", wire.joint_jog(["lift"], [0.1]), "no joint(s) of the arm: lift"),
    "jog: no joint": ("target_joint_jog", wire.joint_jog([], []), "no joint(s) of the arm"),
    "jog: doubled": ("target_joint_jog", wire.joint_jog(SEVEN[:1] * 2, [0.1] * 2), "named twice: panda_joint1"),
    "jog: displacements": ("target_joint_jog", wire.joint_jog(SEVEN[:1], [], 0, [0.1]), "displacements"),
    "jog: wrong length": ("target_joint_jog", wire.joint_jog(SEVEN[:2], [0.1]), "1 values in velocities for 2 names"),
    "jog: NaN": ("target_joint_jog", wire.joint_jog(SEVEN[:1], [NAN]), "a velocity is not finite"),
    "another type": ("target_pose", wire.joints(SEVEN, [0] * 7), "not a geometry_msgs/msg/PoseStamped"),
    "cut off": ("target_twist", wire.twist(ZERO, BASE)[:-5], "not a geometry_msgs/msg/TwistStamped"),
    "nothing": ("target_trajectory", b"", "not a trajectory_msgs"),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize(("role", "data", "text"), BAD.values(), ids=BAD)
def test_bad_input_gets_one_clear_line_and_changes_nothing(inputs, role, data, text):
    inputs.take("target_pose", wire.pose(POSE, BASE))
    before = inputs.targets.state()
    with pytest.raises(MessageError) as caught:
        inputs.take(role, data)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)
    assert inputs.targets.state() == before


GOOD = {
    "target_pose": wire.pose(POSE, BASE, NOW),
    "target_twist": wire.twist([0.1, 0, 0, 0, 0.3, 0], BASE, NOW),
    "target_trajectory": wire.trajectory([(0, [POSE], []), (1, [POSE], [ZERO])], BASE, NOW),
    "target_joints": wire.joints(SEVEN, [0.1] * 7, [0.2] * 7, NOW),
    "target_joint_trajectory": wire.joint_trajectory([(0.5, [0.1] * 7, [])], SEVEN, NOW),
    "target_joint_jog": wire.joint_jog(SEVEN[:2], [0.1, 0.2], NOW),
}


@settings(max_examples=200)
@given(st.data())
def test_damaged_messages_raise_nothing_but_message_errors(data):
    taking = Taking(bundled("panda"))
    role = data.draw(st.sampled_from(sorted(GOOD)))
    taking.take(role, GOOD[role])
    damaged = bytearray(GOOD[role])
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    before = taking.targets.state()
    try:
        taking.take(role, bytes(damaged))
    except MessageError:
        assert taking.targets.state() == before
    reference = taking.reference()
    for name in ("position", "rotation", "twist", "joints", "joint_velocity"):
        value = getattr(reference, name, None)
        assert value is None or np.isfinite(value).all()


def test_every_role_has_a_type_and_a_way_in():
    assert set(GOOD) | {"joint_states", "obstacles"} == set(INPUTS)  # obstacles: control/test_obstacles
