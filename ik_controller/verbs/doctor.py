"""`ik_controller doctor`: check a configuration before it meets an arm."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ik_controller.errors import IkControllerError
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

HELP = "check parameters and robot model: what is wrong, and how to mend it"

_FAST_BRAKE = 2.0  # [s] that no arm's joint should need to stop from full speed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    add_params_argument(parser, "to check")
    add_model_arguments(parser, default="panda")
    add_json_argument(parser)


@dataclass(frozen=True)
class Finding:
    """One finding: `level` is "error", "warning" or "ok"."""

    level: str
    subject: str
    message: str
    remedy: str = ""


def run(arguments: argparse.Namespace) -> int:
    """Print the findings; 0 where nothing is wrong, 1 where something is."""
    findings = examine(arguments)
    ok = all(finding.level == "ok" for finding in findings)
    if arguments.json:
        print_json({"ok": ok, "findings": [vars(finding) for finding in findings]})
    else:
        print_table([(f.level, f"{f.subject}: {f.message}{'; ' + f.remedy if f.remedy else ''}") for f in findings])
        print("all is well" if ok else "something is wrong")
    return 0 if ok else 1


def examine(arguments: argparse.Namespace) -> list[Finding]:
    """Return the findings on the configuration that the arguments name."""
    from ik_controller.robots import build_model

    findings: list[Finding] = []
    try:
        values = values_from(arguments)
        parameters = parameters_from(arguments, values)
    except IkControllerError as error:
        return [Finding("error", "parameters", str(error), "correct the parameter file or the arguments")]
    findings.append(Finding("ok", "parameters", f"{len(values)} values read, all within bounds"))
    try:
        model = build_model(parameters)
    except IkControllerError as error:
        return [*findings, Finding("error", "robot", str(error), "name a robot, or a URDF with tip and base frame")]
    chain = f"{model.n} joints from '{model.base_frame}' to '{model.tip_frame}'"
    findings.append(Finding("ok", "robot", chain))
    return findings + _limits(model) + _law(model, parameters)


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
        sigma = float(np.sqrt(max(float(spectrum(gram(model.jacobian(posture)))[0][0]), 0.0)))
        if model.n >= 6 and sigma < parameters.singular_value_threshold:
            message = f"the posture is near a singularity (σ = {sigma:.3g})"
            findings.append(Finding("warning", "posture", message, "choose one away from singularities"))
    return findings or [Finding("ok", "law", "gain, rate and posture fit together")]
