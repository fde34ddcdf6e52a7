"""Every parameter once: name, type, default, unit, bounds, description.

The ROS declaration, YAML files, validation and the documentation's table are all made from `ControllerParameters`.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller import parameter_spec
from ik_controller.errors import ParameterError, choices
from ik_controller.parameter_file import values_in
from ik_controller.parameter_spec import Spec, parameter

SECTIONS = ("robot", "limits", "obstacles", "law", "tasks", "reference", "node", "recording")

ORIENTATION_ERRORS = (
    "exponential_base",
    "exponential_tool",
    "quaternion",
    "instantaneous",
    "euler_relative_tool",
    "euler_difference_zyx",
    "euler_difference_xyz",
    "euler_difference_zxz",
)

INVERSES = (
    "numerical_filtering",
    "damped",
    "damped_manipulability",
    "damped_singular_value",
    "pseudo",
    "exact",
    "right",
    "left",
    "weighted_right",
    "weighted_left",
    "transpose",
)


@dataclass(frozen=True)
class ControllerParameters:
    """All parameters, checked when made. Raises ParameterError naming the parameter and its legal values.

    Lists of joint values follow the model's joint order; an empty list takes the model's own.
    """

    # robot
    robot: str = parameter(
        "", "robot", "Bundled robot; empty: `urdf`, else the topic robot_description.", read_only=True
    )
    urdf: str = parameter("", "robot", "URDF file; empty: the topic robot_description.", read_only=True)
    tip_frame: str = parameter("", "robot", "Link that carries the tool.", read_only=True)
    base_frame: str = parameter(
        "", "robot", "Link in which targets are expressed; empty: the root link.", read_only=True
    )
    tool_offset: tuple[float, ...] = parameter(
        (),
        "robot",
        "Tool point in the tip frame: x y z qx qy qz qw; empty: the tip itself. Changed at run time, the arm goes "
        "within its limits to where the new tool point is at the target.",
        unit="m, 1",
        lengths=(0, 7),
    )
    locked_joint_names: tuple[str, ...] = parameter(
        (), "robot", "Joints outside the chain that are locked elsewhere than at 0.", read_only=True
    )
    locked_joint_values: tuple[float, ...] = parameter(
        (), "robot", "Their values, in the same order.", unit="rad, m", read_only=True
    )
    # limits
    position_lower: tuple[float, ...] = parameter(
        (), "limits", "Lower joint limits; empty: the URDF's.", unit="rad, m", read_only=True
    )
    position_upper: tuple[float, ...] = parameter(
        (), "limits", "Upper joint limits; empty: the URDF's.", unit="rad, m", read_only=True
    )
    velocity_limits: tuple[float, ...] = parameter(
        (), "limits", "Joint speed limits; empty: the URDF's.", unit="rad/s, m/s", read_only=True
    )
    acceleration_limits: tuple[float, ...] = parameter(
        (), "limits", "Joint acceleration limits; empty: full speed in 0.25 s.", unit="rad/s², m/s²", read_only=True
    )
    jerk_limits: tuple[float, ...] = parameter(
        (),
        "limits",
        "Joint jerk limits, .inf for a joint without one; empty: none.",
        unit="rad/s³, m/s³",
        read_only=True,
    )
    velocity_scale: float = parameter(1.0, "limits", "Factor on all speed limits.", low=0.001, high=1.0)
    acceleration_scale: float = parameter(1.0, "limits", "Factor on all acceleration limits.", low=0.001, high=1.0)
    jerk_scale: float = parameter(1.0, "limits", "Factor on all jerk limits.", low=0.001, high=1.0)
    tool_linear_speed: float = parameter(
        0.0, "limits", "Speed limit of the tool point; 0: none. Joint limits come first.", unit="m/s", low=0.0
    )
    tool_angular_speed: float = parameter(0.0, "limits", "Turning limit of the tool; 0: none.", unit="rad/s", low=0.0)
    tool_linear_acceleration: float = parameter(
        0.0, "limits", "Acceleration limit of the tool point; 0: none.", unit="m/s²", low=0.0
    )
    tool_angular_acceleration: float = parameter(
        0.0, "limits", "Angular acceleration limit of the tool; 0: none.", unit="rad/s²", low=0.0
    )
    # obstacles
    self_collision: bool = parameter(False, "obstacles", "Keep the arm off itself.", read_only=True)
    obstacle_avoidance: bool = parameter(
        False, "obstacles", "Keep the arm off the world: of `obstacles` and of the topic ~/obstacles.", read_only=True
    )
    obstacles: str = parameter(
        "", "obstacles", "YAML file of solids around the arm; switches obstacle_avoidance on.", read_only=True
    )
    srdf: str = parameter("", "obstacles", "SRDF file; its disable_collisions pairs may touch.", read_only=True)
    minimum_distance: float = parameter(
        0.02, "obstacles", "Distance that the arm keeps from the world.", unit="m", low=0.0, high=1.0
    )
    self_minimum_distance: float = parameter(
        0.005, "obstacles", "Distance that the arm keeps from itself.", unit="m", low=0.0, high=1.0
    )
    influence_distance: float = parameter(
        0.1, "obstacles", "Nearer than this, the approach is slowed by obstacle_gain.", unit="m", low=0.0, high=2.0
    )
    obstacle_gain: float = parameter(
        10.0, "obstacles", "Fastest approach for each metre above the minimum distance.", unit="1/s", low=0.1,
        high=1000.0,
    )  # fmt: skip
    # law
    gain: tuple[float, ...] = parameter(
        (50.0,),
        "law",
        "K of q̇ = J⁺(ẋ_d + K e): one value, 6 (x y z, rotation about x y z) or 36 (rows of a 6×6 matrix); "
        "positive definite, and K / rate ≤ 1.",
        unit="1/s",
        lengths=(1, 6, 36),
    )
    feed_forward: bool = parameter(True, "law", "Use the target's velocity ẋ_d; without it a moving target is trailed.")
    orientation_error: str = parameter(
        "exponential_base", "law", "Orientation part of e (notes N4).", legal=ORIENTATION_ERRORS
    )
    inverse: str = parameter(
        "numerical_filtering",
        "law",
        "J⁺ (notes N5): exact away from singularities, damped in the weak directions alone; the others are for study, "
        "take longer, and give way to it where they do not exist.",
        legal=INVERSES,
    )
    inverse_weights: tuple[float, ...] = parameter(
        (), "law", "Diagonal of the metric W: one value a joint for weighted_right, 6 for weighted_left.", low=1e-6
    )
    manipulability_threshold: float = parameter(
        0.05, "law", "Manipulability below which damped_manipulability damps.", low=1e-9
    )
    damping: float = parameter(0.05, "law", "Largest damping λ, reached at a singularity.", low=0.0, high=10.0)
    singular_value_threshold: float = parameter(
        0.04, "law", "Directions whose singular value is below this are damped; others are exact.", low=0.0, high=10.0
    )
    posture: tuple[float, ...] = parameter(
        (), "law", "Joint posture that redundancy is used for; empty: none is sought.", unit="rad, m"
    )
    posture_gain: float = parameter(
        1.0, "law", "Rate at which the posture is sought, in the null space.", unit="1/s", low=0.0
    )
    integration_base: str = parameter(
        "commanded",
        "law",
        "Where e and J are taken: at the commanded joints; at the measured ones; or at the commanded ones (bounded). "
        "The last two keep the commands within max_deviation of the measured joints.",
        legal=("commanded", "measured", "bounded"),
    )
    measured_gain: float = parameter(
        10.0,
        "law",
        "Largest gain where integration_base is measured: the loop then runs through the arm, and is stable while "
        "this times the arm's delay and lag stays below 0.5.",
        unit="1/s",
        low=0.01,
    )
    max_deviation: float = parameter(
        0.1, "law", "Largest commanded minus measured joint position, for integration_base bounded or measured.",
        unit="rad, m",
        low=1e-6,
    )  # fmt: skip
    # tasks
    task_axes: str = parameter(
        "xyzrpy", "tasks", "Axes that the tool must follow: letters of xyzrpy in this order, the last y the yaw."
    )
    task_frame: str = parameter(
        "base", "tasks", "Frame of these axes, and of K: the base, or the desired tool frame.", legal=("base", "tool")
    )
    task_tolerance: tuple[float, ...] = parameter(
        (),
        "tasks",
        "Band that the error of each axis may stay in, x y z and the rotations about them; one value: all; empty: 0.",
        unit="m, rad",
        low=0.0,
        lengths=(0, 1, 6),
    )
    secondary_tasks: tuple[str, ...] = parameter(
        (),
        "tasks",
        "Tasks below the tool's, the first first: 'position FRAME' or some axes ('z FRAME'), 'orientation FRAME', "
        "'swivel'.",
    )
    secondary_targets: tuple[float, ...] = parameter(
        (), "tasks", "Their targets in the base frame, one after the other.", unit="m, rad, 1"
    )
    secondary_gains: tuple[float, ...] = parameter((), "tasks", "Their gains; empty: 2.", unit="1/s", low=0.0)
    objectives: tuple[str, ...] = parameter(
        (), "tasks", "What is left climbs these: joint_centring, limit_repulsion, manipulability."
    )
    objective_gains: tuple[float, ...] = parameter((), "tasks", "Their gains; empty: 1.", unit="rad²/s")
    joint_weights: tuple[float, ...] = parameter(
        (), "tasks", "Effort of each joint's motion, of which the least is sought; empty: all the same.", low=1e-6
    )
    # reference
    mode: str = parameter(
        "auto",
        "reference",
        "Which targets are followed: the kind that arrived last, or one kind alone (pose: poses with their twists); "
        "others are rejected.",
        legal=("auto", "pose", "twist", "trajectory", "joints"),
    )
    twist_unit: str = parameter(
        "speed",
        "reference",
        "Twists and jogs are speeds (m/s, rad/s), or unitless, −1 to 1, times the scales below.",
        legal=("speed", "unitless"),
    )
    linear_scale: float = parameter(0.4, "reference", "Speed of a unitless linear 1.", unit="m/s", low=0.0, high=10.0)
    angular_scale: float = parameter(
        0.8, "reference", "Speed of a unitless angular 1.", unit="rad/s", low=0.0, high=30.0
    )
    joint_scale: float = parameter(
        0.5, "reference", "Speed of a unitless joint jog 1.", unit="rad/s, m/s", low=0.0, high=30.0
    )
    twist_reference_point: str = parameter(
        "tool",
        "reference",
        "A twist command is the velocity of the tool point, only rotated from its frame to the base (tool); or of the "
        "point of the tool's body that is at the frame's origin (frame). Twists beside poses are always of the tool.",
        legal=("tool", "frame"),
    )
    trajectory_mode: str = parameter(
        "replace",
        "reference",
        "A new trajectory replaces the last one, or is appended: what is before its first point stays, and stamp 0 "
        "means from the last one's end.",
        legal=("replace", "append"),
    )
    goal_position_tolerance: float = parameter(
        0.001, "reference", "A trajectory's goal is reached when the measured tool is this near.", unit="m", low=0.0
    )
    goal_orientation_tolerance: float = parameter(
        0.01,
        "reference",
        "A trajectory's goal is reached when the measured tool is turned by less than this.",
        unit="rad",
        low=0.0,
    )
    goal_joint_tolerance: float = parameter(
        0.01, "reference", "A joint trajectory's goal is reached when every joint is this near.", unit="rad, m", low=0.0
    )
    goal_time: float = parameter(
        1.0, "reference", "Time after a trajectory's end before its goal counts as missed.", unit="s", low=0.0
    )
    transform_timeout: float = parameter(
        0.1,
        "reference",
        "How long a target in a frame of TF waits for its transform before it is rejected.",
        unit="s",
        low=0.0,
        high=10.0,
    )
    reference_mode: str = parameter(
        "extrapolate",
        "reference",
        "Between samples: go on with the last twist, or interpolate `reference_delay` in the past.",
        legal=("extrapolate", "interpolate"),
    )
    reference_delay: float = parameter(
        0.03, "reference", "How far in the past to interpolate; take two sample periods.", unit="s", low=0.0, high=1.0
    )
    command_timeout: float = parameter(
        0.1, "reference", "Targets older than this, by arrival, stop the arm.", unit="s", low=0.001, high=10.0
    )
    feedback_timeout: float = parameter(
        0.1, "reference", "joint_states older than this, by arrival, halt the arm.", unit="s", low=0.001, high=10.0
    )
    stamp_tolerance: float = parameter(
        0.5,
        "reference",
        "A stamp further than this from the arrival is of another clock: only its spacing is used.",
        unit="s",
        low=0.0,
    )
    # node
    rate: float = parameter(
        1000.0, "node", "Control cycles a second.", unit="Hz", low=100.0, high=1000.0, read_only=True
    )
    monitor_rate: float = parameter(
        100.0, "node", "~/current_pose and ~/tracking_error a second.", unit="Hz", low=0.1, high=1000.0
    )
    status_rate: float = parameter(
        10.0, "node", "~/status a second; also sent on every change.", unit="Hz", low=0.1, high=100.0
    )
    arms: tuple[str, ...] = parameter(
        (),
        "node",
        "Several arms in one process: a node of each name, `left` or `left/arm`, with its own parameters, instead of "
        "this one.",
        read_only=True,
    )
    autostart: bool = parameter(
        True, "node", "Configure and activate at once; without it wait for the lifecycle services.", read_only=True
    )
    command_output: str = parameter(
        "joint_state",
        "node",
        "Type of the commands: JointState; JointTrajectory of one point; Float64MultiArray of positions or velocities.",
        legal=("joint_state", "joint_trajectory", "position_array", "velocity_array"),
        read_only=True,
    )
    command_topic: str = parameter(
        "",
        "node",
        "Topic of the commands; empty: joint_commands, joint_trajectory_controller/joint_trajectory, "
        "forward_position_controller/commands or forward_velocity_controller/commands.",
        read_only=True,
    )
    trajectory_velocities: bool = parameter(
        False,
        "node",
        "JointTrajectory commands have velocities too; joint_trajectory_controller takes them only with "
        "allow_nonzero_velocity_at_trajectory_end.",
        read_only=True,
    )
    second_publisher: str = parameter(
        "warn",
        "node",
        "When an input has more than one publisher: warn, refuse all its messages until one is left, or allow it.",
        legal=("warn", "refuse", "allow"),
    )
    tool_frame: str = parameter(
        "ik_controller_tool",
        "node",
        "TF frame of the tool point, sent below the tip frame where tf2 is installed; empty: not sent.",
        read_only=True,
    )
    servo_interface: bool = parameter(
        False, "node", "Inputs, services and status under MoveIt Servo's names and types.", read_only=True
    )
    servo_name: str = parameter("servo_node", "node", "Node name before MoveIt Servo's names.", read_only=True)
    # recording
    record: bool = parameter(True, "recording", "Record every run; the service ~/record switches it too.")
    record_folder: str = parameter("runs", "recording", "Folder that gets one bag a run; a change is for the next bag.")
    record_compression: str = parameter(
        "zstd", "recording", "Compression of the bag; a change is for the next bag.", legal=("zstd", "lz4", "none")
    )
    record_max_size: float = parameter(
        0.0, "recording", "Size at which a bag goes on in a new file; 0: never.", unit="MB", low=0.0
    )
    record_max_duration: float = parameter(
        0.0, "recording", "Time after which a bag goes on in a new file; 0: never.", unit="s", low=0.0
    )

    def __post_init__(self) -> None:
        for spec in specs():
            object.__setattr__(self, spec.name, parameter_spec.checked(spec, getattr(self, spec.name)))
        gain_matrix(self.gain, 1.0 / self.rate)
        if len(self.locked_joint_names) != len(self.locked_joint_values):
            raise ParameterError(
                f"locked_joint_values: {len(self.locked_joint_values)} values for "
                f"{len(self.locked_joint_names)} locked_joint_names"
            )
        if self.reference_mode == "interpolate" and self.reference_delay >= self.command_timeout:
            raise ParameterError(
                f"reference_delay {self.reference_delay:g} s must be below command_timeout {self.command_timeout:g} s"
            )

    # -- making one from what users write

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> ControllerParameters:
        """Make parameters from names and values. Raises ParameterError for an unknown name or a bad value."""
        return cls().replace(values)

    def replace(self, values: Mapping[str, Any]) -> ControllerParameters:
        """Return a copy with some values changed. Raises ParameterError as `from_mapping`."""
        known = {spec.name for spec in specs()}
        for name in values:
            if name not in known:
                near = difflib.get_close_matches(str(name), known, n=3) or sorted(known)
                raise ParameterError(f"unknown parameter '{name}'; did you mean: {choices(near)}")
        return dataclasses.replace(self, **dict(values))

    @classmethod
    def from_yaml(cls, path: str | Path) -> ControllerParameters:
        """Read a ROS 2 parameter file (`NODE: ros__parameters: …`) or plain `name: value` YAML; see `values_in`.

        Raises ParameterError: file missing, not YAML, no parameters in it, unknown name, bad value.
        """
        return cls.from_mapping(values_in(path))

    def as_mapping(self) -> dict[str, Any]:
        """Return names and values as plain JSON types (lists for tuples)."""
        return {
            spec.name: list(value) if isinstance(value := getattr(self, spec.name), tuple) else value
            for spec in specs()
        }


def specs() -> Iterator[Spec]:
    """Yield every parameter's Spec in the order of the documentation."""
    for item in dataclasses.fields(ControllerParameters):
        yield Spec(name=item.name, kind=str(item.type), default=item.default, **item.metadata)


def gain_matrix(gain: tuple[float, ...], dt: float) -> NDArray[np.float64]:
    """Return K (6, 6) [1/s] of 1, 6 or 36 values. Raises ParameterError: not positive definite, or K·dt > 1."""
    values = np.array(gain, dtype=float)
    matrix = np.diag(np.broadcast_to(values, 6)) if values.size in (1, 6) else values.reshape(6, 6)
    lowest = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0])
    if not lowest > 0.0:
        raise ParameterError(
            f"gain must be positive definite: the smallest eigenvalue of its symmetric part is {lowest:g}"
        )
    fastest = float(np.abs(np.linalg.eigvals(matrix)).max())
    if fastest * dt > 1.0 + 1e-6:  # cycles are whole nanoseconds: 1/rate may round up by half of one
        raise ParameterError(f"gain {fastest:g} 1/s times the cycle time {dt:g} s must be ≤ 1: at most {1 / dt:g} 1/s")
    return matrix


def table() -> str:
    """Return the Markdown table of all parameters, for the documentation."""
    return parameter_spec.table(specs(), SECTIONS)
