"""The node with a law that a parameter drives mad (posture_gain 13), and with our stand-in for tf2_ros.

A fault is what no input can bring about; the gate is there for mistakes of the law, so one is put in.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent / "stand_ins"))

from ik_controller.control.controller import Controller, Step
from ik_controller.ros.__main__ import run

MAD = 13.0

_advance = Controller._advance


def _mad(self: Controller, *arguments: Any) -> Step:
    step = _advance(self, *arguments)
    if self.parameters.posture_gain == MAD:
        step.position = step.position + 0.1
    return step


if __name__ == "__main__":
    Controller._advance = _mad  # type: ignore[method-assign]
    run()
