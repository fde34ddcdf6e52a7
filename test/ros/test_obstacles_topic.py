"""A box sent over DDS to ~/obstacles stops the arm; the status names the pair, and the run replays bit for bit."""

from __future__ import annotations

import signal

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import PoseStamped
from published import assert_limits_hold, recorded, restarts_of
from rclpy.qos import DurabilityPolicy, QoSProfile
from rig import Rig, values_of
from visualization_msgs.msg import Marker, MarkerArray

from ik_controller.recording.reader import open_bag
from ik_controller.recording.replay import replay
from ik_controller.robots import build_model, bundled_parameters


def test_a_box_from_the_topic_stops_the_arm(rig: Rig) -> None:
    parameters = bundled_parameters("panda")
    model = build_model(parameters)
    home = model.forward(np.array(parameters.posture))
    top = float(home.translation[2]) - 0.15

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    scene = rig._listener.create_publisher(MarkerArray, "/ik_controller/obstacles", latched)
    box = Marker(ns="crate", id=7, type=Marker.CUBE, action=Marker.ADD)
    box.header.frame_id = model.base_frame
    box.pose.position.x, box.pose.position.y, box.pose.position.z = (*home.translation[:2].tolist(), top - 0.05)
    box.scale.x, box.scale.y, box.scale.z = 0.3, 0.3, 0.1
    scene.publish(MarkerArray(markers=[box]))  # before there is a node: it is latched

    rig.start_sim("--rate", "200")
    node = rig.start_node(robot="panda", rate=200.0, obstacle_avoidance="true", command_timeout=10.0)
    rig.until_status("holding")
    publisher = rig.publisher("target_pose")
    target = PoseStamped()
    target.header.frame_id = model.base_frame
    below = pin.SE3ToXYZQUAT(pin.SE3(home.rotation, home.translation - np.array([0.0, 0.0, 0.3])))
    position, orientation = target.pose.position, target.pose.orientation
    position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w = below.tolist()

    def pressing() -> bool:
        publisher.publish(target)
        speeds = [np.abs(command.velocity).max() for command in rig.heard["joint_commands"][-40:]]
        return "an obstacle is near" in rig.heard["status"][-1].message and max(speeds) < 1e-3

    rig.until(pressing, "the arm to rest on the box")
    status = rig.heard["status"][-1]
    assert "panda_hand and crate/7" in status.message
    assert values_of(status)["limit"] == "obstacle"
    tool = model.forward(np.array(rig.heard["joint_commands"][-1].position)).translation
    assert tool[2] > top + 0.02 - 1e-4  # the fingers end 1 cm below the tool point, rounded
    node.send(signal.SIGINT)
    assert node.wait() == 0, node.err
    (bag,) = rig.bags()
    assert_limits_hold(recorded(bag, "/joint_commands"), model, 5_000_000, restarts_of(bag))
    result = replay(open_bag(bag))
    assert result.identical
    assert result.commands > 100
