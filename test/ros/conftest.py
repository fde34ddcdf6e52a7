"""Rigs for the tests of this folder; whatever they started is ended with them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from rig import Rig

from ik_controller.robots import build_model, bundled_parameters
from ik_controller.session import Session


@pytest.fixture(scope="session", autouse=True)
def compiled() -> None:
    """Compile the loop's kernels before any deadline runs: in a fresh checkout that alone takes a minute."""
    parameters = bundled_parameters("panda")
    Session(build_model(parameters), parameters).warm_up()


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    """A rig of one test."""
    with closing(Rig(tmp_path)) as made:
        yield made


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A rig with the simulated Panda and its node at 250 Hz, both running; each test leaves it so."""
    with closing(Rig(tmp_path_factory.mktemp("live"))) as made:
        made.sim = made.start_sim("--rate", "500")
        made.node = made.start_node(robot="panda", rate=250.0)
        made.until_commanding()
        made.until_status("holding")
        yield made
