"""Parameter files are read as ROS itself reads them: the same values for the same node, whatever the sections."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path

import pytest
import rclpy
import yaml
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rig import CLI, NODE, Rig, environment, next_domain

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


def dump(rig: Rig) -> dict[str, object]:
    """Return all parameters of the node, as `ros2 param dump` asks for them."""
    names = rig.request("/ik_controller/list_parameters", ListParameters, ListParameters.Request()).result.names
    answer = rig.request("/ik_controller/get_parameters", GetParameters, GetParameters.Request(names=names))
    values = [parameter_value_to_python(value) for value in answer.values]
    return {
        name: value if isinstance(value, str) else json.loads(json.dumps(value, default=list))
        for name, value in zip(names, values, strict=True)
    }


def test_what_param_dump_writes_can_be_loaded_again(rig: Rig) -> None:
    """ROS's own parameters are among them, and ROS reads an empty list in a file as no value at all."""
    first = rig.start("first", [*NODE, "--ros-args", "-p", "robot:=ur5e", "-p", "damping:=0.1", "-p", "record:=false"])
    dumped = dump(rig)
    assert dumped["arms"] == dumped["tool_offset"] == []
    assert "start_type_description_service" in dumped
    first.send(signal.SIGINT)
    assert first.wait() == 0
    file = rig.folder / "dumped.yaml"
    file.write_text(yaml.safe_dump({"/ik_controller": {"ros__parameters": dumped}}), encoding="utf-8")
    looked = subprocess.run(
        [*CLI, "doctor", "--params", str(file), "--offline"],
        env=environment(rig.domain),
        capture_output=True,
        check=False,
    )
    assert looked.returncode == 0, looked.stdout
    rig.start("second", [*NODE, "--ros-args", "--params-file", str(file)])
    assert dump(rig) == dumped
