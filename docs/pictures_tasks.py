"""Make the picture of docs/tasks.md: `python docs/pictures_tasks.py`.

One function a picture; the name of the function is the name of the file in docs/images.
"""

from __future__ import annotations

import math
from typing import Any

import matplotlib as mpl
import numpy as np
import pinocchio as pin

mpl.use("Agg")
import matplotlib.pyplot as plt
from drawing import make

from ik_controller import Controller, Reference
from ik_controller.robots import build_model, bundled_parameters

DT = 0.004
PERIOD = 4.0  # of one round [s]
ROUNDS = 5
SIZE = 0.12  # [m]


def centring() -> Any:
    """Draw one path driven round and round, without and with joint centring: the joints' place in their ranges."""
    plain = bundled_parameters("panda").replace({"posture": (), "rate": 1.0 / DT})
    model = build_model(plain)
    q0 = np.array([-0.53, -1.0, 0.72, -2.35, 0.02, 1.25, -0.67])
    home = model.forward(q0)

    def target(t: float) -> Any:
        phase = 2.0 * math.pi / PERIOD * (t - 0.5 if t > 1.0 else 0.5 * t * t)
        offset = SIZE * np.array([0.3 * math.sin(2.0 * phase), math.sin(phase), math.cos(phase) - 1.0])
        return pin.SE3(home.rotation, home.translation + offset)

    half, middle = 0.5 * (model.upper - model.lower), 0.5 * (model.upper + model.lower)
    cases = {
        "the whole pose, nothing below it": {},
        "joint centring in its null space": {"objectives": ("joint_centring",), "objective_gains": (4.0,)},
        "the same for a drill, free to turn": {
            "objectives": ("joint_centring",),
            "objective_gains": (4.0,),
            "task_axes": "xyzrp",
            "task_frame": "tool",
        },
    }
    figure, axes = plt.subplots(1, 3, figsize=(11.0, 4.0), layout="constrained", sharey=True)
    for ax, (title, changes) in zip(axes, cases.items(), strict=True):
        controller = Controller(model, plain.replace(changes))
        controller.reset(q0)
        times = np.arange(round(ROUNDS * PERIOD / DT)) * DT
        joints, worst = [], 0.0
        for t in times:
            step = controller.step(controller.position, Reference.between(target(t), target(t + DT), DT), DT)
            joints.append((step.position - middle) / half)
            worst = max(worst, float(np.abs(step.error).max()))
        for joint, line in enumerate(np.transpose(joints), 1):
            ax.plot(times, line, label=f"joint {joint}", linewidth=1.3)
        ax.axhspan(1.0, 1.08, color="0.85")
        ax.axhspan(-1.08, -1.0, color="0.85")
        ax.grid(color="0.9")
        ax.spines[["top", "right"]].set_visible(False)
        ax.set(title=title, xlabel="time [s]", ylim=(-1.08, 1.08))
        ax.title.set_fontsize(10)
        print(f"{title}: largest error {worst:.2g}, furthest {np.abs(joints).max():.3f}")
    axes[0].set_ylabel("place in the joint's range (±1: its limits)")
    axes[2].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure


if __name__ == "__main__":
    make(centring)
