"""Extrapolation: a reference carried on beyond its last sample, by its twist and by how the last twists changed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.rotation_exp import rotation_exp

Array = NDArray[np.float64]


@compiled
def carry_on(
    position: Array, rotation: Array, twist: Array, rate: Array, ahead: Array, dt: float, poses: Array, means: Array
) -> None:
    """Write where a pose is after each of `ahead` (k,) [s] of a twist (6,) that changes at `rate` (6,), and its mean
    over the next dt; before the pose's own time the twist does not change.

    `poses` (k, 4, 3): rotation over position; `means` (k, 6).
    """
    still = np.zeros(6)
    for k in range(ahead.shape[0]):
        time, change = ahead[k], rate if ahead[k] > 0.0 else still
        way = time * twist + (0.5 * time * time) * change
        rotation_exp(way[3:], rotation, poses[k])
        poses[k, 3] = position + way[:3]
        means[k] = twist + (time + 0.5 * dt) * change


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
