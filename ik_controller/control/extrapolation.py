"""Extrapolation: a reference carried on beyond its last sample, by its twist and by how the last twists changed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.rotation_exp import rotation_exp

Array = NDArray[np.float64]


class Course(NamedTuple):
    """How a pose stream goes on without a new sample: from `position` (3,) [m] and `rotation` (3, 3) by `twist` (6,)
    [m/s, rad/s], which changes at `rate` (6,). Cycles begin `ahead` (k,) [s] after the sample.
    """

    position: Array
    rotation: Array
    twist: Array
    rate: Array
    ahead: Array


@compiled
def carry_on(
    position: Array, rotation: Array, twist: Array, rate: Array, ahead: float, dt: float, pose: Array, mean: Array
) -> None:
    """Write where a pose is after `ahead` [s] of a twist (6,) that changes at `rate` (6,), and its mean over the next
    dt.

    `pose` (4, 3): rotation over position; `mean` (6,).
    """
    way = ahead * twist + (0.5 * ahead * ahead) * rate
    rotation_exp(way[3:], rotation, pose)
    pose[3] = position + way[:3]
    mean[:] = twist + (ahead + 0.5 * dt) * rate


@compiled
def agreed_rate(v0: Array, v1: Array, v2: Array, dt1: float, dt2: float) -> Array:
    """Return the rate (6,) of three twists, dt1 and dt2 [s] apart: by component the smaller of the two differences, 0
    where they disagree in sign (minmod).
    """
    rate = np.zeros(6)
    for i in range(6):
        older, newer = (v1[i] - v0[i]) / dt1, (v2[i] - v1[i]) / dt2
        if older * newer > 0.0:
            rate[i] = older if abs(older) < abs(newer) else newer
    return rate
