"""Over DDS: commands in every type, and MoveIt Servo's interface as its clients use it; each run replays."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped
from published import recorded
from rig import NODE, Rig
from std_msgs.msg import Float64MultiArray, Int8
from std_srvs.srv import SetBool, Trigger
from test_bad_input import HOME, JOINTS, twist
from test_services import replayed
from trajectory_msgs.msg import JointTrajectory

from ik_controller.control.status import Code, Limit, Status
from ik_controller.recording.reader import open_bag
from ik_controller.robots import build_model, bundled_parameters
from ik_controller.ros.servo import StatusCode, filled

RATE = 100.0
NODES = {
    "positions": (Float64MultiArray, "/forward_position_controller/commands", {"command_output": "position_array"}),
    "velocities": (Float64MultiArray, "/my/velocities",
                   {"command_output": "velocity_array", "command_topic": "/my/velocities"}),
    "servoing": (JointTrajectory, "/panda_arm_controller/joint_trajectory",
                 {"command_output": "joint_trajectory", "command_topic": "/panda_arm_controller/joint_trajectory",
                  "trajectory_velocities": True, "servo_interface": True, "twist_unit": "unitless"}),
}  # fmt: skip


class Outputs:
    """Three nodes on one simulated arm, which none of them moves; `heard[name]` is what each sends."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        node = rig._listener
        self.heard: dict[str, list[Any]] = {name: [] for name in (*NODES, "code")}
        self._inputs = {
            name: node.create_subscription(kind, topic, lambda _: None, 1000)
            for name, (kind, topic, _) in NODES.items()
        }
        self._inputs["code"] = node.create_subscription(Int8, "/servo_node/status", lambda _: None, 1000)
        rig.start_sim("--rate", "100")
        for name, (_, _, parameters) in NODES.items():
            given = {"robot": "panda", "rate": RATE, "record_folder": str(rig.folder / name), **parameters}
            settings = [part for key, value in given.items() for part in ("-p", f"{key}:={value}")]
            rig.start(name, [*NODE, "--ros-args", "-r", f"__node:={name}", *settings])
        topics = {"positions": "/positions/target_twist", "velocities": "/velocities/target_twist",
                  "servoing": "/servo_node/delta_twist_cmds"}  # fmt: skip
        self.twists = {name: node.create_publisher(TwistStamped, topic, 10) for name, topic in topics.items()}
        self.poses = node.create_publisher(PoseStamped, "/servo_node/pose_target_cmds", 10)
        for name in NODES:
            self.until(lambda name=name: self.heard[name], f"commands of {name}")
            rig.until_known(f"/{name}")

    def listen(self) -> None:
        for name, subscription in self._inputs.items():
            with subscription.handle:
                while (taken := subscription.handle.take_message(subscription.msg_type, False)) is not None:
                    self.heard[name].append(taken[0])

    def until(self, condition: Any, what: str) -> Any:
        def listened() -> Any:
            self.listen()
            return condition()

        return self.rig.until(listened, what)

    def bag(self, name: str) -> Any:
        (bag,) = (self.rig.folder / name).iterdir()
        return bag


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Outputs]:
    with closing(Rig(tmp_path_factory.mktemp("outputs"))) as rig:
        yield Outputs(rig)


def values_of(message: Any) -> np.ndarray:
    return np.array(message.points[0].positions if hasattr(message, "points") else message.data)


def codes(outputs: Outputs, condition: Any, what: str) -> None:
    begin = len(outputs.heard["code"])
    outputs.until(lambda: any(condition(m.data) for m in outputs.heard["code"][begin:]), what)


def call(outputs: Outputs, name: str, kind: Any, request: Any) -> Any:
    return outputs.rig.request(f"/servo_node/{name}", kind, request, "/servoing")


def test_servo_clients_move_pause_and_go_on(outputs: Outputs) -> None:
    heard = outputs.heard["servoing"]
    codes(outputs, lambda code: code == 0, "the code 0")

    def push() -> float:
        """Half of full speed down, unitless; return the tool's speed in the last command [m/s]."""
        outputs.twists["servoing"].publish(push.message)
        point = heard[-1].points[0]
        return float((model.jacobian(np.array(point.positions)) @ np.array(point.velocities))[2])

    model = build_model(bundled_parameters("panda"))
    push.message = twist(x=0.0)
    push.message.twist.linear.z = -0.5
    outputs.until(lambda: push() < -0.19, "0.2 m/s")  # servo's scale: 0.4 m/s
    assert min(push() for _ in range(5)) > -0.21
    for stop, go in itertools.product(("pause_servo", "stop_servo"), ("pause_servo", "start_servo")):
        for service, pausing in ((stop, True), (go, False)):
            if service == "pause_servo":
                assert call(outputs, service, SetBool, SetBool.Request(data=pausing)).success
            else:
                assert call(outputs, service, Trigger, Trigger.Request()).success
            if pausing:
                outputs.until(lambda: push() == 0.0, "the arm to stop")
        outputs.until(lambda: push() < -0.05, "the arm to go on")
        push.message.twist.linear.z *= -1.0  # stay where the arm can move
        outputs.until(lambda: push() > 0.05, "the arm to turn")
        push.message.twist.linear.z *= -1.0


