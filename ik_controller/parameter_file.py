"""Parameter files: plain `name: value` YAML, or ROS 2's, with namespaces and wildcards, read as ROS reads them.

A ROS 2 parameter file has sections by node name: `/ns/arm:`, `arm:` below `ns:`, `/**:` for every node, `/*/arm:` for
`arm` in any one namespace. A node takes every section that fits its name; where two give the same parameter, the later.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ik_controller.errors import ParameterError, choices

_PARAMETERS = "ros__parameters"


def values_in(path: str | Path, node: str | None = None) -> dict[str, Any]:
    """Return the names and values in a parameter file for `node`, its full name with namespace.

    `node` None is for files that are of one node: the only one that is fully named, or all in wildcards alone.
    ROS's own are left out, as `ros2 param dump` writes them too. Raises ParameterError: not readable, not YAML, no
    parameters for this node, or of several nodes and none is named.
    """
    content = _load(path)
    sections = list(_sections(content))
    if not sections:
        return content
    names = list(dict.fromkeys(name for name, _ in sections if "*" not in name))
    if node is None:
        if len(names) > 1:
            raise ParameterError(
                f"parameter file '{path}' has parameters of {len(names)} nodes, name one: {choices(names)}"
            )
        node = names[0] if names else ""
    else:
        node = "/" + node.strip("/")
    values: dict[str, Any] = {}
    for name, parameters in sections:
        if _fits(name, node):
            values.update((name, value) for name, value in _flat(parameters) if not is_ros_own(name))
    if not values and node:
        raise ParameterError(
            f"parameter file '{path}' has no parameters for {node}; it has: {choices(n for n, _ in sections)}"
        )
    return values


def is_ros_own(name: str) -> bool:
    """Tell whether a parameter is one that ROS gives every node."""
    return name in ("use_sim_time", "start_type_description_service") or name.startswith("qos_overrides.")


def read_yaml(path: str | Path, what: str) -> Any:
    """Return what a YAML file holds. Raises ParameterError naming it as `what`: missing, not text, not YAML."""
    import yaml

    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise ParameterError(f"{what} '{path}' cannot be read: {reason}") from None
    except yaml.YAMLError as error:
        raise ParameterError(f"{what} '{path}' is not YAML: {' '.join(str(error).split())}") from None


def _load(path: str | Path) -> dict[str, Any]:
    content = read_yaml(path, "parameter file")
    if not isinstance(content, dict):
        raise ParameterError(f"parameter file '{path}' holds no parameters")
    return content


def _sections(content: Any, namespace: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (node name or pattern, parameters) of every `ros__parameters`, in the file's order."""
    if not isinstance(content, dict):
        return
    for key, below in content.items():
        if key == _PARAMETERS and isinstance(below, dict):
            yield namespace, below
        else:
            yield from _sections(below, f"{namespace}/{str(key).strip('/')}")


def _fits(pattern: str, node: str) -> bool:
    """Say whether a node's full name fits a section's; `node` "" is one of any name."""
    if not node:
        return True
    expression = re.escape(pattern).replace(r"/\*\*", r"(/\w+)*").replace(r"/\*", r"/\w+")
    return re.fullmatch(expression, node) is not None


def _flat(parameters: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in parameters.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
