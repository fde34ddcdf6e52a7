"""Penrose conditions, optimality, damping bounds, null spaces, the examples of 004 pp. 47-52 (N5, N6, N12)."""

from __future__ import annotations

import math

import arms
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import finite_vectors

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.damped_inverse import damped_gram_inverse
from ik_controller.kinematics.inverses import INVERSES, general_solution, inverse, null_space_projector
from ik_controller.kinematics.model import RobotModel

DAMPED = ["damped", "damped_manipulability", "damped_singular_value", "numerical_filtering"]


@st.composite
def matrices(draw, shape=None, rank=None, smallest=0.1):
    """Matrices U Σ Vᵀ of a shape and rank, singular values from `smallest` to 3."""
    m, n = shape or (draw(st.integers(1, 7)), draw(st.integers(1, 7)))
    r = min(m, n) if rank is None else rank
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    u, v = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (m, n))
    sigma = np.zeros((m, n))
    sigma[range(r), range(r)] = draw(st.lists(st.floats(smallest, 3.0), min_size=r, max_size=r))
    return u @ sigma @ v.T


@st.composite
def deficient(draw):
    """Matrices of rank below min(m, n), the zero matrix included."""
    m, n = draw(st.integers(1, 7)), draw(st.integers(1, 7))
    return draw(matrices((m, n), draw(st.integers(0, min(m, n) - 1))))


@st.composite
def metrics(draw, size):
    """Symmetric positive definite (size, size) with condition number up to 1e4."""
    root = draw(matrices((size, size), smallest=0.03))
    return root @ root.T


def assert_penrose(A, sharp, conditions=(1, 2, 3, 4), atol=1e-9):
    checks = {
        1: (A @ sharp @ A, A),
        2: (sharp @ A @ sharp, sharp),
        3: ((A @ sharp).T, A @ sharp),
        4: ((sharp @ A).T, sharp @ A),
    }
    for number in conditions:
        np.testing.assert_allclose(*checks[number], atol=atol, err_msg=f"Penrose condition {number}")


@given(A=st.one_of(matrices(), deficient()))
def test_pseudo_fulfils_all_four_penrose_conditions_at_any_rank(A):
    assert_penrose(A, inverse(A, "pseudo"))
    np.testing.assert_allclose(inverse(A), np.linalg.pinv(A, rcond=1e-10), atol=1e-9)


@given(A=matrices())
def test_right_left_and_exact_are_the_pseudo_inverse_at_full_rank(A):
    m, n = A.shape
    methods = (["right"] if m <= n else []) + (["left"] if m >= n else []) + (["exact"] if m == n else [])
    for method in methods:
        np.testing.assert_allclose(inverse(A, method), inverse(A, "pseudo"), atol=1e-9)
        assert_penrose(A, inverse(A, method))
    if m <= n:
        np.testing.assert_allclose(inverse(A, "right"), A.T @ np.linalg.inv(A @ A.T), atol=1e-8)
        np.testing.assert_allclose(A @ inverse(A, "right"), np.eye(m), atol=1e-9)
    if m >= n:
        np.testing.assert_allclose(inverse(A, "left"), np.linalg.inv(A.T @ A) @ A.T, atol=1e-8)
        np.testing.assert_allclose(inverse(A, "left") @ A, np.eye(n), atol=1e-9)


@given(data=st.data())
def test_weighted_right_is_the_printed_formula_and_has_the_least_weighted_norm(data):
    m = data.draw(st.integers(1, 6))
    n = data.draw(st.integers(m, 7))
    A, W = data.draw(matrices((m, n))), data.draw(metrics(n))
    x, other = data.draw(finite_vectors(m)), data.draw(finite_vectors(n))
    sharp = inverse(A, "weighted_right", weight=W)
    V = np.linalg.inv(W)
    np.testing.assert_allclose(sharp, V @ A.T @ np.linalg.inv(A @ V @ A.T), atol=1e-6)
    np.testing.assert_allclose(A @ sharp, np.eye(m), atol=1e-9)
    assert_penrose(A, sharp, (1, 2, 3), atol=1e-7)
    # Condition 4 in the metric: q̇ᵀ W (null motion) = 0.
    y = sharp @ x
    null = other - inverse(A) @ (A @ other)
    assert y @ W @ null == pytest.approx(0.0, abs=1e-6)
    assert y @ W @ y <= (y + null) @ W @ (y + null) + 1e-6


