"""Time solve_ik on random reachable poses: python test/benchmark/bench_solve.py [poses]."""

from __future__ import annotations

import sys
import time

import numpy as np
import pinocchio as pin
from solve_problems import Problem, problems, solved

from ik_controller.kinematics.accelerate import HAS_NUMBA
from ik_controller.kinematics.closed_form import recognise
from ik_controller.kinematics.solve import solve_ik

ROUNDS = 3


def time_solver(problem: Problem, method: str = "damped") -> tuple[np.ndarray, np.ndarray]:
    """Return answers (N, n), NaN where none, and seconds (N,), the best of some rounds."""
    poses = [pin.SE3(pose[:3, :3].copy(), pose[:3, 3].copy()) for pose in problem.poses]
    answers = np.full(problem.starts.shape, np.nan)
    seconds = np.full(len(poses), np.inf)
    solve_ik(problem.model, poses[0], problem.starts[0], method)  # compile
    for _ in range(ROUNDS):
        for i, (pose, start) in enumerate(zip(poses, problem.starts, strict=True)):
            before = time.perf_counter()
            solution = solve_ik(problem.model, pose, start, method)
            seconds[i] = min(seconds[i], time.perf_counter() - before)
            if solution.converged:
                answers[i] = solution.q
    return answers, seconds


def row(name: str, robot: str, good: np.ndarray, seconds: np.ndarray) -> str:
    """Return a line of the table."""
    median, p99 = np.percentile(seconds * 1e6, (50, 99))
    return f"{robot:8s} {name:34s} {100.0 * good.mean():8.2f} {median:10.1f} {p99:10.1f}"


HEADER = f"{'robot':8s} {'method':34s} {'solved %':>8s} {'median us':>10s} {'p99 us':>10s}"


def main() -> None:
    """Print the table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    print(f"{count} random reachable poses, random starts, 1e-6 m and rad; Numba: {'yes' if HAS_NUMBA else 'no'}")
    print(HEADER)
    for problem in problems(count):
        methods = ["damped"] if recognise(problem.model) is None else ["damped", "analytic"]
        for method in methods:
            answers, seconds = time_solver(problem, method)
            print(row(f"solve_ik {method}", problem.robot, solved(problem, answers), seconds))


if __name__ == "__main__":
    main()
