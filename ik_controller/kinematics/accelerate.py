"""Numba where it is installed: one source of a numerical kernel that runs compiled or, slower, as plain Python.

A kernel is a module-level function of scalars and arrays, decorated with `compiled`. Switch the compiler off with
Numba's own variable, NUMBA_DISABLE_JIT=1. Fast-math stays off: a kernel gives the same bits on every call.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

try:
    import numba
except ImportError:
    numba = None

HAS_NUMBA: bool = numba is not None and not numba.config.DISABLE_JIT

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Return the function compiled by Numba with a cache on disk, or as it is where Numba is missing."""
    if not HAS_NUMBA:
        return function
    try:
        return cast(Function, numba.njit(cache=True, error_model="numpy")(function))
    except RuntimeError:  # no folder to write a cache to
        return cast(Function, numba.njit(error_model="numpy")(function))
