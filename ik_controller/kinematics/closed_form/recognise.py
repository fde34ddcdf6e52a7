"""recognise: which closed form fits an arm, judged by where its axes lie, never by its name (N8, N9)."""

from __future__ import annotations

import numpy as np

from ik_controller.kinematics.closed_form.base import ClosedForm
from ik_controller.kinematics.closed_form.geometry import ALIGNED, Screws, across
from ik_controller.kinematics.closed_form.planar import Planar2R, Planar3R
from ik_controller.kinematics.closed_form.seven import Swivel
from ik_controller.kinematics.closed_form.six import Puma, Stanford, ThreeParallel
from ik_controller.kinematics.closed_form.spherical import SphericalWrist
from ik_controller.kinematics.model import RobotModel

KNOWN = (
    "planar 2R, planar 3R, spherical wrist 3R, PUMA type 6R, Stanford type RRPRRR, "
    "6R with three parallel axes and the last two meeting (UR type), 7R shoulder-elbow-wrist"
)


def recognise(model: RobotModel) -> ClosedForm | None:
    """Return the closed form for the model's axes, or None where there is none here. Links of no length fit none."""
    screws = Screws.of(model)
    if screws is None or why_degenerate(screws) is not None:
        return None
    slides = tuple(bool(p) for p in screws.prismatic)
    if slides == (False,) * 2 and screws.parallel(0, 1):
        return Planar2R(screws)
    if slides == (False,) * 3:
        if screws.parallel(0, 1, 2):
            return Planar3R(screws)
        if screws.meeting_point(0, 1, 2) is not None and _orients(screws, 0, 1, 2):
            return SphericalWrist(screws)
    if len(slides) == 6 and not any(slides[:2] + slides[3:]) and not screws.parallel(0, 1):
        wrist = screws.meeting_point(3, 4, 5) is not None and _orients(screws, 3, 4, 5)
        if wrist and not slides[2] and screws.parallel(1, 2):
            return Puma(screws)
        if wrist and slides[2] and abs(float(screws.axis[1] @ screws.axis[2])) < ALIGNED:
            return Stanford(screws)
        if not slides[2] and screws.parallel(1, 2, 3) and _bent(screws, 3, 4) and _bent(screws, 4, 5):
            return ThreeParallel(screws) if screws.meeting_point(4, 5) is not None else None
    if slides == (False,) * 7:
        shoulder, wrist_point = screws.meeting_point(0, 1, 2), screws.meeting_point(4, 5, 6)
        if (
            shoulder is not None
            and wrist_point is not None
            and _orients(screws, 0, 1, 2)
            and _orients(screws, 4, 5, 6)
            and min(_distance(screws, 3, shoulder), _distance(screws, 3, wrist_point)) > ALIGNED
        ):
            return Swivel(screws)
    return None


def why_degenerate(screws: Screws) -> str | None:
    """Return what is wrong with a chain that has a link of no length, or None."""
    for k in range(screws.n - 1):
        turning = not (screws.prismatic[k] or screws.prismatic[k + 1])
        if turning and screws.coincide(k, k + 1):
            return f"joints {k + 1} and {k + 2} turn about one line: the link between them has no length"
    if not screws.prismatic.any() and screws.parallel(*range(screws.n)):
        off = across(screws.axis[-1], screws.home.translation - screws.point[-1])
        if screws.n == 2 and float(np.linalg.norm(off)) < ALIGNED:
            return "the tool point lies on the axis of joint 2: the last link has no length"
    return None


def _bent(screws: Screws, one: int, other: int) -> bool:
    return not screws.parallel(one, other)


def _orients(screws: Screws, one: int, two: int, three: int) -> bool:
    """Return whether three axes are a wrist's: neighbours across each other, so that every rotation is met."""
    across_12 = abs(float(screws.axis[one] @ screws.axis[two]))
    return across_12 < ALIGNED and abs(float(screws.axis[two] @ screws.axis[three])) < ALIGNED


def _distance(screws: Screws, joint: int, point: np.ndarray) -> float:
    return float(np.linalg.norm(across(screws.axis[joint], point - screws.point[joint])))
