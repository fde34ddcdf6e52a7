"""Outputs: what the node publishes about its arm, cycle by cycle; each gives back the bytes, to be recorded."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from ik_controller.control.controller import Step
from ik_controller.kinematics.model import RobotModel
from ik_controller.messages import cdr
from ik_controller.messages.commands import ARRAY, OUTPUTS, CommandWriter
from ik_controller.messages.inputs import INPUTS
from ik_controller.parameters import ControllerParameters
from ik_controller.recording.run import default_topics
from ik_controller.ros.inputs import inputs_of
from ik_controller.ros.monitor import DIAGNOSTIC_ARRAY, Account, Telling
from ik_controller.session import Session

_CLASSES = {cdr.JOINT_STATE: JointState, cdr.JOINT_TRAJECTORY: JointTrajectory, ARRAY: Float64MultiArray}


class Outputs:
    """The publishers of a configured node; `topics`: role → resolved topic of all that a run's bag holds."""

    def __init__(self, node: Node, model: RobotModel, parameters: ControllerParameters) -> None:
        self._node = node
        kind, topic = OUTPUTS[parameters.command_output]
        topic = parameters.command_topic or topic
        self._commands = node.create_publisher(_CLASSES[kind], topic, 10)
        self._other: CommandWriter | None = None
        if kind != cdr.JOINT_STATE:
            period = round(1e9 / parameters.rate)
            velocities = parameters.trajectory_velocities
            self._other = CommandWriter(parameters.command_output, model.joint_names, period, velocities)
        self._pose = node.create_publisher(PoseStamped, "~/current_pose", 10)
        self._error = node.create_publisher(TwistStamped, "~/tracking_error", 10)
        # For eyes: a listener at the loop's rate would cost the loop, one of these does not.
        self._measured_joints = node.create_publisher(JointState, "~/measured_joints", 1)
        self._commanded_joints = node.create_publisher(JointState, "~/commanded_joints", 1)
        self._telling = Telling(model)
        self._encode = cdr.JointStateWriter(model.joint_names).write
        self._encode_positions = cdr.JointStateWriter(model.joint_names, velocities=False).write
        self.topics = default_topics(node.get_fully_qualified_name())
        inputs = inputs_of(parameters)
        for role in set(INPUTS) - set(inputs):  # a type that is not installed here
            del self.topics[role]
        for role, settings in inputs.items():
            self.topics[role] = node.resolve_topic_name(settings.topic)
        for topic in ("joint_commands", "robot_description"):
            self.topics[topic] = node.resolve_topic_name(topic)
        self.topics["joint_commands" if self._other is None else "command_output"] = self._commands.topic_name

    def command(self, at: int, step: Step) -> list[tuple[str, bytes]]:
        """Send a step's command, stamped `at` [ns]; return roles and bytes."""
        data = self._encode(at, step.position, step.velocity)
        if self._other is None:
            self._commands.publish(data)
            return [("joint_commands", data)]
        # Recorded in both forms: joint_commands, with names and stamp, is what readers of bags and the replay know.
        sent = self._other.write(step.position, step.velocity)
        self._commands.publish(sent)
        return [("joint_commands", data), ("command_output", sent)]

    def tell(self, now: int, session: Session, step: Step | None) -> list[tuple[str, bytes]]:
        """Send tool pose and tracking error; return roles and bytes."""
        sent = []
        pose = self._telling.pose(now, session.model, session.measured)
        if pose is not None:
            self._pose.publish(pose)
            sent.append(("current_pose", pose))
        if step is not None:
            error = self._telling.error(now, step.error)
            self._error.publish(error)
            sent.append(("tracking_error", error))
        return sent

    # For those who watch, if anybody does; not recorded: the bag has them.

    def show_measured(self, now: int, session: Session) -> None:
        """Send the measured joints."""
        measured = session.measured
        if measured is not None and self._measured_joints.get_subscription_count():
            self._measured_joints.publish(self._encode_positions(now, measured, None))

    def show_commanded(self, now: int, session: Session, step: Step | None) -> None:
        """Send the commanded joints."""
        if step is not None and self._commanded_joints.get_subscription_count():
            self._commanded_joints.publish(self._encode(now + session.period, step.position, step.velocity))

    def close(self) -> None:
        """Destroy the publishers, when the last command has left."""
        self._commands.wait_for_all_acked(Duration(seconds=0.5))
        for publisher in (
            self._commands,
            self._pose,
            self._error,
            self._measured_joints,
            self._commanded_joints,
        ):
            self._node.destroy_publisher(publisher)


class StatusOutput:
    """Publishes ~/status and /diagnostics, from the node's first moment to its last, whatever its state."""

    def __init__(self, node: Node) -> None:
        self._name = node.get_fully_qualified_name().lstrip("/")
        self._status = node.create_publisher(DiagnosticStatus, "~/status", 10)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def tell(self, now: int, account: Account, diagnostics: bool) -> bytes:
        """Send an account as ~/status and, where asked for, as /diagnostics; return the status' bytes."""
        content = account.message(self._name)
        data = cdr.encode(content)
        self._status.publish(data)
        if diagnostics:
            array = cdr.message(DIAGNOSTIC_ARRAY, cdr.header(now, ""), [content])
            self._diagnostics.publish(cdr.encode(array))
        return data
