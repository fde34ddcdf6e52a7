"""Runner: one run of one arm, from activation to deactivation; takes what arrives, steps, publishes, records, tells.

The loop runs in a thread of its own. What others ask for is queued as events of `Session.apply` and done between two
cycles, so that a run is one sequence that can be repeated.
"""

from __future__ import annotations

import contextlib
import gc
import json
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ik_controller.control.status import Code
from ik_controller.errors import IkControllerError
from ik_controller.kinematics.model import RobotModel
from ik_controller.parameters import ControllerParameters
from ik_controller.ros.clock import SimulatedLoop
from ik_controller.ros.inputs import Inputs
from ik_controller.ros.loop import Loop, undisturbed
from ik_controller.ros.markers import MarkerOutput
from ik_controller.ros.monitor import Account, Monitor
from ik_controller.ros.optional import optional
from ik_controller.ros.outputs import Outputs, StatusOutput
from ik_controller.ros.publishers import PublisherWatch
from ik_controller.ros.recorder import Recorder
from ik_controller.ros.servo import ServoInterface
from ik_controller.ros.transforms import ToolFrame, Transforms
from ik_controller.session import Session

_STOP_TIME = 5.0  # [s] that braking at the end may take
_TRY_AGAIN = 1.0  # [s] between attempts to record where that is not possible yet
_UNHEARD = (Code.WAITING, Code.NO_FEEDBACK)  # states for want of joint states
_LOOK = 10  # cycles between looks at whether the status has changed
_SHOW_RATE = 25.0  # [Hz] of the joints for those who watch


