"""What every peer's script for the steps does: load the task, and step or follow the line when told. Only numpy.

A script gives `make(task, case)`, which returns (step, joints): `step(k)` goes one cycle on towards the k-th pose from
where the last one has led, `joints()` returns q (n,). It raises NotImplementedError for a case that the peer has not.
"""

import json
import sys
import time

import numpy as np

CASES = ("bare", "limits idle", "limits saturated", "priorities", "self-collision")


def serve(make):
    """Answer the parent's lines, one JSON value each: a case and a count of steps → µs of CPU time a step, or null; a
    file → the line's joints are written there.
    """
    with np.load(sys.argv[1]) as file:
        task = {name: file[name] for name in file.files}
    runs, at = {}, {}
    for line in sys.stdin:
        case, value = json.loads(line)
        try:
            if isinstance(value, str):
                np.save(value, follow(make, task, case))
                answer = 0.0
            else:
                if case not in runs:
                    runs[case], at[case] = make(task, case)[0], 0
                step, first = runs[case], at[case]
                at[case] = first + value if first + 2 * value < len(task["poses"]) else first
                before = time.process_time()
                for k in range(first, first + value):
                    step(k)
                answer = (time.process_time() - before) / value * 1e6
        except NotImplementedError:
            answer = None
        except Exception as error:  # said in the table; the other cases go on
            answer = f"{case}: {' '.join(str(error).split())[:100]}"
        print(json.dumps(answer), flush=True)


def follow(make, task, case):
    """Return the joints (K, n) at the end of every cycle along the line; `case`: "free" or "held"."""
    task = {**task, "poses": task["line"], "start": task["line_start"]}
    task["urdf"] = task["urdf_held"] if case == "held" else task["urdf"]
    task["lower"], task["upper"] = task["lower"].copy(), task["upper"].copy()
    if case == "held":
        task["upper"][int(task["held"])] = task["start"][int(task["held"])]
    step, joints = make(task, "limits idle")
    path = np.empty((len(task["poses"]), len(task["start"])))
    for k in range(len(path)):
        step(k)
        path[k] = joints()
    return path
