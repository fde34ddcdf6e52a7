"""A rig for tests over real DDS: processes in a domain of their own, and a client that listens, sends and calls.

Every rig takes the next ROS domain, counted on from this process' id, so that neither two rigs nor two test runs on one
machine hear each other. Waiting is for a condition with a deadline, never for a time.
"""

from __future__ import annotations

import fcntl
import importlib.util
import itertools
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from ik_controller.recording.target_bag import write_targets
from ik_controller.robots import build_model, bundled_parameters
from ik_controller.ros.transport import over_udp
from ik_controller.verbs.processes import is_quiet

os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
# Within this host, and not through shared memory, which crashes now and then where participants come and go.
os.environ.update(over_udp({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, Path(os.devnull)))

ROOT = Path(__file__).resolve().parents[2]
_AT_ONCE = 1000  # messages of one topic
_AGAIN = 10.0  # [s] before a question without an answer is asked again
PATIENCE = 180.0  # [s] before anything that should happen is taken for not happening
_DOMAINS = itertools.count(os.getpid())
_LOCKS: list[Any] = []

NODE = [sys.executable, "-m", "ik_controller.ros"]
CLI = [sys.executable, "-m", "ik_controller.cli"]

HEARD = {
    "joint_commands": (JointState, "/joint_commands"),
    "joint_states": (JointState, "/joint_states"),
    "current_pose": (PoseStamped, "/ik_controller/current_pose"),
    "tracking_error": (TwistStamped, "/ik_controller/tracking_error"),
    "status": (DiagnosticStatus, "/ik_controller/status"),
    "diagnostics": (DiagnosticArray, "/diagnostics"),
}
SENT = {
    "joint_commands": (JointState, "/joint_commands"),
    "joint_states": (JointState, "/joint_states"),
    "target_pose": (PoseStamped, "/ik_controller/target_pose"),
    "target_twist": (TwistStamped, "/ik_controller/target_twist"),
    "target_trajectory": (MultiDOFJointTrajectory, "/ik_controller/target_trajectory"),
    "target_joints": (JointState, "/ik_controller/target_joints"),
    "obstacles": (MarkerArray, "/ik_controller/obstacles"),
}
SERVICES = {"pause": SetBool, "record": SetBool, "reset": Trigger}


def figure_bag(folder: Path, seconds: float, robot: str = "panda") -> Path:
    """Write the first seconds of the bundled figure-eight, made by scripts/make_bags.py; they end at full speed."""
    file = ROOT / "scripts" / "make_bags.py"
    specification = importlib.util.spec_from_file_location("make_bags", file)
    assert specification is not None
    assert specification.loader is not None
    script = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(script)
    parameters = bundled_parameters(robot)
    model = build_model(parameters)
    targets = script.targets(model.forward(np.array(parameters.posture)), model.base_frame)
    write_targets(folder, [target for target in targets if target.time <= seconds * 1e9], script.START)
    return folder


def next_domain() -> int:
    """Return a ROS domain that nobody on this machine uses, locked against other runs of these tests until this process
    ends.
    """
    for number in itertools.islice(_DOMAINS, 100):
        domain = 1 + number % 100
        if not is_quiet(domain):
            continue
        lock = (Path(tempfile.gettempdir()) / f"ik_controller_test_domain_{domain}").open("w")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            continue
        _LOCKS.append(lock)
        return domain
    raise AssertionError("all 100 ROS domains are taken")


def environment(domain: int) -> dict[str, str]:
    """Return the environment of a process in that domain."""
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(domain),
        "PYTHONPATH": os.pathsep.join(paths),
        "RCUTILS_LOGGING_USE_STDOUT": "0",
        "PYTHONUNBUFFERED": "1",
    }


def bare_node(name: str, context: rclpy.Context) -> Node:
    """Return a node with nothing of its own, neither log topic nor services."""
    plain = [rclpy.parameter.Parameter("start_type_description_service", value=False)]
    return Node(name, context=context, enable_rosout=False, start_parameter_services=False, parameter_overrides=plain)


class Process:
    """A process in a group of its own, with its output in files."""

    def __init__(self, command: list[str], folder: Path, name: str, domain: int) -> None:
        self.name = name
        self._out, self._err = folder / f"{name}.out", folder / f"{name}.err"
        with self._out.open("wb") as out, self._err.open("wb") as err:
            self.popen = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                env=environment(domain),
                cwd=folder,
                start_new_session=True,
            )

    @property
    def out(self) -> str:
        return self._out.read_text(encoding="utf-8", errors="replace")

    @property
    def err(self) -> str:
        return self._err.read_text(encoding="utf-8", errors="replace")

    def send(self, number: int) -> None:
        self.popen.send_signal(number)

    def wait(self) -> int:
        """Return the exit code."""
        return self.popen.wait(PATIENCE)

    def kill(self) -> None:
        """End the whole group, whatever it does."""
        if self.popen.poll() is None:
            os.killpg(self.popen.pid, signal.SIGKILL)
            self.popen.wait(PATIENCE)


