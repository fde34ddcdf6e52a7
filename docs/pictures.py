"""Make the pictures of docs/: `python docs/pictures.py` for all, `python docs/pictures.py drift decay` for some.

One function a picture; the name of the function is the name of the file in docs/images.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import numpy as np
import pinocchio as pin

mpl.use("Agg")
import matplotlib.pyplot as plt
from drawing import make

from ik_controller.kinematics.dh import DHJoint, dh_model
from ik_controller.kinematics.integrate import follow, integrate
from ik_controller.kinematics.inverses import inverse
from ik_controller.kinematics.orientation_error import ORIENTATION_ERRORS
from ik_controller.kinematics.rotation import rotation_from_euler_zyx
from ik_controller.recording.picture import picture
from ik_controller.recording.timeline import collect
from ik_controller.share import bag_folder

HALF = math.pi / 2
PLANAR_2R = dh_model([DHJoint(a=1.0), DHJoint(a=1.0)], "classic")
PUMA = dh_model(
    [DHJoint(alpha=HALF), DHJoint(a=0.43), DHJoint(alpha=HALF), DHJoint(d=0.43, alpha=-HALF), DHJoint(alpha=HALF),
     DHJoint(d=0.1)],
    "classic",
)  # fmt: skip
Q_PUMA = np.array([0.2, 0.6, 0.3, 0.4, -0.9, 0.2])


def _axes(rows: int = 1, columns: int = 1, size: tuple[float, float] = (8.0, 4.0)) -> tuple[Any, Any]:
    figure, axes = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    for ax in axes.flat:
        ax.grid(color="0.9")
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def drift() -> Any:
    """Draw N10: ten rounds of a circle, open loop by three integrators, and closed loop."""
    start = PUMA.forward(Q_PUMA)
    rate = 2.0 * math.pi / 4.0

    def reference(t: float) -> Any:
        p = start.translation + 0.1 * np.array([0.0, math.cos(rate * t) - 1.0, math.sin(rate * t)])
        return pin.SE3(start.rotation, p)

    def twist(t: float) -> np.ndarray:
        return 0.1 * rate * np.array([0.0, -math.sin(rate * t), math.cos(rate * t), 0.0, 0.0, 0.0])

    figure, axes = _axes()
    ax = axes[0, 0]
    for method, gain, label, style in (
        ("euler", 0.0, "Euler, open loop", "C3-"),
        ("euler", 10.0, "Euler, closed loop, K = 10/s", "C0-"),
        ("midpoint", 0.0, "midpoint, open loop", "C1-"),
        ("rk4", 0.0, "RK4, open loop", "C4-"),
    ):
        motion = follow(PUMA, Q_PUMA, 40.0, 0.05, twist=twist, reference=reference, gain=gain, method=method)
        ax.semilogy(motion.t[1:], 1e3 * np.linalg.norm(motion.error[1:, :3], axis=1), style, label=label)
    ax.set(xlabel="time [s]", ylabel="position error [mm]", title="Drift over ten rounds of a circle, steps of 50 ms")
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure


def decay() -> Any:
    """Draw N11: every component of the error falls at the rate of its entry of K."""
    start = PUMA.forward(Q_PUMA)
    gain = np.array([1.0, 2.0, 4.0, 3.0, 6.0, 8.0])
    target = pin.SE3(pin.exp3(np.full(3, 0.02)) @ start.rotation, start.translation + 0.02)
    motion = follow(PUMA, Q_PUMA, 1.5, 0.005, reference=lambda t: target, gain=gain, method="rk4")
    figure, axes = _axes()
    ax = axes[0, 0]
    share = motion.error / motion.error[0]
    for i, name in enumerate(("x", "y", "z", "rotation x", "rotation y", "rotation z")):
        (line,) = ax.semilogy(motion.t, share[:, i], label=f"{name}: K = {gain[i]:g}/s")
        ax.semilogy(motion.t[::30], np.exp(-gain[i] * motion.t[::30]), "o", color=line.get_color(), markersize=4)
    ax.set(
        xlabel="time [s]", ylabel="share of the error left", title="ė + K e = 0: integrated (lines), exp(−K t) (dots)"
    )
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure


def singularity() -> Any:
    """Draw N5, N12: a 2R arm passes 2 cm beside its shoulder, with and without damping."""
    speed, offset, duration = 0.3, 0.02, 5.0

    def reference(t: float) -> np.ndarray:
        return np.array([-0.75 + speed * t, offset])

    def velocity(options: dict[str, Any]) -> Callable[[float, np.ndarray], np.ndarray]:
        def f(t: float, q: np.ndarray) -> np.ndarray:
            e = reference(t) - PLANAR_2R.forward(q).translation[:2]
            return inverse(PLANAR_2R.jacobian(q)[:2], **options) @ (np.array([speed, 0.0]) + 10.0 * e)

        return f

    x, y = reference(0.0)
    elbow = math.acos((x * x + y * y - 2.0) / 2.0)
    q0 = np.array([math.atan2(y, x) - elbow / 2.0, elbow])
    figure, axes = _axes(2, 1, (8.0, 5.5))
    for options, label, style in (
        ({"method": "pseudo"}, "J⁺ (pseudo)", "C3-"),
        ({"method": "damped", "damping": 0.1}, "damped, λ = 0.1", "C1-"),
        ({"method": "damped_manipulability", "damping": 0.1, "threshold": 0.2}, "damped_manipulability", "C2-"),
        ({"method": "numerical_filtering", "damping": 0.1, "threshold": 0.2}, "numerical_filtering", "C0--"),
    ):
        t, q = integrate(velocity(options), q0, duration, 0.001, "midpoint")
        rates = np.abs(np.gradient(q, t, axis=0)).max(axis=1)
        error = [
            np.linalg.norm(reference(tk) - PLANAR_2R.forward(qk).translation[:2]) for tk, qk in zip(t, q, strict=True)
        ]
        axes[0, 0].semilogy(t, rates, style, label=label)
        axes[1, 0].semilogy(t, 1e3 * np.maximum(error, 1e-8), style, label=label)
    axes[0, 0].set(ylabel="fastest joint [rad/s]", title="A 2R arm passes 2 cm beside its shoulder at 0.3 m/s")
    axes[1, 0].set(xlabel="time [s]", ylabel="position error [mm]", ylim=(1e-4, 200))
    axes[0, 0].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure


def orientation_errors() -> Any:
    """Draw N4: how much of a rotation by θ each orientation error sees, about one skew axis."""
    figure, axes = _axes()
    ax = axes[0, 0]
    axis = np.array([-0.8, -0.2, 0.5]) / math.sqrt(0.93)
    R = rotation_from_euler_zyx([0.3, 0.2, 0.4])
    angles = np.linspace(0.001, math.pi - 0.001, 400)
    for name, style in (
        ("exponential_base", "C0-"),
        ("quaternion", "C2-"),
        ("instantaneous", "C3-"),
        ("euler_relative_tool", "C4--"),
        ("euler_difference_zyx", "C1--"),
        ("euler_difference_zxz", "C5:"),
    ):
        error = ORIENTATION_ERRORS[name]
        desired = [pin.exp3(axis * angle) @ R for angle in angles]
        along = [error.to_angular_velocity(error.function(R_desired, R), R) @ axis for R_desired in desired]
        ax.plot(angles, along, style, label=name)
    ax.axhline(0.0, color="0.5", linewidth=0.8)
    ax.set(xlabel="angle θ between R and R_desired [rad]", ylabel="command along the axis [rad]", ylim=(-3.5, 3.5))
    ax.set_title("Orientation errors: below 0 the command turns the wrong way")
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure


def demo() -> Any:
    """The README's picture: the figure-eight on the 7-joint arm, from its golden run."""
    return picture(
        collect(bag_folder("panda_golden")).timeline, "A figure-eight from a 100 Hz stream of poses and twists"
    )


if __name__ == "__main__":
    make(drift, decay, singularity, orientation_errors, demo)
