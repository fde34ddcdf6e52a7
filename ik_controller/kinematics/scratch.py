"""The arrays that a kernel works with: room on its stack for those of its own, the others without counting references.

What Numba does for an array that is made, and whenever one is handed on, takes as long as the dozen numbers that are in
it: it was half of a control step. An array made here is on the stack of the function that makes it, and gone when
that returns: it is handed down, never returned, and never made in a loop, which would fill the stack. A test holds
that. Without Numba all this is NumPy's.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from ik_controller.kinematics.accelerate import HAS_NUMBA, numba


def scratch(n: int) -> Any:
    """Return an array (n,) of whatever was there."""
    return np.empty(n)


def scratch_table(m: int, n: int) -> Any:
    """Return an array (m, n) of whatever was there."""
    return np.empty((m, n))


def scratch_block(k: int, m: int, n: int) -> Any:
    """Return an array (k, m, n) of whatever was there."""
    return np.empty((k, m, n))


def scratch_integers(n: int) -> Any:
    """Return an array (n,) of whatever integers were there."""
    return np.empty(n, dtype=np.int64)


def borrowed(arrays: Any) -> Any:
    """Return a tuple of arrays, or of tuples of them, without their owners: of arguments, which the caller keeps."""
    return arrays


if HAS_NUMBA:
    # What a kernel takes instead of these.
    _ir, _types, _extending = import_module("llvmlite.ir"), numba.types, import_module("numba.extending")
    # The stack is that of the function that asks; not strict, which takes annotations for other arguments.
    _in_place = {"inline": "always", "strict": False}

    def _room(item: Any) -> Any:
        return lambda _context, builder, _signature, arguments: builder.alloca(item, arguments[0])

    @_extending.intrinsic  # type: ignore[untyped-decorator]
    def _numbers(_context: Any, _count: Any) -> Any:
        return _types.CPointer(_types.float64)(_types.intp), _room(_ir.DoubleType())

    @_extending.intrinsic  # type: ignore[untyped-decorator]
    def _integers(_context: Any, _count: Any) -> Any:
        return _types.CPointer(_types.int64)(_types.intp), _room(_ir.IntType(64))

    @_extending.overload(scratch, **_in_place)  # type: ignore[untyped-decorator]
    def _scratch(n: Any) -> Any:
        return lambda n: numba.carray(_numbers(n), n)

    @_extending.overload(scratch_table, **_in_place)  # type: ignore[untyped-decorator]
    def _scratch_table(m: Any, n: Any) -> Any:
        return lambda m, n: numba.carray(_numbers(m * n), (m, n))

    @_extending.overload(scratch_block, **_in_place)  # type: ignore[untyped-decorator]
    def _scratch_block(k: Any, m: Any, n: Any) -> Any:
        return lambda k, m, n: numba.carray(_numbers(k * m * n), (k, m, n))

    @_extending.overload(scratch_integers, **_in_place)  # type: ignore[untyped-decorator]
    def _scratch_integers(n: Any) -> Any:
        return lambda n: numba.carray(_integers(n), n)

    def _disown(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, _types.Array):
            view = context.make_array(kind)(context, builder, value=value)
            view.meminfo, view.parent = view.meminfo.type(None), view.parent.type(None)
            return view._getvalue()
        for k, item in enumerate(kind):
            inner = _disown(context, builder, item, builder.extract_value(value, k))
            value = builder.insert_value(value, inner, k)
        return value

    @_extending.intrinsic  # type: ignore[untyped-decorator]
    def _disowned(_context: Any, arrays: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return _disown(context, builder, signature.args[0], arguments[0])

        return arrays(arrays), generate

    @_extending.overload(borrowed, **_in_place)  # type: ignore[untyped-decorator]
    def _borrowed(arrays: Any) -> Any:
        return lambda arrays: _disowned(arrays)
