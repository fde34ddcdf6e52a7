"""Compile the control kernels into Numba's cache, so that the first run starts as fast as any. Run by `make`."""

from __future__ import annotations

from ik_controller.recording.cycles import warm_up
from ik_controller.robots import build_model, bundled_parameters
from ik_controller.session import Session
from ik_controller.share import robot_names

if __name__ == "__main__":
    for name in robot_names():
        parameters = bundled_parameters(name)
        warm_up(Session(build_model(parameters), parameters))
