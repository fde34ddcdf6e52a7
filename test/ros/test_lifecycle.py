"""The lifecycle over DDS: nothing is commanded unless the node is active, and an arm that moves brakes first."""

from __future__ import annotations

import signal

import numpy as np
import pytest
from published import assert_limits_hold, recorded
from rclpy.qos import DurabilityPolicy, QoSProfile
from rig import Rig, values_of
from std_msgs.msg import String
from test_services import at_rest, moving, replayed

from ik_controller.kinematics.model import RobotModel
from ik_controller.robots import build_model, bundled_parameters, urdf_text

RATE, PERIOD = 200.0, 5_000_000


def description(rig: Rig):
    """Return a function that publishes a robot description, latched."""
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = rig._listener.create_publisher(String, "/ours", latched)
    return lambda text: publisher.publish(String(data=text))


def test_without_autostart_each_transition_does_its_part(rig: Rig) -> None:
    rig.start_sim("--rate", "400")
    node = rig.start_node(robot="panda", rate=RATE, autostart="false")
    told = rig.until_status("unconfigured: waiting to be configured")
    assert (told.level, values_of(told)["state"]) == (b"\x03", "unconfigured")
    assert not rig.change_state("activate")  # not possible from here: refused, and the node lives on
    assert not rig.change_state("dance")
    answer = rig.call("pause", True)
    assert (answer.success, answer.message) == (False, "the node is unconfigured: activate it first")

    assert rig.change_state("configure")
    assert rig.state() == "inactive"
    told = rig.until_status("inactive: nothing is commanded until it is activated")
    assert (told.level, told.hardware_id, values_of(told)["state"]) == (b"\x01", "panda", "inactive")
    assert not rig.heard["joint_commands"]
    assert rig.bags() == []

    assert rig.change_state("activate")
    rig.until_status("holding")
    with moving(rig):
        assert rig.change_state("deactivate")
        rig.until_status("inactive")
        assert at_rest(rig.heard["joint_commands"][-1])
        commanded = len(rig.heard["joint_commands"])
        rig.until_status("inactive")
        assert len(rig.heard["joint_commands"]) == commanded  # although twists go on coming
        assert rig.change_state("activate")  # again, and from the measured position
        rig.until_new("joint_commands", lambda c: np.abs(c.velocity).max() > 0.05, "the arm to move again")
    assert rig.change_state("deactivate")
    assert rig.change_state("cleanup")
    rig.until_status("unconfigured")
    assert rig.state() == "unconfigured"
    assert len(rig.bags()) == 2  # one a run
    assert_runs_are_smooth(rig, build_model(bundled_parameters("panda")))
    node.send(signal.SIGINT)
    assert node.wait() == 0, node.err


def assert_runs_are_smooth(rig: Rig, model: RobotModel) -> None:
    """Every run keeps the limits, ends at rest and replays."""
    for bag in rig.bags():
        assert replayed(bag).identical
        commands = recorded(bag, "/joint_commands")
        stalls = max(int(values_of(status).get("stalls", 0)) for status in recorded(bag, "/ik_controller/status"))
        assert_limits_hold(commands, model, PERIOD, 1 + stalls)
        assert at_rest(commands[-1])


def test_what_is_fixed_while_configured_can_be_changed_before(rig: Rig) -> None:
    rig.start_sim("--rate", "200")
    rig.start_node(robot="panda", rate=RATE, autostart="false")
    assert rig.set_parameters(rate=100.0, velocity_limits=[0.5] * 7, record=False).successful
    refused = rig.set_parameters(robot="ur5e")
    assert (refused.successful, "read-only" in refused.reason, "robot" in refused.reason) == (False, True, True)
    assert rig.set_parameters(velocity_limits=[0.5] * 6).successful  # whether it fits shows with the model:
    assert not rig.change_state("configure")
    rig.until_status("velocity limits")
    assert rig.set_parameters(velocity_limits=[0.5] * 7).successful
    assert rig.change_state("configure")
    refused = rig.set_parameters(rate=200.0)
    assert refused.reason == "rate is read-only while the node is inactive: clean it up first"
    assert rig.set_parameters(rate=100.0).successful  # no change: a parameter file can be loaded again as a whole
    assert rig.change_state("activate")
    commands = [rig.until_new("joint_commands", lambda c: True) for _ in range(2)]
    rig.until(lambda: len(rig.heard["joint_commands"]) > 20)
    stamps = [c.header.stamp.sec * 1_000_000_000 + c.header.stamp.nanosec for c in rig.heard["joint_commands"]]
    assert min(np.diff(stamps)) == 10_000_000, commands
    assert rig.bags() == []


def test_a_changed_description_brakes_and_starts_with_the_new_arm(rig: Rig) -> None:
    """The same arm in other words goes on; one that cannot be used is told; another arm is taken up."""
    text = urdf_text(bundled_parameters("panda"))
    assert text is not None
    publish = description(rig)
    publish(text)
    # The simulated arm publishes a description too: ours is on a topic of its own.
    node = rig.start_node("-r", "robot_description:=ours", tip_frame="panda_hand_tcp", rate=RATE)
    rig.until_status("waiting for the first joint state")
    rig.start_sim("--rate", "400")
    rig.until_status("holding")
    with moving(rig):
        publish(text.replace("<robot", "<!-- other words --><robot", 1))
        publish("<robot")
        told = rig.until_status("rejected robot_description")
        assert "not well-formed XML" in told.message
        assert "rejected" in values_of(told)["reasons"]
        assert "going on with the robot as it was" in node.err
        assert len(rig.bags()) == 1
        shorter = text.replace('xyz="0 0 0.1034"', 'xyz="0 0 0.2"')
        assert shorter != text
        publish(shorter)
        rig.until(lambda: len(rig.bags()) == 2, "a run with the new arm")
        rig.until_new("joint_commands", lambda c: np.abs(c.velocity).max() > 0.05, "the arm to move again")
    node.send(signal.SIGINT)
    assert node.wait() == 0, node.err
    model = build_model(bundled_parameters("panda"))
    model.set_limits(acceleration=4.0 * model.velocity_limit)  # the URDF has none: full speed in 0.25 s
    assert_runs_are_smooth(rig, model)


@pytest.mark.parametrize("active", [True, False])
def test_the_shutdown_transition_ends_the_run(rig: Rig, active: bool) -> None:
    rig.start_sim("--rate", "200")
    node = rig.start_node(robot="panda", rate=RATE, autostart=str(active).lower())
    if active:
        rig.until_commanding()
    else:
        rig.until_status("unconfigured")
    assert rig.change_state("shutdown")
    rig.until_status("finalized")
    assert rig.state() == "finalized"
    if active:
        (bag,) = rig.bags()
        assert replayed(bag).identical
    node.send(signal.SIGTERM)
    assert node.wait() == 0, node.err
