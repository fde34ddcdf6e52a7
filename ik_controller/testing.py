"""For a team's own tests with pytest: its bags become regression tests of its own configuration.

In conftest.py: `from ik_controller.testing import replay_bag`; then a test asks for the fixture `replay_bag`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from ik_controller.errors import IkControllerError
from ik_controller.parameter_file import values_in
from ik_controller.recording.compare import measure, violations
from ik_controller.recording.reader import open_bag
from ik_controller.recording.replay import replay
from ik_controller.recording.run import RunInfo
from ik_controller.recording.target_bag import TargetOptions
from ik_controller.robots import with_bundled


class ReplayedBag:
    """What a replay found: `figures` by name, those of `ik_controller compare`, also as attributes."""

    def __init__(self, name: str, figures: Mapping[str, Any]) -> None:
        self.name = name
        self.figures = dict(figures)

    def __getattr__(self, name: str) -> Any:
        figures = self.__dict__.get("figures", {})
        if name not in figures:
            raise AttributeError(f"no figure '{name}'; there are: {', '.join(figures)}")
        return figures[name]

    def check(self, *, at_most: Mapping[str, float] | None = None, at_least: Mapping[str, float] | None = None) -> None:
        """Fail the test, naming every figure beyond its bound. Raises BagError for an unknown name."""
        broken = violations(self.figures, at_most or {}, at_least or {})
        if broken:
            pytest.fail(f"{self.name}: " + "; ".join(broken), pytrace=False)


Replayer = Callable[..., ReplayedBag]


@pytest.fixture
def replay_bag(request: pytest.FixtureRequest, tmp_path: Path) -> Replayer:
    """Return a function (bag, parameters=None, **options) → ReplayedBag that runs a bag through a configuration.

    `bag`: path, relative to the test's file; a run of ours or anybody's targets. `parameters`: parameter file or
    mapping on top of the recorded ones; for anybody's targets it must name the robot. `options`: a `targets`
    TargetOptions. A configuration that does not fit fails the test.
    """
    here = request.path.parent

    def run(
        bag: str | Path,
        parameters: str | Path | Mapping[str, Any] | None = None,
        targets: TargetOptions | None = None,
    ) -> ReplayedBag:
        if isinstance(parameters, (str, Path)):
            parameters = values_in(here / parameters)
        values = dict(parameters or {})
        path = here / bag
        try:
            opened = open_bag(path)
            if RunInfo.of(opened) is None:
                run_of_it = tmp_path / f"{path.stem}_run_{len(list(tmp_path.iterdir()))}"
                replay(opened, robot=with_bundled(values), targets=targets, output=run_of_it)
                opened, values = open_bag(run_of_it), {}
            return ReplayedBag(str(bag), measure(opened, values))
        except IkControllerError as error:
            pytest.fail(f"{bag}: {error}", pytrace=False)

    return run
