"""Without Numba: the same commands but for rounding, through limits, singularities and everything that leaves NumPy's
short way.
"""

import os
import subprocess
import sys

import daqp
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ik_controller import Controller, Reference
from ik_controller.control.bounded import ALONG
from ik_controller.control.gate import check
from ik_controller.control.kernel import BY_ACCELERATION, BY_VELOCITY, tool_cycle
from ik_controller.control.law import Law
from ik_controller.control.limits import JointLimits
from ik_controller.control.plain import PlainCheck, PlainCycle, near_bound
from ik_controller.control.plain_path import shortest
from ik_controller.control.reach import LAST
from ik_controller.control.reach import near_bound as near_bound_by_loops
from ik_controller.kinematics.accelerate import HAS_NUMBA
from ik_controller.robots import build_model, bundled_parameters

DT, CYCLES = 1e-3, 150
# name → (arm, parameters, offset from the start's tool position [m], how it gets there)
MODELS: dict = {}
FOUND = set()  # (how, limit, is the path slowed)
RUNS = {
    "idle": ("panda", {}, (0.05, 0.1, 0.02), "moving"),
    "six joints": ("ur5e", {}, (0.02, 0.05, 0.02), "moving"),
    "saturated": ("panda", {"velocity_scale": 0.02}, (0.05, 0.1, 0.02), "moving"),
    "saturated, six joints": ("ur5e", {"velocity_scale": 0.02}, (0.05, 0.1, 0.02), "moving"),
    "acceleration held back": ("panda", {"acceleration_scale": 0.05}, (0.05, 0.1, 0.02), "moving"),
    "from far": ("panda", {}, (0.1, -0.3, 0.1), "at once"),
    "out of reach": ("panda", {}, (3.0, 0.0, 0.0), "at once"),
    "no posture": ("panda", {"posture": ()}, (0.05, 0.1, 0.02), "moving"),
    "tool bounds": ("panda", {"tool_linear_speed": 0.1, "tool_linear_acceleration": 2.0}, (0.0, 0.1, 0.0), "moving"),
    "tasks": ("panda", {"secondary_tasks": ["z panda_link4"], "secondary_targets": [0.6]}, (0.0, 0.1, 0.0), "moving"),
}


