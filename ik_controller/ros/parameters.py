"""ROS parameters, declared from `ControllerParameters`: types, bounds and descriptions come from there alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from ik_controller.errors import IkControllerError
from ik_controller.parameter_file import is_ros_own
from ik_controller.parameters import ControllerParameters, specs
from ik_controller.robots import with_bundled


def declare(node: Node) -> ControllerParameters:
    """Declare every parameter on the node and return their values; a bundled robot's own fill what is not given.

    Raises ParameterError naming the parameter, also for a given one that does not exist.
    """
    known = {spec.name: spec for spec in specs()}
    given = {
        name: _given(parameter.value, known[name].default if name in known else None)
        for name, parameter in node._parameter_overrides.items()
        if name in known or not is_ros_own(name)
    }
    parameters = with_bundled(given)
    for spec in known.values():
        value = getattr(parameters, spec.name)
        node.declare_parameter(
            spec.name,
            list(value) if isinstance(value, tuple) else value,
            ParameterDescriptor(
                description=f"{spec.description} [{spec.unit or '-'}]",
                additional_constraints=spec.bounds,
                read_only=spec.at_start,
                dynamic_typing=True,  # so that `rate: 500` is a number too; `ControllerParameters` checks the types
            ),
            ignore_override=True,  # `parameters` has them already, checked
        )
    return parameters


def on_change(node: Node, accept: Callable[[dict[str, Any]], None]) -> None:
    """Hand each set of changed names and values to `accept`, all or none.

    `accept` may raise IkControllerError to refuse; the reason is the service's answer, and nothing is changed.
    """
    known = {spec.name for spec in specs()}

    def callback(changes: list[Parameter]) -> SetParametersResult:
        values = {change.name: _plain(change.value) for change in changes if change.name in known}
        if any(change.name == "use_sim_time" for change in changes):
            return SetParametersResult(successful=False, reason="use_sim_time is read-only: it is fixed at the start")
        try:
            if values:
                accept(values)
        except IkControllerError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(callback)


def _given(value: Any, default: Any) -> Any:
    """Return the value of a parameter that a file or an argument gives; ROS reads an empty list there as no value."""
    return [] if value is None and isinstance(default, tuple) else _plain(value)


def _plain(value: Any) -> Any:
    return list(value) if hasattr(value, "__iter__") and not isinstance(value, str) else value
