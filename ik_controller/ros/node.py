"""The node `ik_controller`: messages in, one session, commands out, all of it recorded.

Three threads: the loop (here), an executor for parameters and services, and the recorder's writer. The executor's side
only queues events; the loop applies them between two cycles, so that a run is one sequence that can be repeated.
"""

from __future__ import annotations

import contextlib
import gc
import json
import signal
import sys
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from ik_controller.control.controller import Controller
from ik_controller.errors import IkControllerError
from ik_controller.messages import cdr
from ik_controller.recording.rosbag2 import new_bag_folder
from ik_controller.recording.run import RunWriter, default_topics
from ik_controller.robots import build_model, urdf_text
from ik_controller.ros import monitor
from ik_controller.ros.loop import Loop
from ik_controller.ros.parameters import declare, on_change
from ik_controller.ros.polling import PolledGroup, PolledSubscription
from ik_controller.session import Session

# Role → (message class, topic, queue depth, reliable). A trajectory comes once and must come; streams must not wait.
_INPUTS = {
    "joint_states": (JointState, "joint_states", 10, False),
    "target_pose": (PoseStamped, "~/target_pose", 100, False),
    "target_twist": (TwistStamped, "~/target_twist", 100, False),
    "target_trajectory": (MultiDOFJointTrajectory, "~/target_trajectory", 10, True),
    "target_joints": (JointState, "~/target_joints", 100, False),
}
_TAKEN_AT_ONCE = 200  # messages of one input a cycle, so that a flood cannot stop the loop
_STOP_TIME = 5.0  # [s] that braking at shutdown may take


