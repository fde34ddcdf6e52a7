"""Make the pictures of docs/solving.md: `python docs/pictures_solving.py` for all, or with names for some.

One function a picture; the name of the function is the name of the file in docs/images.
"""

from __future__ import annotations

import math
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from drawing import make

from ik_controller.kinematics.closed_form import recognise
from ik_controller.kinematics.dh import DHJoint, dh_model
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.solve import solve_ik

HALF = math.pi / 2
PLANAR_2R = dh_model([DHJoint(a=1.0), DHJoint(a=1.0)], "classic")
PUMA = dh_model(
    [DHJoint(d=0.5, alpha=HALF), DHJoint(a=0.43, d=0.15), DHJoint(alpha=HALF), DHJoint(d=0.43, alpha=-HALF),
     DHJoint(alpha=HALF), DHJoint(d=0.12)],
    "classic",
)  # fmt: skip
SEVEN = dh_model(
    [DHJoint(d=0.36, alpha=-HALF), DHJoint(alpha=HALF), DHJoint(d=0.42, alpha=HALF), DHJoint(alpha=-HALF),
     DHJoint(d=0.4, alpha=-HALF), DHJoint(alpha=HALF), DHJoint(d=0.126)],
    "classic",
)  # fmt: skip


def solving_2r() -> Any:
    """Draw N7: the printed 2R example over the workspace and over the joints, inverse and transpose."""
    goal, start = np.array([0.2, 1.3]), (0.25, 0.75)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.6), layout="constrained")
    circle = np.linspace(0.0, 2.0 * math.pi, 200)
    left.fill(2.0 * np.cos(circle), 2.0 * np.sin(circle), color="0.95", zorder=0)
    grid = np.linspace(-math.pi, math.pi, 181)
    a, b = np.meshgrid(grid, grid)
    distance = np.hypot(np.cos(a) + np.cos(a + b) - goal[0], np.sin(a) + np.sin(a + b) - goal[1])
    right.contourf(a, b, distance, levels=12, cmap="Greys", alpha=0.5)
    for method, count, color in (("newton", 10, "C0"), ("transpose", 30, "C3")):
        rows = solve_ik(
            PLANAR_2R, [*goal, 0.0, 0.0, 0.0, 0.0, 1.0], start, method, axes="xy", step=0.75, max_iterations=count,
            history=True,
        ).history  # fmt: skip
        joints = np.array([row.q for row in rows])
        tool = np.array([PLANAR_2R.forward(q).translation[:2] for q in joints])
        label = {"newton": "inverse", "transpose": "transpose"}[method]
        left.plot(*tool.T, "o-", color=color, markersize=4, linewidth=1.2, label=f"{label}, {len(rows) - 1} iterations")
        right.plot(*joints.T, "o-", color=color, markersize=4, linewidth=1.2, label=label)
        for k in range(4):
            left.annotate(str(k), tool[k], xytext=(4, 4), textcoords="offset points", color=color, fontsize=8)
    for q in (start, solve_ik(PLANAR_2R, [*goal, 0.0, 0.0, 0.0, 0.0, 1.0], start, "analytic", axes="xy").q):
        elbow = np.array([math.cos(q[0]), math.sin(q[0])])
        end = elbow + np.array([math.cos(q[0] + q[1]), math.sin(q[0] + q[1])])
        left.plot([0.0, elbow[0], end[0]], [0.0, elbow[1], end[1]], color="0.6", linewidth=4, zorder=1, alpha=0.6)
    left.plot(*goal, "*", color="k", markersize=12, label="target (0.2, 1.3)")
    left.set(aspect="equal", xlim=(-2.1, 2.1), ylim=(-0.7, 2.1), xlabel="x [m]", ylabel="y [m]", title="Tool point")
    left.legend(loc="lower left", fontsize=8)
    solutions = solve_ik(
        PLANAR_2R, [*goal, 0.0, 0.0, 0.0, 0.0, 1.0], start, "analytic", axes="xy", all_solutions=True
    ).solutions
    right.plot(*np.array(solutions).T, "*", color="k", markersize=12, linestyle="none", label="the two solutions")
    right.set(xlabel="θ₁ [rad]", ylabel="θ₂ [rad]", title="Joints, over the distance to the target", xlim=(-1.0, 2.5))
    right.legend(loc="lower left", fontsize=8)
    return figure