class Runner:
    """One run: `start` subscribes and starts the loop, `stop` brakes the arm and returns when the bag is sealed."""

    def __init__(
        self,
        node: Node,
        model: RobotModel,
        parameters: ControllerParameters,
        outputs: Outputs,
        status: StatusOutput,
        on_crash: Callable[[Exception], None],
    ) -> None:
        """`on_crash` is told of an exception that ended the loop. Raises ParameterError: parameters do not fit."""
        self.session = Session(model, parameters)
        self.recorder = Recorder(node.get_logger())
        self._node = node
        self._logger = node.get_logger()
        self._outputs = outputs
        self._status = status
        self._on_crash = on_crash
        self._quiet = contextlib.ExitStack()
        self._events: deque[str] = deque()
        self._stop = False
        self._stop_by: int | None = None  # when braking at the end has taken too long [ns]
        self._loop = self._loop_of(node)
        self._now = 0  # the time of the last cycle [ns]
        self._transforms = Transforms(node, model.base_frame)
        self._thread = threading.Thread(target=self._run, name="loop")
        self.monitor = Monitor(self.session, self._loop, self.recorder, self._notes)
        self._told: tuple[Any, ...] = ()
        self._account: Account | None = None  # to be told in the next cycle
        self.set_rates(parameters)

    def _loop_of(self, node: Node) -> Loop | SimulatedLoop:
        if node.get_parameter("use_sim_time").value:
            return SimulatedLoop(node, self.session.period, self._cycle, self._on_jump, self._on_idle)
        return Loop(self.session.period, self._cycle, self._on_stall)

    # -- the executor's side: it only queues

    def start(self) -> None:
        """Subscribe and start the loop."""
        self._quiet.enter_context(undisturbed())
        # Subscribing is the last thing before the loop: who finds us listening is served at once.
        self._inputs = Inputs(self._node, self.session.parameters)
        self._publishers = PublisherWatch(
            self._node, self._inputs.topics, lambda: self.session.parameters.second_publisher, self.request
        )
        self._extras: list[Any] = [MarkerOutput(self._node, self.session)]
        self._servo: ServoInterface | None = None
        if self.session.parameters.servo_interface:
            self._servo = ServoInterface(self._node, self.session.parameters.servo_name, self.request)
            self._extras.append(self._servo)
        if self.session.parameters.tool_frame and optional("tf2_ros") is not None:
            self._extras.append(ToolFrame(self._node, self.session))
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # a simulated one may stand
        self._again = self._node.create_timer(_TRY_AGAIN, self._record_again, clock=steady)
        self._thread.start()

    def stop(self) -> None:
        """Brake, end the loop, seal the bag; return when all that is done."""
        self._stop = True
        self._node.destroy_timer(self._again)
        self._thread.join()
        self._quiet.close()
        for extra in self._extras:
            extra.close()
        self._publishers.close()
        self._transforms.close()
        self._inputs.close()
        self.recorder.close()

    def request(self, **event: Any) -> None:
        """Ask for an event of `Session.apply` before the next cycle."""
        self._events.append(json.dumps(event))

    def record(self, parameters: ControllerParameters) -> str:
        """Start recording, unless it runs; return the bag's folder. Raises BagError."""
        folder = self.recorder.folder
        if folder is None:
            # Bags of several arms in one folder are told apart by the nodes' names.
            name = self._node.get_fully_qualified_name().replace("/ik_controller", "").replace("/", "_")
            folder = self.recorder.start(self.session, self._outputs.topics, parameters.record_folder, f"run{name}")
        return str(folder)

    def _record_again(self) -> None:
        if self.recorder.failure and self.session.parameters.record:
            with contextlib.suppress(IkControllerError):  # told by the status
                self.record(self.session.parameters)

    def set_rates(self, parameters: ControllerParameters) -> None:
        """Take up how often to tell what."""
        rate = parameters.rate
        self._monitor_every = max(round(rate / parameters.monitor_rate), 1)
        self._status_every = max(round(rate / parameters.status_rate / _LOOK), 1) * _LOOK
        self._show_every = max(round(rate / _SHOW_RATE), 4)
        self._second = round(rate)

    # -- the loop's side

    def _run(self) -> None:
        try:
            self._loop.run()
        except Exception as error:  # a bug: the process must not go on as if it controlled the arm
            self._on_crash(error)

    def _cycle(self, index: int, now: int, late: int) -> None:
        begin = time.monotonic_ns()
        self._now = now
        session = self.session
        bag = self.recorder.switch(session, now)
        if self._stop:
            self._brake(now)
        while self._events:
            self._apply(self._events.popleft(), now)
        for role, data in self._transforms.sorted_in(self._inputs.take(), session, now, self._apply_now):
            if bag is not None:
                bag.write(role, now, data)
            if not session.take(role, data, now):
                self.monitor.rejected(now)
                self._logger.warning(f"rejected: {session.last_rejected}", throttle_duration_sec=1.0)
        step = session.cycle(now)
        if step is not None:
            # The command is for the cycle's end: that is its stamp.
            self._record(now, self._outputs.command(now + session.period, step))
        work = time.monotonic_ns() - begin
        if bag is not None:
            bag.cycle(index, now, int(session.status.code), late, work, step is not None)
        self.monitor.cycle(index, now, late)
        if index % self._monitor_every == 0:
            self._record(now, self._outputs.tell(now, session, step))
        # What takes long is spread over the cycles, so that none of them runs into the next.
        shown = index % self._show_every
        if shown == 3:
            self._outputs.show_measured(now, session)
        elif shown == 1:
            self._outputs.show_commanded(now, session, step)
        if index % _LOOK == _LOOK // 2:
            glance = self.monitor.glance()
            if index % self._status_every == _LOOK // 2 or glance != self._told:
                self._told = glance
                self._account = self.monitor.account(now)
        elif self._account is not None:
            self._tell_status(now, self._account, index % self._second < self._status_every)
            self._account = None
        if index % self._second == self._second // 2:
            gc.collect(1)
        if self._stop and step is None:
            self._loop.stop = True

    def _record(self, now: int, sent: list[tuple[str, bytes]]) -> None:
        bag = self.recorder.bag
        if bag is not None:
            for role, data in sent:
                bag.write(role, now, data)

    def _apply(self, event: str, now: int) -> None:
        try:
            self.session.apply(event)
        except IkControllerError as error:
            self._logger.error(str(error))
            return
        if self.recorder.bag is not None:
            self.recorder.bag.event(now, event)

    def _apply_now(self, event: dict[str, Any]) -> None:
        self._apply(json.dumps(event), self._now)

    def _brake(self, now: int) -> None:
        """End as with a pause: the arm brakes within its limits, then the session has nothing more to command."""
        if self._stop_by is None:
            self._stop_by = now + int(_STOP_TIME * 1e9)
        if not self.session.paused:
            self._apply(json.dumps({"do": "pause"}), now)
        elif now > self._stop_by:
            self._loop.stop = True

    def _on_stall(self, skipped: int) -> None:
        self._logger.error(f"the process was held up for {skipped} cycles: starting again from the measured position")
        length = skipped * self.session.period
        self.monitor.held_up(self._now + length, length)
        self.request(do="reset")

    def _on_jump(self, now: int) -> None:
        self._logger.warning("the simulated time has jumped: starting again from the measured position")
        self._apply(json.dumps({"do": "clock"}), now)

    def _on_idle(self) -> None:
        """While the simulated time stands: nothing moves, but what is asked for is done, and told."""
        if self._stop:
            self._loop.stop = True
            return
        if not self._now:  # before the first tick there is no time to write to a bag
            now = self._node.get_clock().now().nanoseconds
            self._tell_status(now, self.monitor.account(now), False)
            return
        self.recorder.switch(self.session, self._now)
        while self._events:
            self._apply(self._events.popleft(), self._now)
        self._tell_status(self._now, self.monitor.account(self._now), False)

    def _tell_status(self, now: int, account: Account, diagnostics: bool) -> None:
        self._record(now, [("status", self._status.tell(now, account, diagnostics))])
        if self._servo is not None:
            self._servo.tell(self.session.status, self.session.model.joint_names)

    def _notes(self) -> list[tuple[str, str]]:
        """Return reasons (keys of REASONS) and sentences that only this run knows of."""
        notes = [("publishers", warning) for warning in self._publishers.warnings]
        if self.session.status.code in _UNHEARD and self._publishers.silence:
            notes.append((self.session.status.code.name.lower(), self._publishers.silence))
        if self._transforms.waiting:
            notes.append(("transform", self._transforms.waiting))
        if isinstance(self._loop, SimulatedLoop) and self._loop.stands:
            paused = ", and it is paused" if self.session.paused else ""
            notes.append(("clock", f"the simulated time stands still: nothing is commanded{paused}"))
        return notes