@given(data=st.data())
def test_weighted_left_is_the_printed_formula_and_has_the_least_weighted_residual(data):
    n = data.draw(st.integers(1, 6))
    m = data.draw(st.integers(n, 7))
    A, W = data.draw(matrices((m, n))), data.draw(metrics(m))
    x, other = data.draw(finite_vectors(m)), data.draw(finite_vectors(n))
    sharp = inverse(A, "weighted_left", weight=W)
    V = np.linalg.inv(W)
    np.testing.assert_allclose(sharp, np.linalg.inv(A.T @ V @ A) @ A.T @ V, atol=1e-6)
    np.testing.assert_allclose(sharp @ A, np.eye(n), atol=1e-9)
    best, worse = x - A @ (sharp @ x), x - A @ (sharp @ x + other)
    assert best @ V @ best <= worse @ V @ worse + 1e-6 * max(1.0, worse @ V @ worse)


@given(A=matrices())
def test_unit_weight_is_no_weight(A):
    m, n = A.shape
    method, size = ("weighted_right", n) if m <= n else ("weighted_left", m)
    np.testing.assert_allclose(inverse(A, method, weight=np.ones(size)), inverse(A), atol=1e-9)
    np.testing.assert_allclose(inverse(A, method, weight=np.eye(size)), inverse(A), atol=1e-9)


@given(A=st.one_of(matrices(), deficient()), damping=st.floats(0.01, 1.0))
def test_damped_is_the_printed_formula_and_its_twin(A, damping):
    m, n = A.shape
    sharp = inverse(A, "damped", damping=damping)
    np.testing.assert_allclose(sharp, A.T @ np.linalg.inv(A @ A.T + damping**2 * np.eye(m)), atol=1e-8)
    np.testing.assert_allclose(sharp, np.linalg.inv(A.T @ A + damping**2 * np.eye(n)) @ A.T, atol=1e-8)


@pytest.mark.parametrize("method", ["damped", "damped_singular_value", "numerical_filtering"])
@given(A=st.one_of(matrices(smallest=1e-9), deficient()), damping=st.floats(0.01, 0.2))
def test_damping_bounds_the_velocity_at_and_near_every_singularity(method, A, damping):
    options = {} if method == "damped" else {"threshold": 0.3}
    gain = np.linalg.norm(inverse(A, method, damping=damping, **options), 2)
    # σ/(σ² + λ²) ≤ 1/(2λ) with λ = λ₀; where λ² falls below 3/4 λ₀², σ > ε/2.
    assert gain <= max(1 / (2 * math.sqrt(0.75) * damping), 2 / 0.3) + 1e-9


@given(A=deficient(), damping=st.floats(0.01, 0.2))
def test_damping_by_manipulability_bounds_the_velocity_at_a_singularity(A, damping):
    gain = np.linalg.norm(inverse(A, "damped_manipulability", damping=damping, threshold=0.3), 2)
    assert gain <= 1 / (2 * damping) + 1e-9


def test_damping_by_manipulability_can_sleep_near_a_singularity():
    """w is a product: two large singular values hide a small one; the smallest singular value does not."""
    A = np.diag([3.0, 3.0, 1e-3])
    options = {"damping": 0.1, "threshold": 0.005}
    assert np.linalg.norm(inverse(A, "damped_manipulability", **options), 2) > 500
    assert np.linalg.norm(inverse(A, "damped_singular_value", **options), 2) < 200


@pytest.mark.parametrize("method", ["damped_manipulability", "damped_singular_value", "numerical_filtering"])
@given(A=matrices(smallest=1.001))
def test_damping_that_varies_is_off_away_from_singularities(method, A):
    np.testing.assert_allclose(inverse(A, method, damping=0.5, threshold=1.0), inverse(A), atol=1e-12)


@pytest.mark.parametrize("method", DAMPED)
@given(A=st.one_of(matrices(), deficient()))
def test_zero_damping_is_the_pseudo_inverse(method, A):
    np.testing.assert_allclose(inverse(A, method, damping=0.0), inverse(A), atol=1e-12)


def test_the_damping_laws_are_those_of_the_papers():
    A = np.diag([1.0, 0.1])
    w = 0.1
    nakamura = 0.2**2 * (1 - w / 0.4) ** 2
    chiaverini = 0.2**2 * (1 - (0.1 / 0.4) ** 2)
    options = {"damping": 0.2, "threshold": 0.4}
    np.testing.assert_allclose(
        inverse(A, "damped_manipulability", **options), np.diag([1 / (1 + nakamura), 0.1 / (0.01 + nakamura)])
    )
    np.testing.assert_allclose(
        inverse(A, "damped_singular_value", **options), np.diag([1 / (1 + chiaverini), 0.1 / (0.01 + chiaverini)])
    )
    np.testing.assert_allclose(inverse(A, "numerical_filtering", **options), np.diag([1.0, 0.1 / (0.01 + chiaverini)]))


