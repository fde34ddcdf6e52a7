"""A run such as a laboratory records: a noisy, lagging arm follows a noisy 100 Hz stream at 1 kHz, slowly and too fast,
out of its reach, with pauses. The session, the law and the bag are the real ones; only time is not waited for.

    python test/report/long_run.py FOLDER [SECONDS]
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ik_controller.control.simulated_arm import SimulatedArm
from ik_controller.messages import cdr
from ik_controller.recording.run import RunWriter, default_topics
from ik_controller.robots import build_model, bundled_parameters
from ik_controller.session import Session

EPOCH = 1_700_000_000_000_000_000  # [ns]
STREAM = 10  # cycles from one target to the next
ROUND = 30.0  # [s] after which it begins again: slow, faster, too fast, out of reach, pause


def make_run(folder: Path, seconds: float) -> Path:
    """Record a run of that length in `folder`, a new bag, and return it."""
    parameters = bundled_parameters("panda").replace({"rate": 1000.0})
    model = build_model(parameters)
    session = Session(model, parameters)
    session.warm_up()
    posture = np.array(parameters.posture)
    arm = SimulatedArm(posture, delay=0.004, lag=0.008, noise=2e-5, quantisation=1e-5)
    start = model.forward(posture)
    random = np.random.default_rng(7)
    encode = cdr.JointStateWriter(model.joint_names)
    writer = RunWriter(folder, session, default_topics(), patient=True)
    writer.begin(session, EPOCH)

    def take(role: str, now: int, data: bytes) -> None:
        session.take(role, data, now)
        writer.write(role, now, data)

    phase = 0.0
    for index in range(round(seconds * parameters.rate)):
        now = EPOCH + index * session.period
        late, work = (int(1e3 * x) for x in random.lognormal((2.5, 4.8), (0.9, 0.15)))  # [ns], typically 12 and 120 µs
        take("joint_states", now, encode.write(now, *arm.measure()))
        part = index * session.dt % ROUND / ROUND
        if index % STREAM == 0 and part < 0.93:
            phase += STREAM * session.dt * (0.8 if part < 0.4 else 2.0 if part < 0.6 else 9.0)
            target = _target(start, phase, 0.9 if 0.8 < part < 0.85 else 0.0, random)
            take("target_pose", now, cdr.pose_message(now, model.base_frame, target))
        step = session.cycle(now)
        if step is not None:
            arm.command(step.position)
            command = encode.write(now + session.period, step.position, step.velocity)
            writer.write("joint_commands", now, command)
        arm.advance(session.dt)
        writer.cycle(index, now, int(session.status.code), late, work, int(step is not None))
    writer.close()
    return folder


def _target(start: Any, phase: float, away: float, random: np.random.Generator) -> Any:
    """Return a figure-eight's pose, `away` [m] further out, as a camera sees it."""
    turn = pin.exp3(np.array((0.2 * np.sin(phase), 0.0, 0.0)) + random.normal(0.0, 3e-4, 3))
    offset = np.array((away, 0.15 * np.sin(phase), 0.07 * np.sin(2.0 * phase))) + random.normal(0.0, 1e-4, 3)
    return pin.SE3(turn @ start.rotation, start.translation + offset)


if __name__ == "__main__":
    print(make_run(Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 600.0))
