"""Numba where it is installed: one source of a numerical kernel that runs compiled or, slower, as plain Python.

A kernel is a module-level function of scalars and arrays, decorated with `compiled`. Switch the compiler off with
Numba's own variable, NUMBA_DISABLE_JIT=1. Fast-math stays off: a kernel gives the same bits on every call. Kernels are
written as loops over scalars: array expressions compile ten times as long. Numba's cache on disk watches only the file
of the kernel itself: after a change in a kernel that others call, `make clean`.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar, cast

numba: Any = None
# Read here, not by Numba, so that a process that solves one pose is spared the second that importing it takes.
if os.environ.get("NUMBA_DISABLE_JIT", "0") == "0":
    with contextlib.suppress(ImportError):
        numba = import_module("numba")

HAS_NUMBA: bool = numba is not None

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Return the function compiled by Numba with a cache on disk, or as it is where Numba is missing."""
    if not HAS_NUMBA:
        return function
    try:
        return cast(Function, numba.njit(cache=True, error_model="numpy")(function))
    except RuntimeError:  # no folder to write a cache to
        return cast(Function, numba.njit(error_model="numpy")(function))
