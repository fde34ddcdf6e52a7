"""By hand: the live page's ROS side, the keyboard in a real terminal, a joystick; on a simulated arm."""

from __future__ import annotations

import os
import pty
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from rclpy.node import Node
from rig import CLI, Rig, environment
from sensor_msgs.msg import Joy
from visualization_msgs.msg import Marker, MarkerArray

from ik_controller.robots import build_model, bundled_parameters

PANDA = ("--rate", "500")
MODEL = build_model(bundled_parameters("panda"))


def tool_moves(rig: Rig, axis: int) -> float:
    """Return how far the tool has moved along an axis of the base in the commands heard [m]."""
    commands = rig.heard["joint_commands"]
    first, last = (MODEL.forward(np.array(commands[i].position)).translation for i in (0, -1))
    return float(last[axis] - first[axis])


def forget(rig: Rig) -> None:
    """Start with the next commands."""
    rig.until_status("holding")
    rig.heard["joint_commands"].clear()
    rig.until_commanding()


@pytest.fixture
def viewer(live: Rig) -> Iterator[Any]:
    pytest.importorskip("viser")
    from ik_controller.ros.viewer import Viewer

    made = Viewer("/ik_controller", "test", context=live.context)
    thread = threading.Thread(target=made.run)
    thread.start()
    yield made
    made.stop()
    thread.join(30.0)
    assert not thread.is_alive()


def test_the_page_steers_and_follows(live, viewer):
    page = viewer.page
    live.until(lambda: viewer._model is not None, "the viewer to show the arm")
    live.until(lambda: {"measured", "commanded"} <= set(page._shown), "both arms to be shown")
    live.until(lambda: "holding" in page._sentence.content, "the status on the page")
    assert viewer._pose is None  # who only watches does not publish targets

    forget(live)
    start = page._tool.copy()
    goal = start * pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.03]))
    page._steering.drag(goal, True)
    live.until_status("tracking")
    page._steering.drag(goal, False)
    live.until(lambda: abs(tool_moves(live, 2) - 0.03) < 1e-4, "the tool to get there")
    live.until_status("holding")  # what was let go of is not sent for ever
    live.until(lambda: np.linalg.norm(page._tool.translation - goal.translation) < 1e-3, "the page to show it")

    marker = Marker(type=Marker.SPHERE, action=Marker.ADD, ns="ball")
    marker.header.frame_id = "panda_link0"
    marker.pose.position.x, marker.pose.orientation.w = 3.0, 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = 0.2
    hand = Node("hand", context=live.context, enable_rosout=False)
    publisher = hand.create_publisher(MarkerArray, "/ik_controller/obstacles", 10)
    try:
        live.until(lambda: publisher.publish(MarkerArray(markers=[marker])) or len(page._obstacles) == 1, "the ball")
    finally:
        hand.destroy_node()

    page._steering.set("gain", 20.0)
    live.until(lambda: live.get_parameter("gain") == [20.0], "the gain to be set")
    page._steering.set("gain", 50.0)
    live.until(lambda: live.get_parameter("gain") == [50.0], "the gain to be set back")
    page._steering.press("pause")
    live.until_status("paused")
    page._steering.press("resume")
    live.until_status("holding")
    live.until(lambda: viewer._pose is None, "the page to publish no targets any more")


def test_the_page_comes_back_with_its_node(rig):
    pytest.importorskip("viser")
    from ik_controller.ros.viewer import Viewer

    rig.start_sim(*PANDA)
    node = rig.start_node(robot="panda", rate=250.0, record=False)
    failure = [""]
    viewer = Viewer("/ik_controller", "test", context=rig.context, failed=lambda: failure[0])
    thread = threading.Thread(target=viewer.run)
    thread.start()
    try:
        sentence = viewer.page._sentence
        rig.until(lambda: "holding" in sentence.content, "the status on the page")
        node.kill()
        rig.until(lambda: "no node answers" in sentence.content, "the page to see that the node is gone")
        failure[0] = "the node process has ended: killed"
        rig.until(lambda: failure[0] in sentence.content, "the page to say that it will not come back")
        rig.start_node(robot="panda", rate=250.0, record=False)
        rig.until(lambda: "holding" in sentence.content, "the page to find the node again")
        rig.until(lambda: viewer._model is not None, "the arm to be shown again")
    finally:
        viewer.stop()
        thread.join(30.0)


def test_the_keyboard_in_a_terminal(live):
    forget(live)
    pid, terminal = pty.fork()
    if pid == 0:  # the child: a process whose terminal this is
        os.environ.update(environment(live.domain))
        os.execvp(CLI[0], [*CLI, "teleop", "--linear", "0.05"])
    said = bytearray()

    def reads() -> None:
        while True:
            try:
                data = os.read(terminal, 4096)
            except OSError:
                return
            if not data:
                return
            said.extend(data)

    reader = threading.Thread(target=reads, daemon=True)
    reader.start()
    try:
        live.until(lambda: b"nothing held" in said, "the keyboard's line")
        os.write(terminal, b"e")  # up, held: a press, then repeats

        def held() -> bool:
            os.write(terminal, b"e")
            time.sleep(0.03)
            return tool_moves(live, 2) > 0.01

        live.until(held, "the tool to go up")
        assert b"+z" in said
        live.until_status("holding")  # let go
        assert abs(tool_moves(live, 0)) < 1e-3
        os.write(terminal, b"p")
        live.until_status("paused")
        os.write(terminal, b"p")
        live.until_status("holding")
        os.write(terminal, b"x")
        live.until(lambda: os.waitpid(pid, os.WNOHANG)[0] == pid, "teleop to end")
    finally:
        os.close(terminal)
        reader.join(5.0)


def test_a_joystick(live):
    forget(live)
    process = live.start("teleop", [*CLI, "teleop", "--joy", "gamepad", "--linear", "0.05"])
    hand = Node("hand", context=live.context, enable_rosout=False)
    publisher = hand.create_publisher(Joy, "joy", 10)
    axes, buttons = [0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0], [0] * 11

    def pushed() -> bool:
        publisher.publish(Joy(axes=axes, buttons=buttons))
        time.sleep(0.02)
        return tool_moves(live, 0) > 0.01

    try:
        live.until(publisher.get_subscription_count, "teleop to listen")
        by = time.monotonic() + 1.0
        live.until(lambda: pushed() or time.monotonic() > by)
        assert abs(tool_moves(live, 0)) < 1e-9  # the dead man's button is not held
        buttons[5] = 1
        live.until(pushed, "the tool to go forward")
        live.until_status("holding")  # no messages: let go
    finally:
        hand.destroy_node()
    process.send(15)
    assert process.wait() == 0


def test_teleop_says_what_is_missing(rig):
    process = rig.start("teleop", [*CLI, "teleop", "--joy", "gamepad"])
    assert process.wait() == 2
    assert "does not answer" in process.err
    assert len(process.err.strip().splitlines()) == 1
