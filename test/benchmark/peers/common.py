"""What every peer's script does: load the task, time a solver, save the answers. Needs only numpy."""

import sys
import time

import numpy as np

ROUNDS = 3


def load():
    """Return the task as a dictionary of arrays."""
    with np.load(sys.argv[1]) as task:
        return {name: task[name] for name in task.files}


def run(task, solve):
    """Time solve(i), which returns joints (n,) or None, for every pose; save answers and the best of some rounds."""
    count = len(task["poses"])
    answers = np.full(task["starts"].shape, np.nan)
    seconds = np.full(count, np.inf)
    solve(0)
    for _ in range(ROUNDS):
        for i in range(count):
            before = time.perf_counter()
            q = solve(i)
            seconds[i] = min(seconds[i], time.perf_counter() - before)
            if q is not None:
                answers[i] = q
    np.savez(sys.argv[2], answers=answers, seconds=seconds)
