"""Arms for the tests of the closed forms beside those of `arms`: real offsets, turned frames, seven joints."""

from __future__ import annotations

import math

import arms
from arms import Joint, urdf

X, Y, Z, LIFT = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)


def puma_560() -> str:
    """Return a PUMA 560: shoulder offset 0.1501 (both parts), forearm offset -0.0203, a tool off the wrist's axis."""
    return urdf(
        "puma_560",
        [
            Joint((0.2, -0.1, 0.67), Z, rpy=(0.1, -0.2, 0.3)),
            Joint((0.0, 0.2435, 0.0), LIFT),
            Joint((0.4318, -0.0934, 0.0), LIFT),
            Joint((0.4331, 0.0, -0.0203), X),
            Joint((0.0, 0.0, 0.0), LIFT),
            Joint((0.0, 0.0, 0.0), X, lower=-4.6, upper=4.6),
        ],
        (0.0563, 0.01, -0.02),
    )


def wrist_zyx() -> str:
    """Return a spherical wrist with axes z, y, x as in 000/003, tool point off the centre."""
    return urdf("wrist_zyx", [Joint((0.0, 0.0, 0.1), Z), Joint(axis=Y), Joint(axis=X)], (0.1, 0.02, 0.0))


def ur5e() -> str:
    """Return an arm with a UR5e's lengths in frames of its own, joints to ±2π."""
    turn = {"lower": -2.0 * math.pi, "upper": 2.0 * math.pi}
    return urdf(
        "ur5e_lengths",
        [
            Joint((0.0, 0.0, 0.1625), Z, **turn),
            Joint((0.0, 0.138, 0.0), Y, **turn),
            Joint((0.0, -0.131, 0.425), Y, lower=-math.pi, upper=math.pi),
            Joint((0.0, 0.0, 0.3922), Y, **turn),
            Joint((0.0, 0.1263, 0.0), Z, **turn),
            Joint((0.0, 0.0, 0.0997), Y, **turn),
        ],
        (0.01, 0.0996, 0.02),
    )


def shoulder_elbow_wrist(elbow_offset: float = 0.0) -> str:
    """Return a 7-joint arm with an iiwa's lengths; `elbow_offset` [m] puts axis 4 beside the line of the upper arm."""
    return urdf(
        "shoulder_elbow_wrist",
        [
            Joint((0.0, 0.0, 0.36), Z),
            Joint(axis=Y),
            Joint(axis=Z),
            Joint((elbow_offset, 0.0, 0.42), LIFT),
            Joint((-elbow_offset, 0.0, 0.4), Z),
            Joint(axis=Y),
            Joint(axis=Z),
        ],
        (0.0, 0.0, 0.126),
    )


def crossed_shoulder() -> str:
    """Return a 6R arm with a spherical wrist whose axes 1 and 2 meet and 2, 3 are skew: a closed form only EAIK has."""
    return urdf(
        "crossed_shoulder",
        [
            Joint((0.0, 0.0, 0.3), Z),
            Joint(axis=Y),
            Joint((0.0, 0.0, 0.4), (1.0, 0.3, 0.5)),
            Joint((0.1, 0.05, 0.3), Z),
            Joint(axis=Y),
            Joint(axis=X),
        ],
        (0.1, 0.0, 0.05),
    )


# name → (URDF, axes that the closed form needs, its name)
CLOSED_FORMS = {
    "planar_2r": (arms.planar_2r(1.0, 0.7), "xy", "planar 2R arm"),
    "planar_3r": (arms.planar_3r(), "xyy", "planar 3R arm"),
    "wrist": (wrist_zyx(), "rpy", "spherical wrist"),
    "puma": (arms.puma(), "xyzrpy", "PUMA type 6R arm"),
    "puma_560": (puma_560(), "xyzrpy", "PUMA type 6R arm"),
    "stanford": (arms.stanford(tool=0.1, d1=0.4), "xyzrpy", "Stanford type RRPRRR arm"),
    "ur5e": (ur5e(), "xyzrpy", "6R arm with three parallel axes (UR type)"),
    "seven": (shoulder_elbow_wrist(), "xyzrpy", "7-joint shoulder-elbow-wrist arm"),
    "seven_offset": (shoulder_elbow_wrist(0.06), "xyzrpy", "7-joint shoulder-elbow-wrist arm"),
}
