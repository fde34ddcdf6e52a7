"""The law q̇ = J⁺(ẋ_d + K e) + (I − J⁺J) q̇₀ (notes N11, N12), discretised to second order.

Over a cycle from t to t + dt, the error e is taken at the cycle's start and ẋ_d as the reference's secant over the
cycle, so that the feed-forward ends where the reference does. J is taken at the *predicted middle* of the cycle,
q + ½ q̇_previous dt: joint velocities change by at most a·dt between cycles, so the middle is known to O(dt²), and
with it the integration is the midpoint rule at the price of one forward kinematics more.

From far away K e asks for more than the joints can brake. q̇ = K δ decays at the rate K only while K |q̇| ≤ a; beyond,
the fastest approach that can still stop is q̇ = √(2 a (δ − a/2K²)), its tangent continuation. With r = K |q̇|/a the
ratio of the two is β = √(2r − 1)/r, taken for all joints as one so that the direction stays.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.control import plain
from ik_controller.control.kernel import (
    BRAKING,
    BRAKING_SHARE,
    BY_TOOL_ACCELERATION,
    BY_TOOL_SPEED,
    FREE,
    POSTURE,
    SCALARS,
    SEEK_LIMIT,
    TOOL_ACCELERATION,
    TOOL_SPEED,
    bound_tool,
    braking_factor,
    longer,
    stoppable_share,
    tool_cycle,
    tool_is_free,
)
from ik_controller.control.reach import near_bound
from ik_controller.control.reference import Reference
from ik_controller.control.tasks import TaskStack, is_configured
from ik_controller.errors import ArgumentError, ParameterError
from ik_controller.kinematics.accelerate import HAS_NUMBA
from ik_controller.kinematics.damped_inverse import damped_gram_inverse
from ik_controller.kinematics.inverses import INVERSES, inverse
from ik_controller.kinematics.levenberg_marquardt import kinematics, solver_chain
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.orientation_error import DEFAULT_ORIENTATION_ERROR, ORIENTATION_ERRORS
from ik_controller.parameters import ControllerParameters, gain_matrix

Array = NDArray[np.float64]

DEFAULT_INVERSE = "numerical_filtering"  # worked out inside the kernel

# The posture is sought at most at this share of the velocity limits.
_POSTURE_SHARE = 0.2


class Law:
    """The law's constants for one model and one set of parameters: `cycle` is `kernel.tool_cycle` or
    its form in NumPy, `near_bound` that of `reach`; `chain` and `table` are what the first takes.
    """

    def __init__(self, model: RobotModel, parameters: ControllerParameters) -> None:
        """Raises ParameterError where the gain does not fit."""
        n = model.n
        gain = gain_matrix(parameters.gain, 1.0 / parameters.rate)
        rates = np.abs(np.linalg.eigvals(gain))
        self.slowest_gain = float(rates.min())
        if parameters.integration_base == "measured":
            # The loop runs through the arm's delay and lag T, and is stable for K T < 1 or so.
            share = min(parameters.measured_gain / float(rates.max()), 1.0)
            gain, rates = share * gain, share * rates
        self.feed_forward = parameters.feed_forward
        self.threshold = parameters.singular_value_threshold
        self.directions = _directions(model)
        self.chain = solver_chain(model)
        self.cycle = tool_cycle if HAS_NUMBA else plain.PlainCycle(self.chain)
        self.near_bound = near_bound if HAS_NUMBA else plain.near_bound
        self.table = np.zeros((11, max(n, 9)))  # rows as `kernel` numbers them
        self.table[:6, :6] = gain
        self.table[SCALARS, :9] = (
            rates.max(),
            parameters.posture_gain if parameters.posture else 0.0,
            parameters.damping,
            parameters.singular_value_threshold,
            self.directions,
            *(bound or np.inf for bound in _tool_bounds(parameters)),
        )
        braking = BRAKING_SHARE * model.acceleration_limit * parameters.acceleration_scale
        jerk = BRAKING_SHARE * model.jerk_limit * parameters.jerk_scale
        braking = np.fmin(braking, np.sqrt(jerk * model.velocity_limit))  # more is not reached from full speed
        lag = np.zeros(n)
        np.divide(braking * braking, 2.0 * jerk, out=lag, where=np.isfinite(jerk))
        self.table[BRAKING : BRAKING + 2, :n] = braking, lag
        self.table[POSTURE, :n] = parameters.posture if parameters.posture else 0.0
        self.table[SEEK_LIMIT, :n] = _POSTURE_SHARE * model.velocity_limit * parameters.velocity_scale
        self.stack = TaskStack(model, parameters) if is_configured(parameters) else None
        self._model = model
        self._gain = gain
        self._error = ORIENTATION_ERRORS[parameters.orientation_error]
        self.by_name = parameters.inverse != DEFAULT_INVERSE
        # The default error is worked out inside the kernel.
        self.in_kernel = parameters.orientation_error == DEFAULT_ORIENTATION_ERROR and not self.by_name
        self._method, self._options = parameters.inverse, _options(parameters)
        if self.by_name:
            try:
                inverse(np.eye(6, n), self._method, **self._options)
            except ArgumentError as wrong:
                raise ParameterError(f"inverse = '{self._method}' does not fit this arm: {wrong}") from None

    def named_velocity(self, jacobian: Array, feed_forward: Array, feedback: Array, at: Array) -> Array:
        """Return J#(ẋ_d + β K e) + (I − J#J) q̇₀ (n,) with the inverse that the parameters name, for J (6, n).

        Raises ArgumentError where that inverse does not exist, as at a singularity.
        """
        n, table = at.size, self.table
        sharp = inverse(jacobian, self._method, **self._options)
        approach = sharp @ feedback
        seek = table[SCALARS, 1] * (table[POSTURE, :n] - at)
        null = seek / max(float(np.max(np.abs(seek) / table[SEEK_LIMIT, :n])), 1.0)
        steady: Array = null + sharp @ (feed_forward - jacobian @ null)
        return steady + braking_factor(approach, table[SCALARS, 0], table[BRAKING : BRAKING + 2, :n]) * approach

    def bound_tool(self, wanted: Array, jacobian: Array, last: Array, v: Array, dt: float) -> None:
        """Bring `wanted` (n,), in place, within the tool's bounds: see `kernel.bound_tool`."""
        if not tool_is_free(self.table):
            table = self.table[SCALARS]
            sharp = np.empty((6, 6))
            damped_gram_inverse(jacobian @ jacobian.T, float(table[2]), float(table[3]), sharp)
            bound_tool(wanted, jacobian, sharp, last, v, self.table, dt)

    def bound_joints(
        self, feedback: Array, feed_forward: Array, q: Array, state: Array, dt: float
    ) -> tuple[Array, int]:
        """Return the velocity (n,) towards a joint target within the tool's bounds, and which of them holds it
        back, FREE for none.

        `feedback` K (q_d − q) and `feed_forward` q̇_d (n,), at q (n,) half a cycle ahead; `state` (2n + 6): the
        last command. The speed is such that the tool can brake in time, and that the turning of J along the way takes
        half of its accelerations at most; the velocity goes from the last one towards that as far as they allow.
        """
        n, bounds, jacobian = q.size, self.table[SCALARS], self.jacobian(q)
        v, last = state[n : 2 * n], state[2 * n : 2 * n + 6]
        wanted = stoppable_share(jacobian @ feedback, self.table) * feedback + feed_forward
        most = 1.0 / max(longer(jacobian @ wanted, bounds[TOOL_SPEED], bounds[TOOL_SPEED + 1]), 1.0)
        linear, angular = bounds[TOOL_ACCELERATION : TOOL_ACCELERATION + 2] * dt
        turning = jacobian @ v - last
        excess = 2.0 * longer(turning, linear, angular)
        if excess > 1.0:
            most = min(most, float(np.linalg.norm(v) / (np.linalg.norm(wanted) * math.sqrt(excess))))
        share = self.tool_share(v, most * wanted, jacobian, last, dt)
        by = BY_TOOL_ACCELERATION if share < 1.0 else BY_TOOL_SPEED if most < 1.0 else FREE
        return v + share * (most * wanted - v), by

    def bound_approach(self, velocity: Array, jacobian: Array) -> Array:
        """Return a velocity (n,) that decays towards a target, slowed as a whole to what the tool can brake from and to
        its speeds.
        """
        tool, bounds = jacobian @ velocity, self.table[SCALARS]
        share = stoppable_share(tool, self.table)
        return share / max(share * longer(tool, bounds[TOOL_SPEED], bounds[TOOL_SPEED + 1]), 1.0) * velocity

    def tool_share(self, start: Array, end: Array, jacobian: Array, last: Array, dt: float) -> float:
        """Return how far the velocity may go from `start` to `end` (n,) for the tool's accelerations after ẋ_last (6,):
        the share, 1 for all the way; where they allow none, that which comes nearest.
        """
        linear, angular = self.table[SCALARS, TOOL_ACCELERATION : TOOL_ACCELERATION + 2] * dt
        offset, change, share = jacobian @ start - last, jacobian @ (end - start), 1.0
        for part, most in ((slice(0, 3), linear), (slice(3, 6), angular)):
            square = float(change[part] @ change[part])
            if square > 0.0 and most < math.inf:
                middle = -float(offset[part] @ change[part]) / square
                rest = middle * middle + (most * most - float(offset[part] @ offset[part])) / square
                share = min(share, max(middle + math.sqrt(max(rest, 0.0)), 0.0))
        return share

    def tool_keeps(self, tool_velocity: Array, dt: float) -> float:
        """Return the share of a tool velocity (6,) that its accelerations leave at least after braking for dt [s]."""
        linear, angular = self.table[SCALARS, TOOL_ACCELERATION : TOOL_ACCELERATION + 2]
        return max(1.0 - 1.0 / max(longer(tool_velocity, linear * dt, angular * dt), 1e-9), 0.0)

    def jacobian(self, q: Array) -> Array:
        """Return J (6, n) of the tool at q (n,)."""
        jacobian = np.empty((6, q.size))
        kinematics(self.chain, q, np.empty((3, 3)), np.empty(3), jacobian)
        return jacobian

    def feedback(self, error: Array, observed: Array) -> Array:
        """Return K e (6,): worked out of e where the kernel has measured it, else as `observe` returned it."""
        return self.table[:6, :6].dot(error) if self.in_kernel else observed

    def observe(self, reference: Reference, q: Array) -> tuple[Array, Array]:
        """Return (e (6,), K e (6,)) at q (n,): e = reference ⊖ tool [m, rad]; zeros where the reference has no pose.

        With a stack of tasks, e is 0 on free axes and within the tolerances, and K e is left to the kernel.
        """
        if reference.position is None or reference.rotation is None:
            return np.zeros(6), np.zeros(6)
        if self.stack is not None:
            return self.stack.error(reference.position, reference.rotation, q), np.zeros(6)
        tool = self._model.forward(q)
        rotation: Array = tool.rotation
        turn = self._error.function(reference.rotation, rotation)
        error = np.concatenate((reference.position - tool.translation, turn))
        feedback: Array = self._gain.dot(error)
        feedback[3:] = self._error.to_angular_velocity(feedback[3:], rotation)
        return error, feedback


def _directions(model: RobotModel) -> int:
    """Return in how many directions the tool can move at all: the largest rank of J at some configurations."""
    rng = np.random.default_rng(0)
    lower, upper = np.fmax(model.lower, -math.pi), np.fmin(model.upper, math.pi)
    return max(int(np.linalg.matrix_rank(model.jacobian(rng.uniform(lower, upper)), tol=1e-9)) for _ in range(5))


def _tool_bounds(parameters: ControllerParameters) -> tuple[float, float, float, float]:
    """Return the tool's speeds and accelerations, linear and angular; 0 where there is none."""
    return (
        parameters.tool_linear_speed,
        parameters.tool_angular_speed,
        parameters.tool_linear_acceleration,
        parameters.tool_angular_acceleration,
    )


def _options(parameters: ControllerParameters) -> dict[str, Any]:
    """Return what the inverse that the parameters name takes."""
    available = {
        "weight": np.array(parameters.inverse_weights) if parameters.inverse_weights else None,
        "damping": parameters.damping,
        "threshold": parameters.singular_value_threshold,
    }
    if parameters.inverse == "damped_manipulability":
        available["threshold"] = parameters.manipulability_threshold
    return {name: available[name] for name in available if name in INVERSES[parameters.inverse].options}
