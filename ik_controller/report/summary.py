"""Summary: what a person wants to know first of a run, in sentences: did it track, how well, what held it back."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ik_controller.recording.replay import describe_software
from ik_controller.recording.timeline import Lane, Run

_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))


class Fact(NamedTuple):
    """One answer: its question in a word, the answer in few words, the rest in a sentence; `good` None: neither."""

    name: str
    value: str
    text: str
    good: bool | None = None


def headline(run: Run) -> str:
    """Return the run in one sentence."""
    timeline, errors = run.timeline, run.replay.errors.as_mapping()
    tracked, largest = errors["position_rms_m"], errors["position_max_m"]
    held = holding_back(run)
    if tracked is None or largest is None:
        doing = sorted((lane for lane in timeline.lanes if not lane.held), key=lambda lane: -lane.cycles)
        if any(lane.name == "tracking" for lane in doing):
            return f"It moved without a pose to follow{_held_words(run, held)}."
        what = doing[0].name if doing else held[0].name if held else "nothing was commanded"
        return f"It did not track: {what}."
    return f"It tracked within {si(largest, 'm')} of its target{_held_words(run, held)}."


def _held_words(run: Run, held: list[Lane]) -> str:
    if not held:
        return ", and nothing held it back"
    share = held[0].cycles / run.timeline.cycles
    text = f", held back by the {held[0].name}" if "limit" in held[0].name else f"; {held[0].name}"
    return f"{text} for {share_words(share)} of the time"


def holding_back(run: Run) -> list[Lane]:
    """Return what held the arm back, the longest first."""
    return sorted((lane for lane in run.timeline.lanes if lane.held), key=lambda lane: -lane.cycles)


def facts(run: Run) -> list[Fact]:
    """Return the answers for the top of the page."""
    return [_tracked(run), _error(run, "position", "m"), _error(run, "orientation", "rad"), _held(run), _loop(run),
            _replayed(run)]  # fmt: skip


def _tracked(run: Run) -> Fact:
    timeline = run.timeline
    dt = timeline.session.dt
    doing = sorted((lane for lane in timeline.lanes if not lane.held), key=lambda lane: -lane.cycles)
    tracking = sum(lane.cycles for lane in doing if lane.name == "tracking")
    others = [f"{lane.name} {seconds(lane.cycles * dt)}" for lane in doing if lane.name != "tracking"]
    text = f"of {seconds(timeline.duration)}" + ("; " + ", ".join(others) if others else "")
    return Fact("Tracked", seconds(tracking * dt), text, None if tracking else False)


def _error(run: Run, name: str, unit: str) -> Fact:
    errors = run.replay.errors.as_mapping()
    rms, largest = errors[f"{name}_rms_{unit}"], errors[f"{name}_max_{unit}"]
    title = f"{name.capitalize()} error"
    if rms is None or largest is None:
        return Fact(title, "–", "no pose was followed")
    column = run.timeline.high(f"{name}_error_{unit}")
    at = float(run.timeline.first("time_s")[int(np.nanargmax(column))]) if np.isfinite(column).any() else 0.0
    return Fact(title, f"{si(rms, unit)} RMS", f"at most {si(largest, unit)}, at {at:.2f} s")


def _held(run: Run) -> Fact:
    held = holding_back(run)
    if not held:
        return Fact("Held back by", "nothing", "no limit was reached, no singularity was near", True)
    dt = run.timeline.session.dt
    texts = []
    for lane in held[:2]:
        worst = f", down to {100.0 * lane.least_scale:.0f} %" if lane.least_scale < 0.995 else ""
        texts.append(f"{seconds(lane.cycles * dt)}{worst}")
    if len(held) > 1:
        texts[1] = f"then {held[1].name}: {texts[1]}"
    if len(held) > 2:
        texts.append(f"and {len(held) - 2} more")
    return Fact("Held back by", held[0].name, "; ".join(texts), False)


def _loop(run: Run) -> Fact:
    timeline, rate = run.timeline, run.info.parameters.rate
    if not timeline.worked:
        return Fact("Loop", f"{rate:g} Hz", "run on the ideal arm, not in real time")
    median, high = timeline.period_percentiles()
    missed = run.replay.missed
    text = (
        f"period: median {1e-3 * median:.3f} ms, 99 % below {1e-3 * high:.3f} ms, longest "
        f"{1e-3 * timeline.longest_period:.3f} ms; {missed} of {timeline.cycles} deadlines missed"
    )
    return Fact("Loop", f"{rate:g} Hz", text, missed == 0)


def _replayed(run: Run) -> Fact:
    result = run.replay
    if run.simulated:
        return Fact("Replay", "nothing to compare", "the bag holds targets alone; they were run on the ideal arm")
    if result.identical is None:
        return Fact("Replay", "nothing to compare", "the run commanded nothing")
    cut = "; the bag is cut off, this is what can be read of it" if not result.complete else ""
    if result.identical:
        return Fact("Replay", "bit-identical", f"all {result.commands} commands, every bit{cut}", True)
    other = f"; recorded with other software: {describe_software(result.software)}" if result.software else ""
    largest = "without end" if math.isinf(result.max_difference) else f"{result.max_difference:.3g} rad or m"
    return Fact("Replay", "differs", f"from cycle {result.first_difference} on, at most {largest}{other}{cut}", False)


# -- numbers for people


def si(value: float, unit: str) -> str:
    """Return a value with three digits and the prefix that suits it: 6.61 µm."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g} {unit}"
    factor, prefix = next(((f, p) for f, p in _PREFIXES if abs(value) >= 0.9995 * f), _PREFIXES[-1])
    scaled = float(f"{value / factor:.3g}")
    digits = max(2 - math.floor(math.log10(abs(scaled)) + 1e-9), 0)
    return f"{scaled:.{digits}f} {prefix}{unit}"


def seconds(value: float) -> str:
    """Return a time: 0.31 s, 12.2 s, 10 min 3 s."""
    if value < 100.0:
        return f"{value:.2f} s" if value < 10.0 else f"{value:.1f} s"
    return f"{int(value // 60)} min {value % 60:.0f} s"


def share_words(share: float) -> str:
    """Return a share in percent, "less than 1 %" where it is."""
    return "less than 1 %" if share < 0.01 else f"{100.0 * share:.0f} %"
