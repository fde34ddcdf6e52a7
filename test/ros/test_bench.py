"""What `ik_controller bench` measures of a node: that there are numbers; nobody asks how large they are."""

from __future__ import annotations

import math

import pytest
from rig import environment, next_domain

from ik_controller.verbs import bench


@pytest.fixture(autouse=True)
def short_and_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in environment(next_domain()).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(bench, "_WINDOWS", 1)


def test_a_live_run_is_measured_and_replayed() -> None:
    node, period, again = bench._node(1.0)
    assert node["ratio"] > 0.0
    assert period["p99_us"] > 0.0
    assert 0.0 < again["ratio"] < math.inf


def test_the_cost_of_recording_is_measured() -> None:
    cost, period = bench._recording()
    assert math.isfinite(cost["ratio"])
    assert period["p99_us"] > 0.0
    assert period["ratio"] > 0.0
