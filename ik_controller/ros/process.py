"""The process `ik_controller_node`: one arm's node, or a node for each of the parameter `arms`."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Sized
from typing import Any

import rclpy
from rclpy.exceptions import InvalidNamespaceException, InvalidNodeNameException
from rclpy.node import Node

from ik_controller.endings import leave, on_signal
from ik_controller.errors import IkControllerError, ParameterError
from ik_controller.ros.node import ControllerNode
from ik_controller.ros.start import start_ros

_NAME = "ik_controller"


def arms() -> list[tuple[str, str]]:
    """Return (namespace, name) of each node that this process is to run, by the parameter `arms` of the node that it
    would be otherwise. Raises ParameterError where they are no names, or not different ones.
    """
    probe = Node(_NAME, enable_rosout=False, start_parameter_services=False)
    given = probe._parameter_overrides.get("arms")
    namespace, name = probe.get_namespace(), probe.get_name()
    probe.destroy_node()
    if given is None or given.value is None:  # as ROS reads an empty list
        return [(namespace, name)]
    names = given.value
    if not isinstance(names, (list, tuple)) or not all(isinstance(item, str) and item.strip("/") for item in names):
        raise ParameterError(f"arms = {names!r}: need a list of node names, such as [left, right] or [left/arm]")
    found = []
    for item in names:
        below, _, own = item.strip("/").rpartition("/")
        found.append((f"{namespace.rstrip('/')}/{below}".rstrip("/") or "/", own))
    if len(set(found)) < len(found):
        raise ParameterError(f"arms = {list(names)}: need different names")
    return found or [(namespace, name)]


def make_nodes() -> list[ControllerNode]:
    """Return the nodes of this process. Raises IkControllerError; names the arm where there are several."""
    names = arms()
    nodes = []
    for namespace, name in names:
        # Remapping by the node's own arguments comes before a `__node:=` that the process was given.
        own = ["--ros-args", "-r", f"__ns:={namespace}", "-r", f"__node:={name}"]
        try:
            nodes.append(ControllerNode(name, cli_args=own))
        except (InvalidNodeNameException, InvalidNamespaceException) as error:
            raise ParameterError(f"arms: '{name}' in '{namespace}': {' '.join(str(error).split())}") from None
        except IkControllerError as error:
            raise _named(error, f"{namespace.rstrip('/')}/{name}", names) from None
    return nodes


def _named(error: IkControllerError, node: str, nodes: Sized) -> IkControllerError:
    """Return an error that says which arm it is of, where there are several."""
    return error if len(nodes) == 1 else type(error)(f"{node}: {error}")


def _outcome(failures: list[Exception]) -> int:
    """Tell what went wrong and return the exit code; raise what is no mistake in the configuration."""
    for failure in failures:
        if not isinstance(failure, IkControllerError):
            raise failure
        print(f"ik_controller_node: {failure}", file=sys.stderr)
    return 2 if failures else 0


def main(arguments: list[str] | None = None) -> int:
    """Run until SIGINT or SIGTERM: exit code 0 then, 2 for a mistake in the configuration of any arm."""
    try:
        start_ros(sys.argv if arguments is None else arguments)
    except ParameterError as error:
        return _outcome([error])
    wake, waker = os.pipe()  # what may be done in a signal handler: write a byte

    def stop(*_: Any) -> None:
        os.write(waker, b".")

    on_signal(stop)
    failures: list[Exception] = []

    def serve(node: ControllerNode) -> None:
        try:
            node.serve()
        except IkControllerError as error:
            failures.append(_named(error, node.get_fully_qualified_name(), nodes))
        except Exception as error:
            failures.append(error)
        stop()

    nodes: list[ControllerNode] = []
    try:
        nodes = make_nodes()
        threads = [threading.Thread(target=serve, args=(node,), name=f"executor {node.get_name()}") for node in nodes]
        for thread in threads:
            thread.start()
        os.read(wake, 1)  # a signal, or an arm that cannot start: all end together
        for node in nodes:
            node.request_stop()
        for node, thread in zip(nodes, threads, strict=True):
            while thread.is_alive() and not node.preparing:
                thread.join(0.1)
        if any(thread.is_alive() for thread in threads):  # compiling, which takes long and cannot be broken off
            leave(_outcome(failures))
    except IkControllerError as error:
        failures.append(error)
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    return _outcome(failures)
