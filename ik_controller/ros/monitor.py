"""Monitor: what the node tells about itself, as messages: tool pose, tracking error, status, diagnostics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.status import Code
from ik_controller.kinematics.model import RobotModel
from ik_controller.messages import cdr
from ik_controller.recording.writer import WriterStatus
from ik_controller.ros.loop import Loop
from ik_controller.session import Session

DIAGNOSTIC_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"

OK, WARN, ERROR, STALE = range(4)  # of diagnostic_msgs/DiagnosticStatus
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
        starts = np.sort(self._starts[: min(self._count, len(self._starts))])
        median, high = np.percentile(np.diff(starts), (50, 99)) * 1e-3
        return float(median), float(high)


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


def at_rest(state: str, reason: str, hardware: str, description: str = "") -> Account:
    """Return the account of a node that is not active: its lifecycle state and what it waits for."""
    level = WARN if state == "inactive" else STALE
    values = {"state": state, "recorder": "off"}
    if description:
        values["last_rejected"] = description
    return Account(level, f"{state}: {reason}", hardware, values)


def running(session: Session, now: int, timing: Timing, loop: Loop, recorder: WriterStatus | None) -> Account:
    """Return the account of an active node."""
    state = session.status
    names = session.model.joint_names
    age = session.targets.age(now)
    feedback = session.feedback_arrival
    median, high = timing.percentiles()
    sentence = state.sentence(names)
    level = OK
    if state.code in (Code.WAITING, Code.PAUSED) or state.joint >= 0 or state.damped:
        level = WARN
    if state.code in (Code.NO_FEEDBACK, Code.FAULT):
        level = ERROR
    if state.code is Code.WAITING and session.last_rejected:
        sentence += f"; {session.last_rejected}"
    if recorder is not None and (recorder.lost or recorder.state == "interrupted"):
        level = max(level, WARN)
        sentence += f"; recording {recorder.state}: {recorder.reason}, {recorder.lost} messages lost"
    values = {
        "state": state.code.name.lower(),
        "limit": state.limit.value,
        "joint": names[state.joint] if state.joint >= 0 else "",
        "scale": f"{state.scale:.4f}",
        "smallest_singular_value": f"{state.smallest_singular_value:.5f}",
        "damped": str(state.damped).lower(),
        "target_age_s": "never" if age is None else f"{age:.3f}",
        "joint_state_age_s": "never" if feedback is None else f"{(now - feedback) * 1e-9:.3f}",
        "rejected": str(sum(session.rejected.values())),
        **{f"rejected_{role}": str(count) for role, count in sorted(session.rejected.items())},
        "last_rejected": session.last_rejected,
        "period_p50_us": f"{median:.1f}",
        "period_p99_us": f"{high:.1f}",
        "missed": str(loop.missed),
        "stalls": str(loop.stalls),
        "recorder": "off" if recorder is None else recorder.state,
        "recorded_messages": "0" if recorder is None else str(recorder.messages),
        "recorder_lost": "0" if recorder is None else str(recorder.lost),
    }
    return Account(level, sentence, session.model.robot_name, values)
