"""ik_controller: closed-loop inverse kinematics for ROS 2 arms. q̇ = J⁺(ẋ_d + K e) + (I − J⁺J) q̇₀."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ik_controller.control.controller import Controller, Step
    from ik_controller.control.reference import Reference
    from ik_controller.errors import IkControllerError
    from ik_controller.kinematics.model import RobotModel
    from ik_controller.parameters import ControllerParameters

__version__ = "0.1.0"

__all__ = ["Controller", "ControllerParameters", "IkControllerError", "Reference", "RobotModel", "Step"]

# Imported when first asked for (PEP 562): a command that needs no controller starts without Pinocchio and Numba.
_HOMES = {
    "Controller": "control.controller",
    "ControllerParameters": "parameters",
    "IkControllerError": "errors",
    "Reference": "control.reference",
    "RobotModel": "kinematics.model",
    "Step": "control.controller",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
