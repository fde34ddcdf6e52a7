"""Attempts of a solver from several starts, and what their ends mean together (N7).

An attempt works on q (n,) in place: attempt(q, number, within limits?, careful?) returns how it ended, its iterations
and the errors [m], [rad] at q.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_controller.kinematics.chain import chain_of
from ik_controller.kinematics.levenberg_marquardt import CONVERGED, STATIONARY
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.solution import Iterate, Solution
from ik_controller.kinematics.task import Task

Array = NDArray[np.float64]
Attempt = Callable[[Array, int, bool, bool], tuple[int, int, float, float]]

SAME_SOLUTION = 1e-3  # [rad or m] two iterated solutions nearer than this are one
SAME_COST = 1e-4  # two closest points whose squared distances differ by a smaller share are equally far
POLISHED = 4  # so many of the nearest ends are brought as close as they get
PROBED = 10  # so many more are tried without limits, to tell a limit from a pose out of reach


class _End(NamedTuple):
    cost: float
    q: Array
    position_error: float
    orientation_error: float
    ended: int


def search(
    model: RobotModel,
    task: Task,
    attempt: Attempt,
    closer: Attempt,
    start: Array,
    again: int,
    seed: int,
    limited: bool,
    all_solutions: bool,
    kept: list[Iterate] | None,
) -> Solution:
    """Attempt from the start and `again` random ones; `closer` is the damped attempt that judges what failed."""
    solved: list[tuple[Array, float, float]] = []
    ends: list[_End] = []
    total, number = 0, 0
    q = start
    while True:
        ended, taken, linear, angular = attempt(q, number, limited, False)
        total += taken
        if ended != CONVERGED:
            ends.append(_End(linear * linear + angular * angular, q, linear, angular, ended))
        elif all(np.abs(q - other).max() > SAME_SOLUTION for other, _, _ in solved):
            solved.append((q, linear, angular))
        if number == again or (solved and not all_solutions):
            break
        number += 1
        q = _random_start(model, number, again, seed)
    if not solved:
        return _unsolved(model, task, attempt is closer, closer, ends, limited, total, number, kept)
    return Solution(
        True,
        "converged",
        *solved[0],
        solutions=tuple(q for q, _, _ in solved),
        iterations=total,
        restarts=number,
        history=tuple(kept or ()),
    )


def _unsolved(
    model: RobotModel,
    task: Task,
    own: bool,
    closer: Attempt,
    ends: list[_End],
    limited: bool,
    total: int,
    number: int,
    kept: list[Iterate] | None,
) -> Solution:
    """Come as close as possible from the best ends, and say why not closer.

    `own`: the method asked for is the damped one itself, so that what it now reaches counts as solved.
    """
    polished: list[_End] = []
    for end in sorted(ends, key=lambda one: one.cost)[:POLISHED]:
        q = end.q.copy()
        ended, taken, linear, angular = closer(q, number + 1 + len(polished), limited, True)
        total += taken if own else 0
        if ended == CONVERGED and own:
            return Solution(True, "converged", q, linear, angular, (q,), total, number, tuple(kept or ()))
        if ended == CONVERGED:  # the pose can be reached from here, but not by these iterations
            reason = "local_minimum" if end.ended == STATIONARY else "iterations"
            return Solution(False, reason, *end[1:4], (), total, number, tuple(kept or ()))
        polished.append(_End(linear * linear + angular * angular, q, linear, angular, ended))
    polished.sort(key=lambda one: one.cost)
    nearest = polished[0]
    agree = len(polished) > 1 and polished[1].cost - nearest.cost <= SAME_COST * nearest.cost
    if _beyond_reach(model, task):
        reason = "unreachable"
    elif limited and any(closer(end.q.copy(), -1, False, True)[0] == CONVERGED for end in (*polished, *ends[:PROBED])):
        reason = "limit"
    elif agree:
        reason = "unreachable"
    elif nearest.ended == STATIONARY:
        stuck = (nearest.q <= model.lower) | (nearest.q >= model.upper)
        at_limit = limited and number == 0 and bool(stuck.any())
        reason = "limit" if at_limit else "local_minimum"
    else:
        reason = "iterations"
    return Solution(False, reason, *nearest[1:4], (), total, number, tuple(kept or ()))


def _beyond_reach(model: RobotModel, task: Task) -> bool:
    """Return whether the position is farther from the first joint than the links are long: then nothing reaches it."""
    chain = chain_of(model)
    if chain.prismatic.any() and not np.isfinite([model.lower, model.upper]).all():
        return False
    reach = np.linalg.norm(chain.translation[1:], axis=1).sum()
    ends = np.abs(chain.factor * np.stack((model.lower, model.upper))[:, chain.leader] + chain.offset).max(axis=0)
    reach += ends[chain.prismatic].sum()
    counted = task.mask[:3] * (task.axes_frame.T @ (task.position - chain.translation[0]))
    return bool(np.linalg.norm(counted) > reach)


def _random_start(model: RobotModel, number: int, count: int, seed: int) -> Array:
    """Return configuration `number` of `count` uniform ones within the limits (a turn where a joint has none)."""
    lower = np.where(np.isfinite(model.lower), model.lower, -math.pi)
    upper = np.where(np.isfinite(model.upper), model.upper, math.pi)
    start: Array = lower + (upper - lower) * _unit_samples(count, model.n, seed)[number - 1]
    return start


@lru_cache(maxsize=64)
def _unit_samples(count: int, n: int, seed: int) -> Array:
    return np.random.default_rng(seed).random((count, n))
