#!/usr/bin/env python3
"""Make the bags of bags/: a figure-eight of targets for each bundled robot, and a golden run of it on the ideal arm.

    python scripts/make_bags.py [FOLDER]

The golden runs are made at 250 Hz and cut to 6 s to stay small; `ik_controller replay` must repeat them bit for bit on
the machine they were made on, and within 1e-9 rad elsewhere.
"""

from __future__ import annotations

import math
import shutil
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from ik_controller.messages import cdr
from ik_controller.recording.reader import open_bag
from ik_controller.recording.replay import replay
from ik_controller.recording.target_bag import TimedTarget, write_targets
from ik_controller.robots import build_model, bundled_parameters

SIZE = 0.15  # [m] half the figure's width
DURATION = 12.0  # [s]
RAMP = 2.0  # [s] from rest to full speed, and back at the end
LAPS = 2
RATE = 100.0  # [Hz]
START = 1_767_225_600_000_000_000  # [ns] 2026-01-01, so that the same script makes the same bytes


def phase(t: float) -> tuple[float, float]:
    """Return the phase ψ and its rate: at rest at both ends, constant in between, twice differentiable."""
    rate = 2.0 * math.pi * LAPS / (DURATION - RAMP)

    def ramp(x: float) -> tuple[float, float]:
        """A speed that rises from 0 to 1 as a smootherstep over x ∈ [0, 1]: its integral and value."""
        return x**4 * (2.5 - 3.0 * x + x * x), x**3 * (10.0 - 15.0 * x + 6.0 * x * x)

    if t < RAMP:
        way, speed = ramp(t / RAMP)
        return rate * RAMP * way, rate * speed
    if t > DURATION - RAMP:
        way, speed = ramp((DURATION - t) / RAMP)
        return 2.0 * math.pi * LAPS - rate * RAMP * way, rate * speed
    return rate * (t - 0.5 * RAMP), rate


def figure_eight(start: pin.SE3, t: float) -> tuple[pin.SE3, np.ndarray]:
    """Return the pose and the twist (6,) of the figure at t [s]: upright, across the arm, turning with the way."""
    psi, rate = phase(t)
    s, c, s2, c2 = math.sin(psi), math.cos(psi), math.sin(2.0 * psi), math.cos(2.0 * psi)
    offset = np.array((0.0, SIZE * s, 0.5 * SIZE * s2))
    velocity = np.array((0.0, SIZE * c, SIZE * c2)) * rate
    turn = np.array((0.25 * s, 0.15 * s2, 0.3 * s))
    turn_rate = np.array((0.25 * c, 0.3 * c2, 0.3 * c)) * rate
    rotation = pin.exp3(turn)
    omega = rotation @ pin.Jexp3(turn) @ turn_rate  # the right Jacobian gives the rate in the turned frame
    return pin.SE3(rotation @ start.rotation, start.translation + offset), np.concatenate((velocity, omega))


def targets(start: pin.SE3, frame: str) -> list[TimedTarget]:
    """Return the figure as messages of poses and twists."""
    result = []
    for index in range(round(DURATION * RATE) + 1):
        t = index / RATE
        time = round(t * 1e9)
        pose, twist = figure_eight(start, t)
        messages = {
            "target_pose": cdr.pose_message(START + time, frame, pose),
            "target_twist": cdr.twist_message(START + time, frame, twist),
        }
        result += [TimedTarget(time, role, data) for role, data in messages.items()]
    return result


def main() -> None:
    """Make all bags anew."""
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent.parent / "bags"
    for robot in ("panda", "ur5e"):
        parameters = bundled_parameters(robot)
        model = build_model(parameters)
        start = model.forward(np.array(parameters.posture))
        eight, golden = root / f"{robot}_figure_eight", root / f"{robot}_golden"
        for folder in (eight, golden):
            shutil.rmtree(folder, ignore_errors=True)
        write_targets(eight, targets(start, model.base_frame), START)
        result = replay(open_bag(eight), robot=parameters.replace({"rate": 250.0}), output=golden)
        print(robot, result.as_mapping())


if __name__ == "__main__":
    main()
