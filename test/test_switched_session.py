"""Frame, mode, tool and integration base switched at random moments: no command ever jumps beyond its limits."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import wire
from motions import bundled, moved
from test_session import START

from ik_controller.control.simulated_arm import SimulatedArm
from ik_controller.messages.cdr import JointStateWriter
from ik_controller.session import Session

RATE = 500.0
CAMERA = pin.SE3(pin.exp3(np.array([0.2, -0.4, 1.0])), np.array([0.2, 0.1, 0.5]))


class Switching:
    """A session at 500 Hz whose inputs and settings change at random, over a lagging arm; every command is checked."""

    def __init__(self, name: str, seed: int) -> None:
        self.robot = bundled(name)
        self.model = self.robot.model
        self.session = Session(self.model, self.robot.parameters.replace({"rate": RATE, "trajectory_mode": "append"}))
        self.arm = SimulatedArm(self.robot.home, delay=0.02, lag=0.02, noise=1e-5, seed=seed)
        self.random = np.random.default_rng(seed)
        self.writer = JointStateWriter(self.model.joint_names)
        self.frames = [self.model.base_frame, self.model.tip_frame, "camera", self._link(2)]
        self.kind, self.frame = "pose", self.frames[0]
        self.k, self.switches, self.moving = 0, 0, 0
        self.last: tuple[np.ndarray, np.ndarray] | None = None
        self.target = self.model.forward(self.robot.home)

    def _link(self, joint: int) -> str:
        frames = self.model.pin_model.frames
        return next(f.name for f in frames if f.parentJoint == joint and f.type == pin.FrameType.BODY)

    def apply(self, do: str, **more: Any) -> None:
        self.session.apply(json.dumps({"do": do, **more}))

    def switch(self) -> None:
        """Change one thing."""
        self.switches += 1
        random = self.random
        choice = int(random.integers(8))
        if choice == 0:
            self.frame = str(random.choice(self.frames))
        elif choice in (1, 2):
            self.kind = str(random.choice(["pose", "pose with twist", "twist", "trajectory", "joints", "path", "jog"]))
        elif choice == 3:
            offset = pin.SE3(pin.exp3(random.uniform(-1, 1, 3)), random.uniform(-0.2, 0.2, 3))
            tools = [[], pin.SE3ToXYZQUAT(offset).tolist()]
            self.apply("parameters", values={"tool_offset": tools[int(random.integers(2))]})
        elif choice == 4:
            base = str(random.choice(["commanded", "measured", "bounded"]))
            self.apply("parameters", values={"integration_base": base})
        elif choice == 5:
            modes = ["auto", "auto", "auto", "pose", "twist", "trajectory", "joints"]
            self.apply("parameters", values={"mode": str(random.choice(modes))})
        elif choice == 6:
            point = str(random.choice(["tool", "frame"]))
            merge = str(random.choice(["append", "replace"]))
            mode = str(random.choice(["extrapolate", "interpolate"]))
            changes = {"twist_reference_point": point, "trajectory_mode": merge, "reference_mode": mode}
            self.apply("parameters", values=changes)
        else:
            change = random.uniform(-1, 1, 6) * np.array([0.1, 0.1, 0.1, 0.3, 0.3, 0.3])
            self.target = moved(self.model.forward(self.robot.home), change)

    def take(self, role: str, data: bytes, now: int) -> None:
        if self.session.foreign_frame(role, data) == "camera":
            self.apply("transform", frame="camera", pose=pin.SE3ToXYZQUAT(CAMERA).tolist())
        self.session.take(role, data, now)

    def inputs(self, now: int) -> None:
        random, kind = self.random, self.kind
        here = {self.model.base_frame: pin.SE3.Identity(), "camera": CAMERA}.get(self.frame)
        target = self.target if here is None else here.actInv(self.target)
        if here is None:  # in a frame that moves with the arm: a little off its own origin
            target = pin.SE3(np.eye(3), random.uniform(-0.02, 0.02, 3))
        twist = random.uniform(-0.3, 0.3, 6)
        q = self.robot.home + random.uniform(-0.4, 0.4, self.model.n)
        names = self.model.joint_names
        if kind in ("pose", "pose with twist"):
            self.take("target_pose", wire.pose(wire.seven(target), self.frame, now), now)
        if kind in ("twist", "pose with twist"):
            self.take("target_twist", wire.twist(twist, self.frame, now), now)
        if kind == "joints":
            self.take("target_joints", wire.joints(names, q, (), now), now)
        if kind == "jog":
            self.take("target_joint_jog", wire.joint_jog(names[:3], random.uniform(-1, 1, 3), now), now)
        if self.k % 100 == 0 and kind == "trajectory":
            points = [(0.3, [wire.seven(target)], []), (0.9, [wire.seven(target)], [twist])]
            self.take("target_trajectory", wire.trajectory(points, self.frame), now)
        if self.k % 100 == 0 and kind == "path":
            points = [(0.2, q, ()), (0.7, self.robot.home, ())]
            self.take("target_joint_trajectory", wire.joint_trajectory(points, names), now)

    def cycle(self) -> bytes:
        now = START + self.k * self.session.period
        state = self.writer.write(now, self.arm.measure()[0], np.zeros(self.model.n))
        assert self.session.take("joint_states", state, now)
        if self.random.random() < 0.02:
            self.switch()
        if self.k % 5 == 0:
            self.inputs(now)
        step = self.session.cycle(now)
        assert step is not None
        self.check(step)
        self.arm.command(step.position)
        self.arm.advance(self.session.dt)
        self.k += 1
        return bytes(step.position.tobytes())

    def check(self, step: Any) -> None:
        """Position, velocity and acceleration limits, in the positions themselves."""
        dt, model = self.session.dt, self.model
        assert (step.position >= model.lower - 1e-12).all()
        assert (step.position <= model.upper + 1e-12).all()
        if self.last is not None:
            position, before = self.last
            velocity = (step.position - position) / dt
            slack = 1e-9 / dt
            assert (np.abs(velocity) <= model.velocity_limit + slack).all(), self.k
            assert (np.abs(velocity - before) <= model.acceleration_limit * dt + 2 * slack).all(), self.k
            self.moving += bool(np.abs(velocity).max() > 0.05)
            self.last = step.position, velocity
        else:
            self.last = step.position, np.zeros(model.n)


def run(name: str, seconds: float, seed: int) -> None:
    one = Switching(name, seed)
    for _ in range(round(seconds * RATE)):
        one.cycle()
    assert one.switches > 5 * seconds
    assert one.moving > 0.3 * one.k
    assert not {text for text in [one.session.last_rejected] if text and "not followed in mode" not in text}


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_the_commands_stay_within_their_limits_whatever_is_switched(name: str) -> None:
    run(name, 15.0, seed=5)


@pytest.mark.soak
@pytest.mark.parametrize("seed", [1, 2])
def test_the_commands_stay_within_their_limits_for_ten_minutes(seed: int) -> None:
    run("panda", 600.0, seed)


def test_a_run_full_of_switches_continues_from_any_state_with_the_same_bits() -> None:
    one = Switching("panda", 9)
    for _ in range(1111):
        one.cycle()
    state = one.session.state()
    before = one.session
    commands = [one.cycle() for _ in range(400)]
    again = Switching("panda", 9)  # the same random world, brought to the same moment
    for _ in range(1111):
        again.cycle()
    fresh = Session(again.model, again.robot.parameters.replace({"rate": RATE}))
    fresh.apply(state)
    again.session = fresh
    assert [again.cycle() for _ in range(400)] == commands
    assert fresh.state() == before.state()
