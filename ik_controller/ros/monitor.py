"""Monitor: what the node tells about itself, as messages: tool pose, tracking error, status, diagnostics."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.status import Code, in_words
from ik_controller.kinematics.model import RobotModel
from ik_controller.messages import cdr
from ik_controller.ros.clock import SimulatedLoop
from ik_controller.ros.loop import Loop
from ik_controller.ros.reasons import REASONS, level_of, of_status, what_to_do
from ik_controller.ros.recorder import Recorder
from ik_controller.session import Session

DIAGNOSTIC_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"

_RECENT = 5_000_000_000  # [ns] that what happened once is told: `ros2 topic echo` takes a second to start
_WINDOW = 1000  # cycles that the period's percentiles are taken over


class Timing:
    """Start times of the last cycles, for the period's percentiles."""

    def __init__(self, period: int, window: int = _WINDOW) -> None:
        self._starts = np.zeros(window, dtype=np.int64)
        self._period = period
        self._count = 0

    def add(self, start: int) -> None:
        """Note when a cycle really started [ns]."""
        self._starts[self._count % len(self._starts)] = start
        self._count += 1

    def percentiles(self) -> tuple[float, float]:
        """Return the median and the 99th percentile of the period [µs]."""
        if self._count < 3:
            return self._period * 1e-3, self._period * 1e-3
        periods = np.diff(np.sort(self._starts[: min(self._count, len(self._starts))]))
        periods.sort()  # np.percentile takes five times as long
        last = len(periods) - 1
        return 1e-3 * float(periods[round(0.5 * last)]), 1e-3 * float(periods[round(0.99 * last)])


class Telling:
    """Writes ~/current_pose and ~/tracking_error of a model's arm."""

    def __init__(self, model: RobotModel) -> None:
        self._pose = cdr.StampedWriter(cdr.pose_message(0, model.base_frame, pin.SE3.Identity()), 7)
        self._error = cdr.StampedWriter(cdr.twist_message(0, model.base_frame, np.zeros(6)), 6)

    def pose(self, now: int, model: RobotModel, q: NDArray[np.float64] | None) -> bytes | None:
        """Return the tool's pose at the measured joints (n,), None before the first joint state; `model`: as it is now,
        for the tool may have been changed.
        """
        return None if q is None else self._pose.write(now, pin.SE3ToXYZQUAT(model.forward(q)))

    def error(self, now: int, error: NDArray[np.float64]) -> bytes:
        """Return reference minus tool (6,): position [m] and rotation vector [rad], in the base frame."""
        return self._error.write(now, error)


@dataclass(frozen=True)
class Account:
    """What there is to tell at one moment: level, one sentence, the arm's name, and every number behind it."""

    level: int
    sentence: str
    hardware: str
    values: dict[str, str]

    def message(self, name: str) -> Any:
        """Return it as a diagnostic_msgs/DiagnosticStatus of the node `name`."""
        pairs = [cdr.message("diagnostic_msgs/msg/KeyValue", key, value) for key, value in self.values.items()]
        return cdr.message(DIAGNOSTIC_STATUS, self.level, name, self.sentence, self.hardware, pairs)


def idle(state: str, why: str, hardware: str) -> Account:
    """Return the account of a node in a lifecycle state other than active, and why it is in it."""
    values = {"state": state, "reasons": state, "what_to_do": what_to_do([state])}
    return Account(REASONS[state].level, f"{state}: {why}", hardware, values)


