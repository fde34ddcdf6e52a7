"""Cycles worked out ahead, many in one call: what a replay may do, which knows when the next ones are.

Out of Python, a cycle takes a third of the time. It is the same kernel of the law and the same gate on the same
numbers, so the bits are the same; a cycle for which they are not the whole story is left for `Controller.step`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.control.bounded import CLOSEST
from ik_controller.control.gate import check
from ik_controller.control.kernel import NOT_FINITE, SCALARS, rests_away, tool_cycle
from ik_controller.control.reach import LAST, near_bound
from ik_controller.kinematics.accelerate import compiled

Array = NDArray[np.float64]


@compiled
def cycles_ahead(
    chain: Any,
    law: Array,
    limits: Array,
    own_limits: Array,
    speeds: Array,
    poses: Array,
    twists: Array,
    feed_forward: bool,
    reserve: bool,
    dt: float,
    states: Array,
    memories: Array,
    outcomes: Array,
) -> int:
    """Work out a cycle for each reference, as many as need nothing more than this; return how many.

    The references: `poses` (k, 4, 3), rotation over position, and `twists` (k, 6). States `states` (k + 1, 2n + 12) and
    the gate's `memories` (k + 1, 3, n) begin with the last ones; `outcomes` (k, 5): what `tool_cycle` returns.
    `own_limits`: the gate's; `speeds` (n,): see `rests_away`.
    """
    n = speeds.shape[0]
    detail, still = np.empty((7, n)), np.zeros(6)
    count: int = poses.shape[0]
    for k in range(count):
        state, memory, pose = states[k, : 2 * n + 6], memories[k], poses[k]
        limits[LAST, :n] = memory[2]
        how, scale, joint, limit, sigma = tool_cycle(
            chain, law, limits, state, state[:n], pose[3], pose[:3], twists[k] if feed_forward else still, still, True,
            reserve, dt, states[k + 1], detail,
        )  # fmt: skip
        if how == NOT_FINITE or (scale < 1.0 and near_bound(state[:n], limits)):
            return k
        q, v, error = states[k + 1, :n], states[k + 1, n : 2 * n], states[k + 1, 2 * n + 6 :]
        may_rest = sigma < law[SCALARS, 3] or how == CLOSEST or law[SCALARS, 4] < 6.0
        if may_rest and rests_away(v, error, speeds):
            return k
        memories[k + 1] = memory
        if check(memories[k + 1], own_limits, q, v, dt) != 0:
            return k
        outcomes[k, 0], outcomes[k, 1], outcomes[k, 2], outcomes[k, 3], outcomes[k, 4] = how, scale, joint, limit, sigma
    return count
