"""Which solver for the bounded problem: saturation in the null space, the active set, DAQP; on the Panda at random.

Prints µs a solution (median over problems, compiled loops of 20 calls; DAQP through its Python module) and by how much
saturation in the null space (Flacco, De Luca and Khatib 2012, algorithm 1) is slower than the true solution.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import daqp
import numpy as np

from ik_controller.control.bounded import SCALE_WEIGHT, bounded_velocity
from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.small import inverse_spd, loop_gram, loop_times, loop_transposed_times
from ik_controller.robots import build_model, bundled_parameters

CALLS = 20


@compiled
def saturate(x, J, low, high):
    """Return the scale s that saturation in the null space finds for J q̇ = s x within [low, high]."""
    n = J.shape[1]
    free, held, best = np.ones(n), np.zeros(n), 0.0
    inverse, image, along, base = np.empty((6, 6)), np.empty((2, 6)), np.empty(n), np.empty(n)
    while True:
        open_columns = J.copy()
        for j in range(n):
            open_columns[:, j] *= free[j]
        inverse_spd(loop_gram(open_columns, np.empty((6, 6))), inverse)
        if inverse[0, 0] <= 0.0:
            return best
        loop_transposed_times(open_columns, loop_times(inverse, x, image[0]), along)
        loop_times(inverse, loop_times(J, held, image[0]), image[1])
        base[:] = held - loop_transposed_times(open_columns, image[1], base)
        fits, most, least, critical = True, 1.0, 0.0, -1
        for j in range(n):
            if not low[j] - 1e-12 <= along[j] + base[j] <= high[j] + 1e-12:
                fits = False
            if free[j] > 0.0 and along[j] != 0.0:
                one, other = (high[j] - base[j]) / along[j], (low[j] - base[j]) / along[j]
                if max(one, other) < most:
                    most, critical = max(one, other), j
                least = max(least, min(one, other))
        if fits:
            return 1.0
        if most >= least:
            best = max(best, most)
        if critical < 0:
            return best
        free[critical] = 0.0
        held[critical] = high[critical] if along[critical] + base[critical] > high[critical] else low[critical]


@compiled
def repeat_saturate(x, J, low, high):
    """Call it so often that the clock sees it."""
    scale = 0.0
    for _ in range(CALLS):
        scale = saturate(x, J, low, high)
    return scale


@compiled
def repeat_bounded(w, J, last, low, high, limit, step, rows, bounds, velocity):
    """Call it so often that the clock sees it."""
    scale = 0.0
    for _ in range(CALLS):
        scale, _ = bounded_velocity(w, J, last, low, high, limit, step, rows, bounds, velocity)
    return scale


def microseconds(function: Callable[[], object]) -> float:
    """Return the shortest time [µs] of one of the calls that `function` makes CALLS of."""
    best = float("inf")
    for _ in range(40):
        start = time.perf_counter()
        function()
        best = min(best, time.perf_counter() - start)
    return best / CALLS * 1e6


def by_daqp(w, J, low, high, limit) -> Callable[[], None]:
    """Return the calls of DAQP on the same program in its eight variables, matrices made beforehand."""
    deviation = np.column_stack((np.diag(1.0 / limit), -w / limit))
    hessian = deviation.T @ deviation
    hessian[7, 7] += SCALE_WEIGHT
    rows = np.ascontiguousarray(np.column_stack((J, -J @ w)))
    upper, lower = np.concatenate((high, [1.0], np.zeros(6))), np.concatenate((low, np.zeros(7)))
    sense, linear = np.repeat(np.array([0, 5], dtype=np.int32), (8, 6)), np.append(np.zeros(7), -SCALE_WEIGHT)

    def calls() -> None:
        for _ in range(CALLS):
            daqp.solve(hessian, linear, rows, upper, lower, sense)

    return calls


def main() -> None:
    """Print the table."""
    model, rng = build_model(bundled_parameters("panda")), np.random.default_rng(0)
    limit, step, last, velocity = model.velocity_limit.copy(), np.full(7, np.inf), np.zeros(6), np.empty(7)
    nothing = np.zeros((0, 7)), np.zeros(0)
    times: dict[str, list[float]] = {"null space": [], "active set": [], "active set, 10 rows": [], "DAQP": []}
    losses, count = [], 0
    while count < 2000:
        J = np.ascontiguousarray(model.jacobian(rng.uniform(model.lower, model.upper)))
        wanted = np.linalg.pinv(J) @ rng.normal(size=6)
        wanted *= 10 ** rng.uniform(-0.3, 0.7) / np.max(np.abs(wanted) / limit)
        low, high = -limit * rng.uniform(0.2, 1.0, 7), limit * rng.uniform(0.2, 1.0, 7)
        if np.linalg.svd(J)[1][-1] < 0.05 or ((low <= wanted) & (wanted <= high)).all():
            continue
        count += 1
        x = J @ wanted
        args = wanted, J, last, low, high, limit, step
        losses.append(repeat_bounded(*args, *nothing, velocity) - saturate(x, J, low, high))
        if count <= 100:
            rows = rng.normal(size=(10, 7)), np.abs(rng.normal(size=10)) * 2.0
            times["null space"].append(microseconds(lambda: repeat_saturate(x, J, low, high)))  # noqa: B023
            times["active set"].append(microseconds(lambda: repeat_bounded(*args, *nothing, velocity)))  # noqa: B023
            times["active set, 10 rows"].append(microseconds(lambda: repeat_bounded(*args, *rows, velocity)))  # noqa: B023
            times["DAQP"].append(microseconds(by_daqp(wanted, J, low, high, limit)))
    for name, values in times.items():
        print(f"{name:20} {statistics.median(values):6.1f} µs")
    slower = [loss for loss in losses if loss > 1e-6]
    print(f"the null space's scale is too small in {len(slower)} of {count}, by {max(slower):.2f} at most")


if __name__ == "__main__":
    main()
