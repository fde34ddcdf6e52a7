"""Task: the pose to reach, the axes that count, and the error and Jacobian an iterative solver sees (N4, N7).

Three forms of the same error, `frame`:

    base   e = (p_d − p, e_R) in base axes with the basic Jacobian J₀; e_R any orientation error of N4
    body   [E_b] = log(T_sb⁻¹ T_sd), the twist in the tool frame, with the body Jacobian J_b
    space  E_s = Ad(T_sb) E_b, the same twist seen from the base frame's origin, with the space Jacobian J_s

Twists are (v, ω), as everywhere here; the notes write (ω, v). With a subset of the axes, "body" is the form of "base"
along the axes of the desired tool frame: single components of a twist are no distances.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.checks import check_choice
from ik_controller.kinematics.levenberg_marquardt import select_axes
from ik_controller.kinematics.model import pose_from
from ik_controller.kinematics.orientation_error import DEFAULT_ORIENTATION_ERROR, OrientationError, orientation_error

Array = NDArray[np.float64]

AXES = ("x", "y", "z", "r", "p", "y")
FRAMES = ("base", "body", "space")
_BASE_AXES = np.eye(3)


@lru_cache(maxsize=128)
def axes_mask(axes: str) -> Array:
    """Return (6,) ones and zeros for a subset of "xyzrpy", in that order: "xyz", "xyzrp", "xyy" (x, y and yaw).

    A y before any z, r or p is the position's, unless it has been named; a later one is the yaw. Raises ArgumentError.
    """
    mask = np.zeros(6)
    at = 0
    for letter in axes:
        while at < 6 and AXES[at] != letter:
            at += 1
        if at == 6:
            raise ArgumentError(f"axes '{axes}': need letters of xyzrpy in this order, the last y being the yaw")
        mask[at] = 1.0
        at += 1
    if not mask.any():
        raise ArgumentError("axes '': need at least one letter of xyzrpy")
    return mask


def pose_of(pose: Any) -> Any:
    """Return a pose given as `pin.SE3` or (7,) x y z qx qy qz qw as a checked `pin.SE3`. Raises ArgumentError."""
    if not isinstance(pose, pin.SE3):
        try:
            return pose_from(pose, "pose")
        except Exception as error:
            raise ArgumentError(str(error)) from None
    if not math.isfinite(sum(pose.translation.tolist())):
        raise ArgumentError("pose: values must be finite")
    if not is_rotation(pose.rotation.tolist()):
        raise ArgumentError("pose: its rotation is not a rotation matrix, or not finite")
    return pose


def is_rotation(rows: list[list[float]]) -> bool:
    """Return whether a 3 × 3 matrix is a rotation, within 1e-6: x and y orthonormal, z their cross product."""
    (a, d, g), (b, e, h), (c, f, i) = rows  # columns (a b c) (d e f) (g h i)
    worst = max(
        abs(a * a + b * b + c * c - 1.0),
        abs(d * d + e * e + f * f - 1.0),
        abs(a * d + b * e + c * f),
        abs(b * f - c * e - g),
        abs(c * d - a * f - h),
        abs(a * e - b * d - i),
    )
    return worst < 1e-6 and not math.isnan(a + b + c + d + e + f + g + h + i)


@dataclass(slots=True)
class Task:
    """What to reach: `rotation` (3, 3), `position` (3,) [m]; `mask` (6,) of `frame`'s axes; the orientation error."""

    rotation: Array
    position: Array
    mask: Array
    frame: str
    orientation: OrientationError

    @classmethod
    def create(cls, pose: ArrayLike, axes: str, frame: str, orientation: str = DEFAULT_ORIENTATION_ERROR) -> Task:
        """Check and collect. Raises ArgumentError naming pose, axes, frame or orientation error."""
        check_choice(frame, "frame", FRAMES)
        mask = axes_mask(axes)
        if frame == "space" and axes != "xyzrpy":
            raise ArgumentError("axes: frame 'space' takes all of xyzrpy; take frame 'base' or 'body' for a subset")
        placement = pose_of(pose)
        return cls(
            np.ascontiguousarray(placement.rotation),
            np.array(placement.translation),
            mask,
            frame,
            orientation_error(orientation),
        )

    @property
    def axes_frame(self) -> Array:
        """(3, 3): the axes that the mask speaks of, as columns: the base's, or the desired tool frame's."""
        return self.rotation if self.frame == "body" else _BASE_AXES

    def pose_error(self, rotation: Array, position: Array) -> tuple[float, float]:
        """Return position error [m] and orientation error [rad] over the axes that count, whatever the frame."""
        error = np.concatenate((self.position - position, pin.log3(self.rotation @ rotation.T)))
        axes = self.axes_frame
        error = self.mask * np.concatenate((axes.T @ error[:3], axes.T @ error[3:]))
        return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))

    def pose_error_at(self, pose: Any) -> tuple[float, float]:
        """Return `pose_error` of a `pin.SE3`."""
        return self.pose_error(pose.rotation, pose.translation)

    def error_and_jacobian(self, rotation: Array, position: Array, jacobian: Array) -> tuple[Array, Array]:
        """Return e (6,) and its Jacobian (6, n) in the task's frame from J₀, both 0 in the rows that do not count."""
        if self.frame == "base" or not self.mask.all():
            turn = self.orientation.to_angular_velocity(self.orientation.function(self.rotation, rotation), rotation)
            error = np.concatenate((self.position - position, turn))
            jacobian = jacobian.copy()
            if not self.mask.all():
                select_axes(self.axes_frame, self.mask, error, jacobian)
            return error, jacobian
        tool = pin.SE3(rotation, position)
        twist = pin.log6(tool.actInv(pin.SE3(self.rotation, self.position))).vector
        if self.frame == "space":
            to_origin = np.block([[np.eye(3), pin.skew(position)], [np.zeros((3, 3)), np.eye(3)]])
            return tool.toActionMatrix() @ twist, to_origin @ jacobian
        body = np.vstack((rotation.T @ jacobian[:3], rotation.T @ jacobian[3:]))
        return self.mask * twist, self.mask[:, None] * body
