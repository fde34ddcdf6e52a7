"""RobotModel and Urdf: frames, locked, continuous, prismatic and mimic joints, limits, and every error's text."""

from __future__ import annotations

import math
import sys
import threading
import xml.etree.ElementTree as ElementTree

import arms
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ik_controller.errors import ModelError
from ik_controller.kinematics.model import DEFAULT_RAMP_TIME, DEFAULT_VELOCITY, RobotModel, pose_from
from ik_controller.kinematics.urdf import Urdf

SKEWED = arms.skewed_7()
POINT = [0.1, -0.2, 0.3, 0.0, 0.6, 0.0, 0.8]


def joint(name, kind, parent, child, inside="", xyz="0 0 0.1", axis="0 0 1"):
    axis_text = "" if kind in ("fixed", "floating") else f'<axis xyz="{axis}"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/>{axis_text}{inside}</joint>'
    )


def robot(links: str, *joints: str) -> str:
    return '<robot name="r">' + "".join(f'<link name="{name}"/>' for name in links) + "".join(joints) + "</robot>"


LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="1"/>'
TWO = robot("abc", joint("j1", "revolute", "a", "b", LIMIT), joint("j2", "revolute", "b", "c", LIMIT, "1 0 0"))


def chain_pose(text: str, tip: str, base: str, values: dict[str, float]):
    """Forward kinematics by walking the XML: an independent path."""
    above = {j.find("child").get("link"): j for j in ElementTree.fromstring(text).findall("joint")}

    def numbers(element, tag, key, default):
        found = element.find(tag)
        return np.array([float(part) for part in (default if found is None else found.get(key, default)).split()])

    pose, link = np.eye(4), tip
    while link != base:
        element = above[link]
        r, p, y = numbers(element, "origin", "rpy", "0 0 0")
        step = np.eye(4)
        step[:3, :3] = pin.exp3(np.array([0, 0, y])) @ pin.exp3(np.array([0, p, 0])) @ pin.exp3(np.array([r, 0, 0]))
        step[:3, 3] = numbers(element, "origin", "xyz", "0 0 0")
        axis = numbers(element, "axis", "xyz", "1 0 0")
        value, motion = values.get(element.get("name"), 0.0), np.eye(4)
        axis = axis / np.linalg.norm(axis)
        if element.get("type") == "prismatic":
            motion[:3, 3] = value * axis
        else:
            motion[:3, :3] = pin.exp3(value * axis)
        pose, link = step @ motion @ pose, element.find("parent").get("link")
    return pose


@given(st.lists(st.floats(-3.0, 3.0), min_size=7, max_size=7), st.integers(0, 6), st.integers(0, 7))
def test_any_part_of_a_chain_from_any_base_to_any_tip(q, first, last):
    """Base mid-chain, tip mid-chain, the rest locked at any value: the poses are those of a walk through the URDF."""
    names = ["base", *(f"link{i}" for i in range(1, 8)), "tool"]
    base, tip = names[first], names[first + 1 :][min(last, 7 - first)]
    values = {f"joint{i + 1}": value for i, value in enumerate(q)}
    inside = [f"joint{i}" for i in range(first + 1, min(names.index(tip), 7) + 1)]
    outside = {name: value for name, value in values.items() if name not in inside}
    if not inside:  # from link7 to the tool: nothing moves
        return
    model = RobotModel.from_urdf(SKEWED, tip, base, locked_joints=outside)
    assert model.joint_names == tuple(inside)
    here = [values[name] for name in inside]
    np.testing.assert_allclose(model.forward(here).homogeneous, chain_pose(SKEWED, tip, base, values), atol=1e-12)
    assert model.jacobian(here).shape == (6, len(inside))


