"""Packages that a ROS installation may have and the wheels of PyPI have not: taken where they are there."""

from __future__ import annotations

import importlib
from typing import Any


def optional(module: str, name: str = "") -> Any:
    """Return a module, or `name` of it; None where it is not installed."""
    try:
        found = importlib.import_module(module)
    except ImportError:
        return None
    return getattr(found, name, None) if name else found
