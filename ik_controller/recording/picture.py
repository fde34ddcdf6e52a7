"""Picture: path and errors of a run's timeline, drawn by matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.recording.timeline import Timeline

Array = NDArray[np.float64]

_COLUMNS = 2000  # points across the picture; of more, each column shows the largest


def draw(timeline: Timeline, file: Path, title: str) -> None:
    """Draw path and errors over time into a PNG file."""
    picture(timeline, title).savefig(file, dpi=110)


def picture(timeline: Timeline, title: str) -> Any:
    """Return a matplotlib Figure of path and errors over time."""
    from matplotlib.figure import Figure

    time = timeline.first("time_s")
    tool, target = (
        np.column_stack([timeline.first(f"{name}_{axis}_m") for axis in "xyz"]) for name in ("tool", "target")
    )
    model = timeline.session.model
    speeds = [
        np.fmax(-timeline.envelope.low[:, column], timeline.envelope.high[:, column]) / limit
        for column, limit in zip(_range(timeline.signals.joints["velocity"]), model.velocity_limit, strict=True)
    ]

    figure: Any = Figure(figsize=(12, 7), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.05, 1.0))
    path: Any = figure.add_subplot(grid[:, 0], projection="3d")
    every = max(len(time) // _COLUMNS, 1)
    path.plot(*target[::every].T, color="#f58518", linewidth=3.5, alpha=0.55, label="reference")
    path.plot(*tool[::every].T, color="#1f4e9c", linewidth=1.2, label="commanded tool")
    points = np.vstack((tool, target))
    points = points[np.isfinite(points).all(axis=1)]
    if len(points):
        path.scatter(*points[0], color="#1f4e9c", s=28, label="start")
    _equal_axes(path, points if len(points) else np.zeros((1, 3)))
    path.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    path.legend(loc="upper left")

    curves = (
        ("position error [µm]", 1e6 * timeline.high("position_error_m"), "#1f4e9c"),
        ("orientation error [µrad]", 1e6 * timeline.high("orientation_error_rad"), "#1f4e9c"),
        ("fastest joint [% of its limit]", 100.0 * np.max(speeds, axis=0), "#54832e"),
    )
    below: Any = None
    for row, (label, values, color) in enumerate(curves):
        axes = figure.add_subplot(grid[row, 1], sharex=below)
        below = below or axes
        columns, heights = _columns(time, values)
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


def _range(part: slice) -> range:
    return range(part.start, part.stop)


def _columns(time: Array, values: Array) -> tuple[Array, Array]:
    """Thin out to the picture's columns, keeping the largest of each so that no peak is lost."""
    size = len(time) // _COLUMNS
    if size < 2:
        return time, values
    starts = np.arange(0, len(time), size)
    return time[starts], np.fmax.reduceat(values, starts)


def _equal_axes(axes: Any, points: Array) -> None:
    """Give the three axes one scale, so that a circle looks round."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.55 * max(float((high - low).max()), 0.02)
    for name, center in zip("xyz", middle, strict=True):
        getattr(axes, f"set_{name}lim")(center - half, center + half)
    axes.set_box_aspect((1, 1, 1))
