"""A simulated arm and its node as processes beside this one, for the verbs that need an arm to show something."""

from __future__ import annotations

import argparse
import os
import random
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from ik_controller.errors import IkControllerError

PATIENCE = 30.0  # [s] for a process to start or end
_PARTICIPANTS = 20  # of a domain, whose ports are looked at


def is_quiet(domain: int) -> bool:
    """Tell whether no process on this host takes part in a ROS domain: each would listen on two of its UDP ports, where
    RTPS 2.5, 9.6.2.3 has them.
    """
    first = 7400 + 250 * domain + 10
    for port in range(first, first + 2 * _PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
            try:
                listener.bind(("", port))
            except OSError:
                return False
    return True


def private_graph() -> dict[str, str]:
    """Return an environment alone on this host in a ROS domain that nobody uses here, unless the user says otherwise:
    what is simulated must not move a real arm.
    """
    domains = random.SystemRandom().sample(range(1, 101), 100)
    environment = dict(os.environ)
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    environment.setdefault("ROS_DOMAIN_ID", str(next(filter(is_quiet, domains), domains[0])))
    environment.setdefault("RCUTILS_LOGGING_USE_STDOUT", "0")
    return environment


class Processes:
    """Processes in one environment with one log file; `close` ends them all."""

    def __init__(self, log: Path, environment: dict[str, str]) -> None:
        self.log = log
        self._environment = environment
        self._sink = log.open("wb")
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, command: list[str]) -> None:
        """Start `python -m` with a command."""
        self._running[name] = subprocess.Popen(
            [sys.executable, "-m", *command],
            stdout=self._sink,
            stderr=self._sink,
            stdin=subprocess.DEVNULL,
            env=self._environment,
        )

    def poll(self, name: str) -> int | None:
        """Return a process' exit code, None while it runs."""
        return self._running[name].poll()

    def check(self, *names: str) -> None:
        """Raise IkControllerError where one of these has ended."""
        for name in names:
            if self.poll(name) is not None:
                raise IkControllerError(f"the {name} process ended early: {self.last_line()} (all of it: {self.log})")

    def end(self, *names: str) -> None:
        """Ask processes to end, as Ctrl-C does, and wait. Raises IkControllerError where one fails."""
        for name in names:
            process = self._running[name]
            process.send_signal(signal.SIGINT)
            if process.wait(PATIENCE) != 0:
                raise IkControllerError(f"the {name} process failed: {self.last_line()} (all of it: {self.log})")

    def close(self) -> None:
        """Kill what still runs."""
        for process in self._running.values():
            if process.poll() is None:
                process.kill()
                process.wait()
        self._sink.close()

    def last_line(self) -> str:
        """Return the last thing that was said."""
        text = self.log.read_text(encoding="utf-8", errors="replace")
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return lines[-1] if lines else "it said nothing"


def start_arm(processes: Processes, arguments: argparse.Namespace, settings: Mapping[str, object]) -> None:
    """Start the processes "sim" and "node" for the robot of `add_model_arguments`; `settings`: further parameters."""
    robot = [
        part
        for name in ("robot", "urdf", "tip", "base")
        if (value := getattr(arguments, name))
        for part in (f"--{name}", str(value))
    ]
    given: dict[str, object] = {
        "robot": arguments.robot or ("" if arguments.urdf else arguments.default_robot),
        "urdf": arguments.urdf,
        "tip_frame": arguments.tip,
        "base_frame": arguments.base,
        **settings,
    }
    listed = [
        part for name, value in given.items() if value not in (None, "") for part in ("-p", f"{name}:={_yaml(value)}")
    ]
    processes.start("sim", ["ik_controller.cli", "sim", *robot])
    processes.start("node", ["ik_controller.ros", "--ros-args", *listed])


def _yaml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
