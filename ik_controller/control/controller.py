"""Controller: one cycle of the closed loop, a pure function of its state and arguments.

State is the last commanded position, velocity and acceleration, the tool velocity that came of it, and whether the gate
has fired, nothing else: the same calls from the same `reset` give the same bits.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ik_controller.control.ahead import cycles_ahead
from ik_controller.control.bounded import CLOSEST
from ik_controller.control.closest import slide
from ik_controller.control.gate import Gate
from ik_controller.control.kernel import (
    BRAKING,
    BY_POSITION,
    FREE,
    NOT_FINITE,
    bounded_cycle,
    braking_factor,
    rests_away,
    tool_is_free,
)
from ik_controller.control.law import Law
from ik_controller.control.limits import JointLimits
from ik_controller.control.obstacles import Obstacles, Scene
from ik_controller.control.reach import BOUNDS, LAST
from ik_controller.control.reference import Reference
from ik_controller.control.stack import stack_cycle
from ik_controller.control.status import LIMITS, Code, Limit, Status, followed
from ik_controller.control.tasks import TaskStack
from ik_controller.errors import ArgumentError, ParameterError, choices
from ik_controller.kinematics.accelerate import HAS_NUMBA
from ik_controller.kinematics.model import RobotModel
from ik_controller.parameters import ControllerParameters, gain_matrix

Array = NDArray[np.float64]

_ZERO = np.zeros(6)
_NO_POSE = np.zeros(3), np.eye(3)


@dataclass(slots=True)
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

    def __init__(
        self, model: RobotModel, parameters: ControllerParameters | None = None, scene: Scene | None = None
    ) -> None:
        """`scene`: what may not touch, that of the parameters unless given. Raises ParameterError where a list's length
        does not fit the model's joints, ModelError or ParameterError where the scene cannot be made.
        """
        self.model = model
        self._n = model.n
        self.scene = Scene.of(model, parameters or ControllerParameters()) if scene is None else scene
        self._started = False  # has there been a `reset`?
        self._fresh = False
        self._outside = False  # did the arm start outside its bounds, and has not come inside yet?
        self.fault = ""
        self._gate = Gate(model)
        self._detail = np.zeros((7, model.n))  # of one cycle: its wanted velocity and the J that it was made with
        self._wanted, self._task = self._detail[0], self._detail[1:]
        self._keep(np.zeros(2 * model.n + 6))
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
        self._limits = JointLimits(
            model, parameters.velocity_scale, parameters.acceleration_scale, parameters.jerk_scale
        )
        self._obstacles = Obstacles(model, parameters, self.scene)
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

    @property
    def at_rest(self) -> bool:
        """Is the last command at rest, so that none need follow?"""
        return not self._v.any() and self._limits.may_hold(self._gate.acceleration, self._checked_dt)

    def reset(self, q: ArrayLike) -> None:
        """Start at the measured q (n,), at rest: the next step commands exactly q. Clears a fault. Raises ArgumentError
        if it is no q.
        """
        position = np.array(q, dtype=float)
        if position.shape != (self.model.n,) or not np.isfinite(position).all():
            raise ArgumentError(f"q: need {self.model.n} finite values, got {position.tolist()}")
        self._keep(np.concatenate((position, np.zeros(self._n + 6))))
        self._started = self._fresh = True
        self._outside = bool(self._limits.outside(position).any())
        self.fault = ""
        self._gate.start(position)

    def _keep(self, state: Array) -> None:
        """Take a new state (2n + 6,): position, velocity, tool velocity."""
        n = self._n
        self._state, self._q, self._v = state, state[:n], state[n : 2 * n]

    def state(self) -> dict[str, Any]:
        """Return the state as JSON types, for `restore`; floats come back bit for bit."""
        n, state = self._n, self._state[: 2 * self._n + 6].tolist()
        return {
            "position": state[:n] if self._started else None,
            "velocity": state[n : 2 * n],
            "tool_velocity": state[2 * n :],
            "acceleration": self._gate.acceleration.tolist(),
            "fresh": self._fresh,
            "fault": self.fault,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Take a state of `state`."""
        self._started = state["position"] is not None
        position = state["position"] if self._started else [0.0] * self._n
        self._keep(np.array([*position, *state["velocity"], *state.get("tool_velocity", _ZERO)], dtype=float))
        self._gate.memory[:] = self._q, self._v, state.get("acceleration", np.zeros(self._n))
        self._fresh = bool(state["fresh"])
        self._outside = bool(self._limits.outside(self._q).any())
        self.fault = str(state.get("fault", ""))

    def step(self, q_measured: Array | None, reference: Reference | None, dt: float) -> Step:
        """Advance one cycle of dt [s] and return the command for its end.

        `q_measured` (n,): the joints as measured, None if that is too old; `reference`: the set point, None if there is
        none: the arm then brakes within its limits and holds. Raises ArgumentError for a dt that is not positive,
        ParameterError where gain times dt is above 1; conditions of the run are in the status. A command that is not
        fit to publish is not returned: from there on the arm brakes and holds, with the code FAULT, until `reset`.
        """
        if not self.fault:
            step = self._advance(q_measured, reference, dt)
            self.fault = self._gate.passes(step.position, step.velocity, dt)
            if not self.fault:
                return step
        self._keep(np.concatenate((*self._gate.braking(dt), _ZERO)))
        return Step(self._q, self._v, np.zeros(6), Status(Code.FAULT, reason=self.fault))

    def goes_ahead(self, dt: float) -> bool:
        """Tell whether nothing but the law has a say in the next cycles, dt [s] each, by what is known before them."""
        law = self._law
        plain = law.in_kernel and law.stack is None and self.parameters.integration_base == "commanded"
        ready = self._started and not (self._fresh or self._outside or self.fault) and dt == self._checked_dt
        return HAS_NUMBA and plain and ready and not self._obstacles.watching

    def go_ahead(self, poses: Array, twists: Array, dt: float) -> tuple[Array, Reference, Status] | None:
        """Run the next cycles, where it `goes_ahead`: to poses (k, 4, 3), rotation over position, with twists (k, 6);
        as many as nothing but the law has a say in.

        Return their states (k, 2n + 12): position, velocity, the tool's velocity, error; with the last one's reference
        and status. None where `step` has to run the first one.
        """
        law, n, count = self._law, self._n, len(poses)
        states, memories = np.empty((count + 1, 2 * n + 12)), np.empty((count + 1, 3, n))
        states[0, : 2 * n + 6], memories[0] = self._state[: 2 * n + 6], self._gate.memory
        outcomes = np.empty((count, 5))
        done = cycles_ahead(
            law.chain, law.table, self._limits.table, self._gate.limits, self._limits.velocity, poses, twists,
            law.feed_forward, self._limits.reserve, dt, states, memories, outcomes,
        )  # fmt: skip
        if not done:
            return None
        self._keep(states[done])
        self._gate.memory = memories[done]
        how, scale, joint, limit, sigma = outcomes[done - 1].tolist()
        status = followed(scale, LIMITS[int(limit)], int(joint), sigma < law.threshold, sigma, how != CLOSEST)
        pose = poses[done - 1]
        return states[1 : done + 1], Reference(pose[3], pose[:3], twists[done - 1]), status

    def halt(self, reason: str) -> None:
        """Latch a fault that was found outside: from the next step on the arm brakes and holds."""
        self.fault = reason

    def clear_fault(self) -> None:
        """Go on after a fault, from the command that is held."""
        self.fault = ""

    def _advance(self, q_measured: Array | None, reference: Reference | None, dt: float) -> Step:
        """Return the next command, not yet seen by the gate."""
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
        table = limits.table
        if base != "commanded" and q_measured is not None:  # for measured, against winding up on an arm held fast
            table = limits.table_around(q_measured, self.parameters.max_deviation)
        table[LAST, : self._n] = self._gate.acceleration
        if self._outside:
            outside = limits.outside(q)
            self._outside = bool(outside.any())
            table = limits.table_returning(table, outside)
        if reference is not None and not reference.in_joint_space and q_measured is not None:
            return self._follow_tool(reference, q_measured if base == "measured" else q, dt, table)
        limits.update(q, v, dt, table)
        self._obstacles.update(q, v, self._gate.acceleration, limits, dt)
        if q_measured is None:
            return self._stop(dt, Code.NO_FEEDBACK)
        if reference is None or not reference.in_joint_space:
            return self._stop(dt, Code.HOLDING)
        return self._follow_joints(self._q if reference.joints is None else reference.joints, reference, dt)

    # -- the three ways to move

    def _follow_tool(self, reference: Reference, at: Array, dt: float, table: Array) -> Step:
        law, n, reserve = self._law, self._n, self._limits.reserve
        position, rotation, twist = reference.position, reference.rotation, reference.twist
        has_pose = position is not None and rotation is not None
        if position is None or rotation is None:
            position, rotation = _NO_POSE
        if twist is None or (has_pose and not law.feed_forward):
            twist = _ZERO
        measure = has_pose and law.in_kernel
        error, feedback = law.observe(reference, at) if has_pose and not measure else (_ZERO, _ZERO)
        out = np.empty(2 * n + 12)
        if law.stack is not None:
            return self._follow_stack(law.stack, has_pose, at, (position, rotation, twist), dt, table)
        wanted, jacobian = self._wanted, self._task
        how, scale, joint, limit, sigma = law.cycle(
            law.chain, law.table, table, self._state, at, position, rotation, twist, feedback, measure, reserve, dt,
            out, self._detail,
        )  # fmt: skip
        if law.by_name:
            with contextlib.suppress(ArgumentError):  # at a singularity: the damped velocity it is
                jacobian = law.jacobian(self._middle(at, dt))
                wanted = law.named_velocity(jacobian, twist, feedback, at)
                law.bound_tool(wanted, jacobian, self._state[2 * n : 2 * n + 6], self._v, dt)
                how, scale, joint, limit = bounded_cycle(wanted, jacobian, table, self._state, reserve, False, dt, out)
        if not measure:
            out[2 * n + 6 :] = error
        if scale < 1.0 and has_pose and how != NOT_FINITE and law.near_bound(self._q, table):
            tool, ask = law.jacobian(self._middle(at, dt)), law.feedback(out[2 * n + 6 :], feedback) + twist
            how, joint, limit = self._slide(tool, np.eye(6), ask, wanted, dt, table, out) or (how, joint, limit)

        status = followed(scale, LIMITS[limit], joint, sigma < law.threshold, sigma, how != CLOSEST)
        return self._finish(out, how == NOT_FINITE, has_pose, status, wanted, jacobian, dt, table)

    def _middle(self, at: Array, dt: float) -> Array:
        """Return where the joints are half a cycle after `at` (n,), if they accelerate on."""
        middle: Array = at + 0.5 * dt * (self._v + dt * self._gate.acceleration)
        return middle

    def _finish(
        self,
        out: Array,
        lost: bool,
        has_pose: bool,
        status: Status,
        wanted: Array,
        task: Array,
        dt: float,
        table: Array,
    ) -> Step:
        """Take the cycle's outcome, unless an obstacle stands in its way or it is `lost`: not finite.

        `wanted` (n,): the velocity before the joints' limits; `task` (m, n): the Jacobian that it was made with.
        """
        n = self._n
        obstacles = self._obstacles
        watching = obstacles.watching
        if lost or watching:
            self._limits.update(self._q, self._v, dt, table)
            obstacles.update(self._q, self._v, self._gate.acceleration, self._limits, dt)
        if lost:
            return self._stop(dt, Code.HOLDING)
        if watching and not (obstacles.let(wanted) and obstacles.allow(out[n : 2 * n])):
            status = status._replace(scale=1.0, limit=Limit.NONE, joint=-1, feasible=True)
            return self._pass_by(wanted, task, dt, out[2 * n + 6 :], status)
        self._keep(out)
        may_rest = status.damped or not status.feasible or self._law.directions < 6
        if has_pose and may_rest and rests_away(self._v, out[2 * n + 6 :], self._limits.velocity):
            status = status._replace(closest=True)
        return Step(self._q, self._v, out[2 * n + 6 :], status)

    def explain(self, status: Status) -> Status:
        """Return the last step's status with what takes too long to work out in every cycle: condition number, singular
        direction, the lengths of the error.
        """
        if not self._started or status.code not in (Code.TRACKING, Code.STOPPING, Code.HOLDING):
            return status
        axes, rank = np.eye(6), self._law.directions
        if self._law.stack is not None:
            axes, rank = self._law.stack.selected(self._q)
        directions, values, _ = np.linalg.svd(axes @ self._law.jacobian(self._q))
        directions, rank = axes.T @ directions, min(rank, values.size)
        smallest = values.item(rank - 1)
        error = self._state[2 * self._n + 6 :]
        return status._replace(
            smallest_singular_value=smallest,
            condition_number=values.item(0) / smallest if smallest > 0.0 else math.inf,
            singular_direction=tuple(directions[:, rank - 1].tolist()) if status.damped else (),
            position_error=math.hypot(*error[:3]) if error.size else math.nan,
            orientation_error=math.hypot(*error[3:]) if error.size else math.nan,
        )

    def _slide(
        self,
        jacobian: Array,
        axes: Array,
        task_velocity: Array,
        wanted: Array,
        dt: float,
        table: Array,
        out: Array,
    ) -> tuple[int, int, int] | None:
        """Lead the velocity in `out` over to the way to the closest approach, as far as joints at their bounds keep the
        tool from its direction; return (how, joint, limit), None where none does.

        `jacobian` (6, n) of the tool; `axes` (m, 6) of it that are to move, and how, (m,); `wanted` (n,), that by the
        law.
        """
        limits, law, n = self._limits, self._law, self._n
        room = table[BOUNDS] - np.concatenate((self._q, -self._q))
        closer, share, joint = slide(axes, jacobian, task_velocity, wanted, room, limits.velocity, law.table, dt)
        if not share > 0.0:
            return None
        limits.update(self._q, self._v, dt, table)
        before, bounded = out[n : 2 * n], not tool_is_free(law.table)
        if bounded:
            closer = law.bound_approach(closer, jacobian)
        velocity = before + share * (np.fmin(np.fmax(closer, limits.low), limits.high) - before)
        if bounded:
            way = law.tool_share(self._v, velocity, jacobian, self._state[2 * n : 2 * n + 6], dt)
            velocity = limits.part_way(self._v, velocity, way)
        out[: 2 * n + 6] = np.concatenate((self._q + dt * velocity, velocity, jacobian @ velocity))
        return CLOSEST, joint, BY_POSITION

    def _follow_stack(
        self, stack: TaskStack, has_pose: bool, at: Array, target: tuple[Any, Any, Array], dt: float, table: Array
    ) -> Step:
        """Follow a tool reference (position, rotation, twist) with the axes and tasks that the parameters select."""
        law, n = self._law, self._n
        position, rotation, twist = target
        out, detail = np.zeros(2 * n + 12), np.zeros((7, n))
        how, scale, joint, limit, sigma = stack_cycle(
            law.chain, law.table, table, self._state, at, position, np.ascontiguousarray(rotation), twist, has_pose,
            self._limits.reserve, dt, out, detail, *stack.tables,
        )  # fmt: skip
        if scale < 1.0 and has_pose and how != NOT_FINITE and law.near_bound(self._q, table):
            tool = law.jacobian(self._middle(at, dt))
            rows, ask = stack.wanted(position, rotation, twist, out[2 * n + 6 :], law.table[:6, :6], at)
            how, joint, limit = self._slide(tool, rows, ask, detail[0], dt, table, out) or (how, joint, limit)
        status = Status(Code.TRACKING, scale, LIMITS[limit], joint, sigma < law.threshold, sigma, how != CLOSEST)
        return self._finish(out, how == NOT_FINITE, has_pose, status, detail[0], detail[1:], dt, table)

    def _follow_joints(self, joints: Array, reference: Reference, dt: float) -> Step:
        """Joint-space target: q̇ = q̇_d + K (q_d − q), slowed as one where a joint must brake or is at a limit."""
        limits = self._limits
        if joints.shape != self._q.shape:
            names = choices(self.model.joint_names)
            raise ArgumentError(f"reference: {joints.size} joints, need {self.model.n}, one for each of {names}")
        gain = self._law.slowest_gain
        feedback, by_tool = gain * (joints - self._q), FREE
        feedback = braking_factor(feedback, gain, self._law.table[BRAKING : BRAKING + 2, : self._n]) * feedback
        forward = np.zeros(self._n) if reference.joint_velocity is None else reference.joint_velocity
        wanted = feedback + forward
        if not math.isfinite(wanted.dot(wanted)):
            return self._stop(dt, Code.HOLDING)
        if not tool_is_free(self._law.table):
            wanted, by_tool = self._law.bound_joints(feedback, forward, self._middle(self._q, dt), self._state, dt)
        excess = float((np.abs(wanted) / limits.velocity).max())
        scale = 1.0 / max(excess, 1.0)
        if not self._obstacles.let(scale * wanted):
            return self._pass_by(wanted, None, dt, np.zeros(6), Status(Code.TRACKING))
        velocity = np.fmin(np.fmax(scale * wanted, limits.low), limits.high)
        if not self._obstacles.allow(velocity):
            return self._pass_by(wanted, None, dt, np.zeros(6), Status(Code.TRACKING))
        gap = np.abs(wanted - velocity)
        joint = int(np.argmax(gap))
        if gap.item(joint) > 0.0:
            limit = limits.which(joint, wanted.item(joint), self._v, dt)
        else:
            limit, joint = LIMITS[by_tool], -1
        asked = feedback + forward
        if by_tool != FREE:
            scale = min(max(float(velocity.dot(asked) / asked.dot(asked)), 0.0), 1.0) if asked.any() else 1.0
        status = Status(Code.TRACKING, scale, limit, joint)
        return self._commit(velocity, dt, np.zeros(6), status)

    def _pass_by(self, wanted: Array, jacobian: Array | None, dt: float, error: Array, status: Status) -> Step:
        """Move along what is in the way: the velocity nearest to `wanted` (n,) that obstacles and limits allow."""
        velocity, limit, pair, distance = self._obstacles.pass_by(wanted, jacobian, self._q, self._limits)
        size = math.sqrt(wanted.dot(wanted))
        scale = min(max(float(velocity.dot(wanted)) / (size * size), 0.0), 1.0) if size > 0.0 else 1.0
        return self._commit(
            velocity, dt, error, status._replace(scale=scale, limit=limit, pair=pair, distance=distance)
        )

    def _stop(self, dt: float, code: Code) -> Step:
        """Brake all joints as one, so that the arm stops along its joint-space direction, then hold."""
        limits = self._limits
        velocity = limits.stop(self._v, self._gate.acceleration, dt)
        gently = self._law.tool_keeps(self._state[2 * self._n : 2 * self._n + 6], dt) * self._v
        if np.abs(gently).max() > np.abs(velocity).max():  # the joints' own limits come first
            velocity = np.fmin(np.fmax(gently, limits.low), limits.high)
        if not self._obstacles.allow(velocity):
            velocity = self._obstacles.braking.copy()  # each joint for itself: the path that was found free
        if velocity.any() and code is Code.HOLDING:
            code = Code.STOPPING
        return self._commit(velocity, dt, np.zeros(6), Status(code))

    def _commit(self, velocity: Array, dt: float, error: Array, status: Status) -> Step:
        tool = _ZERO
        if velocity.any():
            tool = self._law.jacobian(self._q + 0.5 * dt * velocity).dot(velocity)
        self._keep(np.concatenate((self._q + dt * velocity, velocity, tool)))
        return Step(self._q, self._v, error, status)
