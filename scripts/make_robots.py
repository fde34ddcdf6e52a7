"""Write config/*/robot.urdf: the two bundled robots, from their kinematic constants and simple solids.

    python scripts/make_robots.py

Every solid is both looks and envelope. Lengths in m, angles in rad; a capsule is a cylinder with two balls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
Point = tuple[float, float, float]
COLORS = {
    "white": "0.92 0.92 0.94 1",
    "silver": "0.72 0.74 0.77 1",
    "dark": "0.20 0.21 0.24 1",
    "blue": "0.36 0.55 0.75 1",
}


@dataclass
class Solid:
    """One primitive: `shape` is the URDF geometry element, placed at `xyz`, its z axis turned by `rpy`."""

    shape: str
    xyz: Point
    rpy: Point
    color: str


@dataclass
class Link:
    """A link and its solids, in the link's frame."""

    name: str
    solids: list[Solid] = field(default_factory=list)


@dataclass
class Joint:
    """A joint about z of its frame, or a fixed one where `limits` (lower, upper, velocity, effort) is None."""

    name: str
    parent: str
    child: str
    xyz: Point
    rpy: Point
    limits: tuple[float, float, float, float] | None = None


def box(size: Point, center: Point, color: str) -> list[Solid]:
    """Return a box of `size` around `center`, along the link's axes."""
    return [Solid(f'<box size="{numbers(size)}"/>', center, (0.0, 0.0, 0.0), color)]


def ball(center: Point, radius: float, color: str) -> Solid:
    """Return a sphere."""
    return Solid(f'<sphere radius="{radius:g}"/>', center, (0.0, 0.0, 0.0), color)


def cylinder(start: Point, end: Point, radius: float, color: str) -> list[Solid]:
    """Return a cylinder between two points of its axis."""
    axis = [b - a for a, b in zip(start, end, strict=True)]
    length = math.hypot(*axis)
    center = tuple((a + b) / 2 for a, b in zip(start, end, strict=True))
    # Ry(pitch) tilts z away from the link's z, Rz(yaw) turns it to the right side.
    rpy = (0.0, math.acos(axis[2] / length), math.atan2(axis[1], axis[0]))
    return [Solid(f'<cylinder radius="{radius:g}" length="{length:.6g}"/>', center, rpy, color)]  # type: ignore[arg-type]


def capsule(start: Point, end: Point, radius: float, color: str) -> list[Solid]:
    """Return a cylinder with a ball at both ends."""
    return [*cylinder(start, end, radius, color), ball(start, radius, color), ball(end, radius, color)]


def numbers(values: Point) -> str:
    """Return numbers for an attribute, rounded: looks need no more."""
    return " ".join(format(round(value, 6) + 0.0, ".6g") for value in values)


def exact(*values: float) -> str:
    """Return numbers for an attribute, as many digits as it takes to keep each double."""
    return " ".join(repr(float(value)).removesuffix(".0") for value in values)


def urdf(name: str, comment: str, links: list[Link], joints: list[Joint]) -> str:
    """Return the URDF as text."""
    lines = ['<?xml version="1.0"?>', f"<!-- {comment}", "     Made by scripts/make_robots.py. -->"]
    lines.append(f'<robot name="{name}">')
    used = {solid.color for link in links for solid in link.solids}
    lines += [f'  <material name="{c}"><color rgba="{rgba}"/></material>' for c, rgba in COLORS.items() if c in used]
    for link in links:
        if not link.solids:
            lines.append(f'  <link name="{link.name}"/>')
            continue
        lines.append(f'  <link name="{link.name}">')
        for solid in link.solids:
            place = f'<origin xyz="{numbers(solid.xyz)}" rpy="{numbers(solid.rpy)}"/>'
            geometry = f"<geometry>{solid.shape}</geometry>"
            lines.append(f'    <visual>{place}{geometry}<material name="{solid.color}"/></visual>')
            lines.append(f"    <collision>{place}{geometry}</collision>")
        lines.append("  </link>")
    for joint in joints:
        lines.append(f'  <joint name="{joint.name}" type="{"fixed" if joint.limits is None else "revolute"}">')
        lines.append(f'    <parent link="{joint.parent}"/><child link="{joint.child}"/>')
        lines.append(f'    <origin xyz="{exact(*joint.xyz)}" rpy="{exact(*joint.rpy)}"/>')
        if joint.limits is not None:
            lower, upper, velocity, effort = (exact(value) for value in joint.limits)
            lines.append('    <axis xyz="0 0 1"/>')
            lines.append(f'    <limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="{effort}"/>')
        lines.append("  </joint>")
    return "\n".join([*lines, "</robot>", ""])


