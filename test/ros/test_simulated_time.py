"""Over DDS with use_sim_time: any speed, a clock that stands, a clock that jumps back; the run replays bit for bit."""

from __future__ import annotations

import signal
import time
from typing import Any

import numpy as np
from published import assert_limits_hold, stamp
from rig import Rig, values_of
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from test_bad_input import HOME, JOINTS, twist
from test_services import replayed

from ik_controller.control.simulated_arm import SimulatedArm
from ik_controller.robots import build_model, bundled_parameters

MS = 1_000_000
PERIOD = 5 * MS  # 200 Hz


class World:
    """A simulator: an ideal arm with a clock of its own; `tick` moves both on and sends time, state and a twist."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.now = 100 * 1000 * MS
        self.arm = SimulatedArm(np.array(HOME))
        self.clock = rig._listener.create_publisher(Clock, "/clock", 100)
        rig.until(self.clock.get_subscription_count, "a listener on the clock")
        self.states = rig.publisher("joint_states")
        self.twists = rig.publisher("target_twist")

    def tick(self, milliseconds: int = 10, speed: float = 0.0) -> None:
        """Go on by a step of simulated time, and listen to what the node makes of it."""
        self.now += milliseconds * MS
        commands = self.rig.heard["joint_commands"]
        if commands:
            self.arm.command(np.array(commands[-1].position))
        self.arm.advance(milliseconds * 1e-3)
        state = JointState(name=JOINTS, position=self.arm.measure()[0].tolist())
        message = twist(x=0.0)
        message.twist.linear.z = speed
        for one in (state, message):
            one.header.stamp.sec, one.header.stamp.nanosec = divmod(self.now, 1000 * MS)
        self.states.publish(state)
        self.twists.publish(message)
        time.sleep(0.002)  # the clock comes last
        self.clock.publish(self.time())
        self.rig.listen()

    def time(self) -> Clock:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(self.now, 1000 * MS)
        return message

    def run_until(self, condition: Any, what: str, speed: float = 0.0) -> None:
        def ticked() -> bool:
            self.tick(speed=speed)
            return bool(condition())

        self.rig.until(ticked, what)


def test_a_run_in_simulated_time(rig: Rig) -> None:
    node = rig.start_node(robot="panda", rate=200.0, use_sim_time=True)
    status = rig.until_status("the simulated time stands still")  # nobody sends a clock yet
    assert "clock" in values_of(status)["reasons"]
    world, heard = World(rig), rig.heard["joint_commands"]

    def moving() -> bool:
        return bool(heard) and abs(heard[-1].velocity[1]) > 0.03

    begin, real = world.now, time.monotonic()
    world.run_until(moving, "the arm to move", speed=-0.1)
    assert stamp(heard[-1]) <= world.now + PERIOD
    assert stamp(heard[0]) >= begin

    # The clock stands: nothing is commanded, and the status says so; a pause asked for meanwhile is taken.
    rig.until_status("the simulated time stands still")
    count = len(heard)
    rig.until_status("the simulated time stands still")
    assert len(heard) == count
    assert rig.call("pause", True).success
    rig.until_status("and it is paused")
    assert len(heard) == count
    assert rig.call("pause", False).success
    rig.until_new("status", lambda s: "is paused" not in s.message)
    world.run_until(lambda: world.now > begin + 300 * MS and moving(), "the arm to go on", speed=0.1)

    # It jumps back to the beginning, as a bag that is played again: brake, forget, start where the arm is.
    told = len(heard)
    world.now = begin
    world.run_until(lambda: len(heard) > told + 100 and moving(), "the arm to move again", speed=-0.1)
    stamps = np.array([stamp(c) for c in heard])
    steps = np.diff(stamps)
    assert np.count_nonzero(steps < 0) == 1
    assert (steps % PERIOD == 0).all()
    back = int(np.flatnonzero(steps < 0)[0]) + 1
    assert stamps[back] < stamps[back - 1] - 200 * MS
    model = build_model(bundled_parameters("panda"))
    for part in (heard[:back], heard[back:]):
        assert_limits_hold(part, model, PERIOD, restarts=4)
    before = np.array(heard[back - 1].velocity)
    after = np.array(heard[back].velocity)
    assert (np.abs(after - before) <= model.acceleration_limit * PERIOD * 1e-9 * 1.001).all()

    # Simulated time has gone on at another speed than real time.
    simulated = (stamps[back - 1] - stamps[0]) * 1e-9
    assert abs(simulated / (time.monotonic() - real) - 1.0) > 0.01

    assert not rig.set_parameters(use_sim_time=False).successful
    node.send(signal.SIGINT)  # the clock stands: there is no braking
    assert node.wait() == 0, node.err
    (bag,) = rig.bags()
    result = replayed(bag)
    assert result.identical
    assert result.commands >= len(heard)