def test_commands_are_what_the_controllers_of_ros2_control_take(outputs: Outputs) -> None:
    message = outputs.heard["servoing"][-1]
    assert list(message.joint_names) == JOINTS
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (0, 0)  # from now on
    (point,) = message.points
    assert (point.time_from_start.sec, point.time_from_start.nanosec) == (0, 10_000_000)  # a cycle of 100 Hz
    assert len(point.positions) == len(point.velocities) == 7
    assert len(point.accelerations) == len(point.effort) == 0
    for name in ("positions", "velocities"):
        message = outputs.heard[name][-1]
        assert (list(message.layout.dim), message.layout.data_offset) == ([], 0)
        assert len(message.data) == 7
    np.testing.assert_allclose(values_of(outputs.heard["positions"][0]), HOME, atol=1e-3)
    np.testing.assert_array_equal(values_of(outputs.heard["velocities"][0]), np.zeros(7))


@pytest.mark.parametrize("name", ["positions", "velocities"])
def test_arrays_follow_a_twist_and_the_velocities_are_those_of_the_positions(outputs: Outputs, name: str) -> None:
    message = twist(x=0.0)
    message.twist.linear.z = -0.05

    def moved() -> bool:
        outputs.twists[name].publish(message)
        value = values_of(outputs.heard[name][-1])
        return bool(np.abs(value - (np.array(HOME) if name == "positions" else 0.0)).max() > 0.02)

    outputs.until(moved, "the commands to change")


def test_every_run_holds_what_was_sent_and_replays_bit_identically(outputs: Outputs) -> None:
    for process in outputs.rig.processes[1:]:
        process.send(2)
    for process in outputs.rig.processes[1:]:
        assert process.wait() == 0, process.err
    for name, (_, topic, _) in NODES.items():
        sent = recorded(outputs.bag(name), topic)
        states = recorded(outputs.bag(name), "/joint_commands")
        assert len(sent) == len(states) > 10
        field = "velocity" if name == "velocities" else "position"
        np.testing.assert_array_equal([values_of(m) for m in sent], [getattr(m, field) for m in states])
        result = replayed(outputs.bag(name))
        assert result.identical
        assert result.commands == len(sent)


def test_a_changed_output_is_a_difference_to_the_replay(outputs: Outputs, tmp_path: Any) -> None:
    """The bytes of the output count, not only those of joint_commands."""
    from ik_controller.recording import replay as module

    class Other(module.CommandWriter):
        def write(self, position: Any, velocity: Any) -> bytes:
            return super().write(position, velocity + 1e-17)

    before, module.CommandWriter = module.CommandWriter, Other
    try:
        result = module.replay(open_bag(outputs.bag("velocities")))
    finally:
        module.CommandWriter = before
    assert not result.identical


def test_servos_numbers() -> None:
    code = StatusCode()
    assert code.of(Status(Code.TRACKING)) == 0
    assert code.of(Status(Code.WAITING)) == code.of(Status(Code.NO_FEEDBACK)) == code.of(Status(Code.FAULT)) == -1
    assert code.of(Status(Code.TRACKING, damped=True, smallest_singular_value=0.03)) == 1
    assert code.of(Status(Code.TRACKING, damped=True, smallest_singular_value=0.02)) == 1
    assert code.of(Status(Code.TRACKING, damped=True, smallest_singular_value=0.03)) == 3
    assert code.of(Status(Code.TRACKING)) == 0
    assert code.of(Status(Code.TRACKING, 0.5, Limit.OBSTACLE)) == 4
    assert code.of(Status(Code.TRACKING, 0.0, Limit.SELF_COLLISION)) == 5
    assert code.of(Status(Code.TRACKING, 0.5, Limit.POSITION, 2)) == 6
    assert code.of(Status(Code.TRACKING, 0.5, Limit.VELOCITY, 2)) == 0
    assert filled(Int8(), 3, "leaving").data == 3
    message = filled(SimpleNamespace(code=0, message=""), 1, "near a singularity")  # moveit_msgs/ServoStatus
    assert (message.code, message.message) == (1, "near a singularity")
