"""Nothing is compiled while an arm moves: whatever is switched at run time, `warm_up` has gone through it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import wire
from motions import bundled
from test_session import START

from ik_controller.control.simulated_arm import SimulatedArm
from ik_controller.kinematics.accelerate import HAS_NUMBA
from ik_controller.kinematics.collision_world import box
from ik_controller.messages.cdr import JointStateWriter
from ik_controller.session import Session

_EACH = 210  # cycles
JERK = [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0]
SWITCHES: list[dict[str, Any]] = [
    {"integration_base": "measured"},
    {"velocity_scale": 0.5, "acceleration_scale": 0.5},
    {"tool_linear_speed": 0.2, "tool_angular_acceleration": 1.0},
    {"integration_base": "bounded", "tool_offset": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]},
    {"inverse": "damped", "reference_mode": "interpolate"},
    {"inverse": "pseudo", "orientation_error": "quaternion"},
    {"inverse": "numerical_filtering", "orientation_error": "exponential_base", "task_axes": "xyz"},
    {"task_axes": "xyzrpy", "reference_mode": "extrapolate"},
    {"task_axes": "xyzrpy", "secondary_tasks": ["swivel"], "secondary_targets": [0.1]},
    {"objectives": ["joint_centring", "limit_repulsion", "manipulability"]},
    {"task_axes": "xyz", "task_frame": "tool", "joint_weights": [1.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0]},
]


def compiled() -> dict[str, int]:
    """Return of each kernel how many argument types it has been compiled for; nothing without Numba."""
    modules = [module for name, module in sys.modules.items() if name.startswith("ik_controller.")]
    found = [item for module in modules for item in vars(module).values() if hasattr(item, "nopython_signatures")]
    return {f"{item.__module__}.{item.__qualname__}": len(item.nopython_signatures) for item in found}


SETTINGS: list[dict[str, Any]] = [{}, {"jerk_limits": JERK}, {"self_collision": True, "obstacle_avoidance": True}]


def run(settings: dict[str, Any]) -> set[str]:
    """Switch all there is in motion; return what was compiled meanwhile."""
    robot = bundled("panda")
    model, home = robot.model, robot.home
    session = Session(model, robot.parameters.replace({"rate": 250.0, **settings}))
    session.warm_up(together=True)
    before = compiled()
    arm, writer, random = SimulatedArm(home, lag=0.02), JointStateWriter(model.joint_names), np.random.default_rng(1)
    if session.controller.scene.world_watched:
        session.controller.scene.world.put("crate", box(0.1, 0.1, 0.1).at(pin.SE3(np.eye(3), np.array([0.31, 0, 0.3]))))
    start = model.forward(home)
    for k in range(_EACH * len(SWITCHES)):
        now = START + k * session.period
        if k % _EACH == 0:
            session.apply(json.dumps({"do": "parameters", "values": SWITCHES[k // _EACH]}))
        session.take("joint_states", writer.write(now, arm.measure()[0], np.zeros(model.n)), now)
        kind = k // 30 % 7
        if kind < 2:
            change = np.array([0.05, 0.05, 0.1] if kind == 0 else [0.5, 0.3, -0.6])
            target = pin.SE3(start.rotation, start.translation + change)
            due = now + (k % 30 // 10) * 3 * session.period  # at once, or with some cycles before it
            session.take("target_pose", wire.pose(wire.seven(target), model.base_frame, due), now)
        elif kind == 2:
            session.take("target_twist", wire.twist(random.uniform(-0.5, 0.5, 6), "panda_link4", now), now)
        elif kind > 4:
            if k % 30 == 0:
                points = [(0.1 * i, wire.seven(model.forward(home + 0.01 * i))) for i in (1, 2)]
                way = wire.trajectory([(time, [pose], []) for time, pose in points], model.base_frame)
                joints = wire.joint_trajectory([(0.1 * i, home + 0.01 * i, ()) for i in (1, 2)], model.joint_names)
                role, data = ("target_trajectory", way) if kind == 5 else ("target_joint_trajectory", joints)
                session.take(role, data, now)
        else:
            q = home + random.uniform(-1.0, 1.0, model.n) if kind == 3 else np.array([0, -1.5, 0, -3.05, 0, 0, 0])
            session.take("target_joints", wire.joints(model.joint_names, q, (), now), now)
        gone = session.cycles([now])  # as a replay does
        if gone is None:
            step = session.cycle(now)
            assert step is not None
            arm.command(step.position)
        else:
            arm.command(gone[0][0])
        arm.advance(session.dt)
    assert not session.rejected
    after = compiled()
    return {name for name in after if after[name] != before.get(name)}


@pytest.mark.skipif(not HAS_NUMBA, reason="nothing is compiled without Numba")
def test_nothing_compiles_once_warmed_up() -> None:
    """In a process of its own: what other tests have compiled counts here."""
    folder = Path(__file__).parent
    paths = os.pathsep.join([str(folder.parent), str(folder), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, __file__], env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "set()\nset()\nset()\n"), done.stderr


if __name__ == "__main__":
    for settings in SETTINGS:
        print(run(settings))
