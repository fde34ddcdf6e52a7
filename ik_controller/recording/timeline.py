"""Timeline: a run's signals over time, collected from its replay, and the picture of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.status import Code
from ik_controller.recording.replay import Cycle
from ik_controller.session import Session

Array = NDArray[np.float64]

_COLUMNS = 2000  # points across the picture; of more, each column shows the largest


class Timeline:
    """Tool and reference over time, taken from the cycles of a replay as they pass."""

    def __init__(self) -> None:
        self.starts: list[int] = []  # when each cycle really started [ns]
        self._rows: list[tuple[float, ...]] = []
        self._first: int | None = None

    def watch(self, cycles: Iterator[Cycle], session: Session) -> Iterator[Cycle]:
        """Pass the cycles on and note their signals."""
        model = session.model
        at: Array | None = None
        for cycle in cycles:
            self._first = cycle.time if self._first is None else self._first
            self.starts.append(cycle.time + cycle.late)
            step = cycle.step
            if step is not None:
                tool = model.forward(at if at is not None else step.position).translation
                speed = float((np.abs(step.velocity) / model.velocity_limit).max())
                followed = step.status.code is Code.TRACKING and bool(step.error.any())
                time = (cycle.time - self._first) * 1e-9
                self._rows.append((time, *tool, *step.error, speed, float(followed)))
                at = step.position
            else:
                at = None
            yield cycle

    @property
    def table(self) -> Array:
        """The signals, a row a cycle: time [s], tool x y z [m], error (6,) [m, rad], share of the speed limits,
        followed.
        """
        return np.array(self._rows).reshape(-1, 12)

    def period_percentiles(self) -> tuple[float, float]:
        """Return the median and 99th percentile of the loop's period [µs]; NaN for fewer than two cycles."""
        if len(self.starts) < 2:
            return float("nan"), float("nan")
        median, high = np.percentile(np.diff(np.array(self.starts)), (50, 99)) * 1e-3
        return float(median), float(high)


def draw(timeline: Timeline, file: Path, title: str) -> None:
    """Draw path and errors over time into a PNG file."""
    picture(timeline, title).savefig(file, dpi=110)


def picture(timeline: Timeline, title: str) -> Any:
    """Return a matplotlib Figure of path and errors over time."""
    from matplotlib.figure import Figure

    table = timeline.table
    time, tool, error, speed = table[:, 0], table[:, 1:4], table[:, 4:10], table[:, 10]
    followed = table[:, 11] > 0.0
    reference = np.where(followed[:, None], tool + error[:, :3], np.nan)

    figure: Any = Figure(figsize=(12, 7), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.05, 1.0))
    path: Any = figure.add_subplot(grid[:, 0], projection="3d")
    every = max(len(time) // _COLUMNS, 1)
    path.plot(*reference[::every].T, color="#f58518", linewidth=3.5, alpha=0.55, label="reference")
    path.plot(*tool[::every].T, color="#1f4e9c", linewidth=1.2, label="commanded tool")
    if len(time):
        path.scatter(*tool[0], color="#1f4e9c", s=28, label="start")
    _equal_axes(path, np.vstack((tool, reference[followed])) if len(time) else np.zeros((1, 3)))
    path.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    path.legend(loc="upper left")

    norms = (
        ("position error [µm]", 1e6 * np.linalg.norm(error[:, :3], axis=1), followed, "#1f4e9c"),
        ("orientation error [µrad]", 1e6 * np.linalg.norm(error[:, 3:], axis=1), followed, "#1f4e9c"),
        ("fastest joint [% of its limit]", 100.0 * speed, np.ones(len(time), dtype=bool), "#54832e"),
    )
    below: Any = None
    for row, (label, values, shown, color) in enumerate(norms):
        axes = figure.add_subplot(grid[row, 1], sharex=below)
        below = below or axes
        columns, heights = _columns(time, np.where(shown, values, np.nan))
        axes.plot(columns, heights, color=color, linewidth=1.0)
        if row < 2 and np.isfinite(heights).any() and np.nanmax(heights) > 50.0 * max(np.nanmedian(heights), 1e-9):
            axes.set_yscale("log")
        axes.set_ylabel(label)
        axes.grid(visible=True, alpha=0.3)
        axes.margins(x=0.01)
        if row < 2:
            axes.tick_params(labelbottom=False)
    figure.axes[-1].set_xlabel("time [s]")
    figure.suptitle(title, fontsize=13)
    return figure


def _columns(time: Array, values: Array) -> tuple[Array, Array]:
    """Thin out to the picture's columns, keeping the largest of each so that no peak is lost."""
    size = len(time) // _COLUMNS
    if size < 2:
        return time, values
    count = len(time) // size
    blocks = values[: count * size].reshape(count, size)
    empty = np.isnan(blocks).all(axis=1)
    heights = np.where(empty, np.nan, np.max(np.nan_to_num(blocks, nan=-np.inf), axis=1))
    return time[: count * size : size], heights


def _equal_axes(axes: Any, points: Array) -> None:
    """Give the three axes one scale, so that a circle looks round."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.55 * max(float((high - low).max()), 0.02)
    for name, center in zip("xyz", middle, strict=True):
        getattr(axes, f"set_{name}lim")(center - half, center + half)
    axes.set_box_aspect((1, 1, 1))