def test_locked_joints_between_nothing_of_the_chain_matter_only_beside_it():
    """A branch: the other arm's joints are locked and change nothing; those below the base neither."""
    text = robot(
        "abcde",
        joint("waist", "revolute", "a", "b", LIMIT),
        joint("left", "revolute", "b", "c", LIMIT, "0 1 0"),
        joint("right", "prismatic", "b", "d", LIMIT, "0 -1 0", "0 1 0"),
        joint("float", "floating", "b", "e"),
    )
    for locked in ({}, {"right": 0.7}):
        model = RobotModel.from_urdf(text, "c", "b", locked_joints={**locked, "waist": 0.3})
        assert model.joint_names == ("left",)
        np.testing.assert_allclose(model.forward([0.4]).translation, [0, 1, 0], atol=1e-15)
    both = RobotModel.from_urdf(text, "d", locked_joints={"left": 1.0})
    assert both.joint_names == ("waist", "right")
    np.testing.assert_array_equal(both.prismatic, [False, True])
    np.testing.assert_allclose(both.forward([math.pi / 2, 0.5]).translation, [0.5, 0.0, 0.1], atol=1e-12)


def test_a_continuous_joint_counts_turns_as_one_number():
    text = robot("abc", joint("j1", "continuous", "a", "b"), joint("j2", "revolute", "b", "c", LIMIT, "1 0 0"))
    model = RobotModel.from_urdf(text, "c")
    assert (model.lower[0], model.upper[0]) == (-math.inf, math.inf)
    assert model.velocity_limit[0] == DEFAULT_VELOCITY["continuous"]
    assert model.assumptions == ["joint 'j1' has no velocity limit in the URDF: 1.0 rad/s is assumed"]
    turned = model.forward([0.3 + 20 * math.pi, 0.1])
    np.testing.assert_allclose(turned.homogeneous, model.forward([0.3, 0.1]).homogeneous, atol=1e-12)
    np.testing.assert_array_equal(model.middle(), [0.0, 0.5])


def test_a_prismatic_joint_moves_along_its_axis_whatever_the_axis_length():
    text = robot("ab", joint("j1", "prismatic", "a", "b", LIMIT, "0 0 0", "0 3 4"))
    model = RobotModel.from_urdf(text, "b")
    np.testing.assert_allclose(model.forward([0.5]).translation, [0, 0.3, 0.4], atol=1e-15)
    np.testing.assert_allclose(model.jacobian([0.5])[:, 0], [0, 0.6, 0.8, 0, 0, 0], atol=1e-15)


MIMIC = robot(
    "abcd",
    joint("j1", "revolute", "a", "b", LIMIT),
    joint("j2", "revolute", "b", "c", LIMIT + '<mimic joint="j1" multiplier="-2" offset="0.5"/>', "1 0 0"),
    joint("j3", "prismatic", "c", "d", LIMIT + '<mimic joint="j2" multiplier="0.5"/>', "1 0 0", "1 0 0"),
)


def test_mimic_joints_follow_their_leader_and_chains_of_them():
    model = RobotModel.from_urdf(MIMIC, "d")
    assert model.joint_names == ("j1",)
    q = 0.2
    values = {"j1": q, "j2": 0.5 - 2 * q, "j3": 0.5 * (0.5 - 2 * q)}
    np.testing.assert_allclose(model.forward([q]).homogeneous, chain_pose(MIMIC, "d", "a", values), atol=1e-12)
    h = 1e-6
    ahead, behind = (model.forward([q + s]).translation for s in (h, -h))
    np.testing.assert_allclose(model.jacobian([q])[:3, 0], (ahead - behind) / (2 * h), atol=1e-8)
    assert model.jacobian([q])[5, 0] == pytest.approx(1.0 - 2.0)


def test_limits_of_mimic_joints_bind_their_leader():
    """j2 = 0.5 − 2 j1 in [−1, 2] leaves j1 in [−0.75, 0.75]; its 3 rad/s leave j1 half of them."""
    model = RobotModel.from_urdf(MIMIC, "d")
    np.testing.assert_allclose(model.lower, [-0.75])
    np.testing.assert_allclose(model.upper, [0.75])
    np.testing.assert_allclose(model.velocity_limit, [1.5])
    np.testing.assert_allclose(model.acceleration_limit, [1.5 / DEFAULT_RAMP_TIME])


