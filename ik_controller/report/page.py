"""Page: a run's report as one HTML file that loads nothing; see docs/seeing.md.

The template, its style and its scripts are in assets/. Into it go words and plots' descriptions as JSON, and the
columns of the timeline's envelope as one base64 text: time as float64, all others as float32.
"""

from __future__ import annotations

import base64
import datetime
import html
import json
import math
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ik_controller.errors import IkControllerError, short_names
from ik_controller.parameters import ControllerParameters
from ik_controller.recording.timeline import Run, Timeline
from ik_controller.report import arm
from ik_controller.report.summary import facts, headline

_SCRIPTS = ("uPlot.iife.min.js", "columns.js", "arm.js", "view3d.js", "plots.js", "lanes.js", "page.js")
_STYLES = ("uPlot.min.css", "page.css")


def write_page(run: Run, file: Path) -> None:
    """Write the report. Raises IkControllerError where the file cannot be written."""
    text = page(run)
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise IkControllerError(f"cannot write {file}: {error.strerror}") from None


def page(run: Run) -> str:
    """Return the report's HTML."""
    content, columns = describe(run)
    parts = {
        "TITLE": html.escape(f"{run.bag.path.name}: report of a run"),
        "STYLE": "\n".join(_asset(name) for name in _STYLES),
        # `<` in JSON only ever stands inside a string; so written, no text can end the script element.
        "CONTENT": json.dumps(_plain(content), ensure_ascii=False, allow_nan=False).replace("<", "\\u003c"),
        "COLUMNS": base64.b64encode(columns).decode("ascii"),
        "SCRIPT": "\n".join(_asset(name) for name in _SCRIPTS),
    }
    pieces = _asset("page.html").split("@@")  # text, name, text, name, …
    return "".join(parts[piece] if index % 2 else piece for index, piece in enumerate(pieces))


def describe(run: Run) -> tuple[dict[str, Any], bytes]:
    """Return what the page shows, and the bytes of its columns."""
    timeline = run.timeline
    session = timeline.session
    model = session.model
    used, blob = _columns(timeline)
    content = {
        "bag": run.bag.path.name,
        "when": _date(timeline.first_time) if timeline.worked else "",
        "robot": model.robot_name,
        "headline": headline(run),
        "facts": [fact._asdict() for fact in facts(run)],
        "duration": timeline.duration,
        "dt": session.dt,
        "cycles": timeline.cycles,
        "bucket": timeline.envelope.size,
        "rows": len(timeline.envelope),
        "columns": used,
        "arm": {"joints": arm.joints(model), "tool": arm.tool(model), "solids": arm.solids(model)},
        "charts": charts(run),
        "lanes": [
            {
                "name": lane.name,
                "held": lane.held,
                "seconds": lane.cycles * session.dt,
                "share": lane.cycles / timeline.cycles,
                "scale": lane.least_scale,
            }
            for lane in timeline.lanes
        ],
        "masks": _runs(timeline),
        "events": timeline.events,
        "rejected": run.replay.rejected,
        "last_rejected": run.replay.last_rejected,
        "tables": tables(run),
    }
    return content, blob


def _columns(timeline: Timeline) -> tuple[list[dict[str, Any]], bytes]:
    """Return the columns that hold any value, with what is stored of each, and their bytes, in this order."""
    joints, names = timeline.signals.joints["position"], timeline.signals.names
    sampled = {name for name in names if name.startswith(("tool_", "target_"))} | {*names[joints]}
    used: list[dict[str, Any]] = [{"name": "time_s", "kinds": ["first"], "type": "f8"}]
    parts = [timeline.first("time_s").astype("<f8").tobytes()]
    exact = timeline.envelope.size == 1
    for name in names[1:]:
        if not np.isfinite(timeline.low(name)).any():
            continue
        kinds = ["first"] if exact or name.startswith(("tool_", "target_")) else ["low", "high"]
        if name in sampled and not exact and "first" not in kinds:
            kinds.append("first")
        used.append({"name": name, "kinds": kinds, "type": "f4"})
        parts += [getattr(timeline, kind)(name).astype("<f4").tobytes() for kind in kinds]
    return used, b"".join(parts)


