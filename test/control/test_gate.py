"""The gate fires for each kind of bad command, names the joint, and what it commands instead is in bounds."""

from __future__ import annotations

import math

import arms
import numpy as np
import pytest
import wire
from motions import started

from ik_controller import Controller, Reference, RobotModel
from ik_controller.control.gate import Gate
from ik_controller.control.status import Code
from ik_controller.session import Session

DT = 1e-3


def gate(jerk: float = 2000.0) -> Gate:
    """A gate of a planar 3R that moves at (0.5, −0.4, 0.3) rad/s."""
    model = RobotModel.from_urdf(arms.planar_3r(), "tool")
    model.set_limits(jerk=[jerk, math.inf, jerk])
    result = Gate(model)
    result.start(np.array([0.1, 0.2, -0.3]))
    result.memory[1] = [0.5, -0.4, 0.3]
    return result


def command(of: Gate, velocity) -> tuple[np.ndarray, np.ndarray]:
    velocity = np.asarray(velocity, dtype=float)
    return of.memory[0] + DT * velocity, velocity


@pytest.mark.parametrize(
    ("further", "faster", "reason"),
    [
        ([0, 0, 0], [0, math.nan, 0], "the command of joint 'joint2' is not finite"),
        ([0, 0, math.inf], [0, 0, 0], "the command of joint 'joint3' is not finite"),
        ([1e-9, 0, 0], [0, 0, 0], "position of joint 'joint1' does not follow from its velocity"),
        ([0, 9e-6, 0], [0, 9e-3, 0], "joint 'joint2' would exceed its acceleration limit"),
        ([0, 0, 4e-6], [0, 0, 4e-3], "joint 'joint3' would exceed its jerk limit"),
    ],
)
def test_each_kind_of_bad_command_is_refused_and_named(further, faster, reason):
    checked = gate()
    before = checked.memory.copy()
    q, v = command(checked, checked.memory[1])
    assert reason in checked.passes(q + np.array(further), v + np.array(faster), DT)
    np.testing.assert_array_equal(checked.memory, before)  # and not remembered
    assert checked.passes(q, v, DT) == ""


def test_speed_and_position_bounds():
    checked = gate(math.inf)
    checked.memory[1] = [2.0, 2.0, 2.0]
    assert "'joint2' would exceed its velocity limit" in checked.passes(*command(checked, [2.0, 2.0 + 1e-8, 2.0]), DT)
    assert checked.passes(*command(checked, [2.0, 2.0 + 1e-10, 2.0]), DT) == ""
    checked.memory[0] = [math.pi - 1e-3, 0, 0]
    assert "'joint1' would leave its position bounds" in checked.passes(*command(checked, [2.0, 2.0, 2.0]), DT)
    checked.start(np.array([0.0, math.pi + 0.1, 0.0]))  # outside: it may stay or come in
    assert checked.passes(*command(checked, [0.0, 0.0, 0.0]), DT) == ""
    assert "'joint2' would leave" in checked.passes(*command(checked, [0.0, 1e-6, 0.0]), DT)
    assert checked.passes(*command(checked, [0.0, -1e-3, 0.0]), DT) == ""


def test_what_it_commands_instead_passes_and_ends_at_rest():
    checked = gate()
    seen = []
    for _ in range(400):
        q, v = checked.braking(DT)
        seen.append(v)
        assert np.isfinite(q).all()
        if not v.any():
            break
    assert not v.any()
    assert (np.abs(np.array(seen)) <= np.abs(seen[0]) + 1e-12).all()


def test_where_braking_itself_is_unfit_the_last_position_is_held():
    checked = gate()
    checked.memory[0, 0], checked.memory[1, 0] = math.pi - 1e-6, 1.0  # beyond saving
    last = checked.memory[0].copy()
    q, v = checked.braking(DT)
    np.testing.assert_array_equal(q, last)
    assert not v.any()


# -- in the loop


def corrupted(monkeypatch, further, faster) -> None:
    """From here on the law asks for something else, and nothing before the gate minds."""
    advance = Controller._advance

    def corrupt(self, *arguments):
        step = advance(self, *arguments)
        step.position, step.velocity = step.position + further, step.velocity + faster
        return step

    monkeypatch.setattr(Controller, "_advance", corrupt)


@pytest.mark.parametrize(
    ("further", "faster", "reason"),
    [
        ([0, 0, math.nan, 0, 0, 0, 0], 0.0, "the command of joint 'panda_joint3' is not finite"),
        (0.2 * DT, 0.2, "joint 'panda_joint1' would exceed its acceleration limit"),
        (0.1, 0.0, "the commanded position of joint 'panda_joint1' does not follow from its velocity"),
    ],
)
def test_a_corrupted_law_is_stopped_and_the_fault_is_latched(panda, monkeypatch, further, faster, reason):
    controller, q = started(panda), panda.home
    target = Reference.velocity([0.05, 0.0, 0.02, 0.0, 0.0, 0.0])
    for _ in range(300):
        q = controller.step(q, target, DT).position
    v = controller.velocity.copy()
    assert np.abs(v).max() > 0.02
    with monkeypatch.context() as patch:
        corrupted(patch, further, faster)
        step = controller.step(q, target, DT)
    for k in range(400):
        assert step.status.code is Code.FAULT
        assert reason in step.status.sentence()
        np.testing.assert_allclose(step.position, q + DT * step.velocity, atol=1e-15)
        assert (np.abs(step.velocity - v) <= panda.model.acceleration_limit * DT * (1 + 1e-9)).all()
        q, v = step.position, step.velocity
        if k == 200:
            two = Controller(panda.model, panda.parameters)  # the fault is part of the state
            two.restore(controller.state())
            controller = two
        step = controller.step(q, target, DT)
    assert not v.any()
    controller.reset(q)
    for _ in range(3):
        step = controller.step(q, target, DT)
    assert step.status.code is Code.TRACKING
    assert step.velocity.any()


def test_a_fault_outlives_pause_and_loss_of_feedback_and_ends_with_reset(panda):
    """The session: what clears everything else does not clear a fault."""
    session = Session(panda.model, panda.parameters)
    state = wire.joints(panda.model.joint_names, panda.home)
    now = 0

    def cycles(count: int, feedback: bool = True):
        nonlocal now
        step = None
        for _ in range(count):
            now += session.period
            if feedback:
                session.take("joint_states", state, now)
            step = session.cycle(now)
        return step

    cycles(3)
    session.controller.halt("a test")
    assert cycles(1).status.code is Code.FAULT
    for event in ('{"do": "pause"}', '{"do": "resume"}', '{"do": "parameters", "values": {"velocity_scale": 0.5}}'):
        session.apply(event)
        cycles(400)
        assert session.status.code is Code.FAULT
    cycles(400, feedback=False)
    cycles(400)
    assert session.status.code is Code.FAULT
    assert "fault: a test; reset to go on" in session.status.sentence()
    session.apply('{"do": "reset"}')
    cycles(400)
    assert session.status.code is Code.HOLDING
