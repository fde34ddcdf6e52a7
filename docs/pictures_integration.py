"""Make the pictures of docs/node.md: what each integration base does on an arm with 20 ms delay and 20 ms lag."""

from __future__ import annotations

import math
from typing import Any

import matplotlib as mpl
import numpy as np
import pinocchio as pin

mpl.use("Agg")
import matplotlib.pyplot as plt
from drawing import make

from ik_controller.control.simulated_arm import SimulatedArm
from ik_controller.messages import cdr
from ik_controller.robots import build_model, bundled_parameters
from ik_controller.session import Session

RATE = 500.0
START = 1_790_000_000_000_000_000
BASES = {"commanded": "C0", "measured": "C3", "bounded": "C2"}


def run(base: str, seconds: float, target: Any, *, held: tuple[float, float] = (0.0, 0.0), sag: float = 0.0) -> Any:
    """Follow `target(t)`, (pose, twist), on the lagging arm; return times and the real tool's distance to it [mm]."""
    parameters = bundled_parameters("panda").replace(
        {"rate": RATE, "integration_base": base, "posture": (), "max_deviation": 0.1}
    )
    model = build_model(parameters)
    home = np.array(bundled_parameters("panda").posture)
    session, arm = Session(model, parameters), SimulatedArm(home, delay=0.02, lag=0.02)
    writer, start = cdr.JointStateWriter(model.joint_names), model.forward(home)
    offset = np.zeros(model.n)
    offset[1] = sag
    times, distances = [], []
    for k in range(round(seconds * RATE)):
        now, t = START + k * session.period, k / RATE
        q = arm.measure()[0] + offset
        session.take("joint_states", writer.write(now, q, np.zeros(model.n)), now)
        pose, twist = target(start, t)
        if k % 5 == 0:
            session.take("target_pose", cdr.pose_message(now, model.base_frame, pose), now)
            session.take("target_twist", cdr.twist_message(now, model.base_frame, twist), now)
        step = session.cycle(now)
        assert step is not None
        if not held[0] <= t < held[1]:
            arm.command(step.position)
        arm.advance(session.dt)
        times.append(t)
        distances.append(1e3 * float(np.linalg.norm(model.forward(q).translation - pose.translation)))
    return np.array(times), np.array(distances)


def circle(start: Any, t: float) -> tuple[Any, np.ndarray]:
    """A circle of 10 cm in 4 s, begun gently."""
    w, r = 2.0 * math.pi / 4.0, 0.1
    p = start.translation + r * np.array([0.0, math.sin(w * t), 1.0 - math.cos(w * t)])
    return pin.SE3(start.rotation, p), np.array([0.0, r * w * math.cos(w * t), r * w * math.sin(w * t), 0.0, 0.0, 0.0])


def step(start: Any, t: float) -> tuple[Any, np.ndarray]:
    """A target 10 cm away."""
    return pin.SE3(start.rotation, start.translation + np.array([0.08, 0.0, -0.06])), np.zeros(6)


def integration_base() -> Any:
    """Draw what each base does with a step, a circle, an arm held fast and a joint that sags."""
    figure, axes = plt.subplots(2, 2, figsize=(11.0, 6.5), layout="constrained")
    plots = (
        (axes[0, 0], "A target 10 cm away", step, 2.0, {}),
        (axes[0, 1], "A circle at 0.16 m/s", circle, 5.0, {}),
        (axes[1, 0], "A circle; the arm is held fast from 1 s to 2 s", circle, 5.0, {"held": (1.0, 2.0)}),
        (axes[1, 1], "A target 10 cm away; joint 2 sags by 0.01 rad", step, 2.0, {"sag": 0.01}),
    )
    for ax, title, target, seconds, more in plots:
        for base, color in BASES.items():
            times, distances = run(base, seconds, target, **more)
            ax.plot(times, np.maximum(distances, 1e-3), color, label=base, linestyle="--" if base == "bounded" else "-")
        ax.set(title=title, xlabel="time [s]", ylabel="real tool to target [mm]")

        ax.set_yscale("log")
        ax.grid(color="0.9")
        ax.spines[["top", "right"]].set_visible(False)
    axes[0, 0].legend(frameon=False)
    return figure


if __name__ == "__main__":
    make(integration_base)