def puma_solutions() -> Any:
    """Draw N8: the eight solutions of a PUMA type arm with a shoulder offset for one pose; the arrow is axis 5."""
    q = np.array([0.5, 0.5, 0.6, 0.7, 0.9, -0.4])
    pose = PUMA.forward(q)
    solutions = solve_ik(PUMA, pose, q, "analytic", all_solutions=True, respect_limits=False).solutions
    order = sorted(solutions, key=lambda one: (round(one[0], 3), round(one[2], 3), one[4]))
    figure, axes = plt.subplots(2, 4, figsize=(12.0, 7.0), subplot_kw={"projection": "3d"})
    figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=0.93, wspace=0.0, hspace=0.12)
    for number, (ax, one) in enumerate(zip(axes.T.flat, order, strict=True), 1):
        points = skeleton(PUMA, one)
        ax.plot(*points[:3].T, "-", color="0.4", linewidth=5, solid_capstyle="round")
        ax.plot(*points[2:5].T, "-", color="C0", linewidth=5, solid_capstyle="round")
        ax.plot(*points[4:].T, "-", color="C3", linewidth=4, solid_capstyle="round")
        axis5 = PUMA.jacobian(one)[3:, 4]
        ax.quiver(*points[4], *(0.2 * axis5), color="k", linewidth=1.5)
        frame(ax, pose, 0.15)
        degrees = [f"{math.degrees(x):.0f}°" for x in one]
        ax.set_title(f"{number}:  " + "  ".join(degrees), fontsize=9, y=1.03)
        ax.set(xlim=(-0.1, 0.9), ylim=(-0.25, 0.75), zlim=(0.0, 1.0), xticklabels=[], yticklabels=[], zticklabels=[])
        ax.view_init(elev=38.0, azim=-115.0)
        ax.set_box_aspect((1.0, 1.0, 1.0), zoom=1.0)
    return figure


def swivel() -> Any:
    """Draw N9: one hand pose, the elbow turned about the line from shoulder to wrist."""
    q = np.array([0.3, 0.9, -0.4, 1.5, 0.5, -0.8, 0.2])
    pose = SEVEN.forward(q)
    figure = plt.figure(figsize=(6.0, 5.4))
    figure.subplots_adjust(left=0.0, right=0.98, bottom=0.02, top=1.0)
    ax = figure.add_subplot(projection="3d")
    for angle in np.radians(np.arange(-150, 181, 30)):
        one = solve_ik(SEVEN, pose, q, "analytic", swivel=float(angle), respect_limits=False).q
        color = mpl.colormaps["hsv"]((angle + math.pi) / (2.0 * math.pi))
        points = skeleton(SEVEN, one)
        ax.plot(*points.T, "-", color=color, linewidth=2.0, solid_capstyle="round")
        ax.plot(*points[-3], "o", color=color, markersize=5)
        ax.text(*points[-3], f"  {math.degrees(angle):.0f}°", fontsize=8)
    frame(ax, pose, 0.15)
    ax.set(xlim=(-0.3, 0.6), ylim=(-0.4, 0.5), zlim=(0.1, 1.0), xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    ax.set_box_aspect((1.0, 1.0, 1.0))
    ax.view_init(elev=25.0, azim=-20.0)
    return figure


def skeleton(model: RobotModel, q: np.ndarray) -> np.ndarray:
    """Return the points of a stick figure (k, 3): base, shoulder, the same beside its offset, elbow, wrist, tool."""
    form = recognise(model)
    if form is None:
        raise ValueError("only arms with a closed form are drawn")
    screws = form.screws
    elbow_joint = model.n - 4
    elbow = screws.point[elbow_joint]
    shoulder = screws.point[0] + (screws.axis[0] @ (screws.point[1] - screws.point[0])) * screws.axis[0]
    beside = shoulder + (screws.axis[1] @ (elbow - shoulder)) * screws.axis[1]
    wrist = screws.meeting_point(*range(model.n - 3, model.n))
    points = [np.zeros(3)]
    for place, joints in ((shoulder, 1), (beside, 1), (elbow, elbow_joint), (wrist, model.n - 3)):
        moved = place
        for joint in reversed(range(joints)):
            moved = screws.move(joint, float(q[joint]), moved)
        points.append(moved)
    return np.array([*points, model.forward(q).translation])


def frame(ax: Any, pose: Any, size: float) -> None:
    """Draw the axes of a pose."""
    for column, color in enumerate(("r", "g", "b")):
        tip = pose.translation + size * pose.rotation[:, column]
        ax.plot(*np.array([pose.translation, tip]).T, color=color, linewidth=1.5)


if __name__ == "__main__":
    make(solving_2r, puma_solutions, swivel)
