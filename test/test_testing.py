"""The fixture for users' own tests, by pytest's own means of testing plugins."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest_plugins = ["pytester"]
BAGS = Path(__file__).resolve().parents[1] / "bags"


def test_bags_become_tests_of_a_teams_configuration(pytester: pytest.Pytester) -> None:
    pytester.makeconftest("from ik_controller.testing import replay_bag")
    pytester.path.joinpath("bags").symlink_to(BAGS)
    pytester.path.joinpath("arm.yaml").write_text("gain: 40.0\n")
    pytester.path.joinpath("wrong.yaml").write_text("gains: 40.0\n")
    pytester.makepyfile(
        """
        def test_run(replay_bag):
            run = replay_bag("bags/panda_golden", "arm.yaml")
            run.check(at_most={"position_rms_m": 1e-4}, at_least={"limit_margin_min": 0.05})
            assert run.damped_s == 0.0

        def test_targets(replay_bag):
            run = replay_bag("bags/ur5e_figure_eight", {"robot": "ur5e", "rate": 250.0})
            run.check(at_most={"position_rms_m": 1e-4})

        def test_too_strict(replay_bag):
            replay_bag("bags/panda_golden").check(at_most={"position_rms_m": 1e-12, "jerk_max": 1e9})

        def test_wrong(replay_bag):
            replay_bag("bags/panda_golden", "wrong.yaml")
        """
    )
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    result.assert_outcomes(passed=2, failed=2)
    text = result.stdout.str()
    assert "bags/panda_golden: position_rms_m is " in text
    assert "need at most 1e-12" in text
    assert "jerk_max" not in text
    assert "gains" in text