class Monitor:
    """What is seen of one run; `account` sums it up. `description`: what is wrong with the last robot_description."""

    def __init__(
        self,
        session: Session,
        loop: Loop | SimulatedLoop,
        recorder: Recorder,
        notes: Callable[[], list[tuple[str, str]]],
    ) -> None:
        """`notes` returns reasons (keys of REASONS) and sentences that only the run knows of."""
        self.description = ""
        self._notes = notes
        self._session = session
        self._loop = loop
        self._recorder = recorder
        self._timing = Timing(session.period)
        self._second = round(1e9 / session.period)  # cycles in a second
        self._rejected_at: int | None = None
        self._held_up = 0, 0  # when [ns], and for how long
        self._missed = self._missed_before = 0  # in the last whole second; in all at its end

    def cycle(self, index: int, now: int, late: int) -> None:
        """Note a cycle that was due at `now` and began `late` [ns] after it."""
        self._timing.add(now + late)
        if index % self._second == 0:
            missed = self._loop.missed
            self._missed, self._missed_before = missed - self._missed_before, missed

    def rejected(self, now: int) -> None:
        """Note that a message was rejected."""
        self._rejected_at = now

    def held_up(self, now: int, length: int) -> None:
        """Note that the process stood still for a time [ns]."""
        self._held_up = now, length

    def glance(self) -> tuple[Any, ...]:
        """Return what a new status is sent at once for when it changes."""
        state = self._session.status
        why = state.closest, state.feasible, state.damped
        return state.code, state.limit, state.joint, *why, self._rejected_at is None

    def account(self, now: int) -> Account:
        """Return what there is to tell."""
        session, state = self._session, self._session.explained()
        names = session.model.joint_names
        age, feedback = session.targets.age(now), session.feedback_arrival
        reasons, sentences = list(of_status(state)), [state.sentence(names)]
        if state.code is Code.HOLDING:
            timeout = f", command_timeout is {session.parameters.command_timeout:g} s"
            sentences.append("none has come yet" if age is None else f"the last came {age:.1f} s ago{timeout}")
        if self._rejected_at is not None and now - self._rejected_at > _RECENT:
            self._rejected_at = None
        if self._rejected_at is not None or (state.code is Code.WAITING and session.last_rejected):
            reasons.append("rejected")
            sentences.append(f"rejected {session.last_rejected}")
        if self.description:
            reasons.append("rejected")
            sentences.append(f"rejected robot_description: {self.description}")
        if session.goal.outcome and session.targets.trajectory_end() is not None:
            sentences.append(f"goal {session.goal.outcome}")
            if session.goal.outcome.startswith("missed"):
                reasons.append("goal missed")
        for reason, sentence in self._notes():
            reasons.append(reason)
            sentences.append(sentence)
        when, length = self._held_up
        if 0 < now - when < _RECENT and length:
            reasons.append("held up")
            sentences.append(f"held up for {length * 1e-9:.2f} s and started again from the measured position")
        if self._missed > 0.01 * self._second:
            reasons.append("late")
            sentences.append(f"{self._missed} cycles of the last second began late")
        recorder = self._recorder.status()
        if recorder is not None and (recorder.lost or recorder.state == "interrupted"):
            reasons.append("recording")
            sentences.append(f"recording {recorder.state}: {recorder.reason}, {recorder.lost} messages lost")
        failure = self._recorder.failure if session.parameters.record and recorder is None else ""
        if failure:
            reasons.append("recording")
            sentences.append(f"not recording: {failure}")
        median, high = self._timing.percentiles()
        values = {
            "state": state.code.name.lower(),
            "reasons": ", ".join(dict.fromkeys(reasons)),
            "what_to_do": what_to_do(reasons),
            "mode": session.parameters.mode,
            "goal": session.goal.outcome,
            "limit": state.limit.value,
            "joint": names[state.joint] if state.joint >= 0 else "",
            "scale": f"{state.scale:.4f}",
            "smallest_singular_value": f"{state.smallest_singular_value:.5f}",
            "condition_number": f"{state.condition_number:.4g}",
            "damped": str(state.damped).lower(),
            "singular_direction": in_words(state.singular_direction) if state.singular_direction else "",
            "feasible": str(state.feasible).lower(),
            "closest_approach": str(state.closest).lower(),
            "pair": ", ".join(state.pair),
            "distance_m": "" if math.isnan(state.distance) else f"{state.distance:.4f}",
            "position_error_m": f"{state.position_error:.3g}",
            "orientation_error_rad": f"{state.orientation_error:.3g}",
            "target_age_s": "never" if age is None else f"{age:.3f}",
            "joint_state_age_s": "never" if feedback is None else f"{(now - feedback) * 1e-9:.3f}",
            "rejected": str(sum(session.rejected.values())),
            **{f"rejected_{role}": str(count) for role, count in sorted(session.rejected.items())},
            "last_rejected": session.last_rejected,
            "period_us": f"{session.period * 1e-3:g}",
            "period_p50_us": f"{median:.1f}",
            "period_p99_us": f"{high:.1f}",
            "missed": str(self._loop.missed),
            "stalls": str(self._loop.stalls),
            "recorder": recorder.state if recorder is not None else "interrupted" if failure else "off",
            "bag": str(self._recorder.folder or ""),
            "recorded_messages": "0" if recorder is None else str(recorder.messages),
            "recorder_waiting": "0" if recorder is None else str(recorder.waiting),
            "recorder_lost": "0" if recorder is None else str(recorder.lost),
        }
        return Account(level_of(reasons), "; ".join(sentences), session.model.robot_name, values)