def panda() -> str:
    """Return the 7-joint arm: Franka Emika's Panda by its modified DH constants and the limits libfranka states."""
    right = math.pi / 2
    lower = (-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973)
    upper = (2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973)
    velocity = (2.175,) * 4 + (2.61,) * 3
    effort = (87.0,) * 4 + (12.0,) * 3
    origins: list[tuple[Point, float]] = [
        ((0.0, 0.0, 0.333), 0.0),
        ((0.0, 0.0, 0.0), -right),
        ((0.0, -0.316, 0.0), right),
        ((0.0825, 0.0, 0.0), right),
        ((-0.0825, 0.384, 0.0), -right),
        ((0.0, 0.0, 0.0), right),
        ((0.088, 0.0, 0.0), right),
    ]
    joints = [
        Joint(
            f"panda_joint{i + 1}", f"panda_link{i}", f"panda_link{i + 1}", xyz, (roll, 0.0, 0.0),
            (lower[i], upper[i], velocity[i], effort[i]),
        )
        for i, (xyz, roll) in enumerate(origins)
    ]  # fmt: skip
    joints += [
        Joint("panda_joint8", "panda_link7", "panda_link8", (0.0, 0.0, 0.107), (0.0, 0.0, 0.0)),
        Joint("panda_hand_joint", "panda_link8", "panda_hand", (0.0, 0.0, 0.0), (0.0, 0.0, -math.pi / 4)),
        Joint("panda_hand_tcp_joint", "panda_hand", "panda_hand_tcp", (0.0, 0.0, 0.1034), (0.0, 0.0, 0.0)),
    ]
    links = [
        Link(
            "panda_link0",
            box((0.19, 0.18, 0.05), (-0.045, 0.0, 0.025), "white")
            + cylinder((0.0, 0.0, 0.05), (0.0, 0.0, 0.138), 0.068, "white"),
        ),
        Link(
            "panda_link1",
            cylinder((0.0, 0.0, -0.192), (0.0, 0.0, -0.178), 0.064, "dark")
            + cylinder((0.0, 0.0, -0.178), (0.0, 0.0, -0.02), 0.06, "white")
            + cylinder((0.0, -0.075, 0.0), (0.0, 0.06, 0.0), 0.062, "white"),
        ),
        Link(
            "panda_link2",
            cylinder((0.0, 0.0, 0.06), (0.0, 0.0, 0.078), 0.06, "dark")
            + capsule((0.0, 0.0, 0.0), (0.0, -0.118, 0.0), 0.058, "white"),
        ),
        Link(
            "panda_link3",
            cylinder((0.0, 0.0, -0.192), (0.0, 0.0, -0.178), 0.06, "dark")
            + capsule((0.0, 0.0, -0.12), (0.0, 0.0, -0.085), 0.056, "white")
            + capsule((0.0, 0.0, -0.085), (0.0825, 0.0, 0.0), 0.052, "white")
            + cylinder((0.0825, -0.06, 0.0), (0.0825, 0.06, 0.0), 0.055, "white"),
        ),
        Link(
            "panda_link4",
            cylinder((0.0, 0.0, -0.076), (0.0, 0.0, -0.06), 0.053, "dark")
            + cylinder((0.0, 0.0, 0.06), (0.0, 0.0, 0.076), 0.053, "dark")
            + capsule((0.0, 0.0, 0.0), (-0.0825, 0.085, 0.0), 0.052, "white")
            + cylinder((-0.0825, 0.085, 0.0), (-0.0825, 0.124, 0.0), 0.056, "white"),
        ),
        Link(
            "panda_link5",
            cylinder((0.0, 0.0, -0.26), (0.0, 0.0, -0.246), 0.06, "dark")
            + capsule((0.0, 0.0, -0.205), (0.0, 0.025, -0.15), 0.052, "white")
            + capsule((0.0, 0.025, -0.15), (0.0, 0.045, -0.04), 0.042, "white")
            + cylinder((0.0, -0.055, 0.0), (0.0, 0.085, 0.0), 0.047, "white"),
        ),
        Link(
            "panda_link6",
            cylinder((0.0, 0.0, 0.055), (0.0, 0.0, 0.07), 0.046, "dark")
            + capsule((0.0, 0.0, 0.0), (0.088, 0.0, 0.0), 0.048, "white")
            + cylinder((0.088, 0.0, 0.0), (0.088, -0.05, 0.0), 0.05, "white"),
        ),
        Link(
            "panda_link7",
            cylinder((0.0, 0.0, 0.05), (0.0, 0.0, 0.064), 0.051, "dark")
            + cylinder((0.0, 0.0, 0.064), (0.0, 0.0, 0.107), 0.045, "white"),
        ),
        Link("panda_link8"),
        Link(
            "panda_hand",
            box((0.062, 0.204, 0.058), (0.0, 0.0, 0.029), "silver")
            + box((0.02, 0.022, 0.054), (0.0, 0.04, 0.085), "dark")
            + box((0.02, 0.022, 0.054), (0.0, -0.04, 0.085), "dark"),
        ),
        Link("panda_hand_tcp"),
    ]
    return urdf("panda", "A 7-joint arm with the kinematics and limits of Franka Emika's Panda.", links, joints)


