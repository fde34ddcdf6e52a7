"""Session: one arm's run, from messages to commands, cycle by cycle; no clock and no ROS.

The node feeds it what arrives and the time of each cycle; the replay feeds it the same from a bag. Whatever changes the
run goes through `take`, `apply` or `cycle`, so their sequence determines every bit that comes out.
"""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.controller import Controller, Step
from ik_controller.control.goal import Goal
from ik_controller.control.obstacles import Scene
from ik_controller.control.reference import Reference
from ik_controller.control.status import Code, Status
from ik_controller.control.targets import Targets
from ik_controller.errors import IkControllerError, MessageError, ModelError, choices
from ik_controller.kinematics.collision_world import sphere
from ik_controller.kinematics.model import RobotModel, pose_from
from ik_controller.messages.cdr import (
    JOINT_STATE,
    JointStateReader,
    JointStateWriter,
    decode,
    frame_of,
    pose_message,
    twist_message,
)
from ik_controller.messages.inputs import FRAMED, Inputs
from ik_controller.parameters import ControllerParameters
from ik_controller.robots import with_tool

Array = NDArray[np.float64]

# What a user may switch on in motion, and must not be compiled then: the stack of tasks, or inverses by name; beside
# them bounds of the tool, scales, and what keeps off obstacles, which are all too near here.
_IN_STACK = {
    "task_tolerance": 1e-3,
    "inverse": "numerical_filtering",
    "orientation_error": "exponential_base",
}
_BY_NAME = {
    "inverse": "damped",
    "task_axes": "xyzrpy",
    "task_frame": "base",
    "task_tolerance": (),
    "secondary_tasks": (),
    "secondary_targets": (),
    "secondary_gains": (),
    "objectives": (),
    "objective_gains": (),
    "joint_weights": (),
}
_BOUNDED = {
    "tool_linear_speed": 0.01,
    "tool_linear_acceleration": 0.1,
    "acceleration_scale": 0.5,
    "minimum_distance": 1.0,
    "self_minimum_distance": 1.0,
    "influence_distance": 2.0,
}

EVENTS = ("pause", "resume", "reset", "clock", "parameters", "refuse", "transform", "state")


