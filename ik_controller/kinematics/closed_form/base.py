"""ClosedForm: what a closed form of an arm offers, and the way from its raw angles to checked solutions (N8).

A closed form yields candidates in joint angles modulo 2π. Each is brought to round-off by Newton steps, checked by
forward kinematics against the pose, merged with its doubles, and laid out over the joint limits by full turns.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.closed_form.geometry import Screws, wrap
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.task import Task

Array = NDArray[np.float64]

ROUND_OFF = 1e-13  # errors [m, rad] not worth another Newton step
SAME = 1e-6  # [rad or m]: two solutions nearer than this are one
AT_LIMIT = 1e-9  # [rad or m]: a solution this far beyond a limit is put on it


@dataclass(frozen=True)
class ClosedForm:
    """A closed form: `name`; `count`, the number of solutions of a pose inside the workspace, without joint limits."""

    screws: Screws

    name = "closed form"
    count = 0

    def require(self, task: Task) -> None:
        """Raise ArgumentError where the task's axes leave more freedom than the closed form resolves."""
        if not task.mask.all():
            raise ArgumentError(f"axes: the closed form for the {self.name} needs xyzrpy")

    def candidates(self, target: Any, reference: Array, free: set[str]) -> Iterator[Sequence[float]]:
        """Yield joint vectors for a pose `pin.SE3`; a free joint takes its `reference`, and `free` gets a sentence."""
        raise NotImplementedError


def polish(model: RobotModel, task: Task, q: Array) -> tuple[Array, float, float]:
    """Return q after Newton steps to round-off, and its errors [m], [rad]."""
    best = (math.inf, q, 0.0, 0.0)
    for _ in range(4):
        pose = model.forward(q)
        linear, angular = task.pose_error(pose.rotation, pose.translation)
        if linear + angular >= 0.5 * best[0]:
            break
        best = (linear + angular, q, linear, angular)
        if best[0] < ROUND_OFF:
            break
        error, jacobian = task.error_and_jacobian(pose.rotation, pose.translation, model.jacobian(q))
        # Directions with singular values below the cut are the ones a singular solution may not move in.
        q = q + np.linalg.lstsq(jacobian, error, rcond=1e-6)[0]
    return best[1], best[2], best[3]


def solutions_of(
    form: ClosedForm,
    model: RobotModel,
    task: Task,
    target: Any,
    reference: Array,
    tolerance: tuple[float, float],
) -> tuple[list[Array], list[str]]:
    """Return all solutions, angles in (−π, π], limits not regarded, and sentences on joints that are free.

    `target`: the pose as `pin.SE3`; `tolerance`: the position [m] and orientation error [rad] a solution may have.
    """
    free: set[str] = set()
    found: list[Array] = []
    for candidate in form.candidates(target, reference, free):
        q, linear, angular = polish(model, task, np.array(candidate, dtype=float))
        if linear > tolerance[0] or angular > tolerance[1]:
            continue
        q = np.array([x if slides else wrap(x) for x, slides in zip(q, model.prismatic, strict=True)])
        if all(_apart(q, other, model.prismatic) > SAME for other in found):
            found.append(q)
    return found, sorted(free) if found else []


def _apart(q: Array, other: Array, prismatic: NDArray[np.bool_]) -> float:
    off = np.abs(q - other)
    return float(np.where(prismatic, off, np.minimum(off, np.abs(2.0 * math.pi - off))).max())


def within_limits(q: Array, model: RobotModel) -> list[Array]:
    """Return q (n,) with every combination of full turns that lies within the limits; one turn for a joint without."""
    choices = []
    for x, lower, upper, slides in zip(q, model.lower, model.upper, model.prismatic, strict=True):
        turns = range(1)
        if not slides and math.isfinite(lower) and math.isfinite(upper):
            turn = 2.0 * math.pi
            turns = range(math.ceil((lower - AT_LIMIT - x) / turn), math.floor((upper + AT_LIMIT - x) / turn) + 1)
        values = [x + 2.0 * math.pi * k for k in turns]
        choices.append([min(max(v, lower), upper) for v in values if lower - AT_LIMIT <= v <= upper + AT_LIMIT])
    return [np.array(one) for one in itertools.product(*choices)]
