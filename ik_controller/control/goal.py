"""Goal: whether a trajectory's end was reached by the measured arm; an outcome for people, it changes no command."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.targets import Targets
from ik_controller.kinematics.model import RobotModel
from ik_controller.parameters import ControllerParameters

Array = NDArray[np.float64]


class Goal:
    """Watches the trajectory of `Targets`; `outcome`: "", "under way", "reached: …", "missed: …" or "abandoned"; is it
    `under_way`?
    """

    def __init__(self) -> None:
        self.outcome = ""
        self.under_way = False

    def begin(self) -> None:
        """A trajectory was taken."""
        self.outcome, self.under_way = "under way", True

    def watch(
        self, now: int, targets: Targets, measured: Array | None, model: RobotModel, parameters: ControllerParameters
    ) -> None:
        """Look at the measured joints (n,) at the cycle `now` [ns]; before the trajectory's end there is nothing to
        see.
        """
        if not self.under_way:
            return
        end = targets.trajectory_end()
        if end is None:
            self.outcome, self.under_way = "abandoned", False
            return
        time, target = end
        if now < time or measured is None:
            return
        if isinstance(target, tuple):
            tool = model.forward(measured)
            gap = float(np.linalg.norm(target[0] - tool.translation))
            turn = float(np.linalg.norm(pin.log3(target[1] @ tool.rotation.T)))
            reached = gap <= parameters.goal_position_tolerance and turn <= parameters.goal_orientation_tolerance
            off = f"{1e3 * gap:.3g} mm and {turn:.3g} rad away"
        else:
            away = np.abs(target - measured)
            joint = int(np.argmax(away))
            reached = away.item(joint) <= parameters.goal_joint_tolerance
            off = f"'{model.joint_names[joint]}' {away.item(joint):.3g} away"
        if reached:
            self.outcome, self.under_way = f"reached: {off}", False
        elif now - time >= parameters.goal_time * 1e9:
            late = "" if math.isclose(parameters.goal_time, 0.0) else f" after {parameters.goal_time:g} s"
            self.outcome, self.under_way = f"missed: {off}{late}", False

    def state(self) -> list[Any]:
        """Return all as JSON types, for `restore`."""
        return [self.outcome, self.under_way]

    def restore(self, state: list[Any]) -> None:
        """Take a state of `state`."""
        self.outcome, self.under_way = str(state[0]), bool(state[1])
