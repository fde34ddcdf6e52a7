"""Definitions and hashes against the installed ROS packages, which are an independent source."""

from __future__ import annotations

import ast
import json
import re
import sys
from pathlib import Path

import pytest

import ik_controller
from ik_controller.errors import BagError
from ik_controller.messages.commands import OUTPUTS
from ik_controller.recording.run import ROLES
from ik_controller.recording.samples import ROLES_OF_TYPE
from ik_controller.recording.schema import message_schema, typestore

PACKAGE = Path(ik_controller.__file__).parent


def used_types() -> list[str]:
    """The message types that the package's code names: as text, or as classes imported from a ROS package."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and re.fullmatch(r"\w+/msg/\w+", str(node.value)):
                found.add(node.value)
            if isinstance(node, ast.ImportFrom) and (node.module or "").endswith("_msgs.msg"):
                found |= {f"{(node.module or '').removesuffix('.msg')}/msg/{alias.name}" for alias in node.names}
    return sorted(found)


USED = used_types()


def test_what_a_bag_may_hold_is_among_the_used_types() -> None:
    kinds = {*ROLES.values(), *ROLES_OF_TYPE, *(kind for kind, _ in OUTPUTS.values())} - {""}
    assert kinds <= set(USED)
    assert len(USED) > 30


def share() -> Path:
    folder = Path(sys.prefix) / "share"
    if not (folder / "sensor_msgs" / "msg" / "JointState.msg").exists():
        pytest.skip("no ROS message packages are installed beside this Python")
    return folder


def statements(text: str) -> list[str]:
    """The lines of a definition without comments, blank lines and repeated spaces."""
    lines = (re.sub(r"\s+", " ", line.split("#")[0]).strip() for line in text.splitlines())
    return [line for line in lines if line]


def tight(lines: list[str], package: str) -> list[str]:
    """Some packages write spaces around "=", or their own name before their own types: both mean the same."""
    return [line.removeprefix(f"{package}/").replace(" ", "").replace('"', "'") for line in lines]


def sections(type_name: str) -> dict[str, str]:
    root, *rest = message_schema(type_name).text.split("=" * 80 + "\n")
    found = {type_name.replace("/msg/", "/"): root}
    for section in rest:
        title, _, body = section.partition("\n")
        assert title.startswith("MSG: ")
        found[title.removeprefix("MSG: ")] = body
    return found


@pytest.mark.parametrize("type_name", USED)
def test_definition_and_hash_equal_the_installed_packages(type_name: str) -> None:
    folder = share()
    package, _, short = type_name.split("/")
    if not (folder / package).exists():  # control_msgs, tf2_msgs: no wheels of them
        pytest.skip(f"{package} is not installed")
    hashes = json.loads((folder / package / "msg" / f"{short}.json").read_text())["type_hashes"]
    expected = {entry["type_name"]: entry["hash_string"] for entry in hashes}
    assert message_schema(type_name).type_hash == expected[type_name]
    # the package's list of types is the closure of dependencies: the text must hold exactly these
    assert set(sections(type_name)) == {name.replace("/msg/", "/") for name in expected}
    for name, body in sections(type_name).items():
        package, short = name.split("/")
        assert statements(body) == statements((folder / package / "msg" / f"{short}.msg").read_text()), name


def test_every_installed_message_type_has_the_installed_hash_and_definition() -> None:
    """Any team's own bag may hold any common type, so all that both sides know are compared, not only ours."""
    compared = 0
    for path in sorted(share().glob("*/msg/*.json")):
        type_name = f"{path.parent.parent.name}/msg/{path.stem}"
        source = path.with_suffix(".msg")
        if type_name not in typestore().fielddefs or not source.exists():
            continue
        hashes = json.loads(path.read_text())["type_hashes"]
        # rosbags 0.11 hashes `char` as a type of its own, rosidl as uint8; no type that a robot publishes has one
        if not re.search(r"^char\b", message_schema(type_name).text, flags=re.MULTILINE):
            assert message_schema(type_name).type_hash == {h["type_name"]: h["hash_string"] for h in hashes}[type_name]
        package = path.parent.parent.name
        own = tight(statements(sections(type_name)[type_name.replace("/msg/", "/")]), package)
        theirs = tight(statements(source.read_text()), package)
        # rosbags puts constants first; among fields the order is the message's layout
        assert sorted(own) == sorted(theirs), type_name
        assert [line for line in own if "=" not in line] == [line for line in theirs if "=" not in line], type_name
        compared += 1
    assert compared > 100


def test_tf_message_is_known_without_its_package() -> None:
    schema = message_schema("tf2_msgs/msg/TFMessage")
    assert schema.text.startswith("geometry_msgs/TransformStamped[] transforms\n")
    # as printed by `ros2 topic info --verbose /tf` on Jazzy
    assert schema.type_hash == "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"


def test_short_names_mean_the_same_type() -> None:
    assert message_schema("sensor_msgs/JointState") == message_schema("sensor_msgs/msg/JointState")


def test_unknown_type_names_the_nearest() -> None:
    with pytest.raises(BagError, match=r"type 'sensor_msgs/msg/JointStates'; did you mean: .*JointState"):
        message_schema("sensor_msgs/msg/JointStates")
