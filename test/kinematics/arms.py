"""Small arms for the tests, as URDF text: base link "base", tip link "tool", joints "joint1" ... "jointN".

Every arm is written from its geometry, not from DH tables, so that it is an independent path beside `kinematics.dh`.
Import it from a test in this folder as `import arms`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple


class Joint(NamedTuple):
    """One joint of `urdf`: where it sits on its parent [m, rad], its axis, its limits [rad or m]."""

    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    kind: str = "revolute"
    lower: float = -math.pi
    upper: float = math.pi
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)


def _text(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def urdf(name: str, joints: Sequence[Joint], tool: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> str:
    """Return the URDF of a chain of joints; `tool` [m] places the link "tool" on the last one."""
    lines = [f'<robot name="{name}">', '  <link name="base"/>']
    parent = "base"
    for number, joint in enumerate(joints, 1):
        lines += [
            f'  <link name="link{number}"/>',
            f'  <joint name="joint{number}" type="{joint.kind}">',
            f'    <parent link="{parent}"/><child link="link{number}"/>',
            f'    <origin xyz="{_text(joint.xyz)}" rpy="{_text(joint.rpy)}"/><axis xyz="{_text(joint.axis)}"/>',
            f'    <limit lower="{joint.lower!r}" upper="{joint.upper!r}" velocity="2.0" effort="1.0"/>',
            "  </joint>",
        ]
        parent = f"link{number}"
    lines += [
        '  <link name="tool"/>',
        '  <joint name="tool_mount" type="fixed">',
        f'    <parent link="{parent}"/><child link="tool"/><origin xyz="{_text(tool)}"/>',
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines)


def planar_2r(l1: float = 1.0, l2: float = 1.0) -> str:
    """Return a 2R arm in the x-y plane, stretched along x at q = 0 (notes 000, 002)."""
    return urdf("planar_2r", [Joint(), Joint((l1, 0, 0))], (l2, 0, 0))


def planar_3r(l1: float = 1.0, l2: float = 0.8, l3: float = 0.5) -> str:
    """Return a 3R arm in the x-y plane, stretched along x at q = 0 (notes 002)."""
    return urdf("planar_3r", [Joint(), Joint((l1, 0, 0)), Joint((l2, 0, 0))], (l3, 0, 0))


def stanford(d2: float = 0.154, d1: float = 0.0, tool: float = 0.0) -> str:
    """Return the Stanford Scheinman arm RRPRRR of 004 pp. 36-38, frames as there (modified DH), q3 = d3.

    The tool point is the wrist point unless `tool` [m] moves it along the last axis; `d1` [m] is the shoulder's height.
    At q = 0 every frame is parallel to the base: axes z, y, z (prismatic), z, y, z.
    """
    y, z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    return urdf(
        "stanford",
        [
            Joint((0, 0, d1), z),
            Joint((0, d2, 0), y),
            Joint((0, 0, 0), z, "prismatic", 0.1, 1.2),
            Joint((0, 0, 0), z),
            Joint((0, 0, 0), y),
            Joint((0, 0, 0), z),
        ],
        (0, 0, tool),
    )


def puma(a2: float = 0.432, a3: float = 0.433, d1: float = 0.0, d6: float = 0.1) -> str:
    """Return the PUMA-type 6R arm of 002 (classic DH: no shoulder offset), stretched along x at q = 0.

    Axes at q = 0: z, then -y twice (positive angles lift the arm), then a spherical wrist x, -y, x whose first axis
    is the forearm; tool point d6 [m] along the last axis. (With the frames printed in 002, axis 4 would be parallel to
    axes 2 and 3: between T_3^0 and R_6^3 the notes leave out a turn by 90 degrees.)
    """
    x, lift, z = (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)
    return urdf(
        "puma",
        [
            Joint((0, 0, d1), z),
            Joint((0, 0, 0), lift),
            Joint((a2, 0, 0), lift),
            Joint((a3, 0, 0), x),
            Joint((0, 0, 0), lift),
            Joint((0, 0, 0), x),
        ],
        (d6, 0, 0),
    )


def scara(l1: float = 0.4, l2: float = 0.3) -> str:
    """Return an RRPR arm: planar 2R, a vertical prismatic joint, a roll about it."""
    down = (0.0, 0.0, -1.0)
    return urdf(
        "scara",
        [Joint(), Joint((l1, 0, 0)), Joint((l2, 0, 0), down, "prismatic", 0.0, 0.25), Joint(axis=down)],
    )


def skewed_7(tool: tuple[float, float, float] = (0.05, -0.02, 0.11)) -> str:
    """Return a 7-joint arm without any special geometry: skew axes, skew frames, one prismatic joint."""
    return urdf(
        "skewed_7",
        [
            Joint((0.1, 0.0, 0.3), (0.0, 0.0, 1.0)),
            Joint((0.0, 0.1, 0.2), (0.3, 0.9, -0.1), rpy=(0.2, -0.4, 0.9)),
            Joint((0.3, 0.05, 0.1), (0.5, -0.2, 0.8), "prismatic", -0.3, 0.4, rpy=(-1.0, 0.3, 0.1)),
            Joint((0.2, -0.1, 0.1), (1.0, 0.0, 0.0), rpy=(0.5, 0.1, -2.0)),
            Joint((0.25, 0.0, 0.05), (0.0, 1.0, 0.0), rpy=(0.0, 1.2, 0.4)),
            Joint((0.1, 0.1, 0.0), (-0.6, 0.2, 0.7), rpy=(2.0, 0.0, 0.3)),
            Joint((0.0, 0.05, 0.1), (0.1, 0.2, 1.0), rpy=(0.1, 0.2, 0.3)),
        ],
        tool,
    )
