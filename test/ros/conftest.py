"""Rigs for the tests of this folder; whatever they started is ended with them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from rig import Rig


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    """A rig of one test."""
    made = Rig(tmp_path)
    yield made
    made.close()


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A rig with the simulated Panda and its node at 250 Hz, both running; each test leaves it so."""
    made = Rig(tmp_path_factory.mktemp("live"))
    made.sim = made.start_sim("--rate", "500")
    made.node = made.start_node(robot="panda", rate=250.0)
    made.until_commanding()
    made.until_status("holding")
    yield made
    made.close()
