"""Shared by all tests: hypothesis settings that repeat, the bundled robots, the small arms of test/kinematics."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent / "kinematics"))  # arms.py

settings.register_profile("repeatable", deadline=None, max_examples=50, derandomize=True)
settings.register_profile("soak", deadline=None, max_examples=2000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


@pytest.fixture(scope="session")
def panda():
    from motions import bundled

    return bundled("panda")


@pytest.fixture(scope="session")
def ur5e():
    from motions import bundled

    return bundled("ur5e")


@pytest.fixture(scope="session", params=["panda", "ur5e"])
def robot(request):
    from motions import bundled

    return bundled(request.param)
