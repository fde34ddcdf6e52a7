"""One cycle without Numba: the law of `kernel` in NumPy, where a step of Python costs as much as a whole small product.

Nearly every cycle is away from all limits. Such a one goes through `PlainCycle` in some fifty calls of NumPy, Pinocchio
and Eigen into arrays made beforehand; whatever it does not cover (jerk limits, bounds of the tool, mimic joints, fewer
than six directions, other errors) goes through the kernels' own source, as does the bounded problem where the velocity
may be beyond a limit. Both ways give the same velocities but for rounding; a test holds them together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import eigenpy
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.kernel import (
    AHEAD,
    BRAKING,
    FREE,
    POSTURE,
    SCALARS,
    SEEK_LIMIT,
    bounded_cycle,
    tool_cycle,
    tool_is_free,
)
from ik_controller.control.reach import ACCELERATION, BOUNDS, JERK, LAST, VELOCITY
from ik_controller.kinematics.chain import PinocchioChain

Array = NDArray[np.float64]


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
        self._e, self._turn, self._sides = np.empty(6), np.empty((3, 3)), np.empty((2, 6))
        self._linear, self._angular = self._e[:3], self._e[3:]
        self._steady, self._approach = self._sides
        self._bent, self._seek, self._t = np.empty(n), np.empty(n), np.empty(n)
        self._excess = np.empty(3 * n)
        self._change, self._speed, self._place = self._excess[:n], self._excess[n : 2 * n], self._excess[2 * n :]
        self._law: Array | None = None
        self._table: Array | None = None

    def _take_law(self, law: Array) -> None:
        """Take apart a table of the law."""
        n, scalars = self._n, law[SCALARS].tolist()
        self._law = law
        self._plain_law = self._fits and tool_is_free(law) and scalars[4] >= 6
        self._gain = np.ascontiguousarray(law[:6, :6])
        self._fastest, self._posture_gain, _, self._threshold = scalars[:4]
        self._posture = law[POSTURE, :n].copy()
        self._per_seek = 1.0 / law[SEEK_LIMIT, :n]
        self._per_braking = self._fastest / law[BRAKING, :n]

    def _take_limits(self, limits: Array, dt: float) -> None:
        """Take apart a table of limits: an idle joint is one within the box that always leaves room to stop."""
        n = self._n
        self._table, self._dt = limits, dt
        rows = limits[: ACCELERATION + 1]
        even = bool((rows[VELOCITY:, :n] == rows[VELOCITY:, n:]).all())
        velocity, acceleration = rows[VELOCITY, :n], rows[ACCELERATION, :n]
        upper, lower = rows[BOUNDS, :n], -rows[BOUNDS, n:]
        with np.errstate(all="ignore"):
            self._per_change, self._per_speed = 1.0 / (acceleration * dt), 1.0 / velocity
            room = 0.5 * (upper - lower) - velocity * (0.5 * velocity / acceleration + dt)
            bounded = upper - lower < 1e9
            self._center = np.where(bounded, 0.5 * (upper + lower), 0.0)
            self._per_room = np.where(bounded, 1.0 / np.fmax(room, 1e-12), 0.0)
        self._plain_limits = not bool(np.isfinite(limits[JERK]).any()) and even and bool((velocity > 0.0).all())

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
        n = self._n
        q, v, t = state[:n], state[n : 2 * n], self._t
        pin_model, tool = self._pin_model, self._tool
        pin.forwardKinematics(pin_model, self._at, at)
        pin.updateFramePlacement(pin_model, self._at, tool)
        np.subtract(position, self._position, self._linear)
        np.dot(rotation, self._rotation, self._turn)
        self._angular[:] = pin.log3(self._turn)
        np.multiply(limits[LAST, :n], dt, self._bent)
        np.add(v, self._bent, self._bent)
        np.multiply(self._bent, 0.5 * dt, self._bent)
        np.add(at, self._bent, self._bent)
        jacobian = pin.computeFrameJacobian(pin_model, self._middle, self._bent, tool, pin.LOCAL_WORLD_ALIGNED)
        transposed = jacobian.T

        spectrum = eigenpy.SelfAdjointEigenSolver(jacobian.dot(transposed))
        values, directions = spectrum.eigenvalues(), spectrum.eigenvectors()
        sigma = math.sqrt(max(values.item(0), 0.0))
        if sigma < 4.0 * self._threshold:  # seldom, and with more to do
            return tool_cycle(
                chain, law, limits, state, at, position, rotation, twist, feedback, measure, reserve, dt, out, detail
            )
        np.dot(self._gain, self._e, self._approach)
        self._steady[:] = twist
        seek = self._seek
        if self._posture_gain:
            np.subtract(self._posture, at, seek)
            np.multiply(seek, self._posture_gain, seek)
            ratio = _largest(seek, self._per_seek, t)
            if ratio > 1.0:
                np.divide(seek, ratio, seek)
            np.subtract(self._steady, jacobian.dot(seek), self._steady)
        image = self._sides.dot(directions)
        np.divide(image, values, image)
        steady, approach = image.dot(directions.T).dot(jacobian)
        ratio = _largest(approach, self._per_braking, t)
        if ratio > 1.0:
            np.multiply(approach, math.sqrt(2.0 * ratio - 1.0) / ratio, approach)
        wanted = detail[0]
        detail[1:] = jacobian
        np.add(steady, approach, wanted)
        if self._posture_gain:
            np.add(wanted, seek, wanted)

        np.subtract(wanted, v, self._change)
        np.multiply(self._change, self._per_change, self._change)
        np.multiply(wanted, self._per_speed, self._speed)
        np.subtract(q, self._center, self._place)
        np.multiply(self._place, self._per_room, self._place)
        out[2 * n + 6 :] = self._e
        excess = self._excess
        np.absolute(excess, excess)
        if not excess.max() < 1.0:  # a limit is near; so is what is not finite
            ahead = sigma >= AHEAD * self._threshold
            return *bounded_cycle(wanted, detail[1:], limits, state, reserve, ahead, dt, out), sigma
        np.multiply(wanted, dt, t)
        np.add(q, t, out[:n])
        out[n : 2 * n] = wanted
        np.dot(jacobian, wanted, out[2 * n : 2 * n + 6])
        return 0, 1.0, -1, FREE, sigma


class PlainCheck:
    """`gate.check` for one table of limits (5, n), to be called as that is: a look at all joints at once, and the
    kernel itself where that finds anything to look at.
    """

    def __init__(self, limits: Array, check: Callable[[Array, Array, Array, Array, float], int]) -> None:
        """`check`: the kernel."""
        self._check = check
        n = limits.shape[1]
        lower, upper, velocity, acceleration, jerk = limits
        self._plain = not bool(np.isfinite(jerk).any())
        with np.errstate(all="ignore"):
            bounded = upper - lower < math.inf
            self._center = np.where(bounded, 0.5 * (upper + lower), 0.0)
            self._per_room = np.where(bounded, 2.0 / (upper - lower), 0.0)
            self._per_speed, self._per_change = 1.0 / velocity, 1.0 / acceleration
        self._plain = self._plain and bool((bounded | (np.isinf(lower) & np.isinf(upper))).all())
        self._t, self._excess = np.empty(n), np.empty(3 * n)
        self._change, self._speed, self._place = self._excess[:n], self._excess[n : 2 * n], self._excess[2 * n :]

    def __call__(self, memory: Array, limits: Array, q: Array, v: Array, dt: float) -> int:
        """Return 0 and remember the command, or what is wrong with it: see `gate.check`."""
        t = self._t
        np.multiply(v, dt, t)
        np.add(memory[0], t, t)
        np.subtract(q, t, t)  # nothing is left of a q that was made so
        np.subtract(v, memory[1], self._change)
        np.multiply(self._change, 1.0 / dt, self._change)
        if not self._plain or t.any():
            return self._check(memory, limits, q, v, dt)
        acceleration = self._change.copy()
        np.multiply(self._change, self._per_change, self._change)
        np.multiply(v, self._per_speed, self._speed)
        np.subtract(q, self._center, self._place)
        np.multiply(self._place, self._per_room, self._place)
        np.absolute(self._excess, self._excess)
        if not self._excess.max() <= 1.0:
            return self._check(memory, limits, q, v, dt)
        memory[0], memory[1], memory[2] = q, v, acceleration
        return 0


def _largest(vector: Array, weights: Array, space: Array) -> float:
    """Return max |vᵢ wᵢ|, or something smaller than 1 where it is smaller too."""
    np.multiply(vector, weights, space)
    square: float = space.dot(space)
    return float(np.absolute(space).max()) if square > 1.0 else 0.0
