"""Playback: a recorded run on the page, with a slider for its time."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.status import Code
from ik_controller.errors import BagError
from ik_controller.kinematics.model import RobotModel
from ik_controller.recording.cycles import cycles, session_of
from ik_controller.recording.reader import open_bag
from ik_controller.view.page import Page

Array = NDArray[np.float64]

_RATE = 50.0  # [Hz] of the frames that are kept


class Run:
    """A run thinned out for showing: `times` (k,) [s], `joints` (k, n), `errors` (k, 6), `sentences` (k)."""

    def __init__(self, bag_path: Path) -> None:
        """Replay the bag. Raises BagError where it holds no run of ours, or one without commands."""
        bag = open_bag(bag_path)
        session, info = session_of(bag, {})
        self.model: RobotModel = session.model
        every = max(round(session.parameters.rate / _RATE), 1)
        rows: list[tuple[float, Array, Array, float, int, str]] = []
        first: int | None = None
        worst = np.zeros(6)
        for index, cycle in enumerate(cycles(bag, session, info, {})):
            first = cycle.time if first is None else first
            if cycle.step is None:
                continue
            # Of the cycles between two frames the largest error counts: no peak is lost.
            if float(np.abs(cycle.step.error).max()) >= float(np.abs(worst).max()):
                worst = np.array(cycle.step.error)
            if index % every == 0:
                status = cycle.step.status
                level = 0 if status.code is Code.TRACKING and status.joint < 0 else 1
                speed = float((np.abs(cycle.step.velocity) / self.model.velocity_limit).max())
                sentence = status.sentence(self.model.joint_names)
                rows.append(((cycle.time - first) * 1e-9, cycle.step.position.copy(), worst, speed, level, sentence))
                worst = np.zeros(6)
        if not rows:
            raise BagError(f"bag '{bag_path}' holds no commands")
        self.times = np.array([row[0] for row in rows])
        self.joints = np.array([row[1] for row in rows])
        self.errors = np.array([row[2] for row in rows])
        self.speeds = [row[3] for row in rows]
        self.levels = [row[4] for row in rows]
        self.sentences = [row[5] for row in rows]


class Playback:
    """Plays a Run on a page that it makes; `run` until `stop`."""

    def __init__(self, run: Run, title: str, dark: bool = False) -> None:
        self.page = Page(title, None, dark)
        self._run = run
        self.page.load(run.model)
        self._stop = False
        gui = self.page.server.gui
        self._playing = gui.add_checkbox("play", initial_value=True, order=-3.0)
        self._speed = gui.add_slider("speed", min=0.1, max=5.0, step=0.1, initial_value=1.0, order=-2.0)
        self._time: Any = gui.add_slider(
            "time [s]", min=0.0, max=float(run.times[-1]), step=0.01, initial_value=0.0, order=-1.0
        )
        tool = np.array([run.model.forward(q).translation for q in run.joints])
        points = np.array(tool, dtype=np.float32)
        if len(points) > 1:
            segments = np.stack((points[:-1], points[1:]), axis=1)
            self.page.server.scene.add_line_segments("/path", points=segments, colors=(31, 119, 180), thickness=2.0)
        self._marker: Any = self.page.server.scene.add_icosphere("/reference", radius=0.012, color=(31, 119, 180))

    def stop(self, *_: Any) -> None:
        """End `run`; for signal handlers: it takes no lock."""
        self._stop = True

    def run(self) -> None:
        """Play until `stop`, over and over."""
        shown = -1
        last = time.monotonic()
        while not self._stop:
            time.sleep(0.04)
            now = time.monotonic()
            if self._playing.value:
                at = float(self._time.value) + (now - last) * float(self._speed.value)
                self._time.value = at if at <= self._run.times[-1] else 0.0
            last = now
            index = int(np.clip(np.searchsorted(self._run.times, self._time.value), 0, len(self._run.times) - 1))
            if index != shown:
                shown = index
                self._show(index)
        self.page.close()

    def _show(self, index: int) -> None:
        run, page = self._run, self.page
        q, error = run.joints[index], run.errors[index]
        page.show_arm("measured", q)
        page.show_arm("commanded", q)
        self._marker.position = run.model.forward(q).translation + error[:3]
        page.show_status(run.levels[index], run.sentences[index], [("time", f"{run.times[index]:.2f} s")])
        page.show_errors(
            float(run.times[index]),
            float(np.linalg.norm(error[:3])),
            float(np.linalg.norm(error[3:])),
            run.speeds[index],
        )
