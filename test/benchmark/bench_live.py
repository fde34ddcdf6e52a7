"""What the live page costs the node: its 1 kHz loop without a page and with one that a browser watches, in turns.

    python test/benchmark/bench_live.py [--rounds 5] [--seconds 8]

The node follows the figure-eight at 1 kHz and records, beside the simulated arm. The page is `ik_controller view`, a
process of its own, ended and started anew each round; the browser is one that receives all that the page sends and
draws nothing: a browser draws on its own machine. Prints the period's 99th percentile [µs] without and with the page,
the median of the rounds' ratios, and what the page's process takes of a core.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from ik_controller.messages.cdr import decode_cycle
from ik_controller.recording.reader import open_bag
from ik_controller.recording.run import RunInfo
from ik_controller.share import bag_folder
from ik_controller.verbs.processes import Processes, private_graph, start_arm

SETTLE = 2.0  # [s] after a process came or went


class Browser:
    """Receives what a page sends; `received` [bytes]."""

    def __init__(self, url: str) -> None:
        self.received = 0
        self._socket = connect(
            url.replace("http", "ws"), subprotocols=[f"viser-v{viser.__version__}"], max_size=None, origin=url
        )
        threading.Thread(target=self._receive, daemon=True).start()

    def _receive(self) -> None:
        try:
            for message in self._socket:
                self.received += len(message)
        except ConnectionClosed:
            pass

    def close(self) -> None:
        self._socket.close()


class Watched:
    """The live page with a browser, while the block lasts; `share` of a core that the page's process takes."""

    def __init__(self, environment: dict[str, str]) -> None:
        command = [sys.executable, "-m", "ik_controller.cli", "view", "--port", "0", "--json"]
        self._process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)

    def __enter__(self) -> Watched:
        assert self._process.stdout is not None
        self._browser = Browser(json.loads(self._process.stdout.readline())["url"])
        by = time.monotonic() + 60.0
        while self._browser.received < 100_000:  # the arm's shapes have come
            assert time.monotonic() < by, "the page shows no arm"
            time.sleep(0.1)
        time.sleep(SETTLE)
        self._begin = time.monotonic(), self._spent(), self._browser.received
        return self

    def share(self) -> tuple[float, float]:
        """Return the share of a core, and what the browser gets [kB/s], since the block began."""
        begin, spent, received = self._begin
        seconds = time.monotonic() - begin
        return (self._spent() - spent) / seconds, 1e-3 * (self._browser.received - received) / seconds

    def _spent(self) -> float:
        fields = Path(f"/proc/{self._process.pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def __exit__(self, *_: object) -> None:
        self._browser.close()
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(20.0)
        finally:
            self._process.kill()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5, help="windows without and with the page (5)")
    parser.add_argument("--seconds", type=float, default=8.0, help="length of a window (8)")
    parser.add_argument("--robot", default="panda")
    parser.set_defaults(urdf=None, tip=None, base=None)
    arguments = parser.parse_args()
    environment = private_graph()
    windows: list[tuple[tuple[int, int], tuple[int, int]]] = []
    shares: list[tuple[float, float]] = []

    def window() -> tuple[int, int]:
        begin = time.time_ns()
        time.sleep(arguments.seconds)
        return begin, time.time_ns()

    with tempfile.TemporaryDirectory() as folder:
        processes = Processes(Path(folder) / "log", environment)
        try:
            start_arm(processes, arguments, {"record_folder": f"{folder}/runs"})
            targets = str(bag_folder("panda_figure_eight"))
            processes.start("stream", ["ik_controller.cli", "stream", targets, "--loop", "--patience", "60"])
            by = time.monotonic() + 90.0
            while not any(Path(folder, "runs").glob("*/*.mcap")):
                assert time.monotonic() < by, "the node does not run"
                time.sleep(0.1)
            time.sleep(3.0 * SETTLE)
            for _ in range(arguments.rounds):
                without = window()
                with Watched(environment) as page:
                    windows.append((without, window()))
                    shares.append(page.share())
                time.sleep(SETTLE)
                processes.check("sim", "node", "stream")
            processes.end("stream", "node", "sim")
        finally:
            processes.close()
        (run,) = Path(folder, "runs").iterdir()
        bag = open_bag(run)
        info = RunInfo.of(bag)
        assert info is not None
        records = [decode_cycle(message.data) for message in bag.messages([info.topics["cycle"]])]
    starts = np.array([record[1] + record[3] for record in records])

    def p99(begin: int, end: int) -> float:
        periods = np.diff(starts[(starts >= begin) & (starts < end)])
        assert len(periods) > 100, "the node ran no cycles in a window"
        return float(np.percentile(periods, 99)) * 1e-3

    found = [(p99(*without), p99(*watched)) for without, watched in windows]
    for plain, watched in found:
        print(f"p99 of the period: without a page {plain:7.1f} µs, with {watched:7.1f} µs, ratio {watched / plain:.3f}")
    ratio = statistics.median(watched / plain for plain, watched in found)
    share, rate = (statistics.median(column) for column in zip(*shares, strict=True))
    print(f"median ratio {ratio:.3f}; the page takes {share:.2f} of a core and sends a browser {rate:.0f} kB/s")


if __name__ == "__main__":
    main()
