"""The same jobs by other libraries, each in an environment of its own: python test/benchmark/peers [poses].

Solving poses, then a step towards a moving pose (`steps`). Environments are kept in .venv-peers/. A peer that does not
install is named in the table as such. Every answer, ours too, is checked by our kinematics; a pose counts as solved
within 1e-6 m, 1e-6 rad and the joint limits.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from environments import HERE, bare_urdf, environment

sys.path.insert(0, str(HERE.parent))

# name in the table → (script here, what to install)
PEERS = {
    "roboticstoolbox ik_LM": ("roboticstoolbox_lm.py", ["roboticstoolbox-python==1.5.0"]),
    "TRAC-IK (pytracik), 50 ms": ("trac_ik_speed.py", ["pytracik==0.0.3", "numpy"]),
    "EAIK, closed form": ("eaik_closed_form.py", ["eaik==1.2.2"]),
}


def main() -> None:
    """Print the tables, robot by robot, so that what is compared ran side by side."""
    from bench_solve import HEADER, row, time_solver
    from solve_problems import problems, solved
    from steps import compare_steps

    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    pythons = {name: environment(*peer) for name, peer in PEERS.items()}
    print(f"{count} random reachable poses, random starts; solved: within 1e-6 m, 1e-6 rad and the limits")
    print(HEADER)
    for problem in problems(count):
        answers, seconds = time_solver(problem)
        print(row("ik_controller solve_ik", problem.robot, solved(problem, answers), seconds))
        for name, python in pythons.items():
            if isinstance(python, str):
                print(f"{problem.robot:8s} {name:34s} {python}")
                continue
            with tempfile.TemporaryDirectory() as folder:
                task, result = Path(folder) / "task.npz", Path(folder) / "result.npz"
                np.savez(
                    task,
                    urdf=str(bare_urdf(problem.urdf, Path(folder))),
                    base=problem.model.base_frame,
                    tip=problem.tip,
                    poses=problem.poses,
                    starts=problem.starts,
                    lower=problem.model.lower,
                    upper=problem.model.upper,
                    **screws(problem.model),
                )
                done = subprocess.run(
                    [python, HERE / PEERS[name][0], task, result], capture_output=True, text=True, timeout=600
                )
                if done.returncode != 0:
                    last = [line for line in done.stderr.splitlines() if line.strip()][-1:]
                    print(f"{problem.robot:8s} {name:34s} fails: {''.join(last)[:90]}")
                    continue
                with np.load(result) as got:
                    print(row(name, problem.robot, solved(problem, got["answers"]), got["seconds"]))
    compare_steps()


def screws(model) -> dict[str, np.ndarray]:
    """Return the axes of an arm as EAIK takes them."""
    from ik_controller.kinematics.closed_form.geometry import Screws

    arm = Screws.of(model)
    ends = np.vstack((arm.point, arm.home.translation))
    return {"axes": arm.axis, "offsets": np.diff(np.vstack((np.zeros(3), ends)), axis=0), "home": arm.home.rotation}


if __name__ == "__main__":
    main()
