"""Teleop: twists by hand, from the keyboard or a joystick, to a node's ~/target_twist.

Sent only while something is held; when it is let go the stream ends, and the node brakes by its own timeout.
"""

from __future__ import annotations

import shutil
import sys
import time
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from sensor_msgs.msg import Joy
from std_srvs.srv import SetBool, Trigger

from ik_controller.endings import on_signal
from ik_controller.errors import IkControllerError
from ik_controller.messages import cdr
from ik_controller.ros.joystick import JoyMapping
from ik_controller.ros.keyboard import Held, Terminal, events
from ik_controller.ros.polling import PolledGroup, PolledSubscription
from ik_controller.ros.question import Question
from ik_controller.ros.start import full_name, start_ros

Array = NDArray[np.float64]

RATE = 50.0  # [Hz]
JOY_TIMEOUT = 0.5  # [s] without a message after which a joystick counts as let go
_FASTER = 1.25
_KEYS = {
    "w": (0, 1), "s": (0, -1), "a": (1, 1), "d": (1, -1), "e": (2, 1), "q": (2, -1),
    "l": (3, 1), "j": (3, -1), "i": (4, 1), "k": (4, -1), "u": (5, 1), "o": (5, -1),
}  # fmt: skip
_NAMES = ("x", "y", "z", "roll", "pitch", "yaw")
_HELP = """\
hold to move      w/s  x    a/d  y    e/q  z        l/j  roll    i/k  pitch    u/o  yaw
press             f  frame (base, tool)    +/-  speed    p  pause, go on    r  reset    x  end"""


class Teleop:
    """Sends twists to the node `target`; speeds [m/s, rad/s] at full deflection."""

    def __init__(
        self,
        target: str,
        linear: float,
        angular: float,
        frame: str = "base",
        ros_arguments: list[str] | None = None,
    ) -> None:
        start_ros(ros_arguments or [])
        self.node = node = Node("teleop", start_parameter_services=False)
        target = full_name(node, target)
        self.target, self.linear, self.angular, self.frame = target, linear, angular, frame
        self.paused = False
        self.held: dict[str, float] = {}  # what is held, for showing
        self.message = ""
        self._publisher = node.create_publisher(TwistStamped, f"{target}/target_twist", 10)
        group = PolledGroup()
        self._pose = PolledSubscription(node, group, PoseStamped, f"{target}/current_pose", 1, reliable=False)
        self._status = PolledSubscription(node, group, DiagnosticStatus, f"{target}/status", 1, reliable=False)
        self._pause = node.create_client(SetBool, f"{target}/pause")
        self._reset = node.create_client(Trigger, f"{target}/reset")
        # Made last: whoever answers it has found all of the above.
        self._get = node.create_client(GetParameters, f"{target}/get_parameters")
        self._frames: dict[str, str] = {}
        self._stop = False

    def close(self) -> None:
        """Leave the graph."""
        self.node.destroy_node()
        rclpy.try_shutdown()

    def stop(self, *_: Any) -> None:
        """End; for signal handlers."""
        self._stop = True

    @property
    def stopped(self) -> bool:
        """Has `stop` been called?"""
        return self._stop

    def find(self, patience: float) -> None:
        """Wait for the node and its frames. Raises IkControllerError where it does not answer in `patience` [s]."""
        by = time.monotonic() + patience
        question = Question(self._get, GetParameters.Request(names=["tip_frame"]))
        while not self._stop and len(self._frames) < 2:
            rclpy.spin_once(self.node, timeout_sec=0.05)
            data = self._pose.take()
            if data is not None:
                self._frames["base"] = str(cdr.decode(cdr.POSE, data).header.frame_id)
            answer = question.answer()
            if answer is not None:
                self._frames["tool"] = answer.values[0].string_value
            if time.monotonic() > by:
                heard = "does not know its arm's joints yet" if "tool" in self._frames else "does not answer"
                raise IkControllerError(f"the node '{self.target}' {heard}: is it running, with joint_states?")

    def send(self, shares: Array | None) -> None:
        """Send one twist, shares (6,) of the full speeds; None: nothing is held, so nothing is sent."""
        names = zip(_NAMES, np.zeros(6) if shares is None else shares, strict=True)
        self.held = {name: float(share) for name, share in names if share}
        if shares is None or self.paused:
            return
        twist = np.concatenate((self.linear * shares[:3], self.angular * shares[3:]))
        self._publisher.publish(cdr.twist_message(time.time_ns(), self._frames[self.frame], twist))

    def press(self, name: str) -> None:
        """Do what a button does: frame, faster, slower, pause, reset."""
        if name == "frame":
            self.frame = "tool" if self.frame == "base" else "base"
        elif name in ("faster", "slower"):
            factor = _FASTER if name == "faster" else 1.0 / _FASTER
            self.linear, self.angular = self.linear * factor, self.angular * factor
        elif name == "pause":
            self.paused = not self.paused
            self._pause.call_async(SetBool.Request(data=self.paused))
        elif name == "reset":
            self._reset.call_async(Trigger.Request())

    def listen(self) -> None:
        """Take in the node's status."""
        rclpy.spin_once(self.node, timeout_sec=0.0)
        data = self._status.latest()
        if data is not None:
            self.message = str(cdr.decode("diagnostic_msgs/msg/DiagnosticStatus", data).message)

    def line(self) -> str:
        """Return one line: what is held, frame, speeds, and the node's status."""
        held = " ".join(f"{'+' if share > 0 else '-'}{name}" for name, share in self.held.items()) or "nothing held"
        state = "paused; " if self.paused else ""
        speeds = f"{self.linear:.2f} m/s {self.angular:.2f} rad/s"
        return f"{held:<24} {self.frame:<5} {speeds}  {state}{self.message}"