class ControllerNode(Node):  # type: ignore[misc]
    """One arm's controller. `run` is the loop; it returns after `request_stop`, with the arm at rest and the bag
    sealed.
    """

    def __init__(self, **node_arguments: Any) -> None:
        """Raises IkControllerError where parameters, URDF or frames do not fit."""
        super().__init__("ik_controller", **node_arguments)
        self.parameters = declare(self)
        self._events: deque[str] = deque()
        self._recorder_change: deque[RunWriter | None] = deque()
        self._stop = False
        self._stop_by: int | None = None  # when braking at shutdown has taken too long [ns]
        self._loop: Loop | None = None
        self._recorder: RunWriter | None = None
        self._urdf = urdf_text(self.parameters)
        if self._urdf is None:
            latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self.create_subscription(String, "robot_description", self._on_description, latched)
            self.get_logger().info("waiting for the topic robot_description")

    def _on_description(self, message: String) -> None:
        self._urdf = message.data

    def request_stop(self, *_: Any) -> None:
        """Brake, seal the bag, end `run`; for signal handlers."""
        self._stop = True

    # -- setting up

    def _connect(self) -> None:
        """Build the session and everything that talks; needs the URDF."""
        self.session = session = Session(build_model(self.parameters, self._urdf), self.parameters)
        self.get_logger().info("preparing the loop; the very first time it is compiled, for half a minute")
        session.warm_up()
        for assumption in session.model.assumptions:
            self.get_logger().warning(assumption)
        self._commands = self.create_publisher(JointState, "joint_commands", 10)
        self._pose = self.create_publisher(PoseStamped, "~/current_pose", 10)
        self._error = self.create_publisher(TwistStamped, "~/tracking_error", 10)
        self._status = self.create_publisher(DiagnosticStatus, "~/status", 10)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._topics = default_topics(self.get_fully_qualified_name())
        for role, (_, topic, _, _) in _INPUTS.items():
            self._topics[role] = self.resolve_topic_name(topic)
        for topic in ("joint_commands", "robot_description"):
            self._topics[topic] = self.resolve_topic_name(topic)
        self._encode = cdr.JointStateWriter(session.model.joint_names).write

        self._timing = monitor.Timing(session.period)
        self._telling = monitor.Telling(session)
        self._monitor_every = max(round(self.parameters.rate / self.parameters.monitor_rate), 1)
        self._status_every = max(round(self.parameters.rate / self.parameters.status_rate / 10.0), 1) * 10
        self._second = round(self.parameters.rate)
        self._told: tuple[Any, ...] = ()

        on_change(self, lambda: self.parameters, self._accept_parameters)
        self.create_service(SetBool, "~/pause", self._serve_pause)
        self.create_service(Trigger, "~/reset", self._serve_reset)
        self.create_service(SetBool, "~/record", self._serve_record)

    def _listen(self) -> None:
        """Subscribe, as the last thing before the loop: who finds us listening is served at once."""
        group = PolledGroup()
        self._inputs = [
            (role, PolledSubscription(self, group, kind, topic, depth, reliable))
            for role, (kind, topic, depth, reliable) in _INPUTS.items()
        ]

    # -- the executor's side: it only queues

    def _accept_parameters(self, values: dict[str, Any]) -> None:
        changed = self.parameters.replace(values)
        Controller(self.session.model, changed)  # refuses what does not fit the model
        self.parameters = changed
        self._events.append(json.dumps({"do": "parameters", "values": values}))

    def _serve_pause(self, request: Any, response: Any) -> Any:
        self._events.append(json.dumps({"do": "pause" if request.data else "resume"}))
        response.success, response.message = True, "pausing" if request.data else "going on from the measured position"
        return response

    def _serve_reset(self, request: Any, response: Any) -> Any:
        self._events.append(json.dumps({"do": "reset"}))
        response.success, response.message = True, "starting again from the measured position"
        return response

    def _serve_record(self, request: Any, response: Any) -> Any:
        response.success = True
        if not request.data:
            self._recorder_change.append(None)
            response.message = "sealing the bag"
        elif self._recorder is not None:
            response.message = f"already recording to {self._recorder.folder}"
        else:
            response.success, response.message = self._start_recorder()
        return response

    def _start_recorder(self) -> tuple[bool, str]:
        """Make a bag, which takes longer than a cycle, and hand it to the loop; return (success, message)."""
        try:
            folder = new_bag_folder(Path(self.parameters.record_folder).expanduser())
            recorder = RunWriter(folder, self.session, self._topics)
        except IkControllerError as error:
            self.get_logger().error(f"not recording: {error}")
            return False, str(error)
        self._recorder_change.append(recorder)
        self.get_logger().info(f"recording to {folder}")
        return True, f"recording to {folder}"

    def _seal(self, recorder: RunWriter) -> None:
        status = recorder.close()
        lost = f", {status.lost} lost" if status.lost else ""
        self.get_logger().info(f"recorded {status.messages} messages to {recorder.folder}{lost}")

    # -- the loop's side

    def run(self) -> None:
        """Run until `request_stop`: wait for the robot description if need be, then cycle."""
        executor = SingleThreadedExecutor(context=self.context)
        executor.add_node(self)
        while self._urdf is None and not self._stop:
            executor.spin_once(timeout_sec=0.1)
        if self._urdf is None:
            return
        self._connect()
        if self.parameters.record:
            self._start_recorder()
        serving = threading.Thread(target=_spin, args=(executor,), name="executor", daemon=True)
        serving.start()
        self._loop = loop = Loop(self.session.period, self._cycle, self._on_stall)
        # The collector stops the world at moments of its own choosing: it runs once a second at the end of a cycle.
        gc.collect()
        gc.freeze()
        gc.disable()
        self._listen()
        self.get_logger().info(
            f"ready: {len(self.session.model.joint_names)} joints of '{self.session.model.robot_name}', "
            f"'{self.session.model.base_frame}' to '{self.session.model.tip_frame}', {self.parameters.rate:g} Hz"
        )
        interval = sys.getswitchinterval()
        sys.setswitchinterval(1e-4)  # the loop gets the interpreter back from the other threads within 0.1 ms
        try:
            loop.run()
        finally:
            sys.setswitchinterval(interval)
            gc.enable()
            if self._recorder is not None:
                self._seal(self._recorder)
            executor.shutdown()
            serving.join(timeout=2.0)

    def _cycle(self, index: int, now: int, late: int) -> None:
        begin = time.monotonic_ns()
        session, recorder = self.session, self._recorder
        if self._recorder_change:
            recorder = self._switch_recorder(now)
        if self._stop:
            self._brake(now)
        while self._events:
            self._apply(self._events.popleft(), now)
        for role, subscription in self._inputs:
            for _ in range(_TAKEN_AT_ONCE):
                data = subscription.take()
                if data is None:
                    break
                if recorder is not None:
                    recorder.write(role, now, data)
                if not session.take(role, data, now):
                    self.get_logger().warning(f"rejected: {session.last_rejected}", throttle_duration_sec=1.0)
        step = session.cycle(now)
        if step is not None:
            # The command is for the cycle's end: that is its stamp.
            data = self._encode(now + session.period, step.position, step.velocity)
            self._commands.publish(data)
            if recorder is not None:
                recorder.write("joint_commands", now, data)
        work = time.monotonic_ns() - begin
        if recorder is not None:
            recorder.cycle(index, now, int(session.status.code), late, work, step is not None)
        self._timing.add(now + late)
        if index % self._monitor_every == 0:
            self._tell_pose(now, None if step is None else step.error)
        if index % 10 == 0:
            told = session.status.code, session.status.limit, session.status.joint
            if index % self._status_every == 0 or told != self._told:
                self._told = told
                self._tell_status(now, index % self._second < self._status_every)
        if index % self._second == self._second // 2:
            gc.collect(1)
        if self._stop and step is None and self._loop is not None:
            self._loop.stop = True

    def _apply(self, event: str, now: int) -> None:
        try:
            self.session.apply(event)
        except IkControllerError as error:
            self.get_logger().error(str(error))
            return
        if self._recorder is not None:
            self._recorder.event(now, event)

    def _brake(self, now: int) -> None:
        """Shut down as a pause: the arm brakes within its limits, then the session has nothing more to command."""
        if self._stop_by is None:
            self._stop_by = now + int(_STOP_TIME * 1e9)
        if not self.session.paused:
            self._apply(json.dumps({"do": "pause"}), now)
        elif now > self._stop_by and self._loop is not None:
            self._loop.stop = True

    def _on_stall(self, skipped: int) -> None:
        self.get_logger().error(
            f"the process was held up for {skipped} cycles: starting again from the measured position"
        )
        self._events.append(json.dumps({"do": "reset"}))

    # -- recording and telling

    def _switch_recorder(self, now: int) -> RunWriter | None:
        """Take up or drop a bag; it is sealed beside the loop."""
        dropped, self._recorder = self._recorder, self._recorder_change.popleft()
        if dropped is not None:
            self._sealing = threading.Thread(target=self._seal, args=(dropped,), name="seal")
            self._sealing.start()
        if self._recorder is not None:
            self._recorder.begin(self.session, now)
        return self._recorder

    def _tell_pose(self, now: int, error: Any) -> None:
        pose = self._telling.pose(now)
        messages = [] if pose is None else [("current_pose", self._pose, pose)]
        if error is not None:
            messages.append(("tracking_error", self._error, self._telling.error(now, error)))
        for role, publisher, data in messages:
            publisher.publish(data)
            if self._recorder is not None:
                self._recorder.write(role, now, data)

    def _tell_status(self, now: int, diagnostics: bool) -> None:
        assert self._loop is not None
        recorder = None if self._recorder is None else self._recorder.writer.status()
        name = self.get_fully_qualified_name().lstrip("/")
        content = monitor.status(self.session, name, now, self._timing, self._loop.missed, self._loop.stalls, recorder)
        data = cdr.encode(content)
        self._status.publish(data)
        if self._recorder is not None:
            self._recorder.write("status", now, data)
        if diagnostics:
            array = cdr.message(monitor.DIAGNOSTIC_ARRAY, cdr.header(now, ""), [content])
            self._diagnostics.publish(cdr.encode(array))


def _spin(executor: Any) -> None:
    with contextlib.suppress(ExternalShutdownException):
        executor.spin()


def main(arguments: list[str] | None = None) -> int:
    """Run the node as a process: exit code 0 after SIGINT or SIGTERM, 2 for a mistake in its configuration."""
    # rclpy's own handlers would shut the context down before the stop command can go out.
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # a malformed ROS argument, or a parameter file that cannot be read
        print(f"ik_controller_node: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    node: ControllerNode | None = None
    stopped = False

    def stop(*_: Any) -> None:
        nonlocal stopped
        stopped = True
        if node is not None:
            node.request_stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        node = ControllerNode()
        if stopped:
            node.request_stop()
        node.run()
    except IkControllerError as error:
        print(f"ik_controller_node: {error}", file=sys.stderr)
        return 2
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
