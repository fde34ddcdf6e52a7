"""Operational coordinates x: positions, rotations, and both together, with E(x), E⁺(x) and singularities (N3, 004).

    ẋ = E(x) (v, ω)        (v, ω) = E⁺(x) ẋ        E⁺ E = I        J = E(x) J₀

E has a division that fails at a singularity of the representation; E⁺ has none and always exists. `singularity(x)`
says how far away that is; `E(x)` at a singularity raises instead of dividing. The direction cosines and the Euler
parameters have more coordinates than degrees of freedom and no singularity.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ik_controller.errors import ArgumentError
from ik_controller.kinematics import rotation
from ik_controller.kinematics.checks import Array, check_array, check_choice, check_number
from ik_controller.kinematics.model import RobotModel

# Nearer to a singularity than this (a sine, or metres from the axis) a representation reports `singular`.
SINGULAR_BELOW = 1e-6


@dataclass(frozen=True)
class Singularity:
    """How near x is to a singularity of its representation.

    `measure`: 0 at the singularity; metres from the z axis for positions, |cos β| or |sin β| for Euler angles, infinite
    where there is none. `singular`: measure < tolerance. `condition`: where it is, "" where there is none.
    """

    measure: float
    singular: bool
    condition: str


@dataclass(frozen=True)
class Representation:
    """One way to write a position p (3,) [m] or a rotation R (3, 3) as coordinates x (m,); get it by name.

    `angular` tells which coordinates are angles, whose differences wrap at π; `constraint` checks what redundant
    coordinates must fulfil. The functions given as fields do the work unchecked; the methods check their arguments and
    raise ArgumentError.
    """

    name: str
    kind: str  # "position" or "rotation"
    coordinate_names: tuple[str, ...]
    angular: tuple[bool, ...]
    encode: Callable[[Array, Array | None], Array]
    decode: Callable[[Array], Array]
    matrix: Callable[[Array], Array]
    inverse_matrix: Callable[[Array], Array]
    distance: Callable[[Array], float] = lambda x: math.inf
    condition: str = ""
    constraint: Callable[[Array, str], Array] = lambda x, name: x

    @property
    def size(self) -> int:
        """Number of coordinates m."""
        return len(self.coordinate_names)

    def coordinates(self, part: ArrayLike, previous: ArrayLike | None = None) -> Array:
        """Return x (m,) of a position (3,) [m] or rotation (3, 3).

        `previous` (m,): coordinates just before; only the Euler parameters use it, to keep their sign.
        """
        before = None if previous is None else check_array(previous, "previous", (self.size,))
        if self.kind == "position":
            return self.encode(check_array(part, "position", (3,)), before)
        return self.encode(rotation.check_rotation(part, "rotation"), before)

    def part(self, x: ArrayLike) -> Array:
        """Return the position (3,) [m] or rotation (3, 3) that x (m,) stands for."""
        return self.decode(self._check(x))

    def E(self, x: ArrayLike, tolerance: float = SINGULAR_BELOW) -> Array:
        """Return E(x) (m, 3): ẋ = E v or ẋ = E ω. Raises ArgumentError where x is singular."""
        values = self._check(x)
        report = self.singularity(values, tolerance)
        if report.singular:
            raise ArgumentError(
                f"x: representation '{self.name}' is singular at {report.condition} (measure {report.measure:.3g})"
            )
        return self.matrix(values)

    def E_inverse(self, x: ArrayLike) -> Array:
        """Return E⁺(x) (3, m), a left inverse of E: v or ω = E⁺ ẋ. Exists everywhere, loses rank where E does not."""
        return self.inverse_matrix(self._check(x))

    def singularity(self, x: ArrayLike, tolerance: float = SINGULAR_BELOW) -> Singularity:
        """Return how near x (m,) is to a singularity of this representation."""
        limit = check_number(tolerance, "tolerance", minimum=0.0)
        measure = self.distance(self._check(x))
        return Singularity(measure, measure < limit, self.condition)

    def difference(self, x_desired: ArrayLike, x: ArrayLike) -> Array:
        """Return e = x_desired − x (m,), angles the short way, in [−π, π]. The minimum-coordinate error of 000."""
        return self.wrap(self._check(x_desired, "x_desired") - self._check(x))

    def wrap(self, difference: Array) -> Array:
        """Return a difference of coordinates (m,) with its angles brought into [−π, π]."""
        turns = np.where(self.angular, np.round(difference / (2.0 * math.pi)), 0.0)
        return difference - 2.0 * math.pi * turns

    def _check(self, x: ArrayLike, name: str = "x") -> Array:
        label = f"{name} ({self.name})"
        return self.constraint(check_array(x, label, (self.size,)), label)


# -- positions


def _cylindrical(p: Array, _: Array | None) -> Array:
    return np.array([math.hypot(p[0], p[1]), math.atan2(p[1], p[0]), p[2]])


def _cylindrical_E(x: Array) -> Array:
    rho, c, s = x[0], math.cos(x[1]), math.sin(x[1])
    return np.array([[c, s, 0.0], [-s / rho, c / rho, 0.0], [0.0, 0.0, 1.0]])


def _cylindrical_E_inverse(x: Array) -> Array:
    # 004 p. 65 prints −sin θ in the first column; the inverse has +sin θ.
    rho, c, s = x[0], math.cos(x[1]), math.sin(x[1])
    return np.array([[c, -rho * s, 0.0], [s, rho * c, 0.0], [0.0, 0.0, 1.0]])


def _spherical(p: Array, _: Array | None) -> Array:
    level = math.hypot(p[0], p[1])
    return np.array([math.hypot(level, p[2]), math.atan2(p[1], p[0]), math.atan2(level, p[2])])


def _spherical_E(x: Array) -> Array:
    # 004 pp. 26 and 66 print z = ρ cos θ and cos θ in the first row; it is φ, the angle from the z axis.
    rho, c, s, cp, sp = x[0], math.cos(x[1]), math.sin(x[1]), math.cos(x[2]), math.sin(x[2])
    return np.array(
        [
            [c * sp, s * sp, cp],
            [-s / (rho * sp), c / (rho * sp), 0.0],
            [c * cp / rho, s * cp / rho, -sp / rho],
        ]
    )


def _spherical_E_inverse(x: Array) -> Array:
    # 004 p. 67 prints +ρ sin θ sin φ in row 1 and −sin θ sin φ in row 2; both signs are the other way round.
    rho, c, s, cp, sp = x[0], math.cos(x[1]), math.sin(x[1]), math.cos(x[2]), math.sin(x[2])
    return np.array(
        [
            [c * sp, -rho * s * sp, rho * c * cp],
            [s * sp, rho * c * sp, rho * s * cp],
            [cp, 0.0, -rho * sp],
        ]
    )


CARTESIAN = Representation(
    name="cartesian",
    kind="position",
    coordinate_names=("x", "y", "z"),
    angular=(False, False, False),
    encode=lambda p, _: p.copy(),
    decode=lambda x: x.copy(),
    matrix=lambda x: np.eye(3),
    inverse_matrix=lambda x: np.eye(3),
)
CYLINDRICAL = Representation(
    name="cylindrical",
    kind="position",
    coordinate_names=("rho", "theta", "z"),
    angular=(False, True, False),
    encode=_cylindrical,
    decode=lambda x: np.array([x[0] * math.cos(x[1]), x[0] * math.sin(x[1]), x[2]]),
    matrix=_cylindrical_E,
    inverse_matrix=_cylindrical_E_inverse,
    distance=lambda x: abs(float(x[0])),
    condition="rho = 0 (on the z axis)",
)
SPHERICAL = Representation(
    name="spherical",
    kind="position",
    coordinate_names=("rho", "theta", "phi"),
    angular=(False, True, True),
    encode=_spherical,
    decode=lambda x: (
        x[0] * np.array([math.cos(x[1]) * math.sin(x[2]), math.sin(x[1]) * math.sin(x[2]), math.cos(x[2])])
    ),
    matrix=_spherical_E,
    inverse_matrix=_spherical_E_inverse,
    distance=lambda x: abs(float(x[0]) * math.sin(x[2])),
    condition="rho sin(phi) = 0 (on the z axis)",
)


# -- rotations


def _direction_cosines_E(x: Array) -> Array:
    # ṙᵢ = ω × rᵢ = −r̂ᵢ ω
    return -np.vstack([rotation.skew(x[0:3]), rotation.skew(x[3:6]), rotation.skew(x[6:9])])


def _zyx_E(x: Array) -> Array:
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    return np.array([[ca * sb / cb, sa * sb / cb, 1.0], [-sa, ca, 0.0], [ca / cb, sa / cb, 0.0]])


def _zyx_E_inverse(x: Array) -> Array:
    # Columns: the axes about which α, β, γ turn: z; y after α; x after α and β.
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    return np.array([[0.0, -sa, ca * cb], [0.0, ca, sa * cb], [1.0, 0.0, -sb]])


def _zxz_E(x: Array) -> Array:
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    return np.array([[-sa * cb / sb, ca * cb / sb, 1.0], [ca, sa, 0.0], [sa / sb, -ca / sb, 0.0]])


def _zxz_E_inverse(x: Array) -> Array:
    ca, sa, cb, sb = math.cos(x[0]), math.sin(x[0]), math.cos(x[1]), math.sin(x[1])
    return np.array([[0.0, ca, sa * sb], [0.0, sa, -ca * sb], [1.0, 0.0, cb]])


def _euler_parameters_E(x: Array) -> Array:
    w, a, b, c = x.tolist()
    return 0.5 * np.array([[-a, -b, -c], [w, c, -b], [-c, w, a], [b, -a, w]])


def _orthonormal(x: Array, name: str) -> Array:
    rotation.check_rotation(x.reshape(3, 3).T, name)
    return x


DIRECTION_COSINES = Representation(
    name="direction_cosines",
    kind="rotation",
    coordinate_names=tuple(f"r{row}{column}" for column in "123" for row in "123"),
    angular=(False,) * 9,
    encode=lambda R, _: R.T.reshape(9).copy(),
    decode=lambda x: x.reshape(3, 3).T.copy(),
    matrix=_direction_cosines_E,
    inverse_matrix=lambda x: 0.5 * _direction_cosines_E(x).T,
    constraint=_orthonormal,
)
EULER_ZYX = Representation(
    name="euler_zyx",
    kind="rotation",
    coordinate_names=("alpha", "beta", "gamma"),
    angular=(True, True, True),
    encode=lambda R, _: rotation.euler_zyx_from_rotation(R),
    decode=rotation.rotation_from_euler_zyx,
    matrix=_zyx_E,
    inverse_matrix=_zyx_E_inverse,
    distance=lambda x: abs(math.cos(x[1])),
    condition="beta = ±pi/2",
)
FIXED_XYZ = Representation(
    name="fixed_xyz",
    kind="rotation",
    coordinate_names=("gamma", "beta", "alpha"),
    angular=(True, True, True),
    encode=lambda R, _: rotation.fixed_xyz_from_rotation(R),
    decode=rotation.rotation_from_fixed_xyz,
    matrix=lambda x: _zyx_E(x[::-1])[::-1].copy(),
    inverse_matrix=lambda x: _zyx_E_inverse(x[::-1])[:, ::-1].copy(),
    distance=lambda x: abs(math.cos(x[1])),
    condition="beta = ±pi/2",
)
EULER_ZXZ = Representation(
    name="euler_zxz",
    kind="rotation",
    coordinate_names=("alpha", "beta", "gamma"),
    angular=(True, True, True),
    encode=lambda R, _: rotation.euler_zxz_from_rotation(R),
    decode=rotation.rotation_from_euler_zxz,
    matrix=_zxz_E,
    inverse_matrix=_zxz_E_inverse,
    distance=lambda x: abs(math.sin(x[1])),
    condition="beta = 0 or pi",
)
EULER_PARAMETERS = Representation(
    name="euler_parameters",
    kind="rotation",
    coordinate_names=("lambda0", "lambda1", "lambda2", "lambda3"),
    angular=(False,) * 4,
    encode=rotation.euler_parameters_from_rotation,
    decode=rotation.rotation_from_euler_parameters,
    matrix=_euler_parameters_E,
    inverse_matrix=lambda x: 4.0 * _euler_parameters_E(x).T,
    constraint=rotation.check_quaternion,
)

POSITIONS = {r.name: r for r in (CARTESIAN, CYLINDRICAL, SPHERICAL)}
ROTATIONS = {r.name: r for r in (DIRECTION_COSINES, EULER_ZYX, FIXED_XYZ, EULER_ZXZ, EULER_PARAMETERS)}


@dataclass(frozen=True)
class PoseRepresentation:
    """A position and a rotation representation together: x = (x_p, x_r) (m,), E block-diagonal (m, 6) (004 p. 24)."""

    position: Representation
    rotation: Representation

    @property
    def size(self) -> int:
        """Number of coordinates m."""
        return self.position.size + self.rotation.size

    def split(self, x: ArrayLike, name: str = "x") -> tuple[Array, Array]:
        """Return x_p and x_r of x (m,). Raises ArgumentError where the shape is wrong or a value not finite."""
        values = check_array(x, name, (self.size,))
        return values[: self.position.size], values[self.position.size :]

    def coordinates(self, pose: Any, previous: ArrayLike | None = None) -> Array:
        """Return x (m,) of a `pin.SE3`; `previous` (m,) keeps the sign of Euler parameters."""
        before = None if previous is None else self.split(previous, "previous")[1]
        x_p = self.position.coordinates(pose.translation)
        return np.concatenate((x_p, self.rotation.coordinates(pose.rotation, before)))

    def pose(self, x: ArrayLike) -> Any:
        """Return the `pin.SE3` that x (m,) stands for."""
        x_p, x_r = self.split(x)
        return pin.SE3(self.rotation.part(x_r), self.position.part(x_p))

    def E(self, x: ArrayLike, tolerance: float = SINGULAR_BELOW) -> Array:
        """Return E(x) (m, 6): ẋ = E (v, ω). Raises ArgumentError where either part is singular."""
        x_p, x_r = self.split(x)
        return _block(self.position.E(x_p, tolerance), self.rotation.E(x_r, tolerance))

    def E_inverse(self, x: ArrayLike) -> Array:
        """Return E⁺(x) (6, m): (v, ω) = E⁺ ẋ."""
        x_p, x_r = self.split(x)
        return _block(self.position.E_inverse(x_p), self.rotation.E_inverse(x_r))

    def singularity(self, x: ArrayLike, tolerance: float = SINGULAR_BELOW) -> Singularity:
        """Return the report of whichever part is nearer to its singularity."""
        x_p, x_r = self.split(x)
        reports = (self.position.singularity(x_p, tolerance), self.rotation.singularity(x_r, tolerance))
        return min(reports, key=lambda report: report.measure)

    def difference(self, x_desired: ArrayLike, x: ArrayLike) -> Array:
        """Return e = x_desired − x (m,), angles the short way (000, minimum-coordinate error)."""
        parts = zip((self.position, self.rotation), self.split(x_desired, "x_desired"), self.split(x), strict=True)
        return np.concatenate([representation.difference(a, b) for representation, a, b in parts])

    def jacobian(self, model: RobotModel, q: ArrayLike, previous: ArrayLike | None = None) -> Array:
        """Return J(q) = E(x) J₀(q) (m, n): ẋ = J q̇ (004 p. 23). Raises ArgumentError where x is singular."""
        values = check_array(q, "q", (model.n,))
        J: Array = self.E(self.coordinates(model.forward(values), previous)) @ model.jacobian(values)
        return J


def _block(upper: Array, lower: Array) -> Array:
    block = np.zeros((upper.shape[0] + lower.shape[0], upper.shape[1] + lower.shape[1]))
    block[: upper.shape[0], : upper.shape[1]] = upper
    block[upper.shape[0] :, upper.shape[1] :] = lower
    return block


def pose_representation(position: str = "cartesian", rotation: str = "euler_zyx") -> PoseRepresentation:
    """Return the combination of two representations by name. Raises ArgumentError naming the legal ones."""
    return PoseRepresentation(
        POSITIONS[check_choice(position, "position representation", POSITIONS)],
        ROTATIONS[check_choice(rotation, "rotation representation", ROTATIONS)],
    )
