"""Provenance: what made a run, so that a replay can say what differs: versions, code, model."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
from functools import cache
from pathlib import Path

from ik_controller import __version__
from ik_controller.kinematics.accelerate import HAS_NUMBA

_LIBRARIES = ("numpy", "pin", "daqp", "rosbags", "mcap")
_ROOMS = ("kinematics", "control", "messages")  # whose text decides every bit of a command


def software() -> dict[str, str]:
    """Return what may change a bit of the result: our version, Python, libraries, processor."""
    versions = {"ik_controller": __version__, "python": platform.python_version()}
    versions.update({name: _version(name) for name in _LIBRARIES})
    versions["numba"] = _version("numba") if HAS_NUMBA else "none"
    versions["processor"] = _processor()
    return versions


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def digest(text: str) -> str:
    """Return a short name of a text: the first 16 digits of its SHA-256."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@cache
def code() -> str:
    """Return a short name of our own code that decides the commands; another one means other text, not other bits."""
    package = Path(__file__).parents[1]
    files = sorted(file for room in _ROOMS for file in (package / room).rglob("*.py"))
    return digest("".join(file.read_text(encoding="utf-8") for file in (*files, package / "session.py")))
