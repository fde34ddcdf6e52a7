"""Reasons: every reason why an arm does not move, or not as it was told, with its level and what to do about it.

One table for ~/status, /diagnostics and the documentation; a status names those that hold, by key.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from ik_controller.control.status import Code, Limit, Status

OK, WARN, ERROR, STALE = range(4)  # levels of diagnostic_msgs/DiagnosticStatus
LEVELS = ("OK", "WARN", "ERROR", "STALE")


class Reason(NamedTuple):
    """`level` of diagnostics, what it means, what to do."""

    level: int
    meaning: str
    remedy: str


REASONS: dict[str, Reason] = {
    # the state: always one of these
    "unconfigured": Reason(
        STALE,
        "No robot has been taken up: robot_description has not come, or does not fit the parameters.",
        "Start robot_state_publisher, or correct what the message names; without autostart: `configure`.",
    ),
    "preparing": Reason(
        STALE, "The control loop is got ready, and the very first time compiled.", "Wait: a second, or a minute or two."
    ),
    "inactive": Reason(WARN, "Configured, and nothing is commanded.", "`activate`."),
    "finalized": Reason(STALE, "Shut down by its lifecycle service.", "End the process."),
    "waiting": Reason(
        STALE,
        "No usable joint state has come since the activation; the message says whether anybody publishes them.",
        "Start the driver, remap `joint_states`; `rejected_joint_states` tells whether some did not fit.",
    ),
    "holding": Reason(OK, "No target is live: the arm rests.", "Send targets, faster than `command_timeout`."),
    "tracking": Reason(OK, "A target is followed.", ""),
    "stopping": Reason(
        OK, "The arm brakes, for no target is live any more.", "Send targets until the goal is reached."
    ),
    "paused": Reason(WARN, "Paused by ~/pause: the arm brakes, then nothing is commanded.", "~/pause false."),
    "no_feedback": Reason(
        ERROR, "Joint states have stopped for longer than `feedback_timeout`: the arm is halted.", "See to the driver."
    ),
    "fault": Reason(ERROR, "A command was not safe and was not sent; the message says why.", "~/reset."),
    # what holds it back
    "velocity limit": Reason(
        WARN, "A joint is at its velocity limit.", "Slower targets, or raise `velocity_scale` or `velocity_limits`."
    ),
    "acceleration limit": Reason(
        WARN, "A joint is at its acceleration limit.", "Smoother targets, or raise `acceleration_scale`."
    ),
    "position limit": Reason(WARN, "A joint is at its position limit.", "Targets within reach; set a `posture`."),
    "jerk limit": Reason(WARN, "A joint is at its jerk limit.", "Smoother targets."),
    "tool speed limit": Reason(WARN, "The tool is at its speed limit.", "Slower targets, or raise the limit."),
    "tool acceleration limit": Reason(
        WARN, "The tool is at its acceleration limit.", "Smoother targets, or raise the limit."
    ),
    "obstacle": Reason(WARN, "An obstacle is near: the arm slows, and slides along it.", "Targets away from it."),
    "self collision": Reason(WARN, "Two parts of the arm are near each other.", "Targets or a `posture` away from it."),
    "infeasible": Reason(
        WARN, "The limits leave no velocity along the wanted direction: the closest is taken.", "Slower targets."
    ),
    "out of reach": Reason(
        WARN, "The target is out of reach: the arm rests at its closest approach.", "Targets within reach."
    ),
    "singular": Reason(
        WARN,
        "Near a singularity: the lost direction, which the message names, is damped.",
        "Other targets, or a `posture` away from it; `damping` and `singular_value_threshold` say how early.",
    ),
    # what is amiss around it
    "rejected": Reason(
        WARN, "A message was not usable in the last seconds; the message says which and why.", "Correct the sender."
    ),
    "publishers": Reason(
        WARN, "An input has more than one publisher; they fight over the arm.", "Stop all but one; `second_publisher`."
    ),
    "transform": Reason(
        WARN, "A target waits for its transform from TF.", "See that its frame is sent, with stamps of the same clock."
    ),
    "goal missed": Reason(
        WARN, "A trajectory has ended away from its goal.", "Slower trajectories, within reach; `goal_time`."
    ),
    "clock": Reason(WARN, "use_sim_time, and /clock stands or is not there.", "Let the simulation run."),
    "held up": Reason(
        WARN,
        "In the last seconds the process stood still for 100 ms or more: the arm has begun again from its measured "
        "position, without a target.",
        "Give the process more of the machine; targets are taken as ever, a trajectory is to be sent again.",
    ),
    "late": Reason(
        WARN,
        "More than one cycle in a hundred of the last second began after the next was due.",
        "Lower `rate`, or give the process more of the machine.",
    ),
    "recording": Reason(
        WARN,
        "The recording is not possible, interrupted, or has lost messages; the message says why.",
        "Free the disk: recording goes on by itself; or another `record_folder`.",
    ),
}

_CODES = {code: code.name.lower() for code in Code}
_LIMITS = {
    limit: limit.value if limit in (Limit.OBSTACLE, Limit.SELF_COLLISION) else f"{limit.value} limit"
    for limit in Limit
    if limit is not Limit.NONE
}


def of_status(status: Status) -> Iterator[str]:
    """Yield the keys of REASONS that hold in a step's status, the state first."""
    yield _CODES[status.code]
    if status.limit is not Limit.NONE:
        yield _LIMITS[status.limit]
    if status.closest:
        yield "out of reach"
    elif not status.feasible:
        yield "infeasible"
    if status.damped:
        yield "singular"


def level_of(reasons: list[str]) -> int:
    """Return the level of a list of keys: the worst; the arm's being unknown (STALE) comes before warnings alone."""
    return max((REASONS[reason].level for reason in reasons), key=(OK, WARN, STALE, ERROR).index)


def what_to_do(reasons: list[str]) -> str:
    """Return what to do about a list of keys, the state first."""
    return " ".join(dict.fromkeys(REASONS[reason].remedy for reason in reasons if REASONS[reason].remedy))


def table() -> str:
    """Return the Markdown table of all reasons, for the documentation."""
    lines = ["| reason | level | what it means | what to do |", "|---|---|---|---|"]
    lines += [f"| {key} | {LEVELS[r.level]} | {r.meaning} | {r.remedy} |" for key, r in REASONS.items()]
    return "\n".join(lines)