def test_a_mimic_joint_whose_leader_is_locked_is_locked_at_its_value():
    text = robot(
        "abcde",
        joint("j1", "revolute", "a", "b", LIMIT),
        joint("side", "revolute", "a", "e", LIMIT),
        joint("j2", "revolute", "b", "c", LIMIT + '<mimic joint="side" multiplier="2" offset="0.1"/>', "1 0 0"),
        joint("j3", "revolute", "c", "d", LIMIT + '<mimic joint="j2"/>', "1 0 0"),
    )
    for locked in (0.0, 0.3):
        model = RobotModel.from_urdf(text, "d", locked_joints={"side": locked} if locked else None)
        assert model.joint_names == ("j1",)
        value = 2 * locked + 0.1
        expected = chain_pose(text, "d", "a", {"j1": 0.4, "j2": value, "j3": value})
        np.testing.assert_allclose(model.forward([0.4]).homogeneous, expected, atol=1e-12)


def test_a_mimic_joint_follows_a_leader_it_is_tied_to_by_a_joint_outside_the_chain():
    """j2 mimics a joint beside the chain, which mimics j1: j2 moves with j1."""
    text = robot(
        "abce",
        joint("j1", "revolute", "a", "b", LIMIT),
        joint("side", "revolute", "a", "e", LIMIT + '<mimic joint="j1" multiplier="2"/>'),
        joint("j2", "revolute", "b", "c", LIMIT + '<mimic joint="side"/>', "1 0 0"),
    )
    model = RobotModel.from_urdf(text, "c")
    expected = chain_pose(text, "c", "a", {"j1": 0.2, "j2": 0.4})
    np.testing.assert_allclose(model.forward([0.2]).homogeneous, expected, atol=1e-12)


def test_a_tool_offset_moves_the_tool_point_and_its_velocity():
    plain = RobotModel.from_urdf(SKEWED, "tool")
    q = np.linspace(-0.3, 0.4, 7)
    offset = pose_from(POINT)
    made = RobotModel.from_urdf(SKEWED, "tool", tool_offset=POINT)
    plain_pose, plain_jacobian = plain.forward(q), plain.jacobian(q)
    changed = RobotModel.from_urdf(SKEWED, "tool")
    changed.set_tool_offset(POINT)
    for model in (made, changed):
        pose = model.forward(q)
        np.testing.assert_allclose(pose.homogeneous, (plain_pose * offset).homogeneous, atol=1e-12)
        lever = pose.translation - plain_pose.translation
        velocity = plain_jacobian[:3] - pin.skew(lever) @ plain_jacobian[3:]
        np.testing.assert_allclose(model.jacobian(q)[:3], velocity, atol=1e-12)
        np.testing.assert_allclose(model.jacobian(q)[3:], plain_jacobian[3:], atol=1e-12)
    changed.set_tool_offset([0, 0, 0, 0, 0, 0, 1])
    np.testing.assert_allclose(changed.forward(q).homogeneous, plain_pose.homogeneous, atol=1e-12)


def test_threads_share_a_model():
    """As node and loop do: parameters are checked against the model that a cycle asks where the tool is."""
    model, ended, q = RobotModel.from_urdf(SKEWED, "tool"), threading.Event(), np.linspace(-0.3, 0.4, 7)
    pose, jacobian, interval = model.forward(q).homogeneous, model.jacobian(q), sys.getswitchinterval()

    def ask() -> None:
        while not ended.is_set():
            model.forward(-q)
            model.jacobian(-q)

    other = threading.Thread(target=ask)
    sys.setswitchinterval(1e-6)
    other.start()
    try:
        for _ in range(3000):
            assert np.array_equal(model.forward(q).homogeneous, pose)
            assert np.array_equal(model.jacobian(q), jacobian)
    finally:
        ended.set()
        other.join()
        sys.setswitchinterval(interval)


