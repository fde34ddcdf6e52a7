"""Closed-form inverse kinematics: all solutions of arms that are recognised from their axes (N8, N9)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.checks import check_array, check_number
from ik_controller.kinematics.closed_form.base import ClosedForm, polish, solutions_of, within_limits
from ik_controller.kinematics.closed_form.geometry import Screws
from ik_controller.kinematics.closed_form.library import library_form
from ik_controller.kinematics.closed_form.recognise import KNOWN, recognise, why_degenerate
from ik_controller.kinematics.closed_form.seven import Swivel
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.solution import Solution
from ik_controller.kinematics.task import Task

Array = NDArray[np.float64]

__all__ = ["ClosedForm", "closed_form_of", "recognise", "solve_analytic", "swivel_angle"]

SWIVEL_STEPS = 72  # swivel angles tried where the one asked for has no solution within limits


def closed_form_of(model: RobotModel) -> ClosedForm:
    """Return the arm's closed form: one of ours, or for other 6-joint arms that of the optional library.

    Raises ArgumentError where there is none, or where it needs the extra that is not installed.
    """
    form = recognise(model)
    if form is not None:
        return form
    screws = Screws.of(model)
    if screws is None:
        raise ArgumentError("method 'analytic': a joint of this arm mimics another; use 'damped'")
    wrong = why_degenerate(screws)
    if wrong is not None:
        raise ArgumentError(f"method 'analytic': the model is degenerate, {wrong}; use 'damped'")
    return library_form(screws, KNOWN)


def swivel_angle(model: RobotModel, q: ArrayLike) -> float:
    """Return the swivel angle [rad] of a shoulder-elbow-wrist arm at q (7,), as `seven` defines it (N9).

    Raises ArgumentError where the arm is not one, or q is not (7,).
    """
    form = recognise(model)
    if not isinstance(form, Swivel):
        raise ArgumentError("model: the swivel angle is that of a 7-joint shoulder-elbow-wrist arm")
    return form.angle(check_array(q, "q", (model.n,)))


def solve_analytic(
    model: RobotModel,
    task: Task,
    start: Array,
    tolerance: tuple[float, float],
    respect_limits: bool,
    all_solutions: bool,
    swivel: float | None,
) -> Solution:
    """Return the closed form's solutions, nearest to `start` (n,) first; see `solve.solve_ik`."""
    if task.frame == "space":
        raise ArgumentError("frame: method 'analytic' takes 'base' or 'body'")
    form = closed_form_of(model)
    form.require(task)
    if isinstance(form, Swivel):
        wanted = form.angle(start) if swivel is None else check_number(swivel, "swivel")
        steps = sorted(range(-SWIVEL_STEPS // 2 + 1, SWIVEL_STEPS // 2 + 1), key=abs)
        # A swivel angle that is given holds; the start's is only where the search begins.
        angles = [wanted] if swivel is not None else [wanted + 2.0 * np.pi * k / SWIVEL_STEPS for k in steps]
        forms: list[ClosedForm] = [replace(form, swivel=angle) for angle in angles]
    else:
        if swivel is not None:
            raise ArgumentError(f"swivel: the {form.name} has none")
        forms = [form]
    target = pin.SE3(task.rotation, task.position)
    beyond: list[Array] = []
    for one in forms:
        found, free = solutions_of(one, model, task, target, start, tolerance)
        kept = [q for x in found for q in within_limits(x, model)] if respect_limits else found
        if kept:
            kept.sort(key=lambda q: float(np.linalg.norm(q - start)))
            _, linear, angular = polish(model, task, kept[0])
            solutions = tuple(kept if all_solutions else kept[:1])
            return Solution(True, "converged", kept[0], linear, angular, solutions, free=tuple(free))
        beyond += found
        if not found:
            break  # a swivel angle does not change what can be reached
    return _closest(model, task, start, tolerance, respect_limits, bool(beyond))


def _closest(
    model: RobotModel, task: Task, start: Array, tolerance: tuple[float, float], limited: bool, beyond: bool
) -> Solution:
    """Come as close as possible by iteration: the closed form has no solution, or (`beyond`) none within the limits."""
    from ik_controller.kinematics.solve import solve_damped

    closest = solve_damped(model, task, start, tolerance, limited)
    if closest.converged:  # within the tolerances, but not on the spot: the closed form misses by its own round-off
        return closest
    return replace(closest, reason="limit" if beyond else "unreachable")
