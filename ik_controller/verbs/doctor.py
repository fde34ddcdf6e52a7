"""`ik_controller doctor`: check a configuration before it meets an arm."""

from __future__ import annotations

import argparse
import contextlib
from typing import TYPE_CHECKING

from ik_controller.errors import IkControllerError
from ik_controller.findings import Finding
from ik_controller.verbs.common import (
    add_json_argument,
    add_model_arguments,
    add_params_argument,
    parameters_from,
    print_json,
    print_table,
    values_from,
)

if TYPE_CHECKING:
    from ik_controller.kinematics.model import RobotModel
    from ik_controller.parameters import ControllerParameters
    from ik_controller.ros.graph import Graph

HELP = "check parameters, robot model and the ROS graph: what is wrong, and how to mend it"

_ROBOT = ("robot", "urdf")
_FAST_BRAKE = 2.0  # [s] that no arm's joint should need to stop from full speed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    add_params_argument(parser, "to check")
    parser.add_argument("--offline", action="store_true", help="do not look at the ROS graph that is up")
    parser.add_argument("--seconds", type=float, default=4.0, metavar="S", help="how long to look at it (4)")
    add_model_arguments(parser, default="panda")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the findings; 0 where nothing is wrong, 1 where something is."""
    findings = examine(arguments)
    ok = all(finding.level == "ok" for finding in findings)
    if arguments.json:
        print_json({"ok": ok, "findings": [finding._asdict() for finding in findings]})
    else:
        print_table([(f.level, f"{f.subject}: {f.message}{'; ' + f.remedy if f.remedy else ''}") for f in findings])
        print("all is well" if ok else "something is wrong")
    return 0 if ok else 1


def examine(arguments: argparse.Namespace) -> list[Finding]:
    """Return the findings on the configuration that the arguments name, and on the graph that is up."""
    from ik_controller.parameters import ControllerParameters

    findings: list[Finding] = []
    try:
        values = values_from(arguments)
        # A file that names only frames leaves the URDF to the topic robot_description.
        by_topic = "tip_frame" in values and not any((arguments.robot, arguments.urdf, *map(values.get, _ROBOT)))
        parameters = ControllerParameters.from_mapping(values) if by_topic else parameters_from(arguments, values)
    except IkControllerError as error:
        return [Finding("error", "parameters", str(error), "correct the parameter file or the arguments")]
    findings.append(Finding("ok", "parameters", f"{len(values)} values read, all within bounds"))
    with contextlib.ExitStack() as stack:
        graph = None if arguments.offline else _graph(arguments, stack, findings)
        model = _model(parameters, None if graph is None else graph.description, findings)
        if model is not None:
            findings += _limits(model) + _law(model, parameters)
        if graph is not None:
            findings += graph.findings(model, parameters)
    return findings


def _graph(arguments: argparse.Namespace, stack: contextlib.ExitStack, findings: list[Finding]) -> Graph | None:
    """Return a look at the running graph, None where there is none."""
    try:
        from ik_controller.ros.graph import Graph
    except ImportError:
        findings.append(Finding("ok", "graph", "ROS is not installed: nothing live was checked"))
        return None
    graph = Graph(arguments.node or "/ik_controller")
    stack.callback(graph.close)
    if graph.listen(arguments.seconds):
        return graph
    findings.append(Finding("ok", "graph", "no other node is up: nothing live was checked"))
    return None


def _model(parameters: ControllerParameters, description: str | None, findings: list[Finding]) -> RobotModel | None:
    from ik_controller.robots import build_model, urdf_text

    try:
        text = urdf_text(parameters)
        if text is None and description is None:
            message = "neither the parameters nor a topic robot_description name a URDF"
            findings.append(Finding("error", "robot", message, "give robot or urdf, or start robot_state_publisher"))
            return None
        model = build_model(parameters, text or description)
    except IkControllerError as error:
        remedy = "name a robot, or a URDF with tip and base frame"
        with contextlib.suppress(IkControllerError):
            swapped = {"tip_frame": parameters.base_frame, "base_frame": parameters.tip_frame}
            build_model(parameters.replace(swapped), description)
            remedy = "swap tip_frame and base_frame"
        findings.append(Finding("error", "robot", str(error), remedy))
        return None
    chain = f"{model.n} joints from '{model.base_frame}' to '{model.tip_frame}'"
    findings.append(Finding("ok", "robot", chain))
    return model


def _limits(model: RobotModel) -> list[Finding]:
    findings = [
        Finding("warning", "limits", assumption, "set velocity_limits to the arm's own")
        for assumption in model.assumptions
    ]
    for name, velocity, acceleration in zip(
        model.joint_names, model.velocity_limit, model.acceleration_limit, strict=True
    ):
        time = velocity / acceleration
        if time > _FAST_BRAKE:
            message = f"joint '{name}' needs {time:.1f} s to stop from full speed"
            findings.append(Finding("warning", "limits", message, "raise acceleration_limits or lower velocity_limits"))
    return findings or [Finding("ok", "limits", "stated for every joint")]


def _law(model: RobotModel, parameters: ControllerParameters) -> list[Finding]:
    import numpy as np

    from ik_controller.control.controller import Controller
    from ik_controller.kinematics.small import gram, spectrum

    findings = []
    try:
        Controller(model, parameters)
    except IkControllerError as error:
        return [Finding("error", "law", str(error), "correct the parameter")]
    share = max(parameters.gain) / parameters.rate
    if share > 0.5:
        message = f"gain / rate is {share:.2f}: the arm must follow each command within a cycle or it will oscillate"
        findings.append(Finding("warning", "gain", message, "lower gain, or raise rate"))
    if parameters.posture:
        posture = np.array(parameters.posture)
        if (posture < model.lower).any() or (posture > model.upper).any():
            message = "the posture lies outside the position limits"
            findings.append(Finding("warning", "posture", message, "choose one within the limits"))
        sigma = float(np.sqrt(max(float(spectrum(gram(model.jacobian(posture), np.empty((6, 6))))[0][0]), 0.0)))
        if model.n >= 6 and sigma < parameters.singular_value_threshold:
            message = f"the posture is near a singularity (σ = {sigma:.3g})"
            findings.append(Finding("warning", "posture", message, "choose one away from singularities"))
    return findings or [Finding("ok", "law", "gain, rate and posture fit together")]