def test_limits_come_from_the_urdf_and_can_be_overridden():
    model = RobotModel.from_urdf(TWO, "c")
    np.testing.assert_array_equal(model.lower, [-1, -1])
    np.testing.assert_array_equal(model.upper, [2, 2])
    np.testing.assert_array_equal(model.velocity_limit, [3, 3])
    np.testing.assert_array_equal(model.acceleration_limit, [3 / DEFAULT_RAMP_TIME] * 2)
    assert np.isinf(model.jerk_limit).all()
    assert model.assumptions == []
    model.set_limits(lower=[-2, -math.inf], velocity=[1, 2], acceleration=[5, 6], jerk=[7, 8])
    np.testing.assert_array_equal(model.lower, [-2, -math.inf])
    np.testing.assert_array_equal(model.upper, [2, 2])
    np.testing.assert_array_equal(model.velocity_limit, [1, 2])
    np.testing.assert_array_equal(model.acceleration_limit, [5, 6])
    np.testing.assert_array_equal(model.jerk_limit, [7, 8])


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        ({"lower": [0.0]}, "lower limits: 1 values, need 2, one for each of j1, j2"),
        ({"upper": [1.0, math.nan]}, "upper limits: NaN"),
        ({"velocity": [1.0, 0.0]}, "velocity limits must be positive"),
        ({"acceleration": [-1.0, 1.0]}, "acceleration limits must be positive"),
        ({"jerk": [1.0, -1.0]}, "jerk limits must be positive"),
        ({"lower": [3.0, 0.0]}, "joint 'j1': lower limit 3.0 is not below upper limit 2.0"),
        ({"lower": [0.0, 1.0], "upper": [1.0, 1.0]}, "joint 'j2': lower limit 1.0"),
        ({"velocity": ["a", 1.0]}, "velocity limits: need numbers"),
    ],
)
def test_limits_that_make_no_sense_are_refused_and_change_nothing(limits, text):
    model = RobotModel.from_urdf(TWO, "c")
    with pytest.raises(ModelError) as caught:
        model.set_limits(**{"velocity": [9.0, 9.0], **limits})
    assert text in str(caught.value)
    np.testing.assert_array_equal(model.lower, [-1, -1])
    np.testing.assert_array_equal(model.upper, [2, 2])
    np.testing.assert_array_equal(model.velocity_limit, [3, 3])


BROKEN = {
    "not XML": ("<robot", "not well-formed XML"),
    "another root": ("<sdf/>", "the root element is <sdf>, need <robot>"),
    "xacro": ('<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include/></robot>', "this is xacro, expand it"),
    "no links": ('<robot name="r"/>', "need one root link, found 0: (none)"),
    "two roots": (robot("abcd", joint("j1", "revolute", "a", "b", LIMIT)), "need one root link, found 3: a, c, d"),
    "unknown parent": (TWO.replace('parent link="a"', 'parent link="z"'), "joint 'j1' names link 'z'"),
    "no child": (TWO.replace('<child link="b"/>', ""), "joint 'j1' has no <child link=…>"),
    "no parent": (TWO.replace('<parent link="a"/>', ""), "joint 'j1' has no <parent link=…>"),
    "limit is no number": (TWO.replace('lower="-1"', 'lower="x"', 1), "joint 'j1': <limit lower='x'> is not a number"),
    "limit is NaN": (TWO.replace('upper="2"', 'upper="nan"', 1), "joint 'j1': <limit upper='nan'> is not a number"),
    "no limits": (TWO.replace(LIMIT, "", 1), "joint 'j1': lower limit 0.0 is not below upper limit 0.0"),
    "origin": (TWO.replace('xyz="0 0 0.1"', 'xyz="0 0"', 1), "joint 'j1': <origin xyz='0 0'> is not 3 finite numbers"),
    "axis": (TWO.replace('axis xyz="0 0 1"', 'axis xyz="0 a 1"', 1), "joint 'j1': <axis xyz='0 a 1'> is not 3 finite"),
    "zero axis": (TWO.replace('axis xyz="0 0 1"', 'axis xyz="0 0 0"', 1), "joint 'j1': <axis xyz='0 0 0'> has no dir"),
    "doubled joint": (TWO.replace('"j2"', '"j1"'), "two joints have the same name"),
    "doubled link": (TWO.replace("</robot>", '<link name="b"/></robot>'), "two links have the same name"),
    "nameless joint": (TWO.replace('name="j1"', ""), "a joint has no name"),
    "two parents": (TWO.replace("</robot>", joint("j3", "fixed", "a", "c") + "</robot>"), "'c' hangs on two joints"),
    "loop": (
        robot("abc", joint("j1", "revolute", "b", "c", LIMIT), joint("j2", "fixed", "c", "b")),
        "the links b, c form a loop that hangs on nothing",
    ),
    "mimics nobody": (TWO.replace(LIMIT, LIMIT + '<mimic joint="x"/>', 1), "mimics 'x', which does not exist"),
    "mimics itself": (TWO.replace(LIMIT, LIMIT + '<mimic joint="j1"/>', 1), "joint 'j1' mimics itself"),
    "mimics by zero": (
        TWO.replace(LIMIT, LIMIT + '<mimic joint="j2" multiplier="0"/>', 1), "multiplier='0'> leaves it no motion"),
    "mimic out of range": (
        TWO.replace(LIMIT, LIMIT + '<mimic joint="j2" offset="9"/>', 1), "their limits leave no motion in common"),
    "planar joint in the chain": (TWO.replace('"revolute"', '"planar"', 1), "joint 'j1' between 'a' and 'c' is planar"),
    "all fixed": (TWO.replace('"revolute"', '"fixed"'), "no movable joint between 'a' and 'c'"),
}  # fmt: skip


