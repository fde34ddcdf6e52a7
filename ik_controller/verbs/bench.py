"""`ik_controller bench`: what a step, a replayed cycle and the node cost, each as a ratio to something timed beside
it.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ik_controller.errors import IkControllerError
from ik_controller.verbs.common import add_json_argument, print_json, print_table
from ik_controller.verbs.processes import private_graph

HELP = "measure step, replay and node, each beside a yardstick on this machine"

_BATCH = 20  # calls between two looks at the clock
_ROUNDS = 150
_WINDOWS = 5
_PATIENCE = 60.0  # [s] for the node to start
_GROWTH = 10_000  # bytes in half a second
_TICKS = os.sysconf("SC_CLK_TCK")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("--no-ros", action="store_true", help="leave out what needs processes over DDS")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="length of the node's run (10)")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Measure and print the rows."""
    rows = [*_steps(), *_replay()]
    if not arguments.no_ros:
        rows += [*_node(arguments.seconds), *_recording()]
    if arguments.json:
        print_json(rows)
        return 0
    table = [(r["name"], _number(r["median_us"]), _number(r["p99_us"]), f"{r['ratio']:.3f}", r["beside"]) for r in rows]
    print_table(table, ("name", "median µs", "p99 µs", "ratio", "beside"))
    return 0


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"


def _row(name: str, ours: list[float], theirs: list[float], beside: str) -> dict[str, Any]:
    ratios = [a / b for a, b in zip(ours, theirs, strict=True)]
    high = sorted(ours)[int(0.99 * (len(ours) - 1))]
    return {
        "name": name,
        "median_us": statistics.median(ours),
        "p99_us": high,
        "ratio": statistics.median(ratios),
        "beside": beside,
    }


def _side_by_side(ours: Callable[[], object], theirs: Callable[[], object]) -> tuple[list[float], list[float]]:
    """Return [µs] a call of both, in batches that take turns, so that a slow moment of the machine hits both."""
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(_ROUNDS):
        for function, found in zip((ours, theirs), times, strict=True):
            start = time.perf_counter()
            for _ in range(_BATCH):
                function()
            found.append((time.perf_counter() - start) / _BATCH * 1e6)
    return times


def _steps() -> list[dict[str, Any]]:
    """Time one step on the 7-joint arm beside the step of a textbook in NumPy."""
    import numpy as np
    import pinocchio as pin

    from ik_controller import Controller, Reference
    from ik_controller.kinematics.collision_world import box, half_space
    from ik_controller.robots import build_model, bundled_parameters

    parameters = bundled_parameters("panda")
    model = build_model(parameters)
    posture = np.array(parameters.posture)
    start = model.forward(posture)
    dt = 1e-3

    def figure(k: int) -> Any:
        phase = k * dt
        turn = pin.exp3(np.array((0.2 * np.sin(phase), 0.0, 0.0)))
        offset = np.array((0.0, 0.15 * np.sin(phase), 0.07 * np.sin(2.0 * phase)))
        return pin.SE3(turn @ start.rotation, start.translation + offset)

    count = 2 * _BATCH * _ROUNDS
    references = [Reference.between(figure(k), figure(k + 1), dt) for k in range(count)]
    poses = [figure(k) for k in range(count)]
    twists = [np.asarray(reference.twist) for reference in references]
    data = model.pin_model.createData()

    def stepper(controller: Controller) -> Callable[[], object]:
        controller.reset(posture)
        upcoming = iter(references * 2)

        def step() -> object:
            return controller.step(controller.position, next(upcoming), dt)

        return step

    def textbook() -> Callable[[], object]:
        q = posture
        upcoming = iter(zip(twists * 4, poses * 4, strict=True))

        def step() -> None:
            nonlocal q
            twist, pose = next(upcoming)
            pin.computeJointJacobians(model.pin_model, data, q)
            pin.updateFramePlacement(model.pin_model, data, model.tool_id)
            jacobian = pin.getFrameJacobian(model.pin_model, data, model.tool_id, pin.LOCAL_WORLD_ALIGNED)
            tool = data.oMf[model.tool_id]
            turn = pin.log3(pose.rotation @ tool.rotation.T)
            error = np.concatenate((pose.translation - tool.translation, turn))
            inverse = np.linalg.pinv(jacobian)
            null = (np.eye(model.n) - inverse @ jacobian) @ (posture - q)
            velocity = inverse @ (twist + 50.0 * error) + null
            velocity = np.clip(velocity, -model.velocity_limit, model.velocity_limit)
            q = np.clip(q + dt * velocity, model.lower, model.upper)

        return step

    slow = parameters.replace({"velocity_scale": 0.02})
    tool = parameters.replace({"tool_linear_speed": 1.7, "tool_linear_acceleration": 13.0})
    endless = [1e9] * model.n
    free = build_model(parameters)
    free.set_limits(velocity=endless, acceleration=endless, lower=[-1e9] * model.n, upper=endless)
    watched = parameters.replace({"self_collision": True, "obstacle_avoidance": True})
    pressed = Controller(model, watched)
    # The figure-eight runs through it; the others are the room.
    place = pin.SE3(np.eye(3), start.translation + np.array([0.0, 0.12, -0.06]))
    pressed.scene.world.put("box", box(0.3, 0.3, 0.1).at(place))
    pressed.scene.world.put("floor", half_space(np.array([0.0, 0.0, 1.0]), 0.0))
    pressed.scene.world.put("wall", box(0.02, 2.0, 1.0).at(pin.SE3(np.eye(3), np.array([0.75, 0.0, 0.5]))))
    rows = []
    for name, controller in (
        ("step, bare", Controller(free, parameters.replace({"posture": ()}))),
        ("step, limits idle", Controller(model, parameters)),
        ("step, limits saturated", Controller(model, slow)),
        ("step, tool bounds idle", Controller(model, tool)),
        ("step, self-collision watched", Controller(model, parameters.replace({"self_collision": True}))),
        ("step, pressed on an obstacle", pressed),
    ):
        ours, theirs = stepper(controller), textbook()
        for _ in range(200):
            ours(), theirs()
        rows.append(_row(name, *_side_by_side(ours, theirs), "textbook NumPy step"))
    stack = {
        "task_axes": "xyzrp",
        "task_frame": "tool",
        "secondary_tasks": ["z panda_link4"],
        "secondary_targets": [0.6],
        "objectives": ["joint_centring"],
    }
    ours, plain = stepper(Controller(model, parameters.replace(stack))), stepper(Controller(model, parameters))
    for _ in range(200):
        ours(), plain()
    rows.append(_row("step, priorities", *_side_by_side(ours, plain), "step, limits idle"))
    return rows


