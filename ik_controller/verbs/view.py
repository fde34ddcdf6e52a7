"""`ik_controller view`: the live page of a node, of a simulated arm of its own, or of a recorded run."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path
from typing import Any

from ik_controller.endings import on_signal
from ik_controller.errors import IkControllerError, ParameterError
from ik_controller.verbs.common import add_json_argument, add_model_arguments, print_json

HELP = "show an arm in the browser and drag its target: a running node's, a simulated one (--sim), or a bag's (--bag)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("--node", default="ik_controller", metavar="NAME", help="the node to watch (ik_controller)")
    parser.add_argument("--sim", action="store_true", help="start a simulated arm and its node, and show them")
    parser.add_argument("--bag", metavar="BAG", help="play a recorded run; needs no ROS")
    add_model_arguments(parser, default="panda")
    parser.add_argument("--host", default="127.0.0.1", help="address to serve on (127.0.0.1); others need a token")
    parser.add_argument("--port", type=int, default=8080, help="port to serve on (8080; 0: any that is free)")
    parser.add_argument("--dark", action="store_true", help="dark page")
    parser.add_argument("-o", "--output", default="runs", metavar="FOLDER", help="folder for the bags of --sim (runs)")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    try:
        from ik_controller.view.door import Door
        from ik_controller.view.page import Page
    except ImportError as missing:
        raise IkControllerError(
            f"the live page needs '{missing.name}': pip install 'ik_controller[view]', or pip install viser"
        ) from None
    if not 0 <= arguments.port <= 65535:
        raise ParameterError(f"--port {arguments.port}: need 0 to 65535")
    doors: list[Any] = []

    def opened(page: Page) -> None:
        try:
            door = Door(arguments.host, arguments.port, page.port)
        except OSError as error:
            raise IkControllerError(
                f"cannot serve on {arguments.host}:{arguments.port}: {error.strerror}; another --port?"
            ) from None
        doors.append(door)
        if arguments.json:
            print_json({"url": door.address})
        else:
            print(f"open {door.address}    (Ctrl-C ends)")
        sys.stdout.flush()

    try:
        if arguments.bag:
            _play(arguments, opened)
        elif arguments.sim:
            _simulate(arguments, opened)
        else:
            from ik_controller.ros.viewer import view

            view(arguments.node, arguments.node.strip("/"), arguments.dark, opened, arguments.ros_arguments)
    finally:
        for door in doors:
            door.close()
    return 0


def _play(arguments: argparse.Namespace, opened: Any) -> None:
    from ik_controller.view.playback import Playback, Run

    playback = Playback(Run(Path(arguments.bag)), Path(arguments.bag).name, arguments.dark)
    opened(playback.page)
    on_signal(playback.stop)
    playback.run()


def _simulate(arguments: argparse.Namespace, opened: Any) -> None:
    from ik_controller.robots import build_model
    from ik_controller.verbs.common import parameters_from
    from ik_controller.verbs.processes import Processes, private_graph, start_arm

    parameters = parameters_from(arguments)
    build_model(parameters)  # says what is wrong with it before anything starts
    title = parameters.robot or Path(arguments.urdf).stem
    output = Path(arguments.output)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise IkControllerError(f"--output {output}: {error.strerror}") from None
    os.environ.update(private_graph())  # of this process too, before it loads ROS
    from ik_controller.ros.viewer import view

    on_signal(signal.default_int_handler)  # from here on there are processes to be ended too
    processes = Processes(output / "view.log", dict(os.environ))
    try:
        start_arm(processes, arguments, {"record_folder": str(output)})
        failed = _Watch(processes)
        view("/ik_controller", f"{title} (simulated)", arguments.dark, opened, [], failed)
        processes.end("node", "sim")
    finally:
        processes.close()


class _Watch:
    """Tells where arm or node end by themselves: each time to who asks, once in the terminal."""

    def __init__(self, processes: Any) -> None:
        self._processes = processes
        self._said = ""

    def __call__(self) -> str:
        for name in ("sim", "node"):
            if not self._said and self._processes.poll(name) is not None:
                self._said = f"the {name} process has ended: {self._processes.last_line()}"
                print(f"{self._said} (all of it: {self._processes.log}); Ctrl-C, then start again", file=sys.stderr)
        return self._said
