"""Parameter files are read as ROS itself reads them: the same values for the same node, whatever the sections."""

from __future__ import annotations

from pathlib import Path

import pytest
import rclpy
from rclpy.node import Node
from rig import next_domain

from ik_controller.parameter_file import values_in

FILES = {
    "exact and wildcards": """
/ns/node: {ros__parameters: {a: exact, b: [1.0, 2.0]}}
/**: {ros__parameters: {a: all, c: 1}}
/ns/*: {ros__parameters: {b: namespace}}
/*/node: {ros__parameters: {d: star, group: {e: 1, f: {g: true}}}}
""",
    "nested": """
/**: {ros__parameters: {a: all}}
node: {ros__parameters: {b: root}}
ns:
  node: {ros__parameters: {b: nested}}
  deep: {node: {ros__parameters: {c: deeper}}}
/ns/deep/**: {ros__parameters: {d: below}}
""",
    "all wildcards": """
/**/node: {ros__parameters: {a: anywhere}}
/*: {ros__parameters: {b: top}}
/**/deep/*: {ros__parameters: {c: deep}}
""",
}
NODES = ["/node", "/ns/node", "/ns/other", "/ns/deep/node", "/elsewhere/node"]


@pytest.mark.parametrize("name", FILES)
def test_the_same_values_as_ros(tmp_path: Path, name: str) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(FILES[name], encoding="utf-8")
    context = rclpy.Context()
    rclpy.init(args=["--ros-args", "--params-file", str(file)], context=context, domain_id=next_domain())
    given = {}
    try:
        for full in NODES:
            namespace, _, own = full.rpartition("/")
            node = Node(own, namespace=namespace or "/", context=context, enable_rosout=False)
            given[full] = {
                key: list(value.value) if hasattr(value.value, "tolist") else value.value
                for key, value in node._parameter_overrides.items()
            }
            node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    assert any(given.values())
    for full, values in given.items():
        if values:
            assert values_in(file, full) == values, full
