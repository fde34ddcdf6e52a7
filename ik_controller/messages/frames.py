"""Frames: placements in the model's base frame, of its links by forward kinematics, of others by what TF told.

A transform from TF is told (`tell`) right before the message that needs it and serves that message alone, so that what
TF said is part of the run and a replay needs no TF.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.errors import MessageError, choices
from ik_controller.kinematics.model import RobotModel, frame_pose

Array = NDArray[np.float64]


class Frames:
    """Placements of frames in the base frame; `base` is the identity, the same object always."""

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self._data: Any = model.pin_model.createData()
        self._ids = {f.name: i for i, f in enumerate(model.pin_model.frames) if f.type == pin.FrameType.BODY}
        self._fixed = {
            name: pin.SE3(model.pin_model.frames[i].placement)
            for name, i in self._ids.items()
            if model.pin_model.frames[i].parentJoint == 0
        }
        self.base = self._fixed[model.base_frame] = pin.SE3.Identity()
        self._told: dict[str, Any] = {}  # a `pin.SE3`, or why there is none

    def known(self, name: str) -> bool:
        """Say whether a frame is a link of the model (an empty name is one that nobody else knows either)."""
        return not name or name in self._ids or name in self._fixed

    def tell(self, name: str, placement: Any) -> None:
        """Take a frame's `pin.SE3` in the base frame, or the reason (text) why there is none, for the next message."""
        self._told[name] = placement

    def forget(self) -> None:
        """Drop what was told."""
        if self._told:
            self._told = {}

    def placement(self, name: str, q: Array | None) -> Any:
        """Return the frame's `pin.SE3` in the base frame at q (n,). Raises MessageError: empty or unknown frame, no
        q.
        """
        placement = self._fixed.get(name)
        if placement is not None:
            return placement
        frame = self._ids.get(name)
        if frame is None:
            return self._foreign(name)
        if q is None:
            raise MessageError(f"frame_id '{name}' moves with the arm, and no joint state has come yet")
        return frame_pose(self._model, self._data, q, frame)

    def _foreign(self, name: str) -> Any:
        told = self._told.get(name)
        if told is not None and not isinstance(told, str):
            return told
        given = "is empty" if not name else f"'{name}' is unknown"
        if told is not None:
            given += f": no link of the model, and {told}"
        raise MessageError(f"frame_id {given}; legal: {choices(sorted({*self._ids, self._model.base_frame}))}")
