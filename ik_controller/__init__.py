"""ik_controller: closed-loop inverse kinematics for ROS 2 arms. q̇ = J⁺(ẋ_d + K e) + (I − J⁺J) q̇₀."""

from ik_controller.control.controller import Controller, Step
from ik_controller.control.reference import Reference
from ik_controller.errors import IkControllerError
from ik_controller.kinematics.model import RobotModel
from ik_controller.parameters import ControllerParameters

__version__ = "0.1.0"

__all__ = ["Controller", "ControllerParameters", "IkControllerError", "Reference", "RobotModel", "Step"]
