"""Joystick: from sensor_msgs/Joy to a twist, by a mapping file; for gamepads and the SpaceMouse."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.errors import ParameterError, choices
from ik_controller.parameter_file import read_yaml

Array = NDArray[np.float64]

AXES = ("vx", "vy", "vz", "wx", "wy", "wz")
BUTTONS = ("frame", "faster", "slower", "pause", "reset")


@dataclass(frozen=True)
class JoyMapping:
    """Which axis and button does what.

    `axes`: of AXES, each (index, factor) or a list of such, which add up; `deadman`: button that must be held, −1 none;
    `buttons`: of BUTTONS → index; `deadzone` 0…1; speeds [m/s, rad/s] at full deflection.
    """

    axes: Mapping[str, Any] = field(default_factory=dict)
    buttons: Mapping[str, int] = field(default_factory=dict)
    deadman: int = -1
    deadzone: float = 0.08
    linear_speed: float = 0.2
    angular_speed: float = 0.6

    def twist(self, axes: Sequence[float], buttons: Sequence[int]) -> Array | None:
        """Return the twist (6,) as shares of the full speeds, −1…1; None while the dead man's button is not held.

        Without such a button, a device at rest is one that was let go of.
        """
        if self.deadman >= 0 and not (self.deadman < len(buttons) and buttons[self.deadman]):
            return None
        result = np.zeros(6)
        for row, name in enumerate(AXES):
            entries = self.axes.get(name, [])
            for index, factor in [entries] if entries and not isinstance(entries[0], (list, tuple)) else entries:
                value = axes[index] if index < len(axes) else 0.0
                if math.isfinite(value) and abs(value) > self.deadzone:
                    share = (abs(value) - self.deadzone) / (1.0 - self.deadzone)  # no step at the deadzone's edge
                    result[row] += factor * math.copysign(min(share, 1.0), value)
        if self.deadman < 0 and not result.any():
            return None
        return np.clip(result, -1.0, 1.0)


def load(path: str | Path) -> JoyMapping:
    """Read a mapping file. Raises ParameterError: missing, not YAML, unknown names, not (index, factor)."""
    content = read_yaml(path, "mapping file")
    if not isinstance(content, dict):
        raise ParameterError(f"mapping file '{path}' holds no mapping; it needs: {choices(_names())}")
    for name in content:
        if name not in _names():
            raise ParameterError(f"mapping file '{path}': unknown entry '{name}'; legal: {choices(_names())}")
    for group, legal in (("axes", AXES), ("buttons", BUTTONS)):
        for name, value in dict(content.get(group) or {}).items():
            if name not in legal:
                raise ParameterError(f"mapping file '{path}': unknown {group} '{name}'; legal: {choices(legal)}")
            if not (_is_axis(value) if group == "axes" else isinstance(value, int)):
                need = "[index, factor], or a list of them" if group == "axes" else "a button's index"
                raise ParameterError(f"mapping file '{path}': {group} '{name}' = {value!r}: need {need}")
    for name in ("deadzone", "linear_speed", "angular_speed"):
        value = content.get(name, 0.1)
        if not isinstance(value, (int, float)) or not 0.0 <= value < (1.0 if name == "deadzone" else 100.0):
            raise ParameterError(f"mapping file '{path}': {name} = {value!r}: need a number from 0")
    return JoyMapping(**content)


def _names() -> list[str]:
    return [item.name for item in fields(JoyMapping)]


def _is_axis(value: Any) -> bool:
    if not isinstance(value, list) or not value:
        return False
    pairs = value if isinstance(value[0], list) else [value]
    return all(
        isinstance(p, list) and len(p) == 2 and isinstance(p[0], int) and isinstance(p[1], (int, float)) for p in pairs
    )
