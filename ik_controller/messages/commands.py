"""Commands in the types that ros2_control's controllers take, as bytes: the same bytes for the same command always."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.messages import cdr

Array = NDArray[np.float64]

ARRAY = "std_msgs/msg/Float64MultiArray"

# Parameter command_output → message type and topic.
OUTPUTS = {
    "joint_state": (cdr.JOINT_STATE, "joint_commands"),
    "joint_trajectory": (cdr.JOINT_TRAJECTORY, "joint_trajectory_controller/joint_trajectory"),
    "position_array": (ARRAY, "forward_position_controller/commands"),
    "velocity_array": (ARRAY, "forward_velocity_controller/commands"),
}


class CommandWriter:
    """Writes commands as a JointTrajectory of one point, or as a Float64MultiArray.

    The trajectory's stamp is 0, "from now on", and its point is due a cycle later. Joints are in the model's order.
    """

    def __init__(self, output: str, joint_names: tuple[str, ...], period: int, velocities: bool) -> None:
        """`output`: a key of OUTPUTS but joint_state; `period` of a cycle [ns]; `velocities`: in a trajectory too."""
        n = len(joint_names)
        # Numbers that stand nowhere else show where the fields are.
        position, velocity = -1e300 * np.arange(1.0, n + 1), 1e300 * np.arange(1.0, n + 1)
        self.type_name = OUTPUTS[output][0]
        if output == "joint_trajectory":
            empty = _trajectory(joint_names, position, velocity if velocities else np.zeros(0), period)
        else:
            layout = cdr.message("std_msgs/msg/MultiArrayLayout", [], 0)
            empty = cdr.message(ARRAY, layout, position if output == "position_array" else velocity)
        self._buffer = bytearray(cdr.encode(empty))
        self._position = self._buffer.find(position.tobytes())
        self._velocity = self._buffer.find(velocity.tobytes())

    def write(self, position: Array, velocity: Array) -> bytes:
        """Return the message of a command (n,), (n,)."""
        for at, values in ((self._position, position), (self._velocity, velocity)):
            if at >= 0:
                numbers = values.tobytes()
                self._buffer[at : at + len(numbers)] = numbers
        return bytes(self._buffer)


def _trajectory(joint_names: tuple[str, ...], position: Array, velocity: Array, period: int) -> Any:
    due = cdr.message("builtin_interfaces/msg/Duration", *divmod(period, 1_000_000_000))
    nothing = np.zeros(0)
    point = cdr.message("trajectory_msgs/msg/JointTrajectoryPoint", position, velocity, nothing, nothing, due)
    return cdr.message(cdr.JOINT_TRAJECTORY, cdr.header(0, ""), list(joint_names), [point])