@given(A=st.one_of(matrices((6, 7), smallest=1e-6), matrices((6, 7), rank=5), matrices((6, 4))), x=finite_vectors(6))
def test_what_the_control_loop_runs_is_numerical_filtering(A, x):
    """Its kernel takes a short way where nothing is damped; σ_min is then a Rayleigh quotient: never too small."""
    gram_inverse = np.empty((len(A), len(A)))
    sigma = damped_gram_inverse(A @ A.T, 0.05, 0.1, gram_inverse)
    np.testing.assert_allclose(
        A.T @ (gram_inverse @ x), inverse(A, "numerical_filtering", damping=0.05, threshold=0.1) @ x, atol=1e-6
    )
    values = np.linalg.svd(A, compute_uv=False)
    smallest = values[-1] if len(values) == 6 else 0.0
    assert smallest - 1e-6 <= sigma <= 1.02 * smallest + 1e-6


def test_transpose():
    A = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(inverse(A, "transpose"), A.T)


# -- 004 pp. 47-52


@given(a=st.floats(-5, 5), x=st.floats(-5, 5))
def test_example_of_p47_the_family_of_generalized_inverses(a, x):
    A = np.array([[2.0, -1.0]])
    sharp = np.array([[0.5 + a / 2], [a]])
    np.testing.assert_allclose(A @ sharp @ A, A, atol=1e-12)  # p. 47
    np.testing.assert_allclose(A @ (sharp * x), [[x]], atol=1e-12)  # p. 48, which drops the x in "Ay = A A#"
    # One of the family is the pseudo-inverse, a = −1/5: the others are longer.
    np.testing.assert_allclose(inverse(A), [[0.4], [-0.2]], atol=1e-15)
    assert np.linalg.norm(sharp) >= np.linalg.norm(inverse(A)) - 1e-12


