"""SIGINT and SIGTERM, twice as under a launch file: every process of ours ends with exit code 0 and no traceback."""

from __future__ import annotations

import itertools
import json
import signal
from pathlib import Path

import pytest
from rig import CLI, NODE, Process, Rig, figure_bag

NUMBERS = (signal.SIGINT, signal.SIGTERM)
JOY = ("teleop", "--joy", "gamepad", "--node", "/ik_controller")


def end(process: Process, number: int) -> None:
    """Signal twice, the second time while it is ending, and look at what is left."""
    process.send(number)
    process.send(number)
    assert process.wait() == 0, process.err
    assert "Traceback" not in process.err


def test_while_it_runs(rig: Rig) -> None:
    figure_bag(rig.folder / "targets", 1.0)
    sim, node = rig.start_sim("--rate", "200"), rig.start_node(robot="panda", rate=200.0)
    rig.until_status("holding")
    stream = rig.start("stream", [*CLI, "stream", "targets", "--loop"])
    view = rig.start("view", [*CLI, "view", "--port", "0", "--json"])
    teleop = rig.start("teleop", [*CLI, *JOY])
    rig.until_status("tracking")
    rig.until(lambda: view.out and json.loads(view.out)["url"], "the live page")
    rig.until(lambda: "teleop" in rig._listener.get_node_names(), "teleop")
    for process, number in zip((stream, teleop, view, node, sim), itertools.cycle(NUMBERS), strict=False):
        end(process, number)
    (bag,) = rig.bags()
    assert (bag / "metadata.yaml").exists()


@pytest.mark.parametrize("number", NUMBERS)
def test_while_it_comes_up(rig: Rig, number: int) -> None:
    """As soon as a process has taken the signals over, which is before it imports anything large."""
    commands = [NODE, [*CLI, "sim"], [*CLI, "stream", "targets"], [*CLI, "view", "--port", "0"], [*CLI, *JOY]]
    for command in commands:
        process = rig.start("early", command)
        rig.until(lambda p=process: catches_sigterm(p) or p.popen.poll() is not None, "the process to take signals")
        end(process, number)


def catches_sigterm(process: Process) -> bool:
    """Has it a handler for SIGTERM? Python by itself has one for SIGINT alone."""
    lines = Path(f"/proc/{process.popen.pid}/status").read_text(encoding="ascii").splitlines()
    caught = next(line.split()[1] for line in lines if line.startswith("SigCgt"))
    return bool(int(caught, 16) >> (signal.SIGTERM - 1) & 1)
