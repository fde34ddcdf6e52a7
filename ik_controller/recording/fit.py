"""Fit: move, scale and turn somebody's motion so that an arm can follow it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fitting:
    """How a motion is fitted: positions times `scale`, rotations times `turn`, then moved by `offset` [m].

    `place`: "" leaves it where it is; "start" puts its first pose at the arm's start, position and orientation;
    "middle" the middle of its box, with the first orientation.
    """

    scale: float = 1.0
    turn: float = 1.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    place: str = ""

    @property
    def idle(self) -> bool:
        """Tell whether it changes nothing."""
        return self == Fitting()


class Fit:
    """Fits one stream of poses and twists, pose after pose."""

    def __init__(self, fitting: Fitting, anchor: Array, first: Any, home: Any | None = None) -> None:
        """`anchor` (3,): the point that scaling leaves alone, or that comes to `home`, a `pin.SE3`; `first`: the first
        pose, a `pin.SE3`.
        """
        self._fitting = fitting
        self._anchor = anchor
        placed = home if fitting.place else None
        self._point = (anchor if placed is None else placed.translation) + np.array(fitting.offset)
        self._before = first.rotation.copy()
        self._turned = (first if placed is None else placed).rotation.copy()

    def pose(self, numbers: Array) -> Array:
        """Return the next pose's numbers (7,) x y z qx qy qz qw fitted.

        Rotations are scaled step by step: scaled as a whole one would jump where it passes half a turn.
        """
        rotation = pin.Quaternion(*numbers[[6, 3, 4, 5]]).normalized().toRotationMatrix()
        step = pin.log3(rotation @ self._before.T)
        self._before = rotation
        self._turned = pin.exp3(self._fitting.turn * step) @ self._turned
        position = self._point + self._fitting.scale * (numbers[:3] - self._anchor)
        return np.concatenate((position, pin.Quaternion(self._turned).normalized().coeffs()))

    def twist(self, numbers: Array) -> Array:
        """Return a twist (6,) (v, ω) fitted."""
        return np.concatenate((self._fitting.scale * numbers[:3], self._fitting.turn * numbers[3:]))
