"""Denavit-Hartenberg parameters to transforms and to a RobotModel (note N14; 004 pp. 9-11).

    modified (Craig; 004)    T_{i-1,i} = Rx(α_{i-1}) Tx(a_{i-1}) Rz(θ_i) Tz(d_i)      the notes write ρ_i for d_i
    classic (1955; 002)      T_{i-1,i} = Rz(θ_i) Tz(d_i) Tx(a_i) Rx(α_i)

q_i is added to θ_i of a revolute joint, to d_i of a prismatic one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.checks import Array, check_array, check_choice, check_number
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.rotation import fixed_xyz_from_rotation, rot_x, rot_z

CONVENTIONS = ("modified", "classic")


@dataclass(frozen=True)
class DHJoint:
    """One row of a DH table: a, d [m], alpha, theta [rad]; limits of q and velocity [rad or m, per s].

    Of `theta` and `d` the one that the joint moves is the offset at q = 0. In the modified convention a and alpha are
    those of the link before the joint (a_{i-1}, α_{i-1}).
    """

    a: float = 0.0
    alpha: float = 0.0
    d: float = 0.0
    theta: float = 0.0
    prismatic: bool = False
    lower: float = -math.pi
    upper: float = math.pi
    velocity: float = 1.0
    name: str = ""


def dh_transform(joint: DHJoint, q: float, convention: str = "modified") -> Array:
    """Return T_{i-1,i} (4, 4) of one joint at q [rad or m] (004 p. 10). Raises ArgumentError on bad input."""
    _check(joint, "joint")
    before, after = _fixed_parts(joint, check_choice(convention, "convention", CONVENTIONS))
    value = check_number(q, "q")
    motion = _translation(0.0, value) if joint.prismatic else _rotation(rot_z(value))
    T: Array = before @ motion @ after
    return T


def dh_forward(joints: Sequence[DHJoint], q: ArrayLike, convention: str = "modified") -> Array:
    """Return T_0n (4, 4), the product of the joints' transforms at q (n,) (004 p. 11).

    Raises ArgumentError: no joints, q of another length, values not finite, an unknown convention.
    """
    _check_table(joints)
    T = np.eye(4)
    for joint, value in zip(joints, check_array(q, "q", (len(joints),)).tolist(), strict=True):
        T = T @ dh_transform(joint, value, convention)
    return T


def dh_urdf(joints: Sequence[DHJoint], convention: str = "modified", name: str = "dh_arm") -> str:
    """Return URDF text of the chain: base link "base", tip link "tool", joints as named or "joint1", "joint2", ...

    Raises ArgumentError: no joints, values not finite, limits the wrong way round, an unknown convention.
    """
    _check_table(joints)
    check_choice(convention, "convention", CONVENTIONS)
    lines = [f"<robot name={quoteattr(name)}>", '  <link name="base"/>']
    parent, carried = "base", np.eye(4)
    for number, joint in enumerate(joints, 1):
        before, after = _fixed_parts(joint, convention)
        link = f"link{number}"
        kind = "prismatic" if joint.prismatic else "revolute"
        lines += [
            f'  <link name="{link}"/>',
            f'  <joint name={quoteattr(joint.name or f"joint{number}")} type="{kind}">',
            f'    <parent link="{parent}"/><child link="{link}"/>',
            f'    {_origin(carried @ before)}<axis xyz="0 0 1"/>',
            f'    <limit lower="{joint.lower!r}" upper="{joint.upper!r}" velocity="{joint.velocity!r}" effort="0"/>',
            "  </joint>",
        ]
        parent, carried = link, after
    lines += [
        '  <link name="tool"/>',
        '  <joint name="tool_mount" type="fixed">',
        f'    <parent link="{parent}"/><child link="tool"/>{_origin(carried)}',
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines)


def dh_model(joints: Sequence[DHJoint], convention: str = "modified", name: str = "dh_arm") -> RobotModel:
    """Return the RobotModel of a DH table, tool frame T_0n; errors as in `dh_urdf`."""
    return RobotModel.from_urdf(dh_urdf(joints, convention, name), "tool", "base")


def _fixed_parts(joint: DHJoint, convention: str) -> tuple[Array, Array]:
    """Return what stands before and after the motion about or along z: T(q) = before · motion(q) · after."""
    link = _rotation(rot_x(joint.alpha)) @ _translation(joint.a, 0.0)
    offset = _rotation(rot_z(joint.theta)) @ _translation(0.0, joint.d)
    return (link @ offset, np.eye(4)) if convention == "modified" else (offset, link)


def _rotation(R: Array) -> Array:
    T = np.eye(4)
    T[:3, :3] = R
    return T


def _translation(x: float, z: float) -> Array:
    T = np.eye(4)
    T[0, 3], T[2, 3] = x, z
    return T


def _origin(T: Array) -> str:
    xyz = " ".join(map(repr, T[:3, 3].tolist()))
    rpy = " ".join(map(repr, fixed_xyz_from_rotation(T[:3, :3]).tolist()))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


def _check_table(joints: Sequence[DHJoint]) -> None:
    if len(joints) == 0:
        raise ArgumentError("joints: an empty chain, need at least one DHJoint")
    for number, joint in enumerate(joints):
        _check(joint, f"joints[{number}]")
        if not joint.lower < joint.upper:
            raise ArgumentError(f"joints[{number}]: lower {joint.lower} is not below upper {joint.upper}")


def _check(joint: DHJoint, name: str) -> None:
    for field in ("a", "alpha", "d", "theta"):
        check_number(getattr(joint, field), f"{name}.{field}")
