"""Problems for the solver benchmarks: random reachable poses with random starts within limits, four arms."""

from __future__ import annotations

import math
import site
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ik_controller.kinematics.model import RobotModel

CONFIG = Path(__file__).parents[2] / "config"
EXAMPLE_ROBOTS = "cmeel.prefix/share/example-robot-data/robots"
POSITION_TOLERANCE, ORIENTATION_TOLERANCE = 1e-6, 1e-6  # [m], [rad]: what counts as solved


@dataclass
class Problem:
    """`poses` (N, 4, 4) to reach from `starts` (N, n), for the arm of a URDF from its root link to `tip`."""

    robot: str
    urdf: Path
    tip: str
    model: RobotModel
    poses: np.ndarray
    starts: np.ndarray


def problems(count: int, seed: int = 0) -> list[Problem]:
    """Return `count` poses for the bundled arms, and for two of example-robot-data where it is installed."""
    arms = [
        ("panda", CONFIG / "panda" / "robot.urdf", "panda_hand_tcp"),
        ("ur5e", CONFIG / "ur5e" / "robot.urdf", "tool0"),
    ]
    for packages in site.getsitepackages():
        folder = Path(packages) / EXAMPLE_ROBOTS
        arms += [
            (name, folder / urdf, tip)
            for name, urdf, tip in (
                ("xarm7", "xarm_description/urdf/xarm7.urdf", "link_eef"),
                ("jaco", "kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
            )
            if (folder / urdf).is_file()
        ]
    return [_problem(name, urdf, tip, count, seed) for name, urdf, tip in arms]


def _problem(robot: str, urdf: Path, tip: str, count: int, seed: int) -> Problem:
    model = RobotModel.from_urdf(urdf, tip)
    lower = np.where(np.isfinite(model.lower), model.lower, -math.pi)
    upper = np.where(np.isfinite(model.upper), model.upper, math.pi)
    rng = np.random.default_rng(seed)
    poses = np.array([model.forward(q).homogeneous for q in rng.uniform(lower, upper, (count, model.n))])
    return Problem(robot, urdf, tip, model, poses, rng.uniform(lower, upper, (count, model.n)))


def solved(problem: Problem, answers: np.ndarray) -> np.ndarray:
    """Return (N,) whether each answer (N, n), NaN for none, is within limits and tolerances, by our own kinematics."""
    model = problem.model
    good = np.zeros(len(answers), dtype=bool)
    for i, (q, pose) in enumerate(zip(answers, problem.poses, strict=True)):
        if np.isnan(q).any() or (q < model.lower - 1e-9).any() or (q > model.upper + 1e-9).any():
            continue
        reached = model.forward(q).homogeneous
        turn = reached[:3, :3].T @ pose[:3, :3]
        sine = 0.5 * np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        angle = math.atan2(sine, 0.5 * (np.trace(turn) - 1.0))
        good[i] = np.linalg.norm(reached[:3, 3] - pose[:3, 3]) <= 1.001 * POSITION_TOLERANCE and (
            angle <= 1.001 * ORIENTATION_TOLERANCE
        )
    return good
