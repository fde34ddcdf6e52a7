"""Scratch arrays: where they may stand in the code, what they are, and that their room is given back."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import ik_controller
from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.scratch import borrowed, scratch, scratch_block, scratch_integers, scratch_table
from ik_controller.kinematics.small import gram

PACKAGE = Path(ik_controller.__file__).parent
MAKERS = {"scratch", "scratch_table", "scratch_block", "scratch_integers"}


def makes(node: ast.AST) -> bool:
    """Tell whether an expression makes a scratch array."""
    return any(
        isinstance(part, ast.Call) and isinstance(part.func, ast.Name) and part.func.id in MAKERS
        for part in ast.walk(node)
    )


def functions() -> Iterator[tuple[str, ast.FunctionDef]]:
    """Yield every function of the package that makes scratch arrays."""
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and node.name not in MAKERS and makes(node):
                yield f"{file.stem}.{node.name}", node


def faults(function: ast.FunctionDef) -> list[str]:
    """Return what is wrong in a function: an array made in a loop, by one that is not compiled, or returned."""
    found = []
    if not any(isinstance(name, ast.Name) and name.id in {"compiled", "inlined"} for name in function.decorator_list):
        found.append("not compiled")
    arrays: set[str] = set()
    for node in ast.walk(function):
        if isinstance(node, ast.For | ast.While) and any(makes(part) for part in node.body):
            found.append("made in a loop")
        if isinstance(node, ast.Assign) and makes(node.value):
            for target in node.targets:
                names, values = [target], [node.value]
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    names, values = target.elts, node.value.elts
                arrays |= {
                    name.id
                    for name, value in zip(names, values, strict=True)
                    if isinstance(name, ast.Name) and makes(value)
                }
    gives_arrays = "Array" in ast.unparse(function.returns) if function.returns is not None else True
    for node in ast.walk(function):
        if isinstance(node, ast.Return) and node.value is not None and gives_arrays:
            returned = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
            if any(makes(part) or (isinstance(part, ast.Name) and part.id in arrays) for part in returned):
                found.append("returned")
    return found


def test_scratch_arrays_are_made_by_kernels_outside_of_loops_and_stay_there() -> None:
    checked = {name: faults(function) for name, function in functions()}
    assert len(checked) > 25
    assert {name: found for name, found in checked.items() if found} == {}


def test_each_fault_would_be_found() -> None:
    for source, fault in {
        "def f(n):\n    x = scratch(n)": "not compiled",
        "@compiled\ndef f(n) -> Array:\n    for _ in range(n):\n        x = scratch(n)": "made in a loop",
        "@compiled\ndef f(n) -> Array:\n    x, y = scratch(n), 1\n    return x": "returned",
        "@compiled\ndef f(n) -> Array:\n    x = times(n, scratch(n))\n    return 1, x": "returned",
    }.items():
        (function,) = ast.parse(source).body
        assert isinstance(function, ast.FunctionDef)
        assert faults(function) == [fault]


@compiled
def sum_of_squares(n: int) -> float:
    """Return Σ i² for i < 4n, by way of one array of each kind."""
    one, table, block, integers = scratch(n), scratch_table(2, n), scratch_block(2, 2, n), scratch_integers(n)
    total = 0.0
    for i in range(n):
        one[i], table[0, i], table[1, i], integers[i] = i, n + i, 2 * n + i, 3 * n + i
        block[0, 0, i], block[0, 1, i], block[1, 0, i], block[1, 1, i] = one[i], table[0, i], table[1, i], integers[i]
    for a in range(2):
        for b in range(2):
            for i in range(n):
                total += block[a, b, i] * block[a, b, i]
    return total


@compiled
def many_times(n: int, times: int) -> float:
    """Call it so often that what it does not give back would fill any stack."""
    total = 0.0
    for _ in range(times):
        total += sum_of_squares(n)
    return total


def test_the_arrays_lie_apart_from_each_other_and_their_room_is_given_back() -> None:
    expected = float(np.sum(np.arange(40.0) ** 2))
    assert sum_of_squares(10) == expected
    assert many_times(10, 200_000) == 200_000 * expected  # 140 MB, were it kept


@compiled
def gram_of(first: np.ndarray, second: np.ndarray, out: np.ndarray) -> float:
    """Write A Aᵀ + B Bᵀ to `out`, and return how many numbers that is."""
    (first, second), out = borrowed(((first, second), out))
    m = first.shape[0]
    one, other = gram(first, scratch_table(m, m)), gram(second, scratch_table(m, m))
    for i in range(m):
        for j in range(m):
            out[i, j] = one[i, j] + other[i, j]
    return out.size


def test_borrowed_arrays_are_the_callers_own_and_stay_theirs() -> None:
    random = np.random.default_rng(1)
    for _ in range(1000):
        first, second, out = random.normal(size=(6, 7)), random.normal(size=(6, 3)), np.empty((6, 6))
        assert gram_of(first, second, out) == 36
        np.testing.assert_allclose(out, first @ first.T + second @ second.T, atol=1e-12)
