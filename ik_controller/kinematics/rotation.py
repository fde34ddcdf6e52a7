"""Rotations in all their forms, and the ways between them (note N14, 004 pp. 14-22).

A rotation matrix R (3, 3) holds the tool's axes as columns, in the base frame: p_base = R p_tool. Quaternions are
(x, y, z, w); the notes' Euler parameters λ = (λ0, λ1, λ2, λ3) are the same numbers as (w, x, y, z). Angles in radians:

    Z-Y-X Euler (α, β, γ)   R = Rz(α) Ry(β) Rx(γ)      singular at β = ±π/2
    X-Y-Z fixed (γ, β, α)   the same R, angles in the order x, y, z
    Z-X-Z Euler (α, β, γ)   R = Rz(α) Rx(β) Rz(γ)      singular at β = 0 and π

At a singularity only a sum or difference of the outer angles is defined; then the extraction takes α = 0, and the
angles still give back R.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.checks import Array, check_array

# How far from a rotation, or from unit length, a given matrix or quaternion may be.
UNIT_TOLERANCE = 1e-3
# Below this sine the outer Euler angles are rounding noise.
_NO_DIRECTION = 1e-12


def check_rotation(R: ArrayLike, name: str = "R") -> Array:
    """Return R (3, 3) as an array. Raises ArgumentError naming `name` unless R Rᵀ = I within 1e-3 and det R > 0."""
    matrix = check_array(R, name, (3, 3))
    deviation = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if deviation > UNIT_TOLERANCE:
        raise ArgumentError(f"{name}: not a rotation matrix, R Rᵀ differs from I by {deviation:.3g}")
    if np.linalg.det(matrix) < 0.0:
        raise ArgumentError(f"{name}: a reflection (det = -1), need a rotation (det = +1)")
    return matrix


def check_quaternion(quaternion: ArrayLike, name: str = "quaternion") -> Array:
    """Return a quaternion (4,) scaled to unit length. Raises ArgumentError naming `name` if off unit by over 1e-3."""
    values = check_array(quaternion, name, (4,))
    norm = float(np.linalg.norm(values))
    if abs(norm - 1.0) > UNIT_TOLERANCE:
        raise ArgumentError(f"{name}: norm is {norm:.6g}, need 1 within {UNIT_TOLERANCE:g}")
    unit: Array = values / norm
    return unit


def skew(v: ArrayLike) -> Array:
    """Return the cross-product matrix v̂ (3, 3) of v (3,): v̂ a = v × a (004 p. 32)."""
    x, y, z = check_array(v, "v", (3,)).tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rot_x(angle: float) -> Array:
    """Return the rotation (3, 3) about x by `angle` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rot_y(angle: float) -> Array:
    """Return the rotation (3, 3) about y by `angle` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rot_z(angle: float) -> Array:
    """Return the rotation (3, 3) about z by `angle` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# -- Euler parameters and quaternions


def rotation_from_euler_parameters(parameters: ArrayLike) -> Array:
    """Return R (3, 3) of Euler parameters λ (4,) = (λ0, λ1, λ2, λ3), the scalar first (004 p. 21).

    Raises ArgumentError if λ is not of unit length within 1e-3.
    """
    w, x, y, z = check_quaternion(parameters, "euler_parameters").tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def euler_parameters_from_rotation(R: ArrayLike, previous: ArrayLike | None = None) -> Array:
    """Return Euler parameters λ (4,) of R (3, 3), of the sign that continues `previous` (4,) (004 p. 22).

    One parameter is always of magnitude ≥ ½, so the division is by it. Of λ and −λ, the same rotation, the one nearer
    to `previous` is taken; without `previous` the one with λ0 ≥ 0. Raises ArgumentError: not a rotation.
    """
    matrix = check_rotation(R)
    r11, r12, r13, r21, r22, r23, r31, r32, r33 = matrix.ravel().tolist()
    # Row k is 4 λk λ.
    squares = (1.0 + r11 + r22 + r33, 1.0 + r11 - r22 - r33, 1.0 - r11 + r22 - r33, 1.0 - r11 - r22 + r33)
    rows = (
        (squares[0], r32 - r23, r13 - r31, r21 - r12),
        (r32 - r23, squares[1], r12 + r21, r13 + r31),
        (r13 - r31, r12 + r21, squares[2], r23 + r32),
        (r21 - r12, r13 + r31, r23 + r32, squares[3]),
    )
    largest = max(range(4), key=squares.__getitem__)
    parameters = np.array(rows[largest])
    parameters /= np.linalg.norm(parameters)
    if previous is None:
        return -parameters if parameters[0] < 0.0 else parameters
    before = check_quaternion(previous, "previous")
    return -parameters if float(parameters @ before) < 0.0 else parameters


