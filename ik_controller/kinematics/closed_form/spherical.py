"""A spherical wrist alone: three revolute joints, orientation only (N8)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.closed_form.base import ClosedForm
from ik_controller.kinematics.closed_form.wrist import solve_wrist
from ik_controller.kinematics.task import Task

Array = NDArray[np.float64]


class SphericalWrist(ClosedForm):
    """Three axes that meet: 2 solutions for a rotation, ZYX or ZYZ Euler angles for the wrists of the notes."""

    name = "spherical wrist"
    count = 2

    def require(self, task: Task) -> None:
        if not task.mask[3:].all():
            raise ArgumentError(f"axes: the closed form for the {self.name} needs rpy")

    def candidates(self, target: Any, reference: Array, free: set[str]) -> Iterator[Sequence[float]]:
        rotation = target.rotation @ self.screws.home.rotation.T
        yield from solve_wrist(self.screws, (0, 1, 2), rotation, float(reference[0]), free)
