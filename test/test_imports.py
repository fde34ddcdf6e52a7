"""The rooms of the package: imports point downward only, and nothing outside ros/ needs ROS."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "ik_controller"
# Each room may import from those before it.
ROOMS = ["endings", "errors", "findings", "parameter_spec", "parameter_file", "parameters",
         "share", "kinematics", "robots", "control", "messages", "session", "recording", "report", "view",
         "ros", "testing", "verbs", "cli"]  # fmt: skip
# What only some rooms may know, wherever in a module the import stands.
ONLY = {
    "rclpy": {"ros"},
    "mcap": {"recording"},
    "rosbags": {"messages", "recording"},
    "matplotlib": {"recording", "verbs"},
    "viser": {"view"},
}
ROS = ["rclpy", "rosidl_runtime_py", "ament_index_python", "builtin_interfaces", "std_msgs", "std_srvs", "sensor_msgs",
       "geometry_msgs", "trajectory_msgs", "diagnostic_msgs", "rcl_interfaces", "rosgraph_msgs",
       "visualization_msgs"]  # fmt: skip
MODULES = sorted(PACKAGE.rglob("*.py"))


def room_of(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(file: Path) -> set[str]:
    """Return the modules that a file imports, at its top or inside functions."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def test_every_module_has_a_room():
    assert {room_of(file) for file in MODULES} - {"__init__", "__main__"} <= set(ROOMS)


@pytest.mark.parametrize("file", MODULES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_imports_point_downward(file):
    room = room_of(file)
    if room in ("__init__", "__main__"):
        return
    allowed = set(ROOMS[: ROOMS.index(room) + 1])
    used = {name.split(".")[1] for name in imported(file) if name.startswith("ik_controller.")} & set(ROOMS)
    assert used <= allowed, f"{room} imports {sorted(used - allowed)}"
    for library, rooms in ONLY.items():
        if room not in rooms:
            assert library not in {name.split(".")[0] for name in imported(file)}, f"{room} imports {library}"


def test_all_but_ros_imports_without_rclpy():
    modules = [
        ".".join(("ik_controller", *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")
        for file in MODULES
        if room_of(file) not in ("ros", "__main__")
    ]
    code = (
        "import sys, importlib\n"
        f"for name in {ROS}: sys.modules[name] = None\n"  # None makes `import name` raise ImportError
        f"for name in {modules}: importlib.import_module(name)\n"
        "assert not [name for name in sys.modules if name.startswith('ik_controller.ros')]\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
