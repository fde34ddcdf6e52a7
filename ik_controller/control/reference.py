"""Reference: the set point of one cycle.

A tool reference holds the pose x_d at the cycle's start and the twist that moves it over the cycle, ẋ_d. Given as the
*secant* (x_d(t + dt) ⊖ x_d(t)) / dt, the feed-forward is exact at the end of each cycle, whatever dt; an instantaneous
twist is a first-order approximation of it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ik_controller.errors import ArgumentError, ModelError
from ik_controller.kinematics.checks import check_array
from ik_controller.kinematics.model import pose_from

Array = NDArray[np.float64]


class Reference(NamedTuple):
    """A set point: a tool pose with its twist, a twist alone, joint positions with their velocities, or these alone.

    `position` (3,) [m], `rotation` (3, 3), `twist` (6,) (v, ω) [m/s, rad/s] in the base frame; `joints` (n,) [rad or
    m],
    `joint_velocity` (n,); `about` (3,) [m]: the point of the tool's body that a twist alone is the velocity of, None
    for the tool point. Prefer the constructors `pose`, `velocity`, `between` and `joint`.
    """

    position: Array | None = None
    rotation: Array | None = None
    twist: Array | None = None
    joints: Array | None = None
    joint_velocity: Array | None = None
    about: Array | None = None

    @property
    def in_joint_space(self) -> bool:
        """Whether this is a set point of the joints."""
        return self.joints is not None or self.joint_velocity is not None

    @classmethod
    def pose(cls, pose: Any, twist: ArrayLike | None = None) -> Reference:
        """Make a tool reference of a `pin.SE3` or (7,) x y z qx qy qz qw [m], and a twist (6,), zero unless given.

        Raises ArgumentError where a shape is wrong, a value is not finite or the quaternion is off unit by 1e-3.
        """
        placement = _placement(pose)
        return cls(
            position=np.array(placement.translation),
            rotation=np.array(placement.rotation),
            twist=np.zeros(6) if twist is None else _vector(twist, "twist", 6),
        )

    @classmethod
    def velocity(cls, twist: ArrayLike) -> Reference:
        """Make a pure velocity command (6,) (v, ω) [m/s, rad/s] of the tool point, in the base frame."""
        return cls(twist=_vector(twist, "twist", 6))

    @classmethod
    def between(cls, now: Any, then: Any, dt: float) -> Reference:
        """Make the reference that moves from pose `now` to pose `then` within dt [s]; poses as in `pose`."""
        if not dt > 0.0:
            raise ArgumentError(f"dt = {dt}: need a positive time")
        start, end = _placement(now), _placement(then)
        turn = pin.log3(end.rotation @ start.rotation.T)
        return cls.pose(start, np.concatenate((end.translation - start.translation, turn)) / dt)

    @classmethod
    def joint(cls, joints: ArrayLike, velocity: ArrayLike | None = None) -> Reference:
        """Make a joint-space reference (n,) [rad or m] with velocities (n,), zero unless given."""
        target = _vector(joints, "joints", None)
        rate = np.zeros_like(target) if velocity is None else _vector(velocity, "joint velocity", target.size)
        return cls(joints=target, joint_velocity=rate)


def _placement(pose: Any) -> Any:
    if isinstance(pose, pin.SE3):
        if not np.isfinite(pose.homogeneous).all():
            raise ArgumentError(f"pose: values must be finite: {pose.homogeneous[:3].ravel().tolist()}")
        return pose
    try:
        return pose_from(check_array(pose, "pose", (7,)))
    except ModelError as error:  # the quaternion; a pose is not the model's fault here
        raise ArgumentError(str(error)) from None


def _vector(values: ArrayLike, name: str, size: int | None) -> Array:
    return np.array(check_array(values, name, (size,)))
