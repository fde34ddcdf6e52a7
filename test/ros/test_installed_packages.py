"""Packages that a ROS installation has and PyPI has not, where they are there: control_msgs, moveit_msgs, tf2_ros."""

from __future__ import annotations

import signal

import numpy as np
import pinocchio as pin
import pytest
from geometry_msgs.msg import TransformStamped
from rig import Rig, values_of
from test_bad_input import pose
from test_services import replayed

from ik_controller.robots import build_model, bundled_parameters

JOINT = "panda_joint1"


def test_servos_messages_and_services(rig: Rig) -> None:
    control, moveit = pytest.importorskip("control_msgs.msg"), pytest.importorskip("moveit_msgs.msg")
    kinds = pytest.importorskip("moveit_msgs.srv")
    rig.start_sim("--rate", "250")
    rig.node = rig.start_node(robot="panda", rate=250.0, servo_interface="true", twist_unit="unitless")
    rig.until_status("holding")
    rig.hear("servo", moveit.ServoStatus, "/servo_node/status")
    publisher = rig._listener.create_publisher(control.JointJog, "/servo_node/delta_joint_cmds", 10)
    request = kinds.ServoCommandType.Request(command_type=kinds.ServoCommandType.Request.JOINT_JOG)

    def switch(command: int) -> bool:
        name = "/servo_node/switch_command_type"
        request.command_type = command
        return bool(rig.request(name, kinds.ServoCommandType, request, node="/ik_controller").success)

    assert switch(kinds.ServoCommandType.Request.JOINT_JOG)
    assert not switch(77)
    rig.until_new("status", lambda s: values_of(s)["mode"] == "joints")
    start = np.array(rig.heard["joint_commands"][-1].position)

    def turned() -> bool:
        publisher.publish(control.JointJog(joint_names=[JOINT], velocities=[0.5]))
        return bool(rig.heard["joint_commands"][-1].position[0] > start[0] + 0.05)

    rig.until(turned, "the joint to turn")
    others = np.array(rig.heard["joint_commands"][-1].position)[1:] - start[1:]
    assert np.abs(others).max() < 1e-9
    told = rig.until_new("servo", lambda s: "tracking" not in s.message)
    assert told.code == moveit.ServoStatus.NO_WARNING
    assert told.message.startswith("holding: no live target")
    ended(rig)


def test_a_target_in_a_frame_of_tf(rig: Rig) -> None:
    pytest.importorskip("tf2_ros")
    tf = pytest.importorskip("tf2_msgs.msg")
    model = build_model(bundled_parameters("panda"))
    camera = pin.SE3(pin.utils.rotate("z", 0.7), np.array([0.3, -0.1, 0.2]))
    sent = TransformStamped(child_frame_id="camera")
    sent.header.frame_id = model.base_frame
    t, r = sent.transform.translation, sent.transform.rotation
    t.x, t.y, t.z, r.x, r.y, r.z, r.w = pin.SE3ToXYZQUAT(camera).tolist()
    home = model.forward(np.array(bundled_parameters("panda").posture))
    goal = home * pin.SE3(np.eye(3), np.array([0.0, 0.03, 0.0]))
    target = pose("camera")
    p, o = target.pose.position, target.pose.orientation
    p.x, p.y, p.z, o.x, o.y, o.z, o.w = pin.SE3ToXYZQUAT(camera.actInv(goal)).tolist()

    rig.hear("tf", tf.TFMessage, "/tf")
    rig.start_sim("--rate", "250")
    rig.node = rig.start_node(robot="panda", rate=250.0)
    rig.until_status("holding")
    publisher = rig._listener.create_publisher(tf.TFMessage, "/tf", 10)
    targets = rig.publisher("target_pose")

    def there() -> bool:
        now = rig._listener.get_clock().now().to_msg()
        sent.header.stamp = target.header.stamp = now
        publisher.publish(tf.TFMessage(transforms=[sent]))
        targets.publish(target)
        tool = model.forward(np.array(rig.heard["joint_commands"][-1].position))
        return bool(np.linalg.norm(pin.log6(goal.actInv(tool)).vector) < 1e-4)

    rig.until(there, "the tool at the target")
    # The tool is sent to TF itself, below the tip.
    names = {t.child_frame_id for m in rig.heard["tf"] for t in m.transforms}
    assert len(names - {"camera"}) == 1
    ended(rig)


def ended(rig: Rig) -> None:
    """End the node; its run replays bit for bit, without these packages."""
    rig.node.send(signal.SIGINT)
    assert rig.node.wait() == 0, rig.node.err
    (bag,) = rig.bags()
    assert replayed(bag).identical