class Rig:
    """Node, simulated arm and whoever else in one ROS domain; `folder` gets logs and, in runs/, the recordings.

    `heard[role]` is the list of all messages received on a topic of HEARD, `arrivals[role]` of when [ns].
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.domain = next_domain()
        self.processes: list[Process] = []
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=self.domain)
        self._listener, self._caller = bare_node("test_listener", self.context), bare_node("test_caller", self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self._caller)
        self._clients: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}
        self._met: set[tuple[str, int, int, int]] = set()  # node and how many clients, publishers, processes there were
        self.heard: dict[str, list[Any]] = {role: [] for role in HEARD}
        self.arrivals: dict[str, list[int]] = {role: [] for role in HEARD}
        self._subscriptions = {
            role: self._listener.create_subscription(kind, topic, lambda _: None, QoSProfile(depth=20_000))
            for role, (kind, topic) in HEARD.items()
        }

    def close(self) -> None:
        """End everything."""
        for process in self.processes:
            process.kill()
        self._executor.shutdown()
        self._listener.destroy_node()
        self._caller.destroy_node()
        rclpy.shutdown(context=self.context)

    # -- processes

    def start(self, name: str, command: list[str]) -> Process:
        process = Process(command, self.folder, f"{len(self.processes)}_{name}", self.domain)
        self.processes.append(process)
        return process

    def start_sim(self, *arguments: str) -> Process:
        return self.start("sim", [*CLI, "sim", *arguments])

    def start_node(self, *arguments: str, **parameters: Any) -> Process:
        """Start the node with parameters and further ROS arguments."""
        settings = {"record_folder": str(self.folder / "runs"), **parameters}
        given = [part for name, value in settings.items() for part in ("-p", f"{name}:={value}")]
        return self.start("node", [*NODE, "--ros-args", *given, *arguments])

    def run_cli(self, *arguments: str) -> Process:
        """Run a verb to its end."""
        process = self.start(arguments[0], [*CLI, *arguments])
        self.until(lambda: process.popen.poll() is not None, f"{arguments[0]} to end")
        return process

    def bags(self) -> list[Path]:
        """Return the recorded bags in the order they were made."""
        folder = self.folder / "runs"
        return sorted(folder.iterdir()) if folder.exists() else []

    # -- listening

    def hear(self, role: str, kind: Any, topic: str) -> None:
        """Listen to one more topic, as `heard[role]`."""
        self.heard[role], self.arrivals[role] = [], []
        self._subscriptions[role] = self._listener.create_subscription(
            kind, topic, lambda _: None, QoSProfile(depth=20_000)
        )

    def ignore(self, *roles: str) -> None:
        """Listen to these no more: a long run's messages are many."""
        for role in roles:
            self._listener.destroy_subscription(self._subscriptions.pop(role))

    def listen(self) -> None:
        """Take what has arrived; not all at once where it comes faster than it can be taken."""
        for role, subscription in self._subscriptions.items():
            with subscription.handle:
                for _ in range(_AT_ONCE):
                    taken = subscription.handle.take_message(subscription.msg_type, False)
                    if taken is None:
                        break
                    self.heard[role].append(taken[0])
                    self.arrivals[role].append(time.time_ns())

    def until(self, condition: Callable[[], Any], what: str = "", patience: float = PATIENCE) -> Any:
        """Listen until a condition holds and return its value; fail at the deadline, with the processes' words."""
        by = time.monotonic() + patience
        while True:
            self.listen()
            value = condition()
            if value:
                self.listen()  # what was sent before this on other topics
                return value
            if time.monotonic() > by:
                said = "\n".join(f"[{p.name}: {p.popen.poll()}] {p.err[-1500:]}" for p in self.processes)
                status = self.heard["status"][-1].message if self.heard["status"] else "no status"
                raise AssertionError(f"waited in vain for {what or condition}; status: {status}\n{said}")
            time.sleep(0.01)

    def until_new(self, role: str, condition: Callable[[Any], Any], what: str = "") -> Any:
        """Listen until a message of this role that has not come yet meets the condition; return it."""
        self.listen()
        begin = len(self.heard[role])
        return self.until(
            lambda: next((m for m in self.heard[role][begin:] if condition(m)), None), what or f"a {role} message"
        )

    def until_status(self, text: str) -> Any:
        """Listen until a new ~/status says so; return it."""
        return self.until_new("status", lambda status: text in status.message, f"the status '{text}'")

    def until_commanding(self) -> None:
        """Listen until the node commands."""
        self.until(lambda: self.heard["joint_commands"], "joint_commands")

    # -- sending and calling

    def publisher(self, role: str) -> Any:
        """Return a publisher of a role of SENT; what is sent to the node is heard."""
        if role not in self._publishers:
            kind, topic = SENT[role]
            publisher = self._publishers[role] = self._listener.create_publisher(kind, topic, 100)
            ourselves = role in HEARD
            self.until(lambda: publisher.get_subscription_count() > ourselves, f"a listener on {role}")
        if role != "joint_commands":  # the simulated arm answers nobody
            self._meet("/ik_controller")
        return self._publishers[role]

    def until_known(self, node: str) -> None:
        """Listen until a node's process has found everything made here so far.

        It may find us later than we find it: until then what we send to it is lost, and so are its answers. What one
        process makes is announced in order; so one answer to a client made last proves it of all made before.
        """
        client = self._caller.create_client(GetParameters, f"{node}/get_parameters")

        def answered() -> bool:
            future = client.call_async(GetParameters.Request())
            by = time.monotonic() + 1.0
            while not future.done() and time.monotonic() < by:
                self._executor.spin_once(timeout_sec=0.01)
                self.listen()
            return future.done()

        try:
            self.until(client.service_is_ready, f"{node} to serve")
            self.until(answered, f"{node} to find this process")
        finally:
            self._caller.destroy_client(client)

    def _meet(self, node: str) -> None:
        meeting = (node, len(self._clients), len(self._publishers), len(self.processes))
        if meeting not in self._met:
            self.until_known(node)
            self._met.add(meeting)

    @contextmanager
    def sending(self, role: str, message: Any, every: float = 0.01) -> Iterator[None]:
        """Send a message, or what a function returns, every so many seconds until the block ends."""
        publisher = self.publisher(role)
        ended = threading.Event()

        def send() -> None:
            while not ended.wait(every):
                publisher.publish(message() if callable(message) else message)

        sender = threading.Thread(target=send)
        sender.start()
        try:
            yield
        finally:
            ended.set()
            sender.join()

    def call(self, service: str, data: bool | None = None) -> Any:
        """Call one of the node's services and return the response."""
        kind = SERVICES[service]
        return self.request(
            f"/ik_controller/{service}", kind, kind.Request() if data is None else kind.Request(data=data)
        )

    def set_parameters(self, **values: Any) -> SetParametersResult:
        """Set parameters in one go and return the result."""
        parameters = [rclpy.parameter.Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        return self.request("/ik_controller/set_parameters_atomically", SetParametersAtomically, request).result

    def change_state(self, transition: str, node: str = "/ik_controller") -> bool:
        """Ask for a lifecycle transition and return whether it was made."""
        request = ChangeState.Request(transition=Transition(label=transition))
        return bool(self.request(f"{node}/change_state", ChangeState, request).success)

    def state(self, node: str = "/ik_controller") -> str:
        """Return the node's lifecycle state."""
        return str(self.request(f"{node}/get_state", GetState, GetState.Request()).current_state.label)

    def get_parameter(self, name: str, node: str = "/ik_controller") -> Any:
        request = GetParameters.Request(names=[name])
        response = self.request(f"{node}/get_parameters", GetParameters, request)
        return parameter_value_to_python(response.values[0])

    def request(self, name: str, kind: Any, request: Any, node: str = "") -> Any:
        """Call a service of a node, `<node>/...` where it is not said, and return its response."""
        if name not in self._clients:
            self._clients[name] = self._caller.create_client(kind, name)
        client = self._clients[name]
        self.until(client.service_is_ready, f"the service {name}")
        self._meet(node or name.rpartition("/")[0])
        asked: list[Any] = []
        again = 0.0

        def answer() -> Any:
            nonlocal again
            # On a machine that is held up for seconds, an answer may be lost.
            if time.monotonic() > again:
                again = time.monotonic() + _AGAIN
                asked.append(client.call_async(request))
            self._executor.spin_once(timeout_sec=0.01)
            return next((future for future in asked if future.done()), None)

        return self.until(answer, f"an answer of {name}").result()


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return a status' key-value pairs."""
    return {pair.key: pair.value for pair in status.values}