def _runs(timeline: Timeline) -> list[list[int]]:
    """Return the masks of the buckets run by run: [first bucket, bit, bit, …]."""
    masks = timeline.envelope.masks
    starts = np.flatnonzero(np.diff(masks, prepend=masks[:1] - 1))
    return [[int(k), *(bit for bit in range(len(timeline.lanes)) if int(masks[k]) >> bit & 1)] for k in starts]


# -- plots


def charts(run: Run) -> list[dict[str, Any]]:
    """Return the plots that have anything to show."""
    timeline, parameters = run.timeline, run.info.parameters
    model, joints = timeline.session.model, timeline.signals.joints
    names = timeline.signals.names
    velocity = model.velocity_limit * parameters.velocity_scale
    acceleration = model.acceleration_limit * parameters.acceleration_scale
    bounded = np.isfinite(model.lower) & np.isfinite(model.upper)
    middle = np.where(bounded, 0.5 * (np.where(bounded, model.lower + model.upper, 0.0)), 0.0)
    half = np.where(bounded, 0.5 * np.where(bounded, model.upper - model.lower, 0.0), math.pi)
    turns = "" if bounded.all() else " Joints without limits: 100 % is half a turn."

    def curves(columns: list[str], labels: list[str] | tuple[str, ...]) -> list[dict[str, Any]]:
        return [{"column": c, "label": label} for c, label in zip(columns, labels, strict=True)]

    def of_joints(what: str, center: Any = None, scale: Any = None) -> list[dict[str, Any]]:
        series = curves(names[joints[what]], short_names(model.joint_names))
        for index, entry in enumerate(series):
            entry["unit"] = _unit(names[joints[what]][index])
            if scale is not None:
                entry.update(center=float(center[index]), half=float(scale[index]))
        return series

    zero = np.zeros(model.n)
    threshold = parameters.singular_value_threshold
    found: list[dict[str, Any]] = [
        {"id": "position_error", "title": "Position error", "unit": "m", "log": True,
         "series": curves(["position_error_m", "error_x_m", "error_y_m", "error_z_m"], ("length", "x", "y", "z")),
         "note": "Target minus commanded tool, in the base frame."},
        {"id": "orientation_error", "title": "Orientation error", "unit": "rad", "log": True,
         "series": curves(["orientation_error_rad", *(f"rotation_error_{a}_rad" for a in "xyz")],
                          ("angle", "about x", "about y", "about z")),
         "note": "From tool to target: angle, and rotation vector."},
        {"id": "position", "title": "Joints between their limits", "series": of_joints("position", middle, half),
         "note": "0 % is the middle of a joint's range, ±100 % its limits." + turns},
        {"id": "velocity", "title": "Joint velocity", "series": of_joints("velocity", zero, velocity),
         "note": "Of each joint's limit."},
        {"id": "acceleration", "title": "Joint acceleration", "series": of_joints("acceleration", zero, acceleration),
         "note": "Of each joint's limit; difference of commanded velocities."},
        {"id": "lag", "title": "Arm behind its command", "unit": _unit(names[joints["lag"].start]),
         "series": of_joints("lag"), "note": "Commanded minus measured joint position."},
        {"id": "scale", "title": "Share of the wanted speed", "percent": True, "top": 1.0,
         "series": curves(["scale"], ["share"]), "note": "Below 100 % a limit slows the tool down along its path."},
        {"id": "sigma", "title": "Smallest singular value", "unit": "", "series": curves(
            ["smallest_singular_value"], ["σ min"]),
         "guides": [{"value": threshold, "label": "damped below"}], "note": "Of the Jacobian in metres and radians."},
        {"id": "manipulability", "title": "Manipulability", "unit": "",
         "series": curves(["manipulability"], ["w"]), "note": "w = √det(J Jᵀ), Yoshikawa 1985."},
        {"id": "distance", "title": "Closest pair", "unit": "m", "series": curves(["distance_m"], ["distance"]),
         "note": "Between the arm and obstacles, or the arm and itself, as far as it was near."},
    ]  # fmt: skip
    if timeline.worked:
        period = timeline.session.dt
        found += [
            {"id": "period", "title": "Loop period", "unit": "s", "series": curves(["period_s"], ["period"]),
             "guides": [{"value": period, "label": "wanted"}], "note": "From one cycle's start to the next."},
            {"id": "work", "title": "Work in a cycle", "unit": "s", "series": curves(["work_s"], ["work"]),
             "guides": [{"value": period, "label": "period"}], "note": "Taking inputs, the law, publishing."},
        ]  # fmt: skip
    return [chart for chart in found if any(_shows(timeline, curve["column"]) for curve in chart["series"])]


