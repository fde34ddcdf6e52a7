"""A seeded soak of adversarial streams on several arms: no bound is ever crossed, and the gate never fires.

Short in `make test`; `make soak` takes a million cycles. The references are those of test_limits, and besides, at
random: resets, changes of the scales, pauses, loss of feedback.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from motions import Robot
from test_limits import DT, KINDS, arm, reference_of

from ik_controller import Controller, ControllerParameters, RobotModel
from ik_controller.control.status import Code

ALL = ["panda", "ur5e", "planar_2r", "planar_3r", "scara", "panda jerk", "ur5e jerk", "scara jerk", "kinova", "ur10"]


def soaked(name: str) -> Robot:
    """An arm of test_limits, or one of example-robot-data."""
    files = {
        "kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
        "ur10": ("ur_description/urdf/ur10_robot.urdf", "ee_link"),
    }
    if name not in files:
        return arm(name)
    path, tip = files[name]
    robots = Path(pytest.importorskip("cmeel").__file__).parents[1] / "cmeel.prefix/share/example-robot-data/robots"
    if not (robots / path).exists():
        pytest.skip("example-robot-data is not installed")
    model = RobotModel.from_urdf(robots / path, tip)
    return Robot(model, ControllerParameters(), model.middle() + 0.1)


class Record:
    """The worst excess over each limit, as a share of it, that a stream of commands shows."""

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.worst = dict.fromkeys(("position", "velocity", "acceleration", "jerk"), 0.0)
        self.last: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def add(self, q: np.ndarray, v: np.ndarray) -> None:
        model = self.model
        assert np.isfinite(q).all()
        assert np.isfinite(v).all()
        if self.last is not None:
            _, v0, a0 = self.last
            a = (v - v0) / DT
            rounding = 1e-15 * (np.abs(v) + np.abs(v0)) / DT
            excess = {
                "position": np.fmax(q - model.upper, model.lower - q) / np.fmax(np.abs(q), 1.0),
                "velocity": np.abs(v) / model.velocity_limit - 1.0,
                "acceleration": (np.abs(a) - rounding) / model.acceleration_limit - 1.0,
                "jerk": (np.abs(a - a0) - 2 * rounding) / (model.jerk_limit * DT) - 1.0,
            }
            for key, values in excess.items():
                self.worst[key] = max(self.worst[key], float(values.max()))
            self.last = q, v, a
        else:
            self.last = q, v, np.zeros_like(v)


def soak(name: str, cycles: int, seed: int) -> dict[str, float]:
    robot = soaked(name)
    model, rng = robot.model, np.random.default_rng(seed)
    low, high = np.fmax(model.lower, -6.0), np.fmin(model.upper, 6.0)
    controller, record, spell = Controller(model, robot.parameters), Record(model), 0
    controller.reset(rng.uniform(low, high))
    everything = controller.parameters
    for _ in range(cycles):
        if spell == 0:
            kind, spell = str(rng.choice(KINDS)), int(rng.choice([1, 3, 20, 100, 400]))
            every, noise = rng.random() < 0.3, 0.0 if rng.random() < 0.7 else 10.0 ** rng.uniform(-6, -2)
            reference, feedback = reference_of(kind, model, controller.position, rng)
            chance = rng.random()
            if chance < 0.15:
                scales = 10.0 ** rng.uniform(-1.5, 0.0, 3) if chance < 0.1 else np.ones(3)
                values = zip(("velocity_scale", "acceleration_scale", "jerk_scale"), scales.tolist(), strict=True)
                controller.set_parameters(everything.replace(dict(values)))
            elif chance < 0.18 and controller.at_rest:
                controller.reset(rng.uniform(low, high))
                record.last = None
        elif every:
            reference, feedback = reference_of(kind, model, controller.position, rng)
        spell -= 1
        measured = controller.position + noise * rng.normal(size=model.n)
        step = controller.step(measured if feedback else None, reference, DT)
        assert step.status.code is not Code.FAULT, step.status.sentence()
        record.add(step.position, step.velocity)
    return record.worst


@pytest.mark.parametrize("cycles", [1500, pytest.param(100_000, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", ALL)
def test_no_bound_is_crossed_and_the_gate_never_fires(name, cycles):
    worst = soak(name, cycles, seed=cycles + len(name))
    assert max(worst.values()) <= 1e-9, worst
