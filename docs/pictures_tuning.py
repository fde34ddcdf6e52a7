"""Make the pictures of docs/tuning.md: `python docs/pictures_tuning.py`.

Each runs the real session on a simulated arm, with targets as a camera or a planner would stream them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
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

PANDA = bundled_parameters("panda")
MODEL = build_model(PANDA)
HOME = np.array(PANDA.posture)
START = 1_700_000_000_000_000_000
Array = np.ndarray


def swing(seconds: float) -> tuple[Array, Array]:
    """Return position (3,) [m] and velocity (3,) [m/s] of a target that swings by 8 cm every 2.5 s, softly started."""
    rate = 2.0 * math.pi / 2.5
    share, slope = (0.5 - 0.5 * math.cos(math.pi * seconds), 0.5 * math.pi * math.sin(math.pi * seconds))
    ramp, rise = (share, slope) if seconds < 1.0 else (1.0, 0.0)
    away = 0.08 * math.sin(rate * seconds)
    speed = 0.08 * (rate * math.cos(rate * seconds) * ramp + math.sin(rate * seconds) * rise)
    return np.array([0.0, ramp * away, 0.0]), np.array([0.0, speed, 0.0])


def run(
    targets: Callable[[float], Iterator[tuple[str, bytes]]], every: float, length: float, **changes: Any
) -> tuple[Array, Array, Array]:
    """Stream targets every so many seconds to the arm; return times [s], tool positions (k, 3), joint speeds (k, n)."""
    delay, lag = changes.pop("delay", 0.0), changes.pop("lag", 0.0)
    session = Session(MODEL, PANDA.replace(changes))
    arm = SimulatedArm(HOME, delay=delay, lag=lag)
    encode = cdr.JointStateWriter(MODEL.joint_names)
    times, tools, speeds = [], [], []
    due = 0.0
    for index in range(round(length / session.dt)):
        now, seconds = START + index * session.period, index * session.dt
        session.take("joint_states", encode.write(now, *arm.measure()), now)
        if seconds >= due:
            for role, data in targets(seconds):
                session.take(role, data, now)
            due += every
        step = session.cycle(now)
        if step is not None:
            arm.command(step.position)
        arm.advance(session.dt)
        times.append(seconds + session.dt)
        tools.append(MODEL.forward(arm.measure()[0]).translation.copy())
        speeds.append(np.zeros(MODEL.n) if step is None else step.velocity.copy())
    return np.array(times), np.array(tools), np.array(speeds)


def poses(
    noise: float = 0.0, twists: bool = False, late: float = 0.0
) -> Callable[[float], Iterator[tuple[str, bytes]]]:
    """Return a stream of the swing's poses, with noise [m], with twists, or stamped `late` [s] before they arrive."""
    random = np.random.default_rng(1)
    home = MODEL.forward(HOME)

    def stream(seconds: float) -> Iterator[tuple[str, bytes]]:
        way, speed = swing(seconds)
        stamp = START + round(seconds * 1e9)
        pose = pin.SE3(home.rotation, home.translation + way + noise * random.standard_normal(3))
        if twists:
            twist = np.concatenate((speed, np.zeros(3)))
            yield "target_twist", cdr.twist_message(stamp, MODEL.base_frame, twist)
        yield "target_pose", cdr.pose_message(stamp, MODEL.base_frame, pose)

    return stream


def error(times: Array, tools: Array) -> Array:
    """Return the tool's distance along y from the true swing [m]."""
    truth = np.array([swing(t)[0][1] for t in times]) + MODEL.forward(HOME).translation[1]
    return tools[:, 1] - truth


def _axes() -> tuple[Any, Any]:
    figure, axes = plt.subplots(2, 1, figsize=(8.0, 5.0), layout="constrained", sharex=True)
    for ax in axes:
        ax.grid(color="0.9")
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def tuning_gain() -> Any:
    """Draw a 100 Hz stream of poses without twists, by three gains: the tool trails by v/K."""
    figure, axes = _axes()
    for gain, color in ((5.0, "C3"), (20.0, "C1"), (100.0, "C2")):
        times, tools, _ = run(poses(), 0.01, 5.0, gain=[gain])
        axes[0].plot(times, 1e3 * (tools[:, 1] - tools[0, 1]), color, label=f"K = {gain:g}/s")
        axes[1].plot(times, 1e3 * error(times, tools), color)
    times, tools, _ = run(poses(twists=True), 0.01, 5.0, gain=[20.0])
    axes[0].plot(times, 1e3 * (tools[:, 1] - tools[0, 1]), "C0--", label="K = 20/s, with twists")
    axes[1].plot(times, 1e3 * error(times, tools), "C0--")
    axes[0].set(ylabel="tool y [mm]", title="Poses at 100 Hz: without twists the tool trails by v / K")
    axes[1].set(xlabel="time [s]", ylabel="error [mm]")
    figure.legend(loc="outside lower center", frameon=False, ncols=4)
    return figure


def tuning_noise() -> Any:
    """Draw a noisy 30 Hz stream, as of a camera: what the gain and the mode make of it."""
    figure, axes = _axes()
    cases: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("K = 100/s", "C3", {"gain": [100.0]}),
        ("K = 10/s", "C1", {"gain": [10.0]}),
        ("K = 10/s, interpolate", "C0", {"gain": [10.0], "reference_mode": "interpolate", "reference_delay": 0.07}),
    )
    for label, color, changes in cases:
        times, tools, speeds = run(poses(noise=1e-3), 1.0 / 30.0, 5.0, command_timeout=0.15, **changes)
        axes[0].plot(times, 1e3 * error(times, tools), color, label=label, linewidth=1.0)
        axes[1].plot(times, np.abs(speeds).max(axis=1), color, linewidth=1.0)
    axes[0].set(ylabel="error [mm]", title="Poses at 30 Hz with 1 mm of noise")
    axes[1].set(xlabel="time [s]", ylabel="fastest joint [rad/s]")
    figure.legend(loc="outside lower center", frameon=False, ncols=3)
    return figure


if __name__ == "__main__":
    make(tuning_gain, tuning_noise)