def _shows(timeline: Timeline, column: str) -> bool:
    low, high = timeline.low(column), timeline.high(column)
    if not np.isfinite(low).any():
        return False
    if column == "scale":
        return bool(np.nanmin(low) < 1.0)
    return "_lag_" not in column or bool(np.nanmax(np.fmax(-low, high)) > 0.0)


def _unit(column: str) -> str:
    return column.rsplit("_lag_", 1)[-1].rsplit("_position_", 1)[-1].rsplit("_velocity_", 1)[-1].rsplit(
        "_acceleration_", 1)[-1].replace("_s2", "/s²").replace("_s", "/s")  # fmt: skip


# -- tables


def tables(run: Run) -> list[dict[str, Any]]:
    """Return the tables at the end of the page: title, header, rows of texts."""
    model, info = run.timeline.session.model, run.info
    default = ControllerParameters().as_mapping()
    values = info.parameters.as_mapping()
    own = [[name, _text(value), _text(default[name]) or "empty"]
           for name, value in values.items() if value != default[name]]  # fmt: skip
    others = [[name, _text(value) or "empty"] for name, value in values.items() if value == default[name]]
    limits = [
        [name, *(f"{value:.4g}" for value in row)]
        for name, *row in zip(
            model.joint_names, model.lower, model.upper, model.velocity_limit, model.acceleration_limit, strict=True
        )
    ]
    now = run.replay.software
    software = [
        [name, "not noted", ""] if then == "unknown" else [name, then, now[name][1] if name in now else "the same"]
        for name, then in info.software.items()
    ]
    robot = [
        ["robot", model.robot_name],
        ["base frame → tip frame", f"{model.base_frame} → {model.tip_frame}"],
        ["joints", str(model.n)],
        *([["tool offset (x y z, qx qy qz qw)", _text(info.parameters.tool_offset)]]
          if info.parameters.tool_offset else []),
        *([assumption, ""] for assumption in model.assumptions),
    ]  # fmt: skip
    topics = [[topic.name, topic.type_name, "unknown" if topic.count is None else str(topic.count)]
              for topic in run.bag.topics if topic.count != 0]  # fmt: skip
    silent = [topic.name for topic in run.bag.topics if topic.count == 0]
    if silent:
        topics.append(["without messages", ", ".join(silent), ""])
    return [
        {"title": "Model", "header": ["", ""], "rows": robot},
        {"title": "Joint limits [rad, rad/s, rad/s²; m for a sliding joint]",
         "header": ["joint", "lower", "upper", "velocity", "acceleration"], "rows": limits},
        {"title": "Software", "header": ["", "when recorded", "at this replay"], "rows": software},
        {"title": "Bag", "header": ["topic", "type", "messages"], "rows": topics},
        {"title": "Parameters set at the start", "header": ["name", "value", "default"], "rows": own},
        {"title": "Parameters at their defaults", "header": ["name", "value"], "rows": others},
    ]  # fmt: skip


def _text(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return " ".join(_text(part) for part in value)
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _date(time: int) -> str:
    moment = datetime.datetime.fromtimestamp(time * 1e-9, datetime.timezone.utc)
    return moment.strftime("%Y-%m-%d %H:%M:%S UTC")


def _plain(value: Any) -> Any:
    """Return JSON's types, null for numbers that JSON has no word for."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _asset(name: str) -> str:
    return (resources.files("ik_controller.report") / "assets" / name).read_text(encoding="utf-8")
