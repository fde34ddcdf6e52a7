"""What `ik_controller bench` measures of a node: that there are numbers; nobody asks how large they are."""

from __future__ import annotations

import math

import pytest
from rig import environment, next_domain

from ik_controller.verbs import bench


def test_the_cost_of_recording_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in environment(next_domain()).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(bench, "_WINDOWS", 1)
    cost, period = bench._recording()
    assert math.isfinite(cost["ratio"])
    assert period["p99_us"] > 0.0
    assert period["ratio"] > 0.0
