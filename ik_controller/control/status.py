"""Status: what one step did and, where the arm does not follow, why; a code with a sentence."""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import NamedTuple


class Code(IntEnum):
    """What the arm is doing; the values are stable, they are recorded."""

    WAITING = 0  # no joint state has come yet
    HOLDING = 1  # no live target: at rest
    TRACKING = 2
    STOPPING = 3  # decelerating to rest
    PAUSED = 4
    NO_FEEDBACK = 5  # joint states have stopped coming
    FAULT = 6  # latched; reset clears it


SENTENCES = {
    Code.WAITING: "waiting for the first joint state",
    Code.HOLDING: "holding: no live target",
    Code.TRACKING: "tracking",
    Code.STOPPING: "stopping",
    Code.PAUSED: "paused",
    Code.NO_FEEDBACK: "joint states have stopped: the arm is halted",
    Code.FAULT: "fault: reset to go on",
}


class Limit(Enum):
    """Which limit held the arm back."""

    NONE = ""
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    POSITION = "position"


class Status(NamedTuple):
    """One step's status.

    `scale`: share of the wanted velocity that was commanded, 1 where no limit held it back; `limit`, `joint`: which
    limit of which joint (index, −1 none); `damped`: near a singularity; `smallest_singular_value` σ_min of J.
    """

    code: Code
    scale: float = 1.0
    limit: Limit = Limit.NONE
    joint: int = -1
    damped: bool = False
    smallest_singular_value: float = float("nan")

    def sentence(self, joint_names: tuple[str, ...] = ()) -> str:
        """Return the status as one sentence for people."""
        parts = [SENTENCES[self.code]]
        if self.limit is not Limit.NONE and self.joint >= 0:
            name = joint_names[self.joint] if self.joint < len(joint_names) else str(self.joint)
            parts.append(f"{self.limit.value} limit of '{name}', at {100.0 * self.scale:.0f} % of the wanted speed")
        if self.damped:
            parts.append(f"near a singularity (σ = {self.smallest_singular_value:.3g}), damped")
        return "; ".join(parts)
