"""Time one step of differential inverse kinematics beside other libraries: the same arm, targets and limits.

Each runs in a process and an environment of its own, and they take turns batch by batch, so that a slow moment of the
machine hits all. Then the held joint: a straight line that stays feasible with joint 1 kept at its start by its bound.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from environments import HERE, bare_urdf, environment
from step_common import CASES

from ik_controller.kinematics.collision import arm_collision, pair_distances
from ik_controller.robots import build_model, bundled_parameters
from ik_controller.share import robot_folder

# name in the table → (script here, its argument, without Numba?, what to install)
OURS = {
    "ik_controller, the law": ("step_ours.py", "kernel", False),
    "ik_controller, the step": ("step_ours.py", "step", False),
    "the law, plain NumPy": ("step_ours.py", "kernel", True),
    "the step, plain NumPy": ("step_ours.py", "step", True),
}
PEERS = {
    "Pink": ("step_pink.py", ["pin-pink==4.4.0", "daqp==0.11.0"]),
    "mink": ("step_mink.py", ["mink==1.3.0", "daqp==0.11.0"]),
    "PlaCo": ("step_placo.py", ["placo==0.10.2"]),
    "TSID": ("step_tsid.py", ["tsid==1.7.1", "pin==3.4.0", "cmeel-urdfdom<5", "cmeel-tinyxml2<11"]),
}
BATCH, ROUNDS = 50, 40
DT, SLOW, HEIGHT = 1e-3, 0.02, 0.6
LINE_TIME, LENGTH = 2.0, 0.15  # [s], [m]
HELD = 0


class Runner:
    """A process that steps when told; `fault` says why it does not."""

    def __init__(self, command: list[str], plain: bool = False) -> None:
        self.fault = ""
        variables = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        if plain:
            variables["NUMBA_DISABLE_JIT"] = "1"
        self._process = subprocess.Popen(
            command, env=variables, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )

    def ask(self, case: str, value: int | str) -> Any:
        """Return the answer: µs a step, or a text why there is none."""
        if self.fault:
            return self.fault
        try:
            self._process.stdin.write(json.dumps([case, value]) + "\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
            while answer and not answer.startswith(("null", '"', *"0123456789")):
                answer = self._process.stdout.readline()  # what libraries say on standard output
            if answer:
                return json.loads(answer)
        except BrokenPipeError:
            pass
        last = [line for line in self._process.stderr.read().splitlines() if line.strip()][-1:]
        self.fault = f"fails: {''.join(last)[:80]}"
        return self.fault

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.communicate(timeout=30.0)


def task(folder: Path) -> dict[str, Any]:
    """Return what all are given: the figure of `make bench`, limits, the line, and three URDF files."""
    parameters = bundled_parameters("panda")
    model = build_model(parameters)
    source = robot_folder("panda") / "robot.urdf"
    posture = np.array(parameters.posture)
    start = model.forward(posture)

    def figure(k: int) -> np.ndarray:
        turn = pin.exp3(np.array((0.2 * np.sin(k * DT), 0.0, 0.0)))
        offset = np.array((0.0, 0.15 * np.sin(k * DT), 0.07 * np.sin(2.0 * k * DT)))
        return pin.SE3(turn @ start.rotation, start.translation + offset).homogeneous

    def line(k: int) -> np.ndarray:
        s = min(k * DT / LINE_TIME, 1.0)
        way = LENGTH * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)  # at rest at both ends
        return pin.SE3(start.rotation, start.translation + np.array((0.0, way, 0.0))).homogeneous

    arm = arm_collision(model, posture, folder=source.parent, minimum=parameters.self_minimum_distance)
    # Links that no peer can take for touching to begin with.
    distances = pair_distances(model, arm, arm.pairs, posture)
    near = {(arm.links[a], arm.links[b]) for (a, b), d in zip(arm.pairs.tolist(), distances, strict=True) if d < 0.06}
    pairs = sorted({(arm.links[a], arm.links[b]) for a, b in arm.pairs.tolist()} - near)
    names = list(model.joint_names)
    urdf, held, shapes = bare_urdf(source, folder), folder / "held.urdf", folder / "shapes.urdf"
    tree = ElementTree.parse(urdf)
    for joint in tree.getroot().iter("joint"):
        if joint.get("name") == names[HELD]:
            joint.find("limit").set("upper", repr(float(posture[HELD])))
    tree.write(held)
    tree = ElementTree.parse(source)
    for link in tree.getroot().findall("link"):
        for looks in link.findall("visual"):
            link.remove(looks)
    tree.write(shapes)
    return {
        "urdf": str(urdf),
        "urdf_held": str(held),
        "urdf_shapes": str(shapes),
        "tip": model.tip_frame,
        "names": np.array(names),
        "pairs": np.array(pairs),
        "start": posture,
        "line_start": posture,
        "posture": posture,
        "poses": np.array([figure(k) for k in range(1, BATCH * (ROUNDS + 4))]),
        "line": np.array([line(k) for k in range(1, 2501)]),
        "lower": model.lower,
        "upper": model.upper,
        "velocity": model.velocity_limit,
        "acceleration": model.acceleration_limit,
        "dt": DT,
        "slow": SLOW,
        "height": HEIGHT,
        "held": HELD,
    }


def errors(path: np.ndarray, targets: np.ndarray) -> tuple[float, float, float]:
    """Return largest and root mean square of the position error [m], and the largest orientation error [rad]."""
    model = build_model(bundled_parameters("panda"))
    position, turn = np.empty(len(path)), np.empty(len(path))
    for k, (q, target) in enumerate(zip(path, targets, strict=True)):
        tool = model.forward(q)
        position[k] = np.linalg.norm(target[:3, 3] - tool.translation)
        turn[k] = np.linalg.norm(pin.log3(target[:3, :3] @ tool.rotation.T))
    return position.max(), float(np.sqrt(np.mean(position**2))), turn.max()


def compare_steps(rounds: int = ROUNDS) -> None:
    """Print both tables."""
    pythons = {name: environment(*peer) for name, peer in PEERS.items()}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        given = task(folder)
        np.savez(folder / "task.npz", **given)
        runners: dict[str, Runner | str] = {
            name: Runner([sys.executable, str(HERE / script), str(folder / "task.npz"), what], plain)
            for name, (script, what, plain) in OURS.items()
        }
        for name, python in pythons.items():
            script = str(HERE / PEERS[name][0])
            runners[name] = (
                python if isinstance(python, str) else Runner([str(python), script, str(folder / "task.npz")])
            )
        try:
            print_times(runners, rounds)
            print_held(runners, given, folder)
        finally:
            for runner in runners.values():
                if isinstance(runner, Runner):
                    runner.close()


def print_times(runners: dict[str, Runner | str], rounds: int) -> None:
    """Print the medians of batches that took turns."""
    batches = f"median of {rounds} batches of {BATCH}, taking turns"
    print(f"\none step towards a moving pose, 7-joint arm, µs of CPU time ({batches})")
    print(f"{'':26s}" + "".join(f"{case:>18s}" for case in CASES))
    times: dict[str, dict[str, list[Any]]] = {name: {case: [] for case in CASES} for name in runners}
    for case in CASES:
        for _ in range(rounds + 2):
            for name, runner in runners.items():
                if case == "self-collision" and name in OURS and OURS[name][2]:
                    times[name][case].append(None)  # 10 ms and more: see docs/obstacles.md
                    continue
                times[name][case].append(runner.ask(case, BATCH) if isinstance(runner, Runner) else runner)
    for name, cases in times.items():
        cells = [found[2:] for found in cases.values()]
        text = "".join(f"{statistics.median(c):18.1f}" if isinstance(c[-1], float) else f"{'–':>18s}" for c in cells)
        faults = {c[-1] for c in cells if isinstance(c[-1], str)}
        print(f"{name:26s}{text}  {'; '.join(sorted(faults))}")


def print_held(runners: dict[str, Runner | str], given: dict[str, Any], folder: Path) -> None:
    """Print the errors on the line."""
    print(
        f"\na straight line of {LENGTH} m in {LINE_TIME:.0f} s at {1.0 / DT:.0f} Hz: position error max / RMS, rotation"
    )
    print(f"{'':26s}{'free':>36s}{'one joint held at its bound':>36s}")
    for name, runner in runners.items():
        text = ""
        for case in ("free", "held"):
            file = folder / "path.npy"
            answer = runner.ask(case, str(file)) if isinstance(runner, Runner) else runner
            if answer != 0.0:
                text += f"{answer!s:>36s}"
                continue
            most, mean, turn = errors(np.load(file), given["line"])
            text += f"{f'{most * 1e6:.3g} / {mean * 1e6:.3g} µm, {turn * 1e6:.3g} µrad':>36s}"
        print(f"{name:26s}{text}")


if __name__ == "__main__":
    compare_steps(int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS)
