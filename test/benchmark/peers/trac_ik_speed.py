"""TRAC-IK by pytracik, type Speed, 50 ms a pose at most; quaternions made beforehand, limits set from ours."""

from pathlib import Path

import numpy as np
import pytracik
from common import load, run

task = load()
text = Path(str(task["urdf"])).read_text()
solver = pytracik.TRAC_IK(str(task["base"]), str(task["tip"]), text, 0.05, 1e-7, pytracik.SolveType.Speed)
bounded = np.isfinite(task["lower"]) & np.isfinite(task["upper"])
pytracik.set_joint_limits(
    solver,
    np.where(bounded, task["lower"], -1e6).tolist(),
    np.where(bounded, task["upper"], 1e6).tolist(),
)


def quaternion(matrix):
    """Return (x, y, z, w) of a rotation matrix, by its largest component."""
    four = np.array([np.trace(matrix), *np.diag(matrix)])
    k = int(np.argmax(four))
    if k == 0:
        q = np.array(
            [matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1], 1.0 + four[0]]
        )
    else:
        i, j, l = k - 1, k % 3, (k + 1) % 3  # noqa: E741
        q = np.empty(4)
        q[i] = 1.0 + 2.0 * matrix[i, i] - four[0]
        q[j], q[l] = matrix[i, j] + matrix[j, i], matrix[i, l] + matrix[l, i]
        q[3] = matrix[l, j] - matrix[j, l]
    return q / np.linalg.norm(q)


targets = [(*pose[:3, 3], *quaternion(pose[:3, :3])) for pose in task["poses"]]


def solve(i):
    """Return the joints, or None."""
    answer = pytracik.ik(solver, task["starts"][i], *targets[i])
    return answer[1:] if answer[0] >= 0 else None


run(task, solve)
