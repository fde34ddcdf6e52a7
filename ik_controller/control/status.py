"""Status: what one step did and, where the arm does not follow, why; a code with a sentence."""

from __future__ import annotations

import math
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
    JERK = "jerk"
    TOOL_SPEED = "tool speed"
    TOOL_ACCELERATION = "tool acceleration"
    OBSTACLE = "obstacle"
    SELF_COLLISION = "self collision"


LIMITS = tuple(Limit)  # by the codes of the kernel, which counts them in this order

_AT_LIMIT = {
    Limit.TOOL_SPEED: "the tool's speed limit",
    Limit.TOOL_ACCELERATION: "the tool's acceleration limit",
    Limit.OBSTACLE: "an obstacle is near",
    Limit.SELF_COLLISION: "the arm is near itself",
}


class Status(NamedTuple):
    """One step's status. What a step has not worked out, because it was not needed, has its default.

    `scale`: share of the wanted velocity that was commanded, 1 where no limit held it back; `limit`, `joint`: which
    limit of which joint (index, −1 none); `damped`: near a singularity; `smallest_singular_value` σ_min of J among the
    directions that the arm can move in at all; `feasible`: False where no velocity within the limits keeps the wanted
    direction, and the closest one is taken; `closest`: the target is out of reach, and the arm rests at its closest
    approach; `pair`: names of the two bodies whose distance is the limit, or empty; `distance` of that pair [m];
    `condition_number` σ_max / σ_min; `singular_direction`: the unit twist (v, ω) (6) of σ_min where `damped`, in the
    base frame, or empty; `position_error` [m], `orientation_error` [rad]: lengths of the step's error; `reason`: what
    a FAULT was, or what else there is to say.
    """

    code: Code
    scale: float = 1.0
    limit: Limit = Limit.NONE
    joint: int = -1
    damped: bool = False
    smallest_singular_value: float = math.nan
    feasible: bool = True
    closest: bool = False
    pair: tuple[str, ...] = ()
    distance: float = math.nan
    condition_number: float = math.nan
    singular_direction: tuple[float, ...] = ()
    position_error: float = math.nan
    orientation_error: float = math.nan
    reason: str = ""

    def sentence(self, joint_names: tuple[str, ...] = ()) -> str:
        """Return the status as one sentence for people."""
        parts = [SENTENCES[self.code]]
        if self.code is Code.FAULT and self.reason:
            parts[0] = f"fault: {self.reason}; reset to go on"
        elif self.reason:
            parts.append(self.reason)
        held = self._limit_sentence(joint_names)
        if held:
            parts.append(held)
        if self.closest:
            off = "" if math.isnan(self.position_error) else f", {self._error_sentence()} away"
            parts.append(f"the target is out of reach: at rest at the closest approach{off}")
        elif not self.feasible:
            parts.append("the wanted direction cannot be kept within the limits: the closest velocity is taken")
        if self.damped:
            lost = f": {in_words(self.singular_direction)}" if self.singular_direction else ""
            parts.append(f"near a singularity (σ = {self.smallest_singular_value:.3g}), damped{lost}")
        return "; ".join(parts)

    def _limit_sentence(self, joint_names: tuple[str, ...]) -> str:
        if self.limit is Limit.NONE:
            return ""
        share = f"at {100.0 * self.scale:.0f} % of the wanted speed"
        if self.limit in _AT_LIMIT:
            between = f" ({' and '.join(self.pair)}" if self.pair else ""
            if between:
                between += ")" if math.isnan(self.distance) else f", {self.distance:.3f} m)"
            return f"{_AT_LIMIT[self.limit]}{between}, {share}"
        if self.joint < 0:
            return ""
        name = joint_names[self.joint] if self.joint < len(joint_names) else str(self.joint)
        return f"{self.limit.value} limit of '{name}', {share}"

    def _error_sentence(self) -> str:
        return f"{self.position_error:.4g} m and {self.orientation_error:.4g} rad"


_TRACKING = Code.TRACKING
_DEFAULTS = Status(_TRACKING)[7:]


def followed(scale: float, limit: Limit, joint: int, damped: bool, sigma: float, feasible: bool) -> Status:
    """Return the status of a cycle that tracks; NamedTuple's own constructor would take three times as long."""
    return tuple.__new__(Status, (_TRACKING, scale, limit, joint, damped, sigma, feasible, *_DEFAULTS))


def in_words(direction: tuple[float, ...]) -> str:
    """Return what an arm cannot do that cannot move along a twist (v, ω) (6): "cannot move along z"."""
    linear, angular = direction[:3], direction[3:]
    parts = []
    length, turn = math.hypot(*linear), math.hypot(*angular)
    # A part below a fifth of the other is not worth its words.
    if length > 0.2 * turn:
        parts.append(f"move along {_axis(linear)}")
    if turn > 0.2 * length:
        parts.append(f"turn about {_axis(angular)}")
    return "cannot " + " together with ".join(parts) if parts else ""


def _axis(vector: tuple[float, ...]) -> str:
    """Return a vector's direction: the name of an axis that it is within 5° of, or three numbers."""
    length = math.hypot(*vector)
    for name, value in zip("xyz", vector, strict=True):
        if abs(value) > 0.996 * length:
            return name
    return "(" + ", ".join(f"{value / length:.2f}" for value in vector) + ")"
