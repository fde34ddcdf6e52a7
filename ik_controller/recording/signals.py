"""Signals: what a run's report and export show of each cycle, as one row of numbers with named columns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.controller import Step
from ik_controller.control.status import Code
from ik_controller.kinematics.model import RobotModel, frame_jacobian
from ik_controller.session import Session

Array = NDArray[np.float64]

BLOCK = 4096  # rows that are worked out at once


class Signals:
    """The columns of an arm with n joints, and the rows of its cycles, a block at a time.

    `names`: of all columns, each with its unit (`position_error_m`); `indices` name → column. NaN where a cycle has no
    such value: no command, or no pose to follow. Quantities are those at the cycle's start, but for the commands of
    joint position, velocity and acceleration, which are for its end.
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        n = model.n
        unit = ["m" if prismatic else "rad" for prismatic in model.prismatic]
        self.names = ["time_s", *_vector("tool", "m"), *_vector("target", "m"), *_vector("error", "m")]
        self.names += [*_vector("rotation_error", "rad"), "position_error_m", "orientation_error_rad"]
        self.joints: dict[str, slice] = {}
        for what, per in (("position", ""), ("velocity", "_s"), ("acceleration", "_s2"), ("lag", "")):
            first = len(self.names)
            self.joints[what] = slice(first, first + n)
            self.names += [f"{name}_{what}_{u}{per}" for name, u in zip(model.joint_names, unit, strict=True)]
        self.names += ["manipulability", "smallest_singular_value", "distance_m", "scale", "period_s", "work_s"]
        self.indices = {name: index for index, name in enumerate(self.names)}
        self.rows = np.full((BLOCK, len(self.names)), np.nan)
        self.masks = np.zeros(BLOCK, dtype=np.int64)
        self._at = np.full((BLOCK, n), np.nan)  # joints that tool and Jacobian are taken at
        self._base: Array | None = None  # the same of the next cycle
        self._start: int | None = None  # when the last cycle really started [ns]
        self._last_velocity = np.full(n, np.nan)
        self._data: Any = model.pin_model.createData()
        self._sigma, self._scale = self.indices["smallest_singular_value"], self.indices["scale"]

    def write(self, k: int, time: int, start: int, work: int, step: Step | None, session: Session, mask: int) -> None:
        """Write row k: `time` since the first cycle and real `start` of this one [ns], `work` in it [ns]."""
        row, joints = self.rows[k], self.joints
        row[:] = np.nan
        row[0] = time * 1e-9
        row[-2] = np.nan if self._start is None else (start - self._start) * 1e-9
        row[-1] = work * 1e-9
        self._start, self.masks[k] = start, mask
        measured = session.measured
        if step is None:
            self._at[k], self._base = np.nan, None
            if measured is not None:
                self._at[k] = measured
            return
        base = self._base if self._base is not None else step.position
        if session.parameters.integration_base == "measured" and measured is not None:
            base = measured
        self._at[k] = base
        row[joints["position"]], row[joints["velocity"]] = step.position, step.velocity
        if measured is not None and self._base is not None:
            row[joints["lag"]] = self._base - measured
        row[self._scale - 1], row[self._scale] = step.status.distance, step.status.scale
        if step.status.code is Code.TRACKING and step.error.any():
            row[7:13] = step.error
        self._base = step.position

    def finish(self, count: int, dt: float) -> Array:
        """Work out what is left in the first `count` rows, and return them; `dt` of a cycle [s]."""
        rows, model = self.rows[:count], self.model
        velocity = rows[:, self.joints["velocity"]]
        before = np.vstack((self._last_velocity, velocity[:-1]))
        rows[:, self.joints["acceleration"]] = (velocity - before) / dt
        self._last_velocity = velocity[-1].copy()
        jacobians = np.full((count, 6, model.n), np.nan)
        known = np.flatnonzero(np.isfinite(self._at[:count]).all(axis=1))
        data, tool, pin_model = self._data, model.tool_id, model.pin_model
        for k in known:
            jacobians[k] = frame_jacobian(model, data, self._at[k], tool)
            rows[k, 1:4] = pin.updateFramePlacement(pin_model, data, tool).translation
        error = rows[:, 7:13]
        rows[:, 4:7] = rows[:, 1:4] + error[:, :3]
        rows[:, 13] = np.linalg.norm(error[:, :3], axis=1)
        rows[:, 14] = np.linalg.norm(error[:, 3:], axis=1)
        if len(known):
            sigma = np.linalg.svd(jacobians[known], compute_uv=False)  # Yoshikawa 1985: w is their product
            rows[known, self._sigma - 1], rows[known, self._sigma] = sigma.prod(axis=1), sigma[:, -1]
        return rows


def _vector(name: str, unit: str) -> list[str]:
    return [f"{name}_{axis}_{unit}" for axis in "xyz"]
