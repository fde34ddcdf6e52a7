"""Every topic, field and service that the layouts for Foxglove and RViz name is one of the running node."""

from __future__ import annotations

import json
import re
import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from rig import Rig

from ik_controller.recording.schema import typestore

ROOT = Path(__file__).resolve().parents[2]
# What others publish: the arm's description comes from a robot_state_publisher or out of a bag.
ELSEWHERE = {"/robot_description": "std_msgs/msg/String"}


def strings(value: Any) -> Iterator[str]:
    """Yield all texts of a nested structure, keys too."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from strings(key)
            yield from strings(item)
    elif isinstance(value, list):
        for item in value:
            yield from strings(item)


def check_fields(kind: str, path: list[str]) -> None:
    """Follow a path of field names, with [index] at arrays, from a message type; KeyError where there is none."""
    for name in path:
        field, indexed, _ = name.partition("[")
        node, details = dict(typestore().fielddefs[kind][1])[field]
        array = node.name in ("ARRAY", "SEQUENCE")
        assert array == bool(indexed), name
        if array:
            _, details = details[0]
        kind = details if isinstance(details, str) else details[0]


def test_the_files_are_those_of_the_script():
    made = runpy.run_path(str(ROOT / "scripts" / "make_views.py"))["files"]()
    for name, text in made.items():
        assert (ROOT / "config" / name).read_text(encoding="utf-8") == text, "run: make docs"


def test_every_panel_is_in_the_layout_once():
    layout = json.loads((ROOT / "config" / "foxglove.json").read_text(encoding="utf-8"))
    placed = [text for text in strings(layout["layout"]) if "!" in text]
    assert sorted(placed) == sorted(layout["configById"])


def test_topics_fields_and_services_are_the_nodes(live: Rig):
    layout = json.loads((ROOT / "config" / "foxglove.json").read_text(encoding="utf-8"))
    scene = yaml.safe_load((ROOT / "config" / "ik_controller.rviz").read_text(encoding="utf-8"))
    named = {text for text in (*strings(layout["configById"]), *strings(scene)) if re.match(r"/[a-z]", text)}
    services = {panel["serviceName"] for name, panel in layout["configById"].items() if name.startswith("CallService")}
    paths = named - services
    assert len(paths) > 20

    def known() -> dict[str, str]:
        node = live._caller
        return {name: types[0] for name, types in node.get_topic_names_and_types()} | ELSEWHERE

    live.until(lambda: {path.split(".")[0] for path in paths} <= set(known()), f"topics {sorted(paths)}")
    live.until(lambda: services <= {name for name, _ in live._caller.get_service_names_and_types()}, str(services))
    topics = known()
    for path in paths:
        topic, *fields = path.split(".")
        check_fields(topics[topic], fields)
    displayed = {
        "rviz_default_plugins/Pose": "geometry_msgs/msg/PoseStamped",
        "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
    }
    for display in scene["Visualization Manager"]["Displays"]:
        if display["Class"] in displayed:
            assert topics[display["Topic"]["Value"]] == displayed[display["Class"]]
