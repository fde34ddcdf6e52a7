"""What the files of launch/ ask for, also where ROS's packages launch and launch_ros are missing: they are not on PyPI.

The files are run with classes in place of those packages that note what they are made with; `described` follows them as
launch does, and knows no more of launch than our files use. test_launch_files.py also takes the real `ros2 launch`.
"""

from __future__ import annotations

import json
import runpy
import sys
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any
from unittest.mock import patch

from rig import CLI, NODE, ROOT

EXECUTABLES = {"ik_controller": CLI, "ik_controller_node": NODE}
MODULES = ("launch", "launch.actions", "launch.conditions", "launch.event_handlers", "launch.events",
           "launch.substitutions", "launch_ros", "launch_ros.actions", "launch_ros.parameter_descriptions",
           "launch_ros.substitutions")  # fmt: skip


class Noted:
    """Anything of launch: what it was made with. `kind` is its name there."""

    kind = ""

    def __init__(self, *given: Any, **named: Any) -> None:
        self.given, self.named = given, named

    def perform(self, context: dict[str, str]) -> Any:
        return performed(self, context)


class Module(ModuleType):
    """A module that has every name."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        found = type(name, (Noted,), {"kind": name})
        setattr(self, name, found)
        return found


def performed(value: Any, arguments: dict[str, str]) -> Any:
    """Return what a substitution becomes with these launch arguments; anything else as it is."""
    if isinstance(value, (list, tuple)):
        return "".join(performed(part, arguments) for part in value)
    if not isinstance(value, Noted):
        return value
    (first,) = value.given
    if value.kind == "LaunchConfiguration":
        return arguments[first]
    if value.kind == "PathJoinSubstitution":
        return "/".join(performed(part, arguments) for part in first)
    if value.kind == "FindPackageShare":
        assert first == "ik_controller"
        return str(ROOT)
    assert value.kind == "ParameterValue"
    return value.named["value_type"](performed(first, arguments))


@dataclass
class Description:
    """What a launch file declares and starts with the arguments given."""

    arguments: dict[str, str]  # values
    help: dict[str, str] = field(default_factory=dict)  # what is said of each argument
    commands: list[list[str]] = field(default_factory=list)
    last: int = -1  # of the commands: all end with it
    _common: dict[str, Any] = field(default_factory=dict)
    _actions: list[Noted] = field(default_factory=list)

    def add(self, action: Noted) -> None:
        """Take one action of a launch file."""
        if action.kind == "DeclareLaunchArgument":
            (name,) = action.given
            self.help.setdefault(name, action.named["description"])
            self.arguments.setdefault(name, performed(action.named["default_value"], self.arguments))
        elif action.kind == "SetParameter":
            name, value = action.given
            self._common[name] = performed(value, self.arguments)
        elif action.kind == "OpaqueFunction":
            self.include(action.named["function"](self.arguments))
        elif action.kind == "IncludeLaunchDescription":
            self.include(actions_of(performed(action.given[0], self.arguments)))
        elif action.kind == "RegisterEventHandler":
            (handler,) = action.given
            assert handler.kind == "OnProcessExit"
            assert [(then.kind, then.named["event"].kind) for then in handler.named["on_exit"]] == [
                ("EmitEvent", "Shutdown")
            ]
            self._actions.append(handler.named["target_action"])
        else:
            assert action.kind == "Node"
            if self._wanted(action):
                self.commands.append(self._command(action))
            if self._wanted(action) and action in self._actions:
                self.last = len(self.commands) - 1

    def include(self, actions: list[Noted]) -> None:
        for action in actions:
            self.add(action)

    def _wanted(self, node: Noted) -> bool:
        condition = node.named.get("condition")
        if condition is None:
            return True
        assert condition.kind in ("IfCondition", "UnlessCondition")
        value = performed(condition.given[0], self.arguments).lower()
        assert value in ("true", "false")
        return (value == "true") == (condition.kind == "IfCondition")

    def _command(self, node: Noted) -> list[str]:
        """Return the command line of a process, by docs.ros.org's page on node arguments."""
        assert node.named["package"] == "ik_controller"
        words = [performed(word, self.arguments) for word in node.named.get("arguments", [])]
        ros = ["--ros-args"]
        for name, rule in (("name", "__node"), ("namespace", "__ns")):
            if value := performed(node.named.get(name, ""), self.arguments):
                ros += ["-r", f"{rule}:={'/' * (name == 'namespace') + value.lstrip('/')}"]
        for given in [self._common, *node.named.get("parameters", [])]:
            if isinstance(given, dict):
                for name, value in given.items():
                    ros += ["-p", f"{name}:={json.dumps(performed(value, self.arguments))}"]
            else:
                ros += ["--params-file", performed(given, self.arguments)]
        for topic, other in node.named.get("remappings", []):
            ros += ["-r", f"{topic}:={performed(other, self.arguments)}"]
        return [*EXECUTABLES[node.named["executable"]], *words, *ros]


def actions_of(file: str) -> list[Noted]:
    """Run a launch file and return its actions."""
    with patch.dict(sys.modules, {name: Module(name) for name in MODULES}):
        (actions,) = runpy.run_path(file)["generate_launch_description"]().given
    return list(actions)


def described(file: str, /, **arguments: str) -> Description:
    """Return what `ros2 launch ik_controller NAME.launch.py argument:=value …` would do."""
    description = Description(dict(arguments))
    description.include(actions_of(str(ROOT / "launch" / f"{file}.launch.py")))
    unknown = set(arguments) - set(description.help)
    assert not unknown, f"{file}.launch.py has no {unknown}; it has {sorted(description.help)}"
    return description
