"""Controller: one cycle of the closed loop, a pure function of its state and arguments.

State is the last commanded position and velocity, nothing else: the same calls from the same `reset` give the same
bits.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ik_controller.control.bounded import bounded_velocity
from ik_controller.control.kernel import braking_factor, tool_cycle, within
from ik_controller.control.law import BRAKING_SHARE, Law
from ik_controller.control.limits import JointLimits
from ik_controller.control.reference import Reference
from ik_controller.control.status import Code, Limit, Status
from ik_controller.errors import ArgumentError, ParameterError, choices
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.small import gram, spectrum
from ik_controller.parameters import ControllerParameters, gain_matrix

Array = NDArray[np.float64]

_ZERO = np.zeros(6)
_NO_POSE = np.zeros(3), np.eye(3)


@dataclass
class Step:
    """The outcome of one cycle: the command for its end, and what was seen at its start.

    `position` (n,) [rad or m] and `velocity` (n,) [rad/s or m/s]: the command; `error` (6,) (position [m], rotation
    [rad]): reference ⊖ tool at the cycle's start, zero without a pose reference; `status`.
    """

    position: Array
    velocity: Array
    error: Array
    status: Status


class Controller:
    """The closed loop of N11 within the joints' limits: `reset(q)`, then `step(q_measured, reference, dt)` a cycle."""

    def __init__(self, model: RobotModel, parameters: ControllerParameters | None = None) -> None:
        """Raises ParameterError where a list's length does not fit the model's joints."""
        self.model = model
        self._q = np.zeros(model.n)
        self._started = False  # has there been a `reset`?
        self._v = np.zeros(model.n)
        self._fresh = False
        self.parameters = ControllerParameters()
        self.set_parameters(parameters or self.parameters)

    def set_parameters(self, parameters: ControllerParameters, model: RobotModel | None = None) -> None:
        """Take new parameters between two cycles; the command goes on without a jump. Raises ParameterError; nothing
        changes then. `model`: the same arm with another tool point.
        """
        model = model or self.model
        posture = parameters.posture
        if posture and len(posture) != model.n:
            names = choices(model.joint_names)
            raise ParameterError(f"posture: {len(posture)} values, need {model.n}, one for each of {names}")
        self._law = Law(model, parameters)
        self.model = model
        self._limits = JointLimits(self.model, parameters.velocity_scale, parameters.acceleration_scale)
        self._checked_dt = 1.0 / parameters.rate
        self.parameters = parameters

    @property
    def position(self) -> Array | None:
        """The last commanded position (n,), None before the first `reset`."""
        return self._q if self._started else None

    @property
    def velocity(self) -> Array:
        """The last commanded velocity (n,)."""
        return self._v

    def reset(self, q: ArrayLike) -> None:
        """Start at the measured q (n,), at rest: the next step commands exactly q. Raises ArgumentError if it is no
        q.
        """
        position = np.array(q, dtype=float)
        if position.shape != (self.model.n,) or not np.isfinite(position).all():
            raise ArgumentError(f"q: need {self.model.n} finite values, got {position.tolist()}")
        self._q = position
        self._v = np.zeros(self.model.n)
        self._started = self._fresh = True

    def state(self) -> dict[str, Any]:
        """Return the state as JSON types, for `restore`; floats come back bit for bit."""
        position = self._q.tolist() if self._started else None
        return {"position": position, "velocity": self._v.tolist(), "fresh": self._fresh}

    def restore(self, state: dict[str, Any]) -> None:
        """Take a state of `state`."""
        self._started = state["position"] is not None
        if self._started:
            self._q = np.array(state["position"])
        self._v = np.array(state["velocity"])
        self._fresh = bool(state["fresh"])

    def step(self, q_measured: Array | None, reference: Reference | None, dt: float) -> Step:
        """Advance one cycle of dt [s] and return the command for its end.

        `q_measured` (n,): the joints as measured, None if that is too old; `reference`: the set point, None if there is
        none: the arm then brakes within its limits and holds. Raises ArgumentError for a dt that is not positive,
        ParameterError where gain times dt is above 1; conditions of the run are in the status.
        """
        if not self._started:
            if q_measured is None:
                raise ArgumentError("step: call reset(q) with a measured position first")
            self.reset(q_measured)
        if dt != self._checked_dt:
            if not 0.0 < dt < math.inf:
                raise ArgumentError(f"dt = {dt}: need a positive time")
            gain_matrix(self.parameters.gain, dt)
            self._checked_dt = dt
        q, v = self._q, self._v
        if self._fresh:
            self._fresh = False
            code = Code.HOLDING if reference is None else Code.TRACKING
            error = np.zeros(6) if reference is None else self._law.observe(reference, q)[0]
            return Step(q, v, error, Status(code))

        base, limits = self.parameters.integration_base, self._limits
        bounds = limits.bounds
        if base == "bounded" and q_measured is not None:
            bounds = limits.bounds_around(q_measured, self.parameters.max_deviation)
        if reference is not None and not reference.in_joint_space and q_measured is not None:
            return self._follow_tool(reference, q_measured if base == "measured" else q, dt, bounds)
        limits.update(q, v, dt, bounds)
        if q_measured is None:
            return self._stop(dt, Code.NO_FEEDBACK)
        if reference is None or not reference.in_joint_space:
            return self._stop(dt, Code.HOLDING)
        return self._follow_joints(self._q if reference.joints is None else reference.joints, reference, dt)

    # -- the three ways to move

    def _follow_tool(self, reference: Reference, at: Array, dt: float, bounds: Array) -> Step:
        law, limits = self._law, self._limits
        target, turned, twist = reference.position, reference.rotation, reference.twist
        pose = _NO_POSE if target is None or turned is None else (target, turned)
        has_pose = pose is not _NO_POSE
        measure = has_pose and law.exponential
        error, feedback = (np.zeros(6), _ZERO) if measure or not has_pose else law.observe(reference, at)
        if twist is None or (has_pose and not law.feed_forward):
            twist = _ZERO
        command = np.empty((2, self.model.n))
        fits, sigma = tool_cycle(
            law.chain,
            at,
            pose,
            measure,
            feedback,
            twist,
            law.constants,
            self._q,
            self._v,
            dt,
            (bounds, limits.velocity_twice, limits.acceleration_twice),
            law.work,
            error,
            command,
        )
        wanted, position = command[0], command[1]
        jacobian, reach = law.work
        damped = sigma < law.threshold
        if law.by_name:
            if measure:
                feedback = law.constants[0].dot(error)
            with contextlib.suppress(ArgumentError):  # at a singularity: the damped velocity it is
                wanted = law.named_velocity(twist, feedback, at)
                position = self._q + dt * wanted
                fits = within(wanted, reach)
        if limits.reserve:
            reach = limits.stop_in_time(reach, self._q, self._v, dt)
            fits = within(wanted, reach)
        if fits:
            self._q, self._v = position, wanted
            return Step(position, wanted, error, Status(Code.TRACKING, 1.0, Limit.NONE, -1, damped, sigma))
        limits.take(reach)
        if not math.isfinite(wanted.dot(wanted)):
            return self._stop(dt, Code.HOLDING)
        velocity, scale, _ = bounded_velocity(
            wanted, jacobian, *spectrum(gram(jacobian)), limits.low, limits.high, limits.velocity
        )
        beyond = np.fmax(wanted - limits.high, limits.low - wanted)
        joint = int(np.argmax(beyond / limits.velocity))
        limit = limits.which(joint, wanted.item(joint), self._v, dt)
        return self._commit(velocity, dt, error, Status(Code.TRACKING, scale, limit, joint, damped, sigma))

    def _follow_joints(self, joints: Array, reference: Reference, dt: float) -> Step:
        """Joint-space target: q̇ = q̇_d + K (q_d − q), slowed as one where a joint must brake or is at a limit."""
        limits = self._limits
        if joints.shape != self._q.shape:
            names = choices(self.model.joint_names)
            raise ArgumentError(f"reference: {joints.size} joints, need {self.model.n}, one for each of {names}")
        gain = self._law.slowest_gain
        feedback = gain * (joints - self._q)
        wanted = braking_factor(feedback, gain, BRAKING_SHARE * limits.acceleration) * feedback
        if reference.joint_velocity is not None:
            wanted = wanted + reference.joint_velocity
        if not math.isfinite(wanted.dot(wanted)):
            return self._stop(dt, Code.HOLDING)
        excess = float((np.abs(wanted) / limits.velocity).max())
        scale = 1.0 / max(excess, 1.0)
        velocity = np.fmin(np.fmax(scale * wanted, limits.low), limits.high)
        gap = np.abs(wanted - velocity)
        joint = int(np.argmax(gap))
        limit = limits.which(joint, wanted.item(joint), self._v, dt) if gap.item(joint) > 0.0 else Limit.NONE
        status = Status(Code.TRACKING, scale, limit, joint if limit is not Limit.NONE else -1)
        return self._commit(velocity, dt, np.zeros(6), status)

    def _stop(self, dt: float, code: Code) -> Step:
        """Brake all joints as one, so that the arm stops along its joint-space direction, then hold."""
        limits, v = self._limits, self._v
        cycles = float((np.abs(v) / limits.acceleration).max()) / dt
        keep = max(1.0 - 1.0 / cycles, 0.0) if cycles > 0.0 else 0.0
        velocity = np.fmin(np.fmax(keep * v, limits.low), limits.high)
        if velocity.any() and code is Code.HOLDING:
            code = Code.STOPPING
        return self._commit(velocity, dt, np.zeros(6), Status(code))

    def _commit(self, velocity: Array, dt: float, error: Array, status: Status) -> Step:
        self._v = velocity
        self._q = self._q + dt * velocity
        return Step(self._q, velocity, error, status)
