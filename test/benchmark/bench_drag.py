"""How long the arm takes to follow a hand: from the mouse in the browser to the node's first command that moves.

    python test/benchmark/bench_drag.py [--drags 8]

Runs what `make view` runs: a simulated arm, its node at 1 kHz and the live page, in headless Chromium, which drags the
target by its arrow. Each drag begins from rest. The times are from the browser's own pointer event to the stamp of the
first target_pose that has moved, as the node recorded it, and to the cycle that made the first joint_commands that
move: they hold the browser's frame (drawn by its processor, so it is slower than a desktop's), its websocket, the
page's process, DDS and the wait for the node's next cycle; not the mouse's and the screen's own delays.
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
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from browser import Watched, browser

from ik_controller.messages import cdr
from ik_controller.recording.reader import open_bag
from ik_controller.recording.run import RunInfo
from ik_controller.robots import build_model, bundled_parameters

# Pointer events of drags, on the clock that all processes of this machine share.
EVENTS = """window.drags = [];
addEventListener('pointermove', (e) => {
  if (e.buttons & 1) window.drags.push(performance.timeOrigin + e.timeStamp);
}, true);"""
WIDTH, HEIGHT = 900, 600  # of the page [pixels]
VIEW_FROM, LOOK_AT = np.array((1.25, -1.05, 0.95)), np.array((0.15, 0.05, 0.35))  # the page's first view
FIELD = math.radians(75.0)
MOVED = 1e-3  # [m] of a target that has moved
MOVES = 0.02  # [rad/s] of a joint that moves; holding a target is slower
REST = 3.0  # [s] from letting go to the next drag: the target is sent for 2 s more


def pixel(point: np.ndarray) -> np.ndarray:
    """Return where a point of the scene is in the page's first view."""
    ahead = (LOOK_AT - VIEW_FROM) / np.linalg.norm(LOOK_AT - VIEW_FROM)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    x, y, z = (float(axis @ (point - VIEW_FROM)) for axis in (right, down, ahead))
    scale = 0.5 * HEIGHT / math.tan(0.5 * FIELD)
    return np.array((0.5 * WIDTH + scale * x / z, 0.5 * HEIGHT + scale * y / z))


def drag(page: Any, grip: np.ndarray, way: np.ndarray) -> list[float]:
    """Press at a point, move, let go; return when the page's pointer moved [ms]."""
    page.evaluate("window.drags = []")
    page.mouse.move(*grip)
    page.wait_for_timeout(500)  # until the arrow knows that the pointer is on it
    page.mouse.down()
    page.wait_for_timeout(500)
    for part in (0.5, 1.0):
        page.mouse.move(*(grip + part * way))
        page.wait_for_timeout(300)
    page.mouse.up()
    return list(page.evaluate("window.drags"))


def main() -> None:
    """Drag and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drags", type=int, default=8)
    arguments = parser.parse_args()
    began = []
    parameters = bundled_parameters("panda")
    tool = build_model(parameters).forward(np.array(parameters.posture))
    grip = pixel(tool.translation)
    along = pixel(tool.translation + 0.1 * tool.rotation[:, 2]) - grip
    along /= np.linalg.norm(along)
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "ik_controller.cli", "view", "--sim", "--port", "0", "--json"]
        process = subprocess.Popen(
            [*command, "--output", folder], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=dict(os.environ)
        )
        try:
            assert process.stdout is not None
            url = json.loads(process.stdout.readline())["url"]
            with browser() as chromium:
                page = Watched(chromium, viewport={"width": WIDTH, "height": HEIGHT}).page
                page.add_init_script(EVENTS)
                page.goto(url)
                page.get_by_text("holding").first.wait_for(timeout=240_000.0)  # a node that compiles first takes long
                time.sleep(3.0)  # until the arm is drawn
                for k in range(arguments.drags):
                    sign = -1.0 if k % 2 else 1.0
                    began.append(drag(page, grip + 45.0 * along, sign * 16.0 * along))
                    grip = grip + sign * 16.0 * along  # the arm, and the arrows with it, will be there
                    time.sleep(REST)
        finally:  # not killed, so that its arm and its node end with it
            process.send_signal(signal.SIGINT)
            process.wait(60.0)
        (run,) = (path for path in Path(folder).iterdir() if path.is_dir())
        poses, moving = recorded(run)
    to_target, to_command = [], []
    for events, after in zip(began, [*(events[0] for events in began[1:] if events), math.inf], strict=False):
        if not events:
            continue
        first = events[0] * 1e6
        told = next(
            (at for at, moved in zip(poses[0], poses[1], strict=True) if first < at < 1e6 * after and moved), None
        )
        follows = next((at for at in moving if first < at < 1e6 * after), None)
        if told is not None and follows is not None:
            to_target.append(1e-6 * (told - first))
            to_command.append(1e-6 * (follows - first))
    print(f"{len(to_command)} of {arguments.drags} drags gripped the target and moved the arm")
    for name, times in (("target_pose", to_target), ("joint_commands", to_command)):
        print(f"pointer event → {name}: median {statistics.median(times):.0f} ms, at most {max(times):.0f} ms")


def recorded(run: Path) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Return (when targets came, whether they differ from the one at rest), and the cycles [ns] whose commands move
    after a rest.
    """
    bag = open_bag(run)
    info = RunInfo.of(bag)
    assert info is not None
    times, places = [], []
    for message in bag.messages([info.topics["target_pose"]]):
        place = cdr.decode(cdr.POSE, message.data).pose.position
        times.append(message.log_time_ns)
        places.append((place.x, place.y, place.z))
    assert times, "no drag gripped the target"
    at, where = np.array(times, dtype=np.int64), np.array(places)
    new = np.flatnonzero(np.diff(at, prepend=0) > 5e8)  # the first targets of drags
    start = np.repeat(new, np.diff(np.append(new, len(at))))
    cycles, speeds = [], []
    for message in bag.messages([info.topics["joint_commands"]]):
        cycles.append(message.log_time_ns)
        speeds.append(max(map(abs, cdr.decode(cdr.JOINT_STATE, message.data).velocity)))
    return (at, np.linalg.norm(where - where[start], axis=1) > MOVED), np.array(cycles)[np.array(speeds) > MOVES]


if __name__ == "__main__":
    main()
