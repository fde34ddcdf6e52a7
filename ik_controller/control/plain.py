"""One cycle without Numba: the law of `kernel` in NumPy, where a step of Python costs as much as a whole small product.

Nearly every cycle is away from all limits. Such a one goes through `PlainCycle` in some thirty calls of NumPy, Eigen
and Pinocchio into arrays made beforehand; whatever it does not cover (jerk limits, bounds of the tool, mimic joints,
fewer than six directions, other errors) goes through the kernels' own source, as does the bounded problem where the
velocity may be beyond a limit. Both ways give the same velocities but for rounding; a test holds them together.

What is looked at joint by joint is looked at as Python floats: seven joints cost less so than one reduction of NumPy.
`a.dot(b, out)` and arrays where a number would do (`_dts`) spare 0.3 µs each, of some thirty in all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import eigenpy
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.bounded import ALONG
from ik_controller.control.kernel import (
    BRAKING,
    FREE,
    POSTURE,
    SCALARS,
    SEEK_LIMIT,
    bounded_cycle,
    tool_cycle,
    tool_is_free,
)
from ik_controller.control.plain_path import MOST_JOINTS, PlainPath
from ik_controller.control.reach import ACCELERATION, BOUNDS, JERK, LAST, NEAR, VELOCITY
from ik_controller.kinematics.chain import PinocchioChain

Array = NDArray[np.float64]

_VALUES_ALONE = eigenpy.DecompositionOptions.EigenvaluesOnly


class PlainCycle:
    """`kernel.tool_cycle` for one chain, to be called as that is."""

    def __init__(self, chain: PinocchioChain) -> None:
        model = chain.model
        n = self._n = model.n
        self._fits = model.expansion is None and n >= 6
        self._pin_model, self._tool = model.pin_model, model.tool_id
        self._at, self._middle = model.pin_model.createData(), model.pin_model.createData()
        frame = self._at.oMf[self._tool]
        self._position, self._rotation = frame.translation, frame.rotation.T  # views: they follow the data
        self._e, self._gram, self._ahead, self._seek = np.empty(6), np.empty((6, 6)), np.empty(n), np.empty(n)
        self._motion = np.empty((2, n))  # v and the last acceleration
        self._linear, self._angular = self._e[:3], self._e[3:]
        self._spectrum, self._cholesky = eigenpy.SelfAdjointEigenSolver(6), eigenpy.LLT(6)
        self._law: Array | None = None
        self._table: Array | None = None

    def _take_law(self, law: Array) -> None:
        """Take apart a table of the law."""
        n, scalars = self._n, law[SCALARS].tolist()
        self._law = law
        self._plain_law = self._fits and tool_is_free(law) and scalars[4] >= 6
        self._gain = np.ascontiguousarray(law[:6, :6])
        fastest, self._posture_gain, _, self._threshold = scalars[:4]
        self._posture, self._posture_gains = law[POSTURE, :n].copy(), np.full(n, self._posture_gain)
        self._seek_limit, self._approach_limit = law[SEEK_LIMIT, :n], law[BRAKING, :n] / fastest
        self._slowest_seek, self._slowest_approach = min(self._seek_limit.tolist()), min(self._approach_limit.tolist())

    def _take_limits(self, limits: Array, dt: float) -> None:
        """Take apart a table of limits: an idle joint is one within the box that always leaves room to stop."""
        n = self._n
        self._table, self._dt, self._last = limits, dt, limits[LAST, :n]
        self._half, self._dts = np.array((0.5 * dt, 0.5 * dt * dt)), np.full(n, dt)
        velocity, acceleration = limits[VELOCITY, :n], limits[ACCELERATION, :n]
        both = limits[VELOCITY : ACCELERATION + 1]
        even = bool((both[:, :n] == both[:, n:]).all() and (both > 0.0).all())
        self._plain_limits = even and not bool(np.isfinite(limits[JERK]).any())
        with np.errstate(all="ignore"):
            stop = np.tile(velocity * (0.5 * velocity / acceleration + dt), 2)
            room = np.where(np.isfinite(limits[BOUNDS]), limits[BOUNDS] - stop, math.inf)
        finite = bool(np.isfinite(both).all())
        self._path = (
            PlainPath(velocity, acceleration * dt) if self._plain_limits and finite and n <= MOST_JOINTS else None
        )
        box = velocity, acceleration * dt, -room[n:], room[:n]
        self._box = list(zip(*(row.tolist() for row in box), strict=True))

    def __call__(
        self,
        chain: Any,
        law: Array,
        limits: Array,
        state: Array,
        at: Array,
        position: Array,
        rotation: Array,
        twist: Array,
        feedback: Array,
        measure: bool,
        reserve: bool,
        dt: float,
        out: Array,
        detail: Array,
    ) -> tuple[int, float, int, int, float]:
        """Write one cycle to `out` and `detail`, and return (how, s, joint, limit, σ_min): see `kernel.tool_cycle`."""
        if law is not self._law:
            self._take_law(law)
        if limits is not self._table or dt != self._dt:
            self._take_limits(limits, dt)
        if not (measure and self._plain_law and self._plain_limits):
            return tool_cycle(
                chain, law, limits, state, at, position, rotation, twist, feedback, measure, reserve, dt, out, detail
            )
        n, tool, ahead = self._n, self._tool, self._ahead
        v = state[n : 2 * n]
        pin.forwardKinematics(self._pin_model, self._at, at)
        pin.updateFramePlacement(self._pin_model, self._at, tool)
        np.subtract(position, self._position, self._linear)
        self._angular[:] = pin.log3(rotation.dot(self._rotation))
        motion = self._motion
        motion[0], motion[1] = v, self._last
        self._half.dot(motion, ahead)
        np.add(ahead, at, ahead)
        jacobian = pin.computeFrameJacobian(self._pin_model, self._middle, ahead, tool, pin.LOCAL_WORLD_ALIGNED)

        gram = jacobian.dot(jacobian.T, self._gram)
        smallest = self._spectrum.compute(gram, _VALUES_ALONE).eigenvalues().item(0)
        sigma = math.sqrt(max(smallest, 0.0))
        if not sigma >= 4.0 * self._threshold:  # seldom, and with more to do
            return tool_cycle(
                chain, law, limits, state, at, position, rotation, twist, feedback, measure, reserve, dt, out, detail
            )
        inverse = self._cholesky.compute(gram)
        task = self._gain.dot(self._e)
        if math.sqrt(task.dot(task)) > sigma * self._slowest_approach:  # else |J⁺K e| ≤ |K e|/σ_min is slow enough
            ratio = _largest(inverse.solve(task).dot(jacobian) / self._approach_limit)
            if ratio > 1.0:
                task *= math.sqrt(2.0 * ratio - 1.0) / ratio
        np.add(task, twist, task)
        detail[1:] = jacobian
        wanted = detail[0]
        if not self._posture_gain:
            inverse.solve(task).dot(jacobian, wanted)
        else:
            seek = self._seek
            np.subtract(self._posture, at, seek)
            np.multiply(seek, self._posture_gains, seek)
            if math.sqrt(seek.dot(seek)) > self._slowest_seek:
                np.divide(seek, max(_largest(seek / self._seek_limit), 1.0), seek)
            np.subtract(task, jacobian.dot(seek), task)
            inverse.solve(task).dot(jacobian, wanted)
            np.add(wanted, seek, wanted)

        out[2 * n + 6 :] = self._e
        q, velocity, scale, joint, limit = state[:n], wanted, 1.0, -1, FREE
        places, rates, goals = q.tolist(), v.tolist(), wanted.tolist()
        if not self._idle(goals, rates, places):
            found = None
            if self._path is not None and math.isfinite(wanted.dot(wanted)) and self._idle(rates, rates, places):
                found = self._path.velocity(goals, rates, jacobian, state[2 * n : 2 * n + 6])
            if found is None:
                return *bounded_cycle(wanted, jacobian, limits, state, reserve, True, dt, out), sigma
            velocity, scale, joint, limit = found
        np.multiply(velocity, self._dts, ahead)
        np.add(q, ahead, out[:n])
        out[n : 2 * n] = velocity
        jacobian.dot(velocity, out[2 * n : 2 * n + 6])
        return ALONG, scale, joint, limit, sigma

    def _idle(self, wanted: list[float], v: list[float], q: list[float]) -> bool:
        """Tell whether no joint at q is held back from its `wanted` velocity after v, (n,) each, nor would be by its
        bounds from any other within its limits.
        """
        for velocity, before, place, (speed, step, low, high) in zip(wanted, v, q, self._box, strict=True):
            # Written so that what is not finite fails.
            if not (-speed <= velocity <= speed and -step <= velocity - before <= step and low < place < high):
                return False
        return True


class PlainCheck:
    """`gate.check` for one table of limits (5, n), to be called as that is: one look at each joint, and the kernel
    itself where that finds anything to look at.
    """

    def __init__(self, limits: Array, check: Callable[[Array, Array, Array, Array, float], int]) -> None:
        """`check`: the kernel."""
        self._check = check
        self._limits = list(zip(*limits[:3].tolist(), strict=True))
        self._plain = not bool(np.isfinite(limits[4]).any())
        self._dt = 0.0
        self._steps, self._rates = [0.0] * limits.shape[1], np.zeros(limits.shape[1])

    def __call__(self, memory: Array, limits: Array, q: Array, v: Array, dt: float) -> int:
        """Return 0 and remember the command, or what is wrong with it: see `gate.check`."""
        if not self._plain:
            return self._check(memory, limits, q, v, dt)
        if dt != self._dt:
            self._dt, self._steps, self._rates = dt, (limits[3] * dt).tolist(), np.full(q.shape, 1.0 / dt)
        last, speed, acceleration = memory
        for place, rate, before, slower, step, (lower, upper, fastest) in zip(
            q.tolist(), v.tolist(), last.tolist(), speed.tolist(), self._steps, self._limits, strict=True
        ):
            # Nothing is left of a place that was made so.
            if not (
                place == before + rate * dt
                and -fastest <= rate <= fastest
                and -step <= rate - slower <= step
                and lower <= place <= upper
            ):
                return self._check(memory, limits, q, v, dt)
        np.subtract(v, speed, acceleration)
        np.multiply(acceleration, self._rates, acceleration)
        last[:], speed[:] = q, v
        return 0


def near_bound(q: Array, limits: Array) -> bool:
    """Tell the same as `reach.near_bound`."""
    places = q.tolist()
    rows = limits[BOUNDS : ACCELERATION + 1].tolist()
    for place, bound, speed, acceleration in zip(places + [-place for place in places], *rows, strict=True):
        slow = NEAR * speed
        if (bound - place) * acceleration < slow * slow:
            return True
    return False


def _largest(vector: Array) -> float:
    """Return the largest |vᵢ|."""
    largest: float = max(map(abs, vector.tolist()))
    return largest