def rotation_from_quaternion(quaternion: ArrayLike) -> Array:
    """Return R (3, 3) of a quaternion (4,) (x, y, z, w). Raises ArgumentError if off unit length by over 1e-3."""
    x, y, z, w = check_quaternion(quaternion).tolist()
    return rotation_from_euler_parameters((w, x, y, z))


def quaternion_from_rotation(R: ArrayLike, previous: ArrayLike | None = None) -> Array:
    """Return the quaternion (4,) (x, y, z, w) of R (3, 3), sign as in `euler_parameters_from_rotation`."""
    before = None if previous is None else np.roll(check_quaternion(previous, "previous"), 1)
    return np.roll(euler_parameters_from_rotation(R, before), -1)


# -- angles


def rotation_from_euler_zyx(angles: ArrayLike) -> Array:
    """Return R (3, 3) = Rz(α) Ry(β) Rx(γ) of angles (3,) (α, β, γ) [rad] (004 p. 15)."""
    alpha, beta, gamma = check_array(angles, "angles", (3,)).tolist()
    R: Array = rot_z(alpha) @ rot_y(beta) @ rot_x(gamma)
    return R


def euler_zyx_from_rotation(R: ArrayLike) -> Array:
    """Return Z-Y-X Euler angles (3,) (α, β, γ) [rad] of R (3, 3), |β| ≤ π/2; α = 0 where β = ±π/2 (004 p. 15)."""
    matrix = check_rotation(R)
    r11, r12, r13, r21, r22, r23, r31, _, _ = matrix.ravel().tolist()
    alpha = math.atan2(r21, r11) if math.hypot(r11, r21) > _NO_DIRECTION else 0.0
    c, s = math.cos(alpha), math.sin(alpha)
    # The rest from Rz(−α) R = Ry(β) Rx(γ): accurate however near the singularity.
    beta = math.atan2(-r31, c * r11 + s * r21)
    gamma = math.atan2(s * r13 - c * r23, c * r22 - s * r12)
    return np.array([alpha, beta, gamma])


def rotation_from_fixed_xyz(angles: ArrayLike) -> Array:
    """Return R (3, 3) of angles (3,) (γ, β, α) [rad] about the fixed axes x, then y, then z (004 p. 16)."""
    gamma, beta, alpha = check_array(angles, "angles", (3,)).tolist()
    return rotation_from_euler_zyx((alpha, beta, gamma))


def fixed_xyz_from_rotation(R: ArrayLike) -> Array:
    """Return X-Y-Z fixed angles (3,) (γ, β, α) [rad] of R (3, 3): the Z-Y-X Euler angles reversed (004 p. 17)."""
    angles: Array = euler_zyx_from_rotation(R)[::-1].copy()
    return angles


def rotation_from_euler_zxz(angles: ArrayLike) -> Array:
    """Return R (3, 3) = Rz(α) Rx(β) Rz(γ) of angles (3,) (α, β, γ) [rad] (004 p. 27)."""
    alpha, beta, gamma = check_array(angles, "angles", (3,)).tolist()
    R: Array = rot_z(alpha) @ rot_x(beta) @ rot_z(gamma)
    return R


def euler_zxz_from_rotation(R: ArrayLike) -> Array:
    """Return Z-X-Z Euler angles (3,) (α, β, γ) [rad] of R (3, 3), 0 ≤ β ≤ π; α = 0 where β = 0 or π (004 p. 27)."""
    matrix = check_rotation(R)
    r11, r12, r13, r21, r22, r23, _, _, r33 = matrix.ravel().tolist()
    alpha = math.atan2(r13, -r23) if math.hypot(r13, r23) > _NO_DIRECTION else 0.0
    c, s = math.cos(alpha), math.sin(alpha)
    # From Rz(−α) R = Rx(β) Rz(γ).
    beta = math.atan2(s * r13 - c * r23, r33)
    gamma = math.atan2(-c * r12 - s * r22, c * r11 + s * r21)
    return np.array([alpha, beta, gamma])


# -- exponential coordinates


def exp_rotation(rotation_vector: ArrayLike) -> Array:
    """Return R (3, 3) = exp(ŵ) of exponential coordinates w (3,) = axis · angle [rad] (000)."""
    R: Array = pin.exp3(check_array(rotation_vector, "rotation_vector", (3,)))
    return R


def log_rotation(R: ArrayLike) -> Array:
    """Return exponential coordinates (3,) = axis · angle [rad] of R (3, 3), angle ≤ π; at π either sign (000)."""
    vector: Array = pin.log3(check_rotation(R))
    return vector


def rotation_angle(R: ArrayLike) -> float:
    """Return the angle [rad] in [0, π] by which R (3, 3) turns."""
    return float(np.linalg.norm(log_rotation(R)))
