"""The node `ik_controller`: a lifecycle node around one arm's runs.

Threads: this node's executor (`serve`: parameters, services, transitions), while it is active the loop and the
recorder's writer, and one that tells the status while the executor's is compiling.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from ik_controller.control.controller import Controller
from ik_controller.control.obstacles import Scene
from ik_controller.errors import IkControllerError, ParameterError
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.urdf import same_arm
from ik_controller.parameters import specs
from ik_controller.robots import build_model, urdf_text, with_tool
from ik_controller.ros import monitor
from ik_controller.ros.outputs import Outputs, StatusOutput
from ik_controller.ros.parameters import declare, on_change
from ik_controller.ros.runner import Runner
from ik_controller.session import Session

_STATUS_PERIOD = 0.1  # [s] of ~/status while the node is not active
_PREPARING = "getting the control loop ready; the very first time it is compiled, for a minute or two"


class ControllerNode(LifecycleNode):  # type: ignore[misc]
    """One arm's controller. `serve` is its life; it returns after `request_stop`, with the arm at rest and the bag
    sealed.
    """

    def __init__(self, name: str = "ik_controller", **node_arguments: Any) -> None:
        """Raises IkControllerError where parameters or URDF do not fit."""
        super().__init__(name, **node_arguments)
        try:
            self.parameters = declare(self)
            self._urdf = urdf_text(self.parameters)
        except IkControllerError:
            self.destroy_node()
            raise
        self.model: RobotModel | None = None
        self.runner: Runner | None = None
        self._outputs: Outputs | None = None
        self._stopping: Future = Future()
        self._failure: Exception | None = None  # why the last transition was not made
        self._fatal: Exception | None = None  # what ends the process
        self._told = 0
        self.preparing: RobotModel | None = None  # its loop is being compiled: nothing is commanded yet
        self._status = StatusOutput(self)
        on_change(self, self._accept_parameters)
        self.create_service(SetBool, "~/pause", self._serve_pause)
        self.create_service(Trigger, "~/reset", self._serve_reset)
        self.create_service(SetBool, "~/record", self._serve_record)
        self._change_state, self._service_change_state.callback = (
            self._service_change_state.callback,
            self._serve_change_state,
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # told while the simulated time stands, too
        self._idle_timer = self.create_timer(_STATUS_PERIOD, self._tell_idle, clock=steady)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(String, "robot_description", self._on_description, latched)
        if self._urdf is None:
            self.get_logger().info("waiting for the topic robot_description")

    @property
    def state(self) -> str:
        """The lifecycle state's name: "unconfigured", "inactive", "active" or "finalized"."""
        return str(self._state_machine.current_state[1])

    def request_stop(self) -> None:
        """Brake, seal the bag, end `serve`."""
        self._stopping.set_result(None)

    def serve(self) -> None:
        """Run until `request_stop`. Raises IkControllerError where the node is to start by itself and cannot."""
        executor = SingleThreadedExecutor(context=self.context)
        executor.add_node(self)
        try:
            if self._urdf is not None:
                self._autostart()
            while not self._stopping.done():
                self._spin(executor)
        finally:
            if self.state != "finalized":
                self.trigger_shutdown()
            executor.shutdown()
        if self._fatal is not None:
            raise self._fatal

    def _spin(self, executor: SingleThreadedExecutor) -> None:
        try:
            executor.spin_until_future_complete(self._stopping)
        except ExternalShutdownException:
            self.request_stop()
        except Exception:  # of a callback: the others are served all the same
            self.get_logger().error(traceback.format_exc())

    def _autostart(self) -> None:
        if self.parameters.autostart and not self._stopping.done():
            done = self.trigger_configure() == TransitionCallbackReturn.SUCCESS
            if done and not self._stopping.done():  # configuring may take long: the end may have been asked for
                done = self.trigger_activate() == TransitionCallbackReturn.SUCCESS
            if not done:
                self._fatal = self._failure
                self.request_stop()

    # -- transitions

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Build the model and everything that talks."""
        return self._transition(self._configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start a run."""
        return self._transition(self._activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brake and end the run."""
        return self._transition(self._end_run)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop the model."""
        return self._transition(self._clean_up)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brake and end the run; the node is of no more use."""
        self._clean_up()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After an unexpected exception: back to unconfigured."""
        self._clean_up()
        return TransitionCallbackReturn.SUCCESS

    def _transition(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        """Do a transition's work; a mistake in the configuration is told and leaves the node as it was."""
        try:
            work()
        except IkControllerError as error:
            self._failure = error
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # rclpy would swallow it
            self._failure = error
            self.get_logger().fatal(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        self._failure = None
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        if self._urdf is None:
            raise ParameterError("no robot yet: waiting for the topic robot_description")
        self._build(build_model(self.parameters, self._urdf))

    def _build(self, model: RobotModel) -> None:
        """Take up a model. Raises ParameterError where parameters do not fit it."""
        session = Session(model, self.parameters)
        self.get_logger().info(_PREPARING)
        self.preparing = model
        ready = threading.Event()
        telling = threading.Thread(target=self._tell_until, args=(ready,), name=f"preparing {self.get_name()}")
        telling.start()
        try:
            session.warm_up()
        finally:
            ready.set()
            telling.join()
            self.preparing = None
        for assumption in model.assumptions:
            self.get_logger().warning(assumption)
        self.model = model
        self._outputs = Outputs(self, model, self.parameters)

    def _activate(self) -> None:
        assert self.model is not None
        assert self._outputs is not None
        self.runner = Runner(self, self.model, self.parameters, self._outputs, self._status, self._crashed)
        if self.parameters.record:
            try:
                self.runner.record(self.parameters)
            except IkControllerError as error:  # the arm runs all the same
                self.get_logger().error(f"not recording: {error}")
        self._idle_timer.cancel()
        self.runner.start()
        model = self.model
        self.get_logger().info(
            f"ready: {model.n} joints of '{model.robot_name}', "
            f"'{model.base_frame}' to '{model.tip_frame}', {self.parameters.rate:g} Hz"
        )

    def _end_run(self) -> None:
        if self.runner is not None:
            self.runner.stop()
            self.runner = None
        self._idle_timer.reset()

    def _clean_up(self) -> None:
        self._end_run()
        if self._outputs is not None:
            self._outputs.close()
        self._outputs = self.model = None

    def _crashed(self, error: Exception) -> None:
        self.get_logger().fatal("".join(traceback.format_exception(type(error), error, error.__traceback__)))
        self._fatal = error
        self.request_stop()

    def _serve_change_state(self, request: Any, response: Any) -> Any:
        try:
            return self._change_state(request, response)
        except Exception as error:  # rclpy's service raises where the transition is not possible now
            self.get_logger().error(f"no such transition from the state {self.state}: {' '.join(str(error).split())}")
            response.success = False
            return response

    # -- the robot's description

    def _on_description(self, message: String) -> None:
        """Take up a description; a changed one ends the run and starts one with the new model, an unusable one is told
        and dropped.
        """
        text = message.data
        if self.parameters.robot or self.parameters.urdf:
            return
        if self.model is None or self._urdf is None:
            self._urdf = text
            if self.state == "unconfigured":
                self._autostart()
            return
        if text == self._urdf:
            return
        try:
            model = build_model(self.parameters, text)
            Controller(model, self.parameters)
        except IkControllerError as error:
            self.get_logger().error(f"rejected robot_description, going on with the robot as it was: {error}")
            self._describe(str(error))
            return
        self._describe("")
        if same_arm(text, self._urdf):
            self._urdf = text
            return
        self.get_logger().warning("robot_description has changed: starting again with the new robot")
        active = self.runner is not None
        self._clean_up()
        self._urdf = text
        self._build(model)
        if active:
            self._activate()

    def _describe(self, mistake: str) -> None:
        if self.runner is not None:
            self.runner.monitor.description = mistake

    # -- parameters and services: the executor's side only queues

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters as rclpy does, but name those that do not exist, which its answer leaves out."""
        unknown = [parameter.name for parameter in parameter_list if not self.has_parameter(parameter.name)]
        try:
            if unknown:
                self.parameters.replace(dict.fromkeys(unknown))
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return super().set_parameters_atomically(parameter_list)

    def _accept_parameters(self, values: dict[str, Any]) -> None:
        """Take changed values up, or raise IkControllerError."""
        changed = self.parameters.replace(values)
        if self.model is None:
            self._urdf = urdf_text(changed) or self._urdf
        else:
            for spec in specs():
                if spec.read_only and getattr(changed, spec.name) != getattr(self.parameters, spec.name):
                    raise ParameterError(f"{spec.name} is read-only while the node is {self.state}: clean it up first")
            model = with_tool(self.model, self.parameters, changed)
            Controller(model, changed, Scene())  # refuses what does not fit the model
            self.model = model
        if self.runner is not None:
            if values.get("record"):
                self.runner.record(changed)
            elif "record" in values:
                self.runner.recorder.stop()
            self.runner.set_rates(changed)
            self.runner.request(do="parameters", values=values)
        self.parameters = changed

    def _serve_pause(self, request: Any, response: Any) -> Any:
        said = "pausing" if request.data else "going on from the measured position"
        return self._ask(response, "pause" if request.data else "resume", said)

    def _serve_reset(self, request: Any, response: Any) -> Any:
        return self._ask(response, "reset", "starting again from the measured position")

    def _ask(self, response: Any, do: str, said: str) -> Any:
        if self.runner is None:
            response.success, response.message = False, f"the node is {self.state}: activate it first"
        else:
            self.runner.request(do=do)
            response.success, response.message = True, said
        return response

    def _serve_record(self, request: Any, response: Any) -> Any:
        before = None if self.runner is None else self.runner.recorder.folder
        result = self.set_parameters_atomically([Parameter("record", value=request.data)])
        response.success = result.successful
        if not result.successful:
            response.message = result.reason
        elif not request.data:
            response.message = "nothing was being recorded" if before is None else "sealing the bag"
        elif self.runner is None:
            response.message = "recording from the activation on"
        else:
            response.message = (
                f"{'recording' if before is None else 'already recording'} to {self.runner.recorder.folder}"
            )
        return response

    # -- telling while there is no loop

    def _tell_until(self, ready: threading.Event) -> None:
        """Tell the status while the executor's thread has no time for it."""
        self._tell_idle()
        while not ready.wait(_STATUS_PERIOD):
            self._tell_idle()

    def _tell_idle(self) -> None:
        if self.runner is not None:
            return
        state = "preparing" if self.preparing else self.state
        if self.preparing:
            why = _PREPARING
        elif self.model is not None:
            why = "nothing is commanded until it is activated"
        elif state == "finalized":
            why = "shut down"
        elif self._failure is not None:
            why = str(self._failure)
        else:
            why = "waiting for the topic robot_description" if self._urdf is None else "waiting to be configured"
        model = self.preparing or self.model
        account = monitor.idle(state, why, model.robot_name if model else "")
        self._status.tell(self.get_clock().now().nanoseconds, account, self._told % 10 == 0)
        self._told += 1