def ur5e() -> str:
    """Return the 6-joint arm: Universal Robots' UR5e by its DH constants, base_link facing as in REP 103."""
    right, turn = math.pi / 2, math.pi
    d1, a2, a3, d4, d5, d6 = 0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996
    names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    chain = ("base", "shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")
    origins: list[tuple[Point, float]] = [
        ((0.0, 0.0, d1), 0.0),
        ((0.0, 0.0, 0.0), right),
        ((a2, 0.0, 0.0), 0.0),
        ((a3, 0.0, d4), 0.0),
        ((0.0, -d5, 0.0), right),
        ((0.0, d6, 0.0), -right),
    ]
    effort = (150.0,) * 3 + (28.0,) * 3
    # `base` is the DH base of the maker's controller; base_link is the same, half a turn about z, as ROS users know it.
    joints = [Joint("base_link-base_fixed_joint", "base_link", "base", (0.0, 0.0, 0.0), (0.0, 0.0, turn))]
    for i, (xyz, roll) in enumerate(origins):
        reach = turn if names[i] == "elbow" else 2.0 * turn
        limits = (-reach, reach, turn, effort[i])
        joints.append(Joint(f"{names[i]}_joint", chain[i], chain[i + 1], xyz, (roll, 0.0, 0.0), limits))
    joints.append(Joint("wrist_3-tool0_fixed_joint", "wrist_3_link", "tool0", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    side = 0.1365  # the upper arm runs beside the shoulder, the forearm back in line
    links = [
        Link(
            "base_link",
            cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.02), 0.075, "dark")
            + cylinder((0.0, 0.0, 0.02), (0.0, 0.0, 0.098), 0.064, "silver"),
        ),
        Link("base"),
        Link(
            "shoulder_link",
            cylinder((0.0, 0.0, -0.0625), (0.0, 0.0, 0.06), 0.06, "silver")
            + cylinder((0.0, 0.0, 0.06), (0.0, 0.0, 0.072), 0.058, "blue")
            + cylinder((0.0, 0.0, 0.0), (0.0, -0.077, 0.0), 0.059, "silver"),
        ),
        Link(
            "upper_arm_link",
            cylinder((0.0, 0.0, 0.079), (0.0, 0.0, 0.192), 0.06, "silver")
            + cylinder((0.0, 0.0, 0.192), (0.0, 0.0, 0.203), 0.058, "blue")
            + cylinder((0.0, 0.0, side), (a2, 0.0, side), 0.047, "silver")
            + cylinder((a2, 0.0, 0.078), (a2, 0.0, 0.185), 0.053, "silver")
            + cylinder((a2, 0.0, 0.185), (a2, 0.0, 0.195), 0.051, "blue"),
        ),
        Link(
            "forearm_link",
            cylinder((0.0, 0.0, -0.05), (0.0, 0.0, 0.076), 0.053, "silver")
            + cylinder((0.0, 0.0, -0.06), (0.0, 0.0, -0.05), 0.051, "blue")
            + cylinder((0.0, 0.0, 0.012), (a3, 0.0, 0.012), 0.038, "silver")
            + cylinder((a3, 0.0, -0.04), (a3, 0.0, 0.066), 0.042, "silver")
            + cylinder((a3, 0.0, -0.05), (a3, 0.0, -0.04), 0.04, "blue"),
        ),
        Link(
            "wrist_1_link",
            cylinder((0.0, 0.0, -0.066), (0.0, 0.0, 0.038), 0.041, "silver")
            + cylinder((0.0, 0.0, 0.038), (0.0, 0.0, 0.048), 0.039, "blue")
            + cylinder((0.0, 0.0, 0.0), (0.0, -0.052, 0.0), 0.041, "silver"),
        ),
        Link(
            "wrist_2_link",
            cylinder((0.0, 0.0, -0.047), (0.0, 0.0, 0.038), 0.041, "silver")
            + cylinder((0.0, 0.0, 0.038), (0.0, 0.0, 0.048), 0.039, "blue")
            + cylinder((0.0, 0.0, 0.0), (0.0, 0.052, 0.0), 0.041, "silver"),
        ),
        Link(
            "wrist_3_link",
            cylinder((0.0, 0.0, -0.0475), (0.0, 0.0, -0.012), 0.04, "silver")
            + cylinder((0.0, 0.0, -0.012), (0.0, 0.0, 0.0), 0.034, "dark"),
        ),
        Link("tool0"),
    ]
    return urdf("ur5e", "A 6-joint arm with the kinematics and limits of Universal Robots' UR5e.", links, joints)


ROBOTS = {"panda": panda, "ur5e": ur5e}

if __name__ == "__main__":
    for robot, make in ROBOTS.items():
        (ROOT / "config" / robot / "robot.urdf").write_text(make(), encoding="utf-8")
