"""demo, view and bench run where nobody else on this host listens: what they simulate must not move a real arm."""

from __future__ import annotations

import random

import pytest
from rig import Rig, next_domain

from ik_controller.verbs.processes import is_quiet, private_graph


def test_a_domain_in_use_on_this_host_is_not_taken(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    free = next_domain()
    assert is_quiet(free)
    assert not is_quiet(rig.domain)  # the rig's own listener is enough
    monkeypatch.setattr(random.SystemRandom, "sample", lambda *_: [rig.domain, free])
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert private_graph()["ROS_DOMAIN_ID"] == str(free)


def test_who_names_a_domain_gets_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert private_graph()["ROS_DOMAIN_ID"] == "42"