@given(x=finite_vectors(2), y0=finite_vectors(3))
def test_example_of_p49_has_infinitely_many_solutions(x, y0):
    A = np.array([[2.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
    sharp = inverse(A, "right")
    np.testing.assert_allclose(A @ general_solution(A, sharp, x, y0), x, atol=1e-12)
    np.testing.assert_allclose(np.linalg.svd(null_space_projector(A, sharp), compute_uv=False), [1, 0, 0], atol=1e-12)


@given(y=finite_vectors(2), off=st.floats(0.1, 3.0))
def test_example_of_p50_has_one_solution_or_none(y, off):
    A = np.array([[1.0, 0.0], [2.0, 4.0], [3.0, 4.0]])
    sharp = inverse(A, "left")
    np.testing.assert_allclose(sharp @ (A @ y), y, atol=1e-12)  # x in the plane of (1, 2, 3) and (0, 4, 4)
    normal = np.cross(A[:, 0], A[:, 1])
    x = A @ y + off * normal / np.linalg.norm(normal)
    np.testing.assert_allclose(sharp @ x, y, atol=1e-12)  # off the plane: the nearest point's
    assert np.linalg.norm(A @ (sharp @ x) - x) == pytest.approx(off)


# -- null space


@pytest.mark.parametrize("method", ["pseudo", "right", "weighted_right"])
@given(q=finite_vectors(7), q0=finite_vectors(7), x=finite_vectors(6))
def test_null_motion_does_not_move_the_tool(method, q, q0, x):
    J = RobotModel.from_urdf(arms.skewed_7(), "tool").jacobian(q)
    assume(np.linalg.svd(J, compute_uv=False)[-1] > 0.02)
    sharp = inverse(J, method, weight=np.linspace(1, 5, 7) if method == "weighted_right" else None)
    N = null_space_projector(J, sharp)
    np.testing.assert_allclose(J @ (N @ q0), 0, atol=1e-11)
    np.testing.assert_allclose(N @ N, N, atol=1e-10)
    solution = general_solution(J, sharp, x, q0)
    np.testing.assert_allclose(solution, sharp @ x + N @ q0, atol=1e-9)
    np.testing.assert_allclose(J @ solution, x, atol=1e-10)


@given(q=finite_vectors(6), q0=finite_vectors(6), x=finite_vectors(3))
def test_a_position_task_leaves_a_six_joint_arm_three_freedoms(q, q0, x):
    J = RobotModel.from_urdf(arms.puma(), "tool").jacobian(q)[:3]
    assume(np.linalg.svd(J, compute_uv=False)[-1] > 0.02)
    sharp = inverse(J, "right")
    np.testing.assert_allclose(J @ general_solution(J, sharp, x, q0), x, atol=1e-10)
    assert np.linalg.matrix_rank(null_space_projector(J, sharp), tol=1e-6) == 3


def test_a_damped_inverse_lets_null_motion_leak_and_filtering_only_along_the_lost_direction():
    J = np.diag([1.0, 0.05])
    leak = J @ null_space_projector(J, inverse(J, "damped", damping=0.1))
    assert np.abs(leak).max() > 0.009
    leak = J @ null_space_projector(J, inverse(J, "numerical_filtering", damping=0.1, threshold=0.2))
    assert abs(leak[0, 0]) < 1e-15
    assert abs(leak[1, 1]) > 0.03


# -- errors


@pytest.mark.parametrize(
    ("J", "method", "options", "message"),
    [
        (np.eye(2), "svd", {}, "inverse method 'svd' is unknown; legal: exact, right, left, pseudo, weighted_right"),
        (np.ones(3), "pseudo", {}, r"J: need shape \(\*, \*\), got \(3,\)"),
        (np.zeros((0, 3)), "pseudo", {}, r"J: need shape \(\*, \*\), got \(0, 3\)"),
        (np.array([[math.nan]]), "pseudo", {}, "J: every value must be finite"),
        (np.ones((2, 3)), "exact", {}, r"J: shape \(2, 3\) is not square, exact needs m = n"),
        (np.ones((3, 2)), "right", {}, r"J: shape \(3, 2\) has m > n, right needs m ≤ n"),
        (np.ones((2, 3)), "left", {}, r"J: shape \(2, 3\) has m < n, left needs m ≥ n"),
        (np.ones((2, 2)), "exact", {}, "J: singular, rank 1 of 2, which 'exact' cannot invert; use 'pseudo'"),
        (np.ones((2, 3)), "right", {}, "J: singular, rank 1 of 2, which 'right' cannot invert"),
        (np.zeros((3, 2)), "left", {}, "J: singular, rank 0 of 2, which 'left' cannot invert"),
        (np.ones((2, 3)), "weighted_right", {"weight": np.ones(3)}, "J: singular, rank 1 of 2, which 'weighted_right'"),
        (np.eye(2), "weighted_right", {}, "weight: inverse 'weighted_right' needs it"),
        (np.eye(2), "weighted_right", {"weight": np.ones((2, 2))}, "weight: must be positive definite"),
        (np.eye(2), "weighted_right", {"weight": [1, 0]}, "weight: must be positive definite, its smallest eigenvalue"),
        (np.eye(2), "weighted_right", {"weight": [[1, 0.5], [0, 1]]}, "weight: must be symmetric"),
        (np.eye(2), "weighted_left", {"weight": np.ones(3)}, r"weight: need shape \(2, 2\), got \(3, 3\)"),
        (np.eye(2), "weighted_left", {"weight": [1, math.inf]}, "weight: every value must be finite"),
        (np.eye(2), "weighted_left", {"weight": "heavy"}, "weight: need an array of numbers"),
        (np.eye(2), "damped", {"damping": -0.1}, "damping: need a value ≥ 0, got -0.1"),
        (np.eye(2), "damped", {"damping": math.nan}, "damping: every value must be finite"),
        (np.eye(2), "damped", {"threshold": 0.1}, "threshold: inverse 'damped' does not take it; it takes: damping"),
        (np.eye(2), "numerical_filtering", {"threshold": 0}, "threshold: need a value > 0, got 0"),
        (np.eye(2), "pseudo", {"tolerance": -1}, "tolerance: need a value ≥ 0"),
    ],
)
def test_bad_input_is_one_line_that_names_the_argument(J, method, options, message):
    with pytest.raises(ArgumentError, match=message) as caught:
        inverse(J, method, **options)
    assert "\n" not in str(caught.value)


def test_shapes_that_do_not_match_are_named():
    with pytest.raises(ArgumentError, match=r"J_sharp: need shape \(3, 2\), got \(2, 3\)"):
        null_space_projector(np.ones((2, 3)), np.ones((2, 3)))
    with pytest.raises(ArgumentError, match=r"x: need shape \(2,\), got \(3,\)"):
        general_solution(np.ones((2, 3)), np.ones((3, 2)), np.ones(3), np.ones(3))
    with pytest.raises(ArgumentError, match=r"q0: need shape \(3,\), got \(2,\)"):
        general_solution(np.ones((2, 3)), np.ones((3, 2)), np.ones(2), np.ones(2))


def test_the_registry_names_what_the_functions_take():
    for name, entry in INVERSES.items():
        assert entry.name == entry.function.__name__ == name
        arguments = entry.function.__code__.co_varnames[1 : entry.function.__code__.co_argcount]
        assert entry.options == arguments
