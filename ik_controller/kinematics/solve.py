"""solve_ik: joints for a tool pose, by iteration or in closed form, or the reason why there are none (N7-N9, N12)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.chain import PinocchioChain
from ik_controller.kinematics.checks import check_array, check_choice
from ik_controller.kinematics.inverses import INVERSES
from ik_controller.kinematics.iterate import iterate, newton, transpose
from ik_controller.kinematics.levenberg_marquardt import descend, solver_chain
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.orientation_error import DEFAULT_ORIENTATION_ERROR
from ik_controller.kinematics.search import Attempt, search
from ik_controller.kinematics.solution import Iterate, Solution
from ik_controller.kinematics.task import Task

Array = NDArray[np.float64]

METHODS = ("newton", "damped", "transpose", "analytic")
MAX_ITERATIONS = {"newton": 100, "damped": 30, "transpose": 1000}
RESTARTS = {"newton": 0, "damped": 100, "transpose": 0}
POLISH_ITERATIONS = 200


def solve_ik(
    model: RobotModel,
    pose: Any,
    q0: ArrayLike | None = None,
    method: str = "damped",
    *,
    axes: str = "xyzrpy",
    frame: str = "base",
    step: float | ArrayLike | Callable[[int], float | ArrayLike] = 1.0,
    position_tolerance: float = 1e-6,
    orientation_tolerance: float = 1e-6,
    max_iterations: int | None = None,
    restarts: int | None = None,
    seed: int = 0,
    clamp: float = math.inf,
    respect_limits: bool = True,
    all_solutions: bool = False,
    history: bool = False,
    inverse: str = "pseudo",
    inverse_options: Mapping[str, Any] | None = None,
    orientation_error: str = DEFAULT_ORIENTATION_ERROR,
    swivel: float | None = None,
) -> Solution:
    """Return joints q that put the tool at `pose`, or the closest found and why not.

    `pose`: `pin.SE3` or (7,) x y z [m] qx qy qz qw, in the base frame. `q0` (n,): the start, the middle of the ranges
    unless given. `method`: newton (θ + Λ J⁺e), transpose (θ + Λ Jᵀe), damped (Levenberg-Marquardt) or analytic (closed
    form, for arms that `closed_form.recognise` knows).

    `axes`: the subset of xyzrpy that counts, along the axes of `frame`: "base"; or "body", the desired tool frame, so
    that "xyzrp" leaves the turn about the tool's z free. With all axes, newton and transpose take their error as twist
    in "body" or "space". `step`: λ, or Λ's diagonal (n,), or a function of k that gives either. `position_tolerance`
    [m], `orientation_tolerance` [rad]. `max_iterations` per attempt, and `restarts` from random configurations by
    `seed`: 30 and 100 for damped, 100 and 0 for newton, 1000 and 0 for transpose. `clamp` [rad or m]: the most a joint
    moves in one iteration. `respect_limits`: keep every iterate within the joint limits. `all_solutions`: all that the
    closed form or the restarts find, in `solutions`. `history`: keep every iterate. `inverse`, `inverse_options`:
    newton's J⁺ by the name and options of `inverses.inverse`; `orientation_error`: newton's and transpose's, by name.
    `swivel` [rad]: the elbow's angle of a 7-joint closed form, that of q0 unless given.

    Raises ArgumentError naming the argument; a pose that cannot be reached raises nothing. Source: notes 000/003 (N7),
    001 (N12), 002 (N8, N9); damping of Chan and Lawrence 1988.
    """
    if method not in METHODS:
        check_choice(method, "method", METHODS)
    task = Task.create(pose, axes, frame, orientation_error)
    start = model.middle() if q0 is None else np.array(q0, dtype=float)
    if start.shape != (model.n,) or not math.isfinite(start.sum()):
        check_array(start, "q0", (model.n,))
    for name, value in (("position_tolerance", position_tolerance), ("orientation_tolerance", orientation_tolerance)):
        if not 0.0 <= value < math.inf:
            raise ArgumentError(f"{name}: need a finite value ≥ 0, got {value}")
    tolerance = (float(position_tolerance), float(orientation_tolerance))
    if method == "analytic":
        from ik_controller.kinematics.closed_form import solve_analytic

        return solve_analytic(model, task, start, tolerance, respect_limits, all_solutions, swivel)
    if swivel is not None:
        raise ArgumentError(f"swivel: method '{method}' does not take it, only 'analytic'")
    iterations = _count(max_iterations, "max_iterations", MAX_ITERATIONS[method], 1)
    again = _count(restarts, "restarts", RESTARTS[method], 0)
    if not clamp > 0.0:
        raise ArgumentError(f"clamp: need a value > 0, got {clamp}")
    kept: list[Iterate] | None = [] if history else None

    if method == "damped":
        if frame == "space":
            raise ArgumentError("frame: method 'damped' takes 'base' or 'body'; both minimize the same error")
        attempt = _damped(model, task, _diagonal(step, model.n, method), clamp, tolerance, iterations, kept)
        return search(model, task, attempt, attempt, start, again, seed, respect_limits, all_solutions, kept)
    check_choice(inverse, "inverse", INVERSES)
    rule = newton(inverse, inverse_options or {}) if method == "newton" else transpose
    attempt = _iterated(model, task, rule, step, clamp, tolerance, iterations, kept)
    closer = _damped(model, task, _constant(1.0, model.n), math.inf, tolerance, iterations, None)
    return search(model, task, attempt, closer, start, again, seed, respect_limits, all_solutions, kept)


def solve_damped(
    model: RobotModel, task: Task, start: Array, tolerance: tuple[float, float], limited: bool
) -> Solution:
    """Return the damped solution of a checked task, with the defaults of `solve_ik`."""
    attempt = _damped(model, task, _constant(1.0, model.n), math.inf, tolerance, MAX_ITERATIONS["damped"], None)
    return search(model, task, attempt, attempt, start, RESTARTS["damped"], 0, limited, False, None)


# -- one attempt: from a start, in place; (q, number, within limits?, careful?) → how it ended, iterations, errors


def _damped(
    model: RobotModel,
    task: Task,
    step: Array,
    clamp: float,
    tolerance: tuple[float, float],
    iterations: int,
    kept: list[Iterate] | None,
) -> Attempt:
    chain = solver_chain(model)
    frame = task.axes_frame
    rows = np.empty((0 if kept is None else max(iterations, POLISH_ITERATIONS) + 1, model.n + 2))

    def attempt(q: Array, number: int, limited: bool, careful: bool) -> tuple[int, int, float, float]:
        lower, upper = _bounds(model, limited)
        most = POLISH_ITERATIONS if careful else iterations
        ended: tuple[int, int, float, float] = descend(
            chain, task.rotation, task.position, task.mask, frame, lower, upper, model.prismatic,
            step, float(clamp), *tolerance, most, careful, q, rows,
        )  # fmt: skip
        if kept is not None and number >= 0:  # a probe without limits is none of the history's
            kept.extend(
                Iterate(number, k, row[:-2].copy(), float(row[-2]), float(row[-1]))
                for k, row in enumerate(rows[: ended[1] + 1])
            )
        return ended

    return attempt


def _iterated(
    model: RobotModel,
    task: Task,
    rule: Callable[[Array, Array], Array],
    step: Any,
    clamp: float,
    tolerance: tuple[float, float],
    iterations: int,
    kept: list[Iterate] | None,
) -> Attempt:
    chain = PinocchioChain(model)
    if callable(step):

        def schedule(k: int) -> Array:
            return _diagonal(step(k), model.n, f"k = {k}")
    else:
        constant = _diagonal(step, model.n, "step")

        def schedule(k: int) -> Array:
            return constant

    def attempt(q: Array, number: int, limited: bool, careful: bool) -> tuple[int, int, float, float]:
        lower, upper = _bounds(model, limited)
        return iterate(
            chain,
            task,
            rule,
            q,
            step=schedule,
            clamp=clamp,
            tolerance=tolerance,
            iterations=iterations,
            lower=lower,
            upper=upper,
            history=kept,
            attempt=number,
        )

    return attempt


def _bounds(model: RobotModel, limited: bool) -> tuple[Array, Array]:
    if limited:
        return model.lower, model.upper
    return np.full(model.n, -math.inf), np.full(model.n, math.inf)


# -- arguments


def _count(value: int | None, name: str, default: int, least: int) -> int:
    if value is None:
        return default
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ArgumentError(f"{name}: need a whole number ≥ {least}, got {value!r}")
    return value


def _diagonal(step: float | ArrayLike | Callable[[int], Any], n: int, where: str) -> Array:
    """Return λ or Λ's diagonal as (n,)."""
    if callable(step):
        raise ArgumentError(f"step: method '{where}' takes a number or (n,), a function of k is for newton, transpose")
    if isinstance(step, (float, int)) and 0.0 < step < math.inf:
        return _constant(float(step), n)
    values = np.asarray(step, dtype=float)
    values = np.full(n, values) if values.ndim == 0 else check_array(values, "step", (n,))
    if not (np.isfinite(values).all() and (values > 0.0).all()):
        raise ArgumentError(f"step: every value must be finite and > 0, got {values.tolist()} ({where})")
    return values


@lru_cache(maxsize=64)
def _constant(value: float, n: int) -> Array:
    return np.full(n, value)
