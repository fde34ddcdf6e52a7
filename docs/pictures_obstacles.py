"""Make the picture of docs/obstacles.md: `python docs/pictures_obstacles.py`."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
import pinocchio as pin

mpl.use("Agg")
import matplotlib.pyplot as plt
from drawing import make
from matplotlib.patches import Rectangle

from ik_controller import Controller, Reference
from ik_controller.control.obstacles import Scene
from ik_controller.kinematics.chain import chain_of
from ik_controller.kinematics.collision import joint_frames, place_capsules
from ik_controller.kinematics.collision_world import box
from ik_controller.robots import build_model, bundled_parameters

DT = 1e-3
SIZE = np.array([0.16, 0.3, 0.16])


def capsules(model: Any, arm: Any, q: np.ndarray) -> np.ndarray:
    """Return the capsules' ends (S, 2, 3) at q (n,)."""
    chain, placed = tuple(chain_of(model)), np.empty(arm.ends.shape)
    m = len(chain[3])
    rotation, position = np.empty((m, 3, 3)), np.empty((m, 3))
    joint_frames(chain, q, rotation, position, np.empty((m, 3)))
    place_capsules(arm.joint, arm.ends, rotation, position, placed)
    return placed


def obstacles() -> Any:
    """Draw a straight line through a box, with and without obstacle avoidance, from the side."""
    parameters = bundled_parameters("panda").replace({"obstacle_avoidance": True})
    model = build_model(parameters)
    home = np.array(parameters.posture)
    start = model.forward(home)
    way = np.array([0.3, 0.0, -0.32])
    middle = start.translation + 0.55 * way
    figure, axes = plt.subplots(1, 3, figsize=(11.0, 4.2), layout="constrained", width_ratios=(1, 1, 1.1))
    for ax, on in zip(axes, (False, True), strict=False):
        scene = Scene.of(model, parameters)
        if on:
            scene.world.put("box", box(*SIZE).at(pin.SE3(np.eye(3), middle)))
        controller = Controller(model, parameters, scene)
        controller.reset(home)
        path, gaps = [], []
        for k in range(5000):
            share = min(k / 2500.0, 1.0)
            reference = Reference.pose(pin.SE3(start.rotation, start.translation + share * way))
            step = controller.step(controller.position, reference, DT)
            path.append(model.forward(step.position).translation)
            if k % 10 == 0:
                ends, points = capsules(model, scene.arm, step.position), np.linspace(0.0, 1.0, 21)[:, None, None]
                points = (ends[:, 0] + points * (ends[:, 1] - ends[:, 0]))[:, scene.arm.joint >= 0]
                away = np.abs(points - middle) - 0.5 * SIZE
                outside = np.linalg.norm(np.maximum(away, 0.0), axis=2) + np.minimum(away.max(axis=2), 0.0)
                gaps.append((k * DT, 1e3 * float((outside - scene.arm.radius[scene.arm.joint >= 0]).min())))
            if k in (0, 1600, 4999):
                for (a, b), radius in zip(capsules(model, scene.arm, step.position), scene.arm.radius, strict=True):
                    draw_capsule(ax, a[[0, 2]], b[[0, 2]], radius, 0.25 + 0.5 * (k > 0) * (k == 4999))
        path = np.array(path)
        ax.add_patch(
            Rectangle(middle[[0, 2]] - 0.5 * SIZE[[0, 2]], SIZE[0], SIZE[2], color="#c0392b", alpha=0.8, zorder=5)
        )
        goal = start.translation + way
        ax.plot(*np.array([start.translation, goal])[:, [0, 2]].T, "k:", zorder=6, label="wanted")
        ax.plot(path[:, 0], path[:, 2], color="#1f4e9c", linewidth=2, zorder=7, label="tool")
        ax.set(aspect="equal", xlim=(-0.2, 0.85), ylim=(0.0, 1.0), xlabel="x [m]", ylabel="z [m]")
        ax.set_title("with" if on else "without")
        ax.legend(loc="upper right")
        times, distances = np.array(gaps).T
        axes[2].plot(times, distances, label="with" if on else "without", color="#1f4e9c" if on else "0.6")
    axes[2].axhline(1e3 * parameters.minimum_distance, color="#c0392b", linestyle="--", label="minimum_distance")
    axes[2].set(xlabel="time [s]", ylabel="arm to box [mm]", title="distance", ylim=(-60, 250))
    axes[2].legend()
    axes[2].grid(color="0.9")
    return figure


def draw_capsule(ax: Any, a: np.ndarray, b: np.ndarray, radius: float, alpha: float) -> None:
    """Draw a capsule's outline, filled."""
    along = b - a
    turn = np.arctan2(along[1], along[0]) if np.linalg.norm(along) > 1e-9 else 0.0
    angles = np.linspace(0.5 * np.pi, 1.5 * np.pi, 24) + turn
    half = radius * np.column_stack((np.cos(angles), np.sin(angles)))
    ax.fill(*np.vstack((a + half, b - half)).T, color="#8d99ae", alpha=0.5 * alpha, linewidth=0)


if __name__ == "__main__":
    make(obstacles)