def by_keyboard(teleop: Teleop) -> None:
    """Steer with the keyboard until x, Escape or Ctrl-C. Raises IkControllerError where stdin is no terminal."""
    if not sys.stdin.isatty():
        raise IkControllerError("the keyboard needs a terminal; for a joystick give --joy FILE")
    print(_HELP)
    held = Held()
    actions = {"f": "frame", "+": "faster", "=": "faster", "-": "slower", "p": "pause", "r": "reset"}
    with Terminal() as terminal:
        while not teleop.stopped:
            for key, kind in events(terminal.read(1.0 / RATE)):
                if kind == "release":
                    held.release(key)
                elif key in _KEYS:
                    held.press(key, time.monotonic(), told=kind != "type")
                elif kind in ("press", "type"):
                    if key in ("x", "\x1b", "\x03"):
                        teleop.stop()
                    elif key in actions:
                        teleop.press(actions[key])
            keys = held.keys(time.monotonic())
            shares = np.zeros(6)
            for key in keys:
                row, sign = _KEYS[key]
                shares[row] += sign
            teleop.send(shares if keys else None)
            teleop.listen()
            width = shutil.get_terminal_size().columns - 1
            sys.stdout.write(f"\r{teleop.line()[:width]:<{width}}")
            sys.stdout.flush()
    print()


def by_joystick(teleop: Teleop, mapping: JoyMapping, topic: str) -> None:
    """Steer with a joystick's Joy messages until SIGINT or SIGTERM."""
    messages = PolledSubscription(teleop.node, PolledGroup(), Joy, topic, 10, reliable=False)
    shares: Array | None = None
    heard = -JOY_TIMEOUT
    down: set[str] = set()
    while not teleop.stopped:
        begin = time.monotonic()
        while (data := messages.take()) is not None:
            joy = cdr.decode("sensor_msgs/msg/Joy", data)
            buttons = [int(b) for b in joy.buttons]
            shares, heard = mapping.twist([float(a) for a in joy.axes], buttons), begin
            now_down = {name for name, i in mapping.buttons.items() if i < len(buttons) and buttons[i]}
            for name in sorted(now_down - down):
                teleop.press(name)
            down = now_down
        teleop.send(shares if begin - heard < JOY_TIMEOUT else None)
        teleop.listen()
        if sys.stdout.isatty():
            width = shutil.get_terminal_size().columns - 1
            sys.stdout.write(f"\r{teleop.line()[:width]:<{width}}")
            sys.stdout.flush()
        time.sleep(max(1.0 / RATE - (time.monotonic() - begin), 0.0))


def teleop(
    target: str,
    linear: float,
    angular: float,
    frame: str,
    joy: JoyMapping | None,
    topic: str,
    ros_arguments: list[str],
) -> None:
    """Steer the node `target` by hand until the user ends it."""
    hands = Teleop(target, linear, angular, frame, ros_arguments)
    on_signal(hands.stop)
    try:
        hands.find(10.0)
        if joy is None:
            by_keyboard(hands)
        else:
            by_joystick(hands, joy, topic)
    finally:
        hands.close()
