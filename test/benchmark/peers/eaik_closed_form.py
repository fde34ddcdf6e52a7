"""EAIK: all solutions in closed form, the first within limits taken; 6-joint arms that it can decompose."""

import sys

import numpy as np
from common import load, run
from eaik.pybindings import EAIK

task = load()
if task["axes"].shape[0] != 6:
    sys.exit("not a 6-joint arm")
robot = EAIK.Robot(task["axes"].T, task["offsets"].T, np.eye(3), [], True)
if not robot.has_known_decomposition():
    sys.exit("no closed form for this arm")
targets = task["poses"].copy()
targets[:, :3, :3] = targets[:, :3, :3] @ task["home"].T
lower, upper = task["lower"], task["upper"]


def solve(i):
    """Return the joints, or None."""
    answer = robot.calculate_IK(targets[i])
    for q, approximate in zip(answer.Q, answer.is_LS, strict=True):
        if approximate:
            continue
        turned = np.where(q < lower, q + 2.0 * np.pi, np.where(q > upper, q - 2.0 * np.pi, q))
        if (turned >= lower).all() and (turned <= upper).all():
            return turned
    return None


run(task, solve)
