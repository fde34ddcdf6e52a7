"""A run of somebody's targets on the ideal arm, which is where it was commanded to be."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.simulated_arm import SimulatedArm
from ik_controller.control.status import Code
from ik_controller.errors import BagError
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.solve import solve_ik
from ik_controller.messages import cdr
from ik_controller.parameters import ControllerParameters
from ik_controller.recording.reader import BagReader
from ik_controller.recording.replay import Replay, tracking_error
from ik_controller.recording.run import RunWriter, default_topics
from ik_controller.recording.samples import within_turns
from ik_controller.recording.target_bag import TargetBag, TargetOptions, restamped
from ik_controller.robots import build_model
from ik_controller.session import Session

Array = NDArray[np.float64]

_EPOCH = 1_000_000_000_000_000_000  # [ns] when these runs begin, so that the same run makes the same bytes
_CLOSE = 2e-3  # [m or rad] from the first target, at which an arm at its posture may start there


def run_on_ideal_arm(
    bag: BagReader, parameters: ControllerParameters, options: TargetOptions | None = None, output: Path | None = None
) -> Replay:
    """Follow the bag's targets at the configured rate; `output`: folder of a new bag of this run.

    The arm starts at the recorded joints, at its posture if the first target is there, or where its tool is at the
    first target. Raises BagError where the bag holds nothing that can be followed.
    """
    model = build_model(parameters)
    posture = np.array(parameters.posture) if parameters.posture else model.middle()
    targets = TargetBag(bag, options, model=model, home=model.forward(posture))
    session = Session(model, parameters)
    result = Replay(complete=bag.complete)
    writer = RunWriter(output, session, default_topics(), patient=True) if output else None
    arm = SimulatedArm(_start(model, targets, posture))
    encode = cdr.JointStateWriter(model.joint_names)
    if writer is not None:
        writer.begin(session, _EPOCH)
    upcoming = iter(targets)
    target = next(upcoming, None)
    rest = int(2e9 * parameters.command_timeout)
    end = 0
    session.warm_up()
    begin = time.perf_counter()
    index = 0
    while target is not None or index * session.period <= end:
        now = _EPOCH + index * session.period
        arrived = [("joint_states", encode.write(now, *arm.measure()))]
        while target is not None and target.time <= index * session.period:
            arrived.append((target.role, restamped(target.data, _EPOCH + target.time)))
            end = target.time + rest
            target = next(upcoming, None)
        for role, data in arrived:
            session.take(role, data, now)
            if writer is not None:
                writer.write(role, now, data)
        before = session.controller.position
        step = session.cycle(now)
        if step is not None:
            arm.command(step.position)
            if step.status.code is Code.TRACKING:
                result.errors.add(tracking_error(session, step, before))
            result.commands += 1
        arm.advance(session.dt)
        if writer is not None:
            if step is not None:
                command = encode.write(now + session.period, step.position, step.velocity)
                writer.write("joint_commands", now, command)
            writer.cycle(index, now, int(session.status.code), 0, 0, int(step is not None))
        index += 1
    result.cycles = index
    result.elapsed = time.perf_counter() - begin
    result.duration = index * session.dt
    result.rejected = sum(session.rejected.values()) + targets.skipped
    result.last_rejected = session.last_rejected or targets.last_skipped
    if writer is not None:
        writer.close()
    if session.rejected and not result.errors.count:
        raise BagError(
            f"bag '{bag.path}': none of its targets could be used: {session.last_rejected}; "
            "--frame says in which link's frame they are"
        )
    return result


def _start(model: RobotModel, targets: TargetBag, posture: Array) -> Array:
    """Return the joints (n,) from which the arm starts."""
    options = targets.options
    if targets.first_joints is not None and options.fitting.idle:
        return within_turns(model, targets.first_joints)
    first: Any = targets.first_pose
    if first is None or targets.first_frame != model.base_frame:
        return posture
    away = model.forward(posture).inverse() * first
    turned = float(np.arccos(np.clip(0.5 * (np.trace(away.rotation) - 1.0), -1.0, 1.0)))
    if max(float(np.linalg.norm(away.translation)), turned) < _CLOSE:
        return posture
    found = solve_ik(model, first, posture)
    return found.q if found.converged else posture