class Session:
    """Takes inputs as they arrive and turns each cycle's into one command.

    `controller`, `targets`, `parameters`; `period` of a cycle [ns], `dt` the same [s]; `rejected` counts unusable
    messages by role, `last_rejected` tells of the last one; `paused`; `status` of the last cycle; `goal` of the last
    trajectory. Its model is its own where the tool is changed at run time.
    """

    def __init__(self, model: RobotModel, parameters: ControllerParameters, scene: Scene | None = None) -> None:
        """`scene`: what may not touch, to be restored with the state; that of the parameters unless given. Raises
        ParameterError where parameters do not fit the model, ModelError where the scene cannot be made.
        """
        self.model = model
        self.parameters = parameters
        self.controller = Controller(model, parameters, scene)
        self._own_scene = scene is None
        self.targets = Targets(parameters)
        self.paused = False
        self.rejected: Counter[str] = Counter()
        self.last_rejected = ""
        self.status = Status(Code.WAITING)
        self.goal = Goal()
        self.reference: Reference | None = None  # of the last cycle
        self.feedback_arrival: int | None = None
        self._refused: dict[str, str] = {}  # role → why nothing is taken from it
        self._inputs = Inputs(model, self.targets, parameters, self.controller.scene)
        self._joint_states = JointStateReader(model.joint_names)
        self._measured: Array | None = None
        self._running = False
        self._restarting = False  # brakes to rest before it starts anew
        self._rest_since: int | None = None  # when a restarting arm's commands came to rest [ns]
        self._set_times()

    def _set_times(self) -> None:
        self.period = round(1e9 / self.parameters.rate)  # of a cycle [ns]
        self.dt = self.period / 1e9
        self._feedback_timeout = int(self.parameters.feedback_timeout * 1e9)

    # -- what arrives

    def take(self, role: str, data: bytes, arrival: int) -> bool:
        """Take one message of a role of INPUTS that arrived at `arrival` [ns]; return False where it was rejected."""
        try:
            if role in self._refused:
                raise MessageError(self._refused[role])
            if role == "joint_states":
                measured = self._joint_states.read(data)
                if measured is not None:
                    self._measured, self.feedback_arrival = measured, arrival
                elif self._measured is None:
                    names = choices(decode(JOINT_STATE, data).name)
                    raise MessageError(
                        f"none of the joints {choices(self.model.joint_names)}; the message has: {names}"
                    )
            else:
                self._inputs.take(role, data, arrival, self.controller.position, self.controller.velocity)
                if role in ("target_trajectory", "target_joint_trajectory"):
                    self.goal.begin()
        except MessageError as error:
            self.rejected[role] += 1
            self.last_rejected = f"{role}: {error}"
            return False
        finally:
            if role != "joint_states":  # they are in no frame
                self._inputs.frames.forget()
        return True

    def joint_states(self, rows: NDArray[np.uint8]) -> Array | None:
        """Return the joints (k, n) in joint states, bytes (k, length), that are all like the last one that was taken,
        for `measure`; None where one is not, and `take` has to look at them.
        """
        return None if "joint_states" in self._refused else self._joint_states.read_all(rows)

    def measure(self, q: Array, arrival: int) -> None:
        """Take the joints as measured, q (n,), in a joint state that arrived at `arrival` [ns]."""
        self._measured, self.feedback_arrival = q, arrival

    def is_fresh(self, age: Any) -> Any:
        """Tell whether a joint state is of use that arrived `age` [ns] ago; of many where that is an array."""
        return age <= self._feedback_timeout

    def foreign_frame(self, role: str, data: bytes) -> str:
        """Return the frame of a target that the model does not know and TF may, "" where there is none: an event
        "transform" is wanted before the message.
        """
        if role not in FRAMED:
            return ""
        frame = frame_of(data)
        return "" if self._inputs.frames.known(frame) else frame

    def apply(self, event: str) -> None:
        """Apply one event, JSON text with the key "do" of EVENTS; between two cycles.

        Raises IkControllerError where it cannot be applied (unknown, or parameters that do not fit); nothing changes
        then.
        """
        try:
            content = json.loads(event)
        except ValueError:
            content = None
        if not isinstance(content, dict):
            raise IkControllerError(f"not an event: {event[:60]!r}; need a JSON object with the key 'do'")
        do = content.get("do")
        if do == "pause":
            self.paused = True
            self.targets.clear()
        elif do == "resume":
            if self.paused:
                self.paused = False
                self._restarting = self._running
        elif do == "reset":
            self._restarting = self._running
            self.controller.clear_fault()
            self.targets.clear()
        elif do == "clock":  # time jumped: what was timed by it is of no use any more
            self._restarting = self._running
            self.targets.clear()
            self._measured = self.feedback_arrival = self._rest_since = None
        elif do == "refuse":
            self._refuse(str(content.get("role")), str(content.get("reason", "")))
        elif do == "transform":
            self._tell_transform(content)
        elif do == "parameters":
            values = content.get("values")
            if not isinstance(values, dict):
                raise IkControllerError("event 'parameters' has no 'values', an object of names and values")
            self.set_parameters(self.parameters.replace(values))
        elif do == "state":
            self._restore(content)
        else:
            raise IkControllerError(f"unknown event '{do}'; legal: {choices(EVENTS)}")

    def _refuse(self, role: str, reason: str) -> None:
        """Take nothing more from a role, for this reason; with an empty one take it again."""
        if reason:
            self._refused[role] = reason
        else:
            self._refused.pop(role, None)

    def _tell_transform(self, content: dict[str, Any]) -> None:
        frame, pose = str(content.get("frame")), content.get("pose")
        try:
            told = str(content.get("reason")) if pose is None else pose_from(pose, f"transform of '{frame}'")
        except ModelError as error:
            raise IkControllerError(f"event 'transform': {error}") from None
        self._inputs.frames.tell(frame, told)

    def set_parameters(self, parameters: ControllerParameters) -> None:
        """Take new parameters between two cycles. Raises ParameterError; nothing changes then."""
        model = with_tool(self.model, self.parameters, parameters)
        self.controller.set_parameters(parameters, model)
        self.targets.set_parameters(parameters)
        if model is not self.model:
            self.model = model
            self._inputs = Inputs(model, self.targets, parameters, self.controller.scene)
        self._inputs.set_parameters(parameters)
        self.parameters = parameters
        self._set_times()

    @property
    def measured(self) -> Array | None:
        """The joints as last measured (n,), None before the first joint state."""
        return self._measured

    def explained(self) -> Status:
        """Return the last cycle's status with what takes too long to work out in every cycle; for people."""
        return self.controller.explain(self.status)

    # -- one cycle

    def cycle(self, now: int) -> Step | None:
        """Run the cycle that starts at `now` [ns]; return its Step, None where nothing is to be commanded."""
        arrival = self.feedback_arrival
        fresh = arrival is not None and self.is_fresh(now - arrival)
        measured = self._measured if fresh else None
        if self._restarting and not self.controller.fault and self.controller.at_rest:
            # The arm lags behind its commands: it comes to rest too before it is asked where it is.
            self._rest_since = now if self._rest_since is None else self._rest_since
            if now - self._rest_since >= self._feedback_timeout:
                self._running = self._restarting = False
                self._rest_since = None
        if not self._running:
            if self.paused or measured is None:
                lost = arrival is not None
                self.status = Status(Code.PAUSED if self.paused else Code.NO_FEEDBACK if lost else Code.WAITING)
                return None
            # Whatever was commanded before, the arm starts from where it is.
            self.controller.reset(measured)
            self._running = True
        reference = None if self.paused or self._restarting else self.targets.reference(now, self.dt)
        if reference is not None and reference.about is not None:
            reference = self._about_tool(reference, reference.about)
        self.reference = reference
        rested = self.paused and self.controller.at_rest
        step = self.controller.step(measured, reference, self.dt)
        self.goal.watch(now, self.targets, measured, self.model, self.parameters)
        if self.controller.fault:  # latched: it goes on holding until a reset
            self.status = step.status
            return None if rested else step
        if self.paused:
            step.status = step.status._replace(code=Code.PAUSED)
        if (self.paused or measured is None) and self.controller.at_rest:
            self._running = False
        self.status = step.status
        return step

    def cycles(self, times: list[int]) -> tuple[Array, Array, Array] | None:
        """Run cycles that start at these times [ns] and between which nothing arrives but fresh joint states: as many
        as can be worked out together, with the same bits as one by one.

        Return their positions (k, n), velocities (k, n) and errors (k, 6); None where `cycle` has to run the first one.
        """
        if not self._running or self.paused or self._restarting or self.goal.under_way:
            return None
        if not self.controller.goes_ahead(self.dt):
            return None
        references = self.targets.references(times, self.dt)
        gone = None if references is None else self.controller.go_ahead(*references, self.dt)
        if gone is None:
            return None
        states, self.reference, self.status = gone
        n = self.model.n
        return states[:, :n], states[:, n : 2 * n], states[:, 2 * n + 6 :]

    def _about_tool(self, reference: Reference, point: Array) -> Reference:
        """Return a twist of the tool's body at a point as that of the tool point, at the middle of the cycle."""
        assert reference.twist is not None and self.controller.position is not None  # noqa: PT018
        at = self.controller.position
        if self.parameters.integration_base == "measured" and self._measured is not None:
            at = self._measured
        lever = self.model.forward(at + 0.5 * self.dt * self.controller.velocity).translation - point
        v, w = reference.twist[:3], reference.twist[3:]
        return Reference(twist=np.concatenate((v + np.cross(w, lever), w)))

    def warm_up(self, *, together: bool = False) -> None:
        """Go once through every kind of cycle in scratch sessions: what compiles or is worked out on first use is done
        before the first deadline, and this session is left as it is. `together`: those of `cycles` too.
        """
        rest = np.clip(self.model.middle() + 0.1, self.model.lower, self.model.upper)
        at_bounds = np.where(np.isfinite(self.model.upper), self.model.upper, rest)
        second = {
            "secondary_tasks": (f"position {self.model.tip_frame}",),
            "secondary_targets": (0.0, 0.0, 0.0),
            "secondary_gains": (),
        }
        for changes in ({}, _IN_STACK, {**_BOUNDED, **_BY_NAME}, {**_BOUNDED, **_IN_STACK, **second}):
            for q in (rest, at_bounds):
                self._rehearse(self.parameters.replace({"mode": "auto", **changes}), q, together)

    def _rehearse(self, parameters: ControllerParameters, q: Array, together: bool) -> None:
        """Follow every kind of target in a scratch session whose arm is at q (n,), brake, pause and fault."""
        model = self.model
        scratch = Session(model, parameters, self.controller.scene.copy())
        if scratch.controller.scene.world_watched:
            scratch.controller.scene.world.put("rehearsal", sphere(0.1))
        state = JointStateWriter(model.joint_names).write(0, q, np.zeros(model.n))
        pose = model.forward(q)
        targets = (
            ("target_pose", pose_message(0, model.base_frame, pose)),
            *[("target_twist", twist_message(0, model.base_frame, np.full(6, 1e-3 * k))) for k in (1, 2, 3)],
            ("target_pose", pose_message(0, model.base_frame, pin.SE3(pose.rotation, pose.translation + 0.5))),
            ("target_pose", pose_message(0, model.base_frame, model.forward(q + 0.2))),
            ("target_pose", pose_message(1 + 40 * self.period, model.base_frame, pose)),  # on the way until it is due
            ("target_joints", state),
        )
        now = 1
        for role, data in targets:
            scratch.take("joint_states", state, now)
            scratch.take(role, data, now)
            for _ in range(3):
                scratch.cycle(now)
                now += self.period
            if together and scratch.cycles([now]):
                now += self.period
        scratch.apply('{"do": "pause"}')
        scratch.cycle(now)
        scratch.controller.halt("rehearsal")
        scratch.controller.step(q, None, scratch.dt)

    # -- the state, for a recording that starts in the middle of a run

    def state(self) -> str:
        """Return the whole state as an event for `apply`; numbers are written so that they come back bit for bit."""
        controller = self.controller
        return json.dumps(
            {
                "do": "state",
                "parameters": self.parameters.as_mapping(),
                "paused": self.paused,
                "running": self._running,
                "restarting": self._restarting,
                "rest_since": self._rest_since,
                "measured": None if self._measured is None else self._measured.tolist(),
                "feedback_arrival": self.feedback_arrival,
                "controller": controller.state(),
                "scene": controller.scene.state(),
                "targets": self.targets.state(),
                "goal": self.goal.state(),
                "refused": self._refused,
            }
        )

    def _restore(self, content: dict[str, Any]) -> None:
        try:
            self.set_parameters(ControllerParameters.from_mapping(content["parameters"]))
            self.paused = bool(content["paused"])
            self._running = bool(content["running"])
            self._restarting = bool(content["restarting"])
            self._rest_since = content["rest_since"]
            self._measured = None if content["measured"] is None else np.array(content["measured"])
            self.feedback_arrival = content["feedback_arrival"]
            self.controller.restore(content["controller"])
            if not self._own_scene and "scene" in content:  # not in the runs of version 0.1
                self.controller.scene.restore(content["scene"])
            self.targets.restore(content["targets"])
            # Not in the runs of version 0.1
            self.goal.restore(content.get("goal", ["", False]))
            self._refused = dict(content.get("refused", {}))
        except (KeyError, TypeError, ValueError) as error:
            raise IkControllerError(f"event 'state' is of another version of ik_controller: {error!r}") from None
