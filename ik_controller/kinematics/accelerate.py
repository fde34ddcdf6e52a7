"""Numba where it is installed: one source of a numerical kernel that runs compiled or, slower, as plain Python.

A kernel is a module-level function of scalars and arrays, decorated with `compiled`. Switch the compiler off with
Numba's own variable, NUMBA_DISABLE_JIT=1. Fast-math stays off: a kernel gives the same bits on every call. Kernels are
best written as loops over scalars: array expressions compile ten times as long.

Numba's cache on disk watches only the file of the kernel itself, and would go on with the old code of a kernel that it
calls. So the cache's folder is named after the text of all files with kernels.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

numba: Any = None
# Read here, not by Numba, so that a process that solves one pose is spared the second that importing it takes.
if os.environ.get("NUMBA_DISABLE_JIT", "0") == "0":
    with contextlib.suppress(ImportError):
        numba = import_module("numba")

HAS_NUMBA: bool = numba is not None

Function = TypeVar("Function", bound=Callable[..., Any])


def _cache_folder() -> str:
    """Return the folder for this state of the kernels: Numba's own if the user has set one, else beside the package."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(package.glob("*/*.py")):
        text = file.read_bytes()
        if b"@compiled" in text or b"extending.overload" in text:
            digest.update(text)
    given = numba.config.CACHE_DIR
    parent = Path(given) if given else package / "__pycache__"
    if not os.access(parent if parent.exists() else parent.parent, os.W_OK):
        parent = Path.home() / ".cache" / "ik_controller"
    return str(parent / f"kernels-{digest.hexdigest()[:16]}")


_CACHE = _cache_folder() if HAS_NUMBA else ""


def compiled(function: Function) -> Function:
    """Return the function compiled by Numba with a cache on disk, or as it is where Numba is missing."""
    if not HAS_NUMBA:
        return function
    users = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _CACHE  # read while the function is decorated, and ours alone
    try:
        return cast(Function, numba.njit(cache=True, error_model="numpy")(function))
    except RuntimeError:  # no folder to write a cache to
        return cast(Function, numba.njit(error_model="numpy")(function))
    finally:
        numba.config.CACHE_DIR = users


def inlined(function: Function) -> Function:
    """Return the function made a part of every kernel that calls it: an argument that is a constant there is one for
    the compiler too, which then unrolls the loops.
    """
    return cast(Function, numba.njit(inline="always", error_model="numpy")(function)) if HAS_NUMBA else function
