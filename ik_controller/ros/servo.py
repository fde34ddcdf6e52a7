"""MoveIt Servo's services and status under its names, for clients that were written for it.

What differs on purpose: arms leave a singularity and a joint bound by themselves, so "halt: singularity" (2) is never
told; nothing jumps on un-pausing; a stamp of zero means now; a quaternion of zero is rejected.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Int8
from std_srvs.srv import SetBool, Trigger

from ik_controller.control.status import Code, Limit, Status
from ik_controller.ros.optional import optional

INVALID, OK, SLOW_TO_SINGULARITY, SLOW_FROM_SINGULARITY, SLOW_FOR_COLLISION, HALT_FOR_COLLISION, JOINT_BOUND = (
    -1, 0, 1, 3, 4, 5, 6
)  # fmt: skip
_HALTED = 1e-3  # share of the wanted speed below which it is a halt
_MODES = {0: "joints", 1: "twist", 2: "pose"}  # moveit_msgs/ServoCommandType: JOINT_JOG, TWIST, POSE


class StatusCode:
    """Servo's number for a status; whether a singularity nears or recedes is seen from one status to the next."""

    def __init__(self) -> None:
        self._sigma = float("inf")

    def of(self, status: Status) -> int:
        """Return the code of the status of one cycle."""
        before, self._sigma = self._sigma, status.smallest_singular_value if status.damped else float("inf")
        if status.code in (Code.WAITING, Code.NO_FEEDBACK, Code.FAULT):
            return INVALID
        if status.limit in (Limit.OBSTACLE, Limit.SELF_COLLISION):
            return HALT_FOR_COLLISION if status.scale < _HALTED else SLOW_FOR_COLLISION
        if status.limit is Limit.POSITION:
            return JOINT_BOUND
        if status.damped:
            return SLOW_FROM_SINGULARITY if self._sigma > before else SLOW_TO_SINGULARITY
        return OK


class ServoInterface:
    """Services pause_servo, start_servo, stop_servo (and switch_command_type where moveit_msgs is installed), and the
    topic status: std_msgs/Int8, or moveit_msgs/ServoStatus where that is installed.
    """

    def __init__(self, node: Node, name: str, request: Callable[..., None]) -> None:
        """`name` stands before each name; `request` takes events of `Session.apply`."""
        self._node = node
        self._request = request
        self._code = StatusCode()
        self._kind = optional("moveit_msgs.msg", "ServoStatus") or Int8
        self._status = node.create_publisher(self._kind, f"{name}/status", 10)
        self._services = [
            node.create_service(SetBool, f"{name}/pause_servo", self._pause),
            node.create_service(Trigger, f"{name}/start_servo", self._start),
            node.create_service(Trigger, f"{name}/stop_servo", self._stop),
        ]
        switch = optional("moveit_msgs.srv", "ServoCommandType")
        if switch is not None:
            self._services.append(node.create_service(switch, f"{name}/switch_command_type", self._switch))

    def tell(self, status: Status, names: tuple[str, ...]) -> None:
        """Send the status."""
        self._status.publish(filled(self._kind(), self._code.of(status), status.sentence(names)))

    def _pause(self, request: Any, response: Any) -> Any:
        self._request(do="pause" if request.data else "resume")
        response.success, response.message = True, "pausing" if request.data else "going on"
        return response

    def _start(self, request: Any, response: Any) -> Any:
        self._request(do="resume")
        response.success, response.message = True, "going on from the measured position"
        return response

    def _stop(self, request: Any, response: Any) -> Any:
        self._request(do="pause")
        response.success, response.message = True, "pausing"
        return response

    def _switch(self, request: Any, response: Any) -> Any:
        response.success = request.command_type in _MODES
        if response.success:
            self._node.set_parameters([Parameter("mode", value=_MODES[request.command_type])])
        return response

    def close(self) -> None:
        """Withdraw it all."""
        for service in self._services:
            self._node.destroy_service(service)
        self._node.destroy_publisher(self._status)


def filled(message: Any, code: int, sentence: str) -> Any:
    """Return an Int8 or a ServoStatus with the code, and the sentence where it has a place."""
    if hasattr(message, "code"):
        message.code, message.message = code, sentence
    else:
        message.data = code
    return message
