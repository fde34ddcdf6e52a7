"""Orientation errors: what is left to turn from R to R_desired, reference minus current (note N4).

All agree to first order, and differ in how they weigh large angles θ and in where they fail:

    name                    frame   value                               length     fails
    exponential_base        base    log(R_d Rᵀ), the "boxminus"         θ          at θ = π: two ways are equally short
    exponential_tool        tool    log(Rᵀ R_d)                         θ          the same
    quaternion              base    2 sgn(λ0) (λ1, λ2, λ3) of R_d Rᵀ    2 sin θ/2  the same
    instantaneous           base    ½ Σ rᵢ × r_id                       sin θ      shrinks beyond π/2, is 0 at π
    euler_relative_tool     tool    X-Y-Z fixed angles of Rᵀ R_d        –          from θ = π/2 on, if |β| reaches π/2
    euler_difference_zyx    angles  φ_d − φ, each the short way         –          where R or R_d has β = ±π/2
    euler_difference_xyz    angles  the same with X-Y-Z fixed angles    –          the same
    euler_difference_zxz    angles  the same with Z-X-Z Euler angles    –          where R or R_d has β = 0 or π

An error e lives in its own frame; `to_angular_velocity(g, R)` turns g = K e into the ω in the base frame that the
control law adds to the reference: the identity, R g, or E⁺(φ) g. With K scalar the tool and base forms agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ik_controller.errors import ArgumentError, choices
from ik_controller.kinematics.checks import Array, check_array
from ik_controller.kinematics.representations import EULER_ZXZ, EULER_ZYX, FIXED_XYZ, Representation
from ik_controller.kinematics.rotation import check_rotation, euler_parameters_from_rotation, fixed_xyz_from_rotation


@dataclass(frozen=True)
class OrientationError:
    """One orientation error; call it as error(R_desired, R) → e (3,) [rad].

    `function` and `to_angular_velocity` do the work without checking their arguments, for loops; a call checks them.
    `frame`: "base", "tool" or "angles". `valid_angle` [rad]: below this angle between R_desired and R the error
    grows with the angle and the command to_angular_velocity(e, R) shrinks it; for Euler differences it counts from an R
    halfway between their singularities, and is less by as much as R is nearer to one. `doc`: where it fails, in words.
    """

    name: str
    frame: str
    function: Callable[[Array, Array], Array]
    to_angular_velocity: Callable[[Array, Array], Array]
    valid_angle: float
    doc: str

    def __call__(self, R_desired: ArrayLike, R: ArrayLike) -> Array:
        """Return e (3,) [rad]. Raises ArgumentError unless R_desired and R are rotation matrices (3, 3)."""
        return self.function(check_rotation(R_desired, "R_desired"), check_rotation(R))

    def angular_velocity(self, e: ArrayLike, R: ArrayLike) -> Array:
        """Return ω (3,) in the base frame for e or K e (3,) at the current R. Raises ArgumentError on bad input."""
        return self.to_angular_velocity(check_array(e, "e", (3,)), check_rotation(R))


def exponential_base(R_desired: Array, R: Array) -> Array:
    """Return log(R_desired Rᵀ) (3,) [rad] in the base frame: the rotation that takes R to R_desired (001, 000 (2))."""
    e: Array = pin.log3(R_desired.dot(R.T))
    return e


def exponential_tool(R_desired: Array, R: Array) -> Array:
    """Return log(Rᵀ R_desired) (3,) [rad] in the tool frame (000 (2))."""
    e: Array = pin.log3(R.T.dot(R_desired))
    return e


def quaternion(R_desired: Array, R: Array) -> Array:
    """Return 2 sgn(λ0) (λ1, λ2, λ3) (3,) of R_desired Rᵀ, in the base frame (000 (3), scaled to gradient 1).

    The notes' (q1, q2, q3) of Rᵀ R_desired, in the tool frame, is ½ Rᵀ of this.
    """
    return 2.0 * euler_parameters_from_rotation(R_desired.dot(R.T))[1:]


def instantaneous(R_desired: Array, R: Array) -> Array:
    """Return ½ Σ rᵢ × r_id (3,) in the base frame, rᵢ the columns of R (004 p. 73, which has current − desired)."""
    # Σ rᵢ × r_id is the vector of the skew part of R_d Rᵀ.
    M = R_desired.dot(R.T)
    return 0.5 * np.array([M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]])


def euler_relative_tool(R_desired: Array, R: Array) -> Array:
    """Return the X-Y-Z fixed angles (3,) [rad] of Rᵀ R_desired, in the tool frame (000 (1), method 2).

    These are the Z-Y-X Euler angles in the order x, y, z, so that the gradient at zero is the identity.
    """
    return fixed_xyz_from_rotation(R.T.dot(R_desired))


def _as_it_is(g: Array, R: Array) -> Array:
    return g


def _tool_to_base(g: Array, R: Array) -> Array:
    omega: Array = R.dot(g)
    return omega


def _euler_difference(name: str, angles: Representation) -> OrientationError:
    """Return the error φ_d − φ of an Euler-angle representation (000 (1), method 1)."""

    def difference(R_desired: Array, R: Array) -> Array:
        return angles.wrap(angles.encode(R_desired, None) - angles.encode(R, None))

    def to_angular_velocity(g: Array, R: Array) -> Array:
        omega: Array = angles.inverse_matrix(angles.encode(R, None)).dot(g)
        return omega

    doc = f"fails where R or R_desired has {angles.condition}: angles jump there, and E⁺ loses a direction"
    return OrientationError(name, "angles", difference, to_angular_velocity, math.pi / 2, doc)


_AT_PI = "at pi two ways are equally short and either may be taken"

ORIENTATION_ERRORS: dict[str, OrientationError] = {
    error.name: error
    for error in (
        OrientationError("exponential_base", "base", exponential_base, _as_it_is, math.pi, _AT_PI),
        OrientationError("exponential_tool", "tool", exponential_tool, _tool_to_base, math.pi, _AT_PI),
        OrientationError("quaternion", "base", quaternion, _as_it_is, math.pi, _AT_PI),
        OrientationError(
            "instantaneous",
            "base",
            instantaneous,
            _as_it_is,
            math.pi / 2,
            "from pi/2 on it shrinks as the angle grows, and is zero at pi; below pi it still points the right way",
        ),
        OrientationError(
            "euler_relative_tool",
            "tool",
            euler_relative_tool,
            _tool_to_base,
            math.pi / 2,
            "from pi/2 on the angles can be singular and point away from the short way",
        ),
        _euler_difference("euler_difference_zyx", EULER_ZYX),
        _euler_difference("euler_difference_xyz", FIXED_XYZ),
        _euler_difference("euler_difference_zxz", EULER_ZXZ),
    )
}
DEFAULT_ORIENTATION_ERROR = "exponential_base"


def orientation_error(name: str = DEFAULT_ORIENTATION_ERROR) -> OrientationError:
    """Return an orientation error by name. Raises ArgumentError naming the legal ones."""
    if name not in ORIENTATION_ERRORS:
        raise ArgumentError(f"orientation error '{name}' is unknown; legal: {choices(ORIENTATION_ERRORS)}")
    return ORIENTATION_ERRORS[name]
