"""Solution: what a solver answers, never a wrong configuration without saying so."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REASONS = {
    "converged": "the pose is reached within both tolerances",
    "limit": "the pose can only be reached, or approached further, beyond joint limits",
    "local_minimum": "the error cannot be lowered from here by small motions; another start may do better",
    "unreachable": "out of the arm's reach: by its link lengths, by its closed form, or every restart that settled "
    "ended equally far from the pose",
    "iterations": "the iterations ran out while the error was still changing",
}


class Iterate(NamedTuple):
    """One row of the history: iteration `k` of attempt `restart`, q (n,) there, its errors [m] and [rad]."""

    restart: int
    k: int
    q: Array
    position_error_m: float
    orientation_error_rad: float


@dataclass(frozen=True)
class Solution:
    """The answer to "which q puts the tool at this pose?".

    `converged`; `reason`, a key of REASONS; `q` (n,), the solution, or the closest configuration found;
    `position_error_m`, `orientation_error_rad` at q, over the axes asked for; `solutions`, every solution found, (n,)
    each, q first (empty where not converged); `iterations` over all attempts; `restarts` taken; `history`, empty unless
    asked for; `free`, a sentence for each singularity of a closed form where joints can move without moving the tool,
    so that `solutions` holds one of infinitely many.
    """

    converged: bool
    reason: str
    q: Array
    position_error_m: float
    orientation_error_rad: float
    solutions: tuple[Array, ...] = ()
    iterations: int = 0
    restarts: int = 0
    history: tuple[Iterate, ...] = ()
    free: tuple[str, ...] = field(default=())