@pytest.mark.parametrize(("urdf", "text"), BROKEN.values(), ids=BROKEN)
def test_a_broken_urdf_gets_one_clear_line(urdf, text, capfd):
    with pytest.raises(ModelError) as caught:
        RobotModel.from_urdf(urdf, "c")
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")  # nothing of urdfdom's own on the terminal


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"tip_frame": "z"}, "tip frame 'z' is not a link of 'r'; there are: a, b, c"),
        ({"tip_frame": "c", "base_frame": "z"}, "base frame 'z' is not a link of 'r'; there are: a, b, c"),
        ({"tip_frame": "a", "base_frame": "c"}, "tip frame 'a' does not hang below base frame 'c'"),
        ({"tip_frame": "b", "base_frame": "b"}, "no movable joint between 'b' and 'b'"),
        (
            {"tip_frame": "b", "locked_joints": {"x": 1.0}},
            "locked joint 'x' is not a joint outside the chain; there are: j2",
        ),
        ({"tip_frame": "b", "locked_joints": {"j1": 1.0}}, "locked joint 'j1' is not a joint outside the chain"),
        ({"tip_frame": "b", "locked_joints": {"j2": math.nan}}, "locked joint 'j2': nan is not finite"),
        ({"tip_frame": "c", "tool_offset": [1, 2, 3]}, "tool_offset: need 7 values x y z qx qy qz qw, got shape (3,)"),
        ({"tip_frame": "c", "tool_offset": [0] * 7}, "quaternion (x, y, z, w) has norm 0, need 1 within 1e-3"),
        ({"tip_frame": "c", "tool_offset": [math.nan] * 7}, "tool_offset: values must be finite"),
        ({"tip_frame": "c", "tool_offset": "here"}, "tool_offset: need 7 values"),
    ],
)
def test_wrong_names_and_values_are_told_with_the_legal_ones(arguments, text):
    with pytest.raises(ModelError) as caught:
        RobotModel.from_urdf(TWO, **arguments)
    assert text in str(caught.value)


def test_a_fixed_joint_cannot_be_locked():
    with pytest.raises(ModelError, match="locked joint 'tool_mount' is not a joint outside the chain"):
        RobotModel.from_urdf(arms.planar_2r(), "tool", locked_joints={"tool_mount": 0.1})


def test_files_are_read_and_missing_ones_named(tmp_path):
    file = tmp_path / "robot.urdf"
    file.write_text(TWO)
    for path in (file, str(file)):
        assert RobotModel.from_urdf(path, "c").joint_names == ("j1", "j2")
    for path, reason in ((tmp_path / "none.urdf", "No such file"), (tmp_path, "directory"), ("", "directory")):
        with pytest.raises(ModelError, match="cannot be read") as caught:
            RobotModel.from_urdf(path, "c")
        assert reason in str(caught.value)
    file.write_bytes(b"\xff\xfe\x01")
    with pytest.raises(ModelError, match="cannot be read: not text"):
        RobotModel.from_urdf(file, "c")
    file.write_text("<sdf/>")
    with pytest.raises(ModelError, match=f"{file}: the root element"):
        RobotModel.from_urdf(file, "c")


def test_solids_and_meshes_that_are_missing_do_not_matter():
    text = TWO.replace('<link name="b"/>', '<link name="b"><visual><geometry><mesh filename="package://x/y.stl"/>'
                       "</geometry></visual></link>")  # fmt: skip
    assert RobotModel.from_urdf(text, "c").n == 2
    assert Urdf(text).text == text  # and the text is kept as it came
