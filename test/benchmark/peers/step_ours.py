"""ik_controller: the whole `Controller.step`, with gate and status; "kernel" as an argument: the compiled law alone."""

import sys

import numpy as np
import pinocchio as pin
from step_common import serve

from ik_controller import Controller, Reference
from ik_controller.robots import build_model, bundled_parameters


def make(task, case):
    """Return (step, joints) for a case."""
    parameters = bundled_parameters("panda")
    model = build_model(parameters)
    dt, endless = float(task["dt"]), [1e9] * model.n
    changes = {}
    model.set_limits(lower=task["lower"], upper=task["upper"])
    if case == "bare":
        model.set_limits(velocity=endless, acceleration=endless, lower=[-1e9] * model.n, upper=endless)
        changes = {"posture": ()}
    elif case == "limits saturated":
        changes = {"velocity_scale": float(task["slow"])}
    elif case == "priorities":
        changes = {"secondary_tasks": ["z panda_link4"], "secondary_targets": [float(task["height"])]}
    elif case == "self-collision":
        changes = {"self_collision": True}
    controller = Controller(model, parameters.replace(changes))
    controller.reset(task["start"])
    poses = [pin.SE3(pose) for pose in task["poses"]]
    references = [Reference.between(now, then, dt) for now, then in zip([poses[0], *poses[:-1]], poses, strict=True)]

    if "kernel" not in sys.argv:
        controller.step(task["start"], references[0], dt)

        def step(k):
            controller.step(controller.position, references[k], dt)

        return step, lambda: controller.position

    if case in ("priorities", "self-collision"):
        raise NotImplementedError("another kernel")
    law, limits, n = controller._law, controller._limits, model.n
    states = [np.concatenate((task["start"], np.zeros(n + 12))), np.empty(2 * n + 12)]
    nothing, detail = np.zeros(6), np.empty((7, n))

    def step_kernel(k):
        state, out = states
        states[0], states[1] = out, state
        reference = references[k]
        law.cycle(
            law.chain, law.table, limits.table, state, state[:n], reference.position, reference.rotation,
            reference.twist, nothing, True, limits.reserve, dt, out, detail,
        )  # fmt: skip

    return step_kernel, lambda: states[0][:n]


serve(make)
