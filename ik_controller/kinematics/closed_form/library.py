"""EAIK, an optional library, for the 6-joint arms with a closed form that is not among ours (N8).

EAIK (Ostermeier, Külz & Althoff 2025) decomposes every 6R arm with a spherical wrist, three parallel axes or suitable
pairs that meet, in about 20 µs a pose. `ssik` was judged beside it: it also solves 6R arms without special geometry,
but took milliseconds a pose from Python, and minutes to prepare such an arm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.closed_form.base import ClosedForm
from ik_controller.kinematics.closed_form.geometry import Screws

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LibraryForm(ClosedForm):
    """A 6R arm solved by EAIK; joints that are free at a singularity are not reported."""

    robot: Any = None
    family: str = ""

    @property
    def name(self) -> str:  # type: ignore[override]
        """The kinematic family, as EAIK calls it."""
        return f"{self.family} arm (EAIK)"

    def candidates(self, target: Any, reference: Array, free: set[str]) -> Iterator[Sequence[float]]:
        # EAIK's tool frame is parallel to the base at q = 0.
        pose = target.homogeneous.copy()
        pose[:3, :3] = target.rotation @ self.screws.home.rotation.T
        yield from self.robot.calculate_IK(pose).Q


def library_form(screws: Screws, known: str) -> ClosedForm:
    """Return EAIK's closed form. Raises ArgumentError: not a 6R arm, EAIK missing, or no closed form; `known`: ours."""
    if screws.n != 6 or screws.prismatic.any():
        raise ArgumentError(f"method 'analytic': no closed form for this arm; there are: {known}; use 'damped'")
    try:
        eaik: Any = import_module("eaik.pybindings.EAIK")
    except ImportError:
        raise ArgumentError(
            "method 'analytic': this 6-joint arm needs the extra 'analytic': pip install 'ik_controller[analytic]'; "
            "or use 'damped'"
        ) from None
    offsets = np.vstack((screws.point[:1], np.diff(screws.point, axis=0), screws.home.translation - screws.point[-1:]))
    robot = eaik.Robot(screws.axis.T, offsets.T, np.eye(3), [], True)
    if not robot.has_known_decomposition():
        raise ArgumentError(f"method 'analytic': EAIK knows no closed form for this arm; ours: {known}; use 'damped'")
    return LibraryForm(screws, robot, robot.get_kinematic_family())