def _replay() -> list[dict[str, Any]]:
    """Time the replay of a run of the ideal arm at 1 kHz."""
    from ik_controller.recording.reader import open_bag
    from ik_controller.recording.replay import replay
    from ik_controller.robots import bundled_parameters

    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "run"
        replay(open_bag(_targets()), robot=bundled_parameters("panda"), output=bag)
        return [_replay_of(bag, "replay, a cycle")]


def _replay_of(bag: Path, name: str) -> dict[str, Any]:
    """Time the replay of a 1 kHz run a cycle; the ratio is to real time, its inverse the speed."""
    from ik_controller.recording.reader import open_bag
    from ik_controller.recording.replay import replay

    results = [replay(open_bag(bag)) for _ in range(5)]
    times = [result.elapsed / result.cycles * 1e6 for result in results]
    return _row(name, times, [1000.0] * len(times), "1 kHz real time")


class Graph:
    """Processes over DDS, alone on this host, all ended with the `with` block."""

    def __init__(self, commands: dict[str, list[str]]) -> None:
        self._environment = private_graph()
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        for name, command in commands.items():
            self.start(name, command)

    def start(self, name: str, command: list[str]) -> subprocess.Popen[bytes]:
        """Start `python -m` with a command."""
        self.processes[name] = subprocess.Popen(
            [sys.executable, "-m", *command],
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            stdin=subprocess.DEVNULL,
        )
        return self.processes[name]

    def end(self, name: str) -> bytes:
        """Ask a process to end; return what it said."""
        self.processes[name].send_signal(signal.SIGTERM)
        return self.processes[name].communicate(timeout=30.0)[0]

    def processor_time(self, name: str) -> float:
        """Return the user and system time [s] of a process, threads included."""
        fields = Path(f"/proc/{self.processes[name].pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS

    def __enter__(self) -> Graph:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self.processes.values():
            if process.poll() is None:
                process.kill()
            process.communicate()


def run_of_node(folder: str, record: bool) -> dict[str, list[str]]:
    """Return the commands of a node at 1 kHz, its simulated arm, and who sends it targets."""
    settings = ["-p", "robot:=panda", "-p", f"record_folder:={folder}", "-p", f"record:={str(record).lower()}"]
    return {
        "sim": ["ik_controller.cli", "sim"],
        "node": ["ik_controller.ros", "--ros-args", *settings],
        "stream": ["ik_controller.cli", "stream", str(_targets()), "--loop", "--patience", "30"],
    }


def _node(seconds: float) -> list[dict[str, Any]]:
    """Run sim, node, relay and sleep loop at once; compare processor time and the period's 99th percentile."""
    with tempfile.TemporaryDirectory() as folder:
        beside = {name: ["ik_controller.ros.baseline", name] for name in ("relay", "listen", "sleep")}
        with Graph({**run_of_node(folder, record=True), **beside}) as graph:
            bag = _recording_in(Path(folder))
            time.sleep(4.0)  # until the others have started and found each other too
            shares = []
            for _ in range(_WINDOWS):  # the machine's speed drifts: the ratio is taken window by window
                before = {name: graph.processor_time(name) for name in graph.processes}
                time.sleep(seconds / _WINDOWS)
                shares.append({name: graph.processor_time(name) - before[name] for name in graph.processes})
            outputs = {name: graph.end(name) for name in ("stream", "node", "relay", "listen", "sleep", "sim")}
        node_p99 = _node_period(bag, seconds)
        again = _replay_of(bag, "replay of that run, a cycle")
    sleep_p99 = json.loads(outputs["sleep"])["period_p99_us"]
    cycles = seconds / _WINDOWS * 1000.0
    relay = statistics.median(share["relay"] for share in shares)
    return [
        {
            "name": "node with recording, processor time a cycle",
            "median_us": statistics.median(share["node"] for share in shares) / cycles * 1e6,
            "p99_us": None,
            "ratio": statistics.median(share["node"] / share["relay"] for share in shares),
            "beside": f"bare polled relay ({relay / cycles * 1e6:.0f} µs)",
        },
        {
            "name": "node's period",
            "median_us": 1000.0,
            "p99_us": node_p99,
            "ratio": node_p99 / sleep_p99,
            "beside": f"p99 of a bare sleep loop ({sleep_p99:.0f} µs)",
        },
        again,
    ]


def _recording() -> list[dict[str, Any]]:
    """Switch a node's recording on and off in turns; compare processor time and the period's 99th percentile."""
    shares: dict[str, list[float]] = {"on": [], "off": []}
    periods: dict[str, list[float]] = {"on": [], "off": []}
    with tempfile.TemporaryDirectory() as folder, Graph(run_of_node(folder, record=False)) as graph:
        said = graph.start("switch", ["ik_controller.ros.baseline", "switch", str(_WINDOWS)]).stdout
        assert said is not None
        while state := said.readline().decode().strip():
            before, start = graph.processor_time("node"), time.monotonic()
            told = json.loads(said.readline() or "[]")
            shares[state].append((graph.processor_time("node") - before) / (time.monotonic() - start))
            periods[state].append(statistics.median(told or [math.nan]))
        for name in ("stream", "node", "sim"):
            graph.end(name)
    if len(shares["off"]) < _WINDOWS:
        raise IkControllerError("the node's recording could not be switched: is rclpy installed?")
    cost = statistics.median(on - off for on, off in zip(shares["on"], shares["off"], strict=True))
    p99_on, p99_off = statistics.median(periods["on"]), statistics.median(periods["off"])
    return [
        {
            "name": "recording, processor time a cycle",
            "median_us": 1e3 * cost,
            "p99_us": None,
            "ratio": cost,
            "beside": "one core; the same node without recording takes "
            f"{1e3 * statistics.median(shares['off']):.0f} µs a cycle",
        },
        {
            "name": "recording node's period",
            "median_us": 1000.0,
            "p99_us": p99_on,
            "ratio": statistics.median(on / off for on, off in zip(periods["on"], periods["off"], strict=True)),
            "beside": f"p99 of the same node without recording ({p99_off:.0f} µs)",
        },
    ]


def _targets() -> Path:
    from ik_controller.share import bag_folder

    return bag_folder("panda_figure_eight")


def _recording_in(folder: Path) -> Path:
    """Return the bag in a folder, once it grows as fast as it does with a record of each cycle."""
    deadline, before = time.monotonic() + _PATIENCE, math.inf
    while time.monotonic() < deadline:
        files = list(folder.rglob("*.mcap"))
        size = sum(file.stat().st_size for file in files)
        if size - before > _GROWTH:
            return files[0].parent
        before = size
        time.sleep(0.5)
    raise IkControllerError(f"the node recorded nothing in {_PATIENCE:.0f} s: is rclpy installed?")


def _node_period(path: Path, seconds: float) -> float:
    """Return the 99th percentile [µs] of the node's period over the last `seconds` of its bag."""
    import numpy as np

    from ik_controller.messages.cdr import decode_cycle
    from ik_controller.recording.reader import open_bag
    from ik_controller.recording.run import RunInfo

    bag = open_bag(path)
    info = RunInfo.of(bag)
    if info is None:
        raise IkControllerError(f"bag '{path}' holds no run")
    records = [decode_cycle(message.data) for message in bag.messages([info.topics["cycle"]])]
    starts = np.array([record[1] + record[3] for record in records[-int(1000.0 * seconds) :]])
    return float(np.percentile(np.diff(starts), 99) * 1e-3)