def commands(name):
    """Return position, velocity and σ_min (CYCLES, 2n + 1) of a run."""
    arm, changes, offset, way = RUNS[name]
    parameters = bundled_parameters(arm).replace(changes)
    model = build_model(parameters)
    home = np.array(bundled_parameters(arm).posture) if bundled_parameters(arm).posture else model.middle()
    controller = Controller(model, parameters)
    controller.reset(home)
    start = model.forward(home)

    def pose(k):
        share = 1.0 if way == "at once" else 0.5 - 0.5 * np.cos(k * DT * 4.0)
        return pin.SE3(
            pin.exp3(np.array((0.3 * share, 0.0, 0.0))) @ start.rotation, start.translation + share * np.array(offset)
        )

    rows = []
    for k in range(CYCLES):
        step = controller.step(controller.position, Reference.between(pose(k), pose(k + 1), DT), DT)
        rows.append((*step.position, *step.velocity, step.status.smallest_singular_value))
    return np.array(rows)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    arm=st.sampled_from(["panda", "ur5e"]),
    slow=st.sampled_from([1.0, 0.3, 0.02]),
    gentle=st.sampled_from([1.0, 0.1]),
    away=st.sampled_from([0.0, 1e-5, 1e-3, 0.1, np.nan]),
    moving=st.sampled_from([0.0, 0.1, 0.9, 1.0]),
    faster=st.sampled_from([0.0, 1.0, 1.2, 3.0]),
)
def one_cycle_is_the_kernels(seed, arm, slow, gentle, away, moving, faster):
    """From any state towards anything; only where there is no Numba, and so the kernel runs as it is written."""
    rng, parameters = np.random.default_rng(seed), bundled_parameters(arm)
    model = MODELS.setdefault(arm, build_model(parameters))
    n, limits = model.n, JointLimits(model, slow, gentle)
    law = Law(model, parameters.replace({"velocity_scale": slow, "acceleration_scale": gentle}))
    lower, upper = np.fmax(model.lower, -3.0), np.fmin(model.upper, 3.0)
    q = lower + (upper - lower) * (rng.uniform(0.0, 1.0, n) if seed % 4 == 0 else rng.uniform(0.1, 0.9, n))
    v = rng.uniform(-1.0, 1.0, n)
    v *= moving * limits.velocity / np.abs(v).max()
    limits.table[LAST, :n] = moving * limits.acceleration * rng.uniform(-1.0, 1.0, n)
    state = np.concatenate((q, v, model.jacobian(q) @ v))
    tool = model.forward(q)
    rotation = pin.exp3(away * rng.normal(size=3)) @ tool.rotation
    twist = faster * model.jacobian(q) @ v + (0.01 if seed % 3 == 0 else 0.0) * rng.normal(size=6)
    results = []
    for cycle in (PlainCycle(law.chain), tool_cycle):
        out, detail = np.zeros(2 * n + 12), np.zeros((7, n))
        found = cycle(
            law.chain, law.table, limits.table, state, q, tool.translation + away,
            rotation, twist, np.zeros(6), True, limits.reserve, DT, out, detail,
        )  # fmt: skip
        results.append((found, out, detail))
    (found, out, detail), (expected, out_there, detail_there) = results
    how, scale, joint, limit, sigma = expected
    assert (found[0], found[2], found[3]) == (how, joint, limit)
    np.testing.assert_allclose(found[4], sigma, rtol=0.0, atol=1e-9)
    if np.isnan(away):
        return
    np.testing.assert_allclose(found[1], scale, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(detail, detail_there, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(out[:n], out_there[:n], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(out[n:], out_there[n:], rtol=0.0, atol=1e-7)
    assert near_bound(q, limits.table) == near_bound_by_loops(q, limits.table)
    FOUND.add((how, limit, bool(scale < 1.0)))


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """All runs in a process without Numba, where single cycles are first held against the kernel's own."""
    file = tmp_path_factory.mktemp("plain") / "runs.npz"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, __file__, str(file)], env=environment, check=True, timeout=300)
    with np.load(file) as runs:
        return dict(runs)


@pytest.mark.skipif(not HAS_NUMBA, reason="without Numba there is nothing to compare with")
@pytest.mark.parametrize("name", RUNS)
def test_commands_are_those_of_the_compiled_law(plain, name):
    """Not bit for bit: sums are taken in another order."""
    compiled, found = commands(name), plain[name]
    n = compiled.shape[1] // 2
    np.testing.assert_allclose(found[:, :n], compiled[:, :n], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found[:, n:-1], compiled[:, n:-1], rtol=0.0, atol=1e-7)  # as far as DAQP's digits go
    np.testing.assert_allclose(found[1:, -1], compiled[1:, -1], rtol=0.0, atol=1e-9)
    assert np.abs(compiled[-1, :-1] - compiled[0, :-1]).max() > 1e-4


@settings(max_examples=300, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 9), apart=st.sampled_from([0.0, 1.0, 3.0]))
def test_the_shortest_pair_within_rows_is_that_of_another_solver(seed, count, apart):
    """Where it does not exist, DAQP finds none either; apart: how far the rows are from containing 0."""
    rng = np.random.default_rng(seed)
    matrix, middle = rng.normal(size=(count, 2)), apart * rng.normal(size=count)
    lower, upper = middle - rng.uniform(0.0, 1.0, count), middle + rng.uniform(0.0, 1.0, count)
    found = shortest([*zip(*matrix.T.tolist(), lower.tolist(), upper.tolist(), strict=True)], 1e-12)
    expected, _, flag, _ = daqp.solve(
        np.eye(2), np.zeros(2), matrix, upper, lower, np.zeros(count, dtype=np.int32), primal_tol=1e-11
    )
    assert (found is not None) == (flag == 1)
    if found is not None:
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)


def test_the_quick_look_of_the_gate_finds_what_the_gate_does():
    """Each kind of wrong command, and good ones."""
    rng = np.random.default_rng(0)
    limits = np.array([[-1.0] * 3, [1.0] * 3, [2.0] * 3, [10.0] * 3, [np.inf] * 3])
    verdicts = set()
    for case in range(400):
        memory = np.array([rng.uniform(-0.999, 0.999, 3), rng.uniform(-1.0, 1.0, 3), np.zeros(3)])
        v = memory[1] + rng.uniform(-9e-3, 9e-3, 3)
        if case % 4 == 1:
            v[rng.integers(3)] *= rng.uniform(0.5, 3.0)
        q = memory[0] + v * DT
        if case % 4 == 2:
            q[rng.integers(3)] += rng.choice([1e-9, np.nan, np.inf])
        if case % 4 == 3:
            memory[0, 0] = q[0] = 1.0
        one, other = memory.copy(), memory.copy()
        expected = check(one, limits, q, v, DT)
        assert PlainCheck(limits, check)(other, limits, q, v, DT) == expected
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-12)
        verdicts.add(expected % 7)
    assert {0, 1, 2, 4}.issubset(verdicts)


if __name__ == "__main__":
    one_cycle_is_the_kernels()
    assert {(ALONG, BY_VELOCITY, True), (ALONG, BY_ACCELERATION, True), (ALONG, BY_ACCELERATION, False)} <= FOUND
    np.savez(sys.argv[1], **{name: commands(name) for name in RUNS})
