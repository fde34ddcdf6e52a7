"""solve_ik: solves what can be solved, within limits, and says why not where it cannot (N7, N12)."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import arms
import numpy as np
import pinocchio as pin
import pytest
from arms_closed_form import crossed_shoulder, puma_560, shoulder_elbow_wrist, ur5e
from hypothesis import given
from hypothesis import strategies as st

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.accelerate import HAS_NUMBA
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.solution import REASONS
from ik_controller.kinematics.solve import solve_ik

CONFIG = Path(__file__).parents[2] / "config"
PANDA = RobotModel.from_urdf(CONFIG / "panda" / "robot.urdf", "panda_hand_tcp")
PLANAR = RobotModel.from_urdf(arms.planar_2r(), "tool")
PUMA = RobotModel.from_urdf(arms.puma(), "tool")
ITERATIVE = ("newton", "damped", "transpose")


def example_robot(folder, tip):
    import site

    for packages in site.getsitepackages():
        path = Path(packages) / "cmeel.prefix/share/example-robot-data/robots" / folder
        if path.is_file():
            return RobotModel.from_urdf(path, tip)
    pytest.skip("the package example-robot-data is not installed")


def pose_at(x, y, z=0.0, quaternion=(0.0, 0.0, 0.0, 1.0)):
    return np.array([x, y, z, *quaternion])


def random_configuration(model, rng):
    lower = np.where(np.isfinite(model.lower), model.lower, -math.pi)
    upper = np.where(np.isfinite(model.upper), model.upper, math.pi)
    return rng.uniform(lower, upper)


def check_success_rate(model, poses, seed, at_least):
    rng = np.random.default_rng(seed)
    solved = 0
    for _ in range(poses):
        pose = model.forward(random_configuration(model, rng))
        solution = solve_ik(model, pose, random_configuration(model, rng))
        reached = model.forward(solution.q)
        linear = np.linalg.norm(pose.translation - reached.translation)
        angular = np.linalg.norm(pin.log3(pose.rotation @ reached.rotation.T))
        assert solution.position_error_m == pytest.approx(linear, abs=1e-12)
        assert solution.orientation_error_rad == pytest.approx(angular, abs=1e-12)
        assert (model.lower <= solution.q).all()
        assert (solution.q <= model.upper).all()
        assert solution.converged == (linear <= 1e-6 and angular <= 1e-6) == (solution.reason == "converged")
        solved += solution.converged
    assert solved >= at_least * poses


ROBOTS = {
    "panda": lambda: PANDA,
    "ur5e": lambda: RobotModel.from_urdf(CONFIG / "ur5e" / "robot.urdf", "tool0"),
    "xarm7": lambda: example_robot("xarm_description/urdf/xarm7.urdf", "link_eef"),
    "jaco": lambda: example_robot("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_random_reachable_poses(name):
    check_success_rate(ROBOTS[name](), 100, seed=21, at_least=1.0)


@pytest.mark.soak
@pytest.mark.parametrize("name", ROBOTS)
def test_a_thousand_random_reachable_poses(name):
    check_success_rate(ROBOTS[name](), 1000, seed=22, at_least=0.999)


# -- methods, frames, axes


@pytest.mark.parametrize("frame", ["base", "body", "space"])
@pytest.mark.parametrize("method", ["newton", "transpose"])
def test_every_frame_reaches_the_pose(method, frame):
    q = np.array([0.4, -0.5, 0.3, -1.9, 0.2, 1.6, 0.5])
    options = {"step": 0.3, "max_iterations": 5000} if method == "transpose" else {}
    solution = solve_ik(PANDA, PANDA.forward(q), q + 0.1, method, frame=frame, **options)
    assert solution.converged
    assert np.linalg.norm(pin.log6(PANDA.forward(solution.q).actInv(PANDA.forward(q))).vector) < 3e-6


def test_body_and_space_newton_take_the_same_steps_for_an_invertible_jacobian():
    """J_s = Ad J_b and E_s = Ad E_b, so J_s⁻¹E_s = J_b⁻¹E_b (000/003)."""
    q = np.array([0.2, 0.4, -0.8, 0.3, 0.6, -0.2])
    runs = [
        solve_ik(PUMA, PUMA.forward(q), q + 0.2, "newton", frame=frame, history=True, max_iterations=4).history
        for frame in ("body", "space")
    ]
    assert np.allclose([row.q for row in runs[0]][:4], [row.q for row in runs[1]][:4], atol=1e-9)


def test_newton_converges_quadratically():
    q = np.array([0.2, 0.4, -0.8, 0.3, 0.6, -0.2])
    history = solve_ik(
        PUMA, PUMA.forward(q), q + 0.05, "newton", history=True, position_tolerance=1e-14, orientation_tolerance=1e-14
    ).history
    errors = [math.hypot(row.position_error_m, row.orientation_error_rad) for row in history]
    for before, after in pairwise(errors):
        assert after < 5.0 * before**2 + 1e-14


MASKS = {"xyz": "111000", "xy": "110000", "xyzrp": "111110", "xyzr": "111100", "rpy": "000111", "xyy": "110001"}


@pytest.mark.parametrize("axes", MASKS)
@pytest.mark.parametrize("frame", ["base", "body"])
@pytest.mark.parametrize("method", ["newton", "damped"])
def test_any_subset_of_axes(method, axes, frame):
    rng = np.random.default_rng(31)
    on = np.array([bit == "1" for bit in MASKS[axes]])
    for _ in range(5):
        pose = PANDA.forward(random_configuration(PANDA, rng))
        solution = solve_ik(
            PANDA,
            pose,
            random_configuration(PANDA, rng),
            method,
            axes=axes,
            frame=frame,
            restarts=60,
            max_iterations=60,
        )
        assert solution.converged
        reached = PANDA.forward(solution.q)
        error = np.concatenate((pose.translation - reached.translation, pin.log3(pose.rotation @ reached.rotation.T)))
        if frame == "body":
            error = np.concatenate((pose.rotation.T @ error[:3], pose.rotation.T @ error[3:]))
        assert np.abs(error[on]).max() < 2e-6
        assert np.abs(error[~on]).max() > 1e-3  # what does not count is not forced


def test_free_turn_about_the_tool_is_chosen_to_suit_the_arm():
    """xyzrp in the body frame leaves the tool's z turn free: reached where the full pose is beyond a limit."""
    q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 2.8])
    turned = PANDA.forward(q) * pin.SE3(pin.exp3(np.array([0.0, 0.0, 1.2])), np.zeros(3))
    assert solve_ik(PANDA, turned, q, axes="xyzrp", frame="body", restarts=0).converged


@pytest.mark.parametrize("inverse", ["pseudo", "damped", "damped_singular_value", "numerical_filtering"])
def test_newton_with_other_inverses(inverse):
    q = np.array([0.4, -0.5, 0.3, -1.9, 0.2, 1.6, 0.5])
    assert solve_ik(PANDA, PANDA.forward(q), q + 0.2, "newton", inverse=inverse).converged


@pytest.mark.parametrize("error", ["exponential_tool", "quaternion", "instantaneous", "euler_relative_tool"])
def test_newton_with_other_orientation_errors(error):
    q = np.array([0.4, -0.5, 0.3, -1.9, 0.2, 1.6, 0.5])
    assert solve_ik(PANDA, PANDA.forward(q), q + 0.1, "newton", orientation_error=error).converged


def test_an_orientation_error_that_vanishes_at_pi_is_no_solution():
    """½ Σ rᵢ × r_id is zero half a turn away (N4): e is within any tolerance there, the answer must still be no."""
    q = np.array([0.1, 0.4, -0.8, 0.3, 0.6, -0.2])
    turned = PUMA.forward(q) * pin.SE3(pin.exp3(np.array([math.pi, 0.0, 0.0])), np.zeros(3))
    solution = solve_ik(PUMA, turned, q, "newton", orientation_error="instantaneous", max_iterations=20)
    assert not solution.converged
    assert solution.orientation_error_rad == pytest.approx(math.pi, abs=1e-6)


@pytest.mark.parametrize("frame", ["base", "body", "space"])
def test_converged_means_within_both_tolerances_in_every_frame(frame):
    rng = np.random.default_rng(51)
    for _ in range(20):
        q = random_configuration(PANDA, rng)
        solution = solve_ik(PANDA, PANDA.forward(q), q + 0.1, "newton", frame=frame, position_tolerance=1e-4,
                            orientation_tolerance=1e-3)  # fmt: skip
        if solution.converged:
            assert solution.position_error_m <= 1e-4
            assert solution.orientation_error_rad <= 1e-3


def test_step_as_number_diagonal_and_schedule():
    start, pose, free = (0.25, 0.75), pose_at(0.2, 1.3), {"respect_limits": False}
    full = solve_ik(PLANAR, pose, start, "newton", axes="xy", history=True, max_iterations=1, **free).history[1].q
    diagonal = solve_ik(
        PLANAR, pose, start, "newton", axes="xy", history=True, max_iterations=1, step=(0.5, 0.25), **free
    )
    assert np.allclose(diagonal.history[1].q - start, (full - start) * (0.5, 0.25))
    steps = []

    def schedule(k):
        steps.append(k)
        return 0.5 if k < 3 else 1.0

    assert solve_ik(PLANAR, pose, start, "newton", axes="xy", step=schedule).converged
    assert steps == list(range(len(steps)))
    assert len(steps) > 3


@pytest.mark.parametrize("method", ITERATIVE)
def test_clamp_bounds_every_iteration(method):
    q = np.array([0.2, 0.4, -0.8, 0.3, 0.6, -0.2])
    solution = solve_ik(
        PUMA, PUMA.forward(q), q + 0.6, method, clamp=0.05, history=True, max_iterations=400, restarts=0
    )
    moves = np.diff([row.q for row in solution.history], axis=0)
    assert np.abs(moves).max() <= 0.05 + 1e-12
    if method != "transpose":
        assert solution.converged


def test_bounded_steps_through_a_singularity():
    """N12: at the stretched elbow J⁺e explodes, a damped inverse does not."""
    start, pose = (0.3, 1e-4), pose_at(1.2, 0.3)
    steps = {}
    for inverse in ("pseudo", "damped_singular_value"):
        options = {"damping": 0.2, "threshold": 0.3} if inverse != "pseudo" else {}
        rows = solve_ik(
            PLANAR, pose, start, "newton", axes="xy", history=True, inverse=inverse, inverse_options=options,
            respect_limits=False,
        ).history  # fmt: skip
        steps[inverse] = np.abs(rows[1].q - rows[0].q).max()
    assert steps["pseudo"] > 100.0
    assert steps["damped_singular_value"] < 5.0


# -- limits, and the reason where there is no solution


@given(st.integers(0, 2**32 - 1), st.sampled_from(ITERATIVE))
def test_every_iterate_is_within_the_limits(seed, method):
    rng = np.random.default_rng(seed)
    pose = PANDA.forward(rng.uniform(-3.0, 3.0, 7))  # often beyond the limits
    solution = solve_ik(
        PANDA, pose, rng.uniform(-6.0, 6.0, 7), method, history=True, restarts=3, max_iterations=20, seed=seed
    )
    for row in solution.history:
        assert (PANDA.lower <= row.q).all()
        assert (row.q <= PANDA.upper).all()
    assert solution.reason in REASONS
    assert solution.converged == (solution.reason == "converged")
    reached = PANDA.forward(solution.q)
    assert np.linalg.norm(reached.translation - pose.translation) == pytest.approx(solution.position_error_m, abs=1e-9)


@pytest.mark.parametrize("method", [*ITERATIVE, "analytic"])
def test_out_of_reach_gives_the_closest_point_and_says_so(method):
    solution = solve_ik(PLANAR, pose_at(3.0, 4.0), (0.1, 0.5), method, axes="xy", max_iterations=None)
    assert not solution.converged
    assert solution.reason == "unreachable"
    assert solution.solutions == ()
    # The nearest point of a disc of radius 2 to a point at distance 5.
    assert solution.position_error_m == pytest.approx(3.0, abs=1e-6)
    assert np.allclose(PLANAR.forward(solution.q).translation, [1.2, 1.6, 0.0], atol=1e-3)


def test_inside_the_reach_but_unreachable():
    """A 2R arm with unequal links has a hole of radius 0.3 around its base."""
    model = RobotModel.from_urdf(arms.planar_2r(1.0, 0.7), "tool")
    for method in ("damped", "analytic"):
        solution = solve_ik(model, pose_at(0.1, 0.0), (0.3, 1.0), method, axes="xy")
        assert solution.reason == "unreachable"
        assert solution.position_error_m == pytest.approx(0.2, abs=1e-6)


@pytest.mark.parametrize("method", ["damped", "analytic"])
def test_beyond_a_limit(method):
    model = RobotModel.from_urdf(arms.planar_2r(), "tool")
    model.set_limits(lower=[-0.5, -0.5], upper=[0.5, 0.5])
    goal = model.forward([1.0, 0.3])
    solution = solve_ik(model, goal, (0.0, 0.1), method, axes="xy")
    assert solution.reason == "limit"
    assert (np.abs(solution.q) <= 0.5).all()
    grid = np.linspace(-0.5, 0.5, 201)
    nearest = min(np.linalg.norm(model.forward([a, b]).translation - goal.translation) for a in grid for b in grid)
    assert solution.position_error_m == pytest.approx(nearest, abs=1e-4)
    assert solve_ik(model, goal, (0.0, 0.1), method, axes="xy", respect_limits=False).converged


def test_local_minimum_without_restarts_and_solved_with_them():
    rng = np.random.default_rng(41)
    reasons = []
    for _ in range(60):
        pose, start = PANDA.forward(random_configuration(PANDA, rng)), random_configuration(PANDA, rng)
        alone = solve_ik(PANDA, pose, start, restarts=0)
        reasons.append(alone.reason)
        assert solve_ik(PANDA, pose, start).converged
    assert {"converged", "limit"} <= set(reasons) <= set(REASONS)


def test_stretched_arm_pointing_away_is_a_local_minimum():
    """θ = (0, 0) and a goal straight behind: Jᵀe = 0, though the goal can be reached."""
    for method in ITERATIVE:
        solution = solve_ik(PLANAR, pose_at(-1.0, 0.0), (0.0, 0.0), method, axes="xy", restarts=0)
        assert (solution.converged, solution.reason) == (False, "local_minimum")
    assert solve_ik(PLANAR, pose_at(-1.0, 0.0), (0.0, 0.0), axes="xy").converged


def test_too_few_iterations():
    solution = solve_ik(PLANAR, pose_at(0.2, 1.3), (0.25, 0.75), "transpose", axes="xy", max_iterations=5)
    assert (solution.converged, solution.reason, solution.iterations) == (False, "iterations", 5)


def test_full_turns_bring_a_joint_back_within_its_limits():
    model = RobotModel.from_urdf(ur5e(), "tool")
    q = np.array([6.2, -1.0, 1.2, -6.1, 1.0, 6.2])
    solution = solve_ik(model, model.forward(q), q + 0.15)
    assert solution.converged
    assert (np.abs(solution.q) <= 2.0 * math.pi).all()


def test_same_seed_same_answer_other_seed_another():
    pose = PANDA.forward([0.4, -0.5, 0.3, -1.9, 0.2, 1.6, 0.5])
    start = [2.8, 1.7, -2.8, -0.1, 2.8, 0.0, -2.8]
    first, again, other = (solve_ik(PANDA, pose, start, seed=seed) for seed in (5, 5, 6))
    assert first.restarts > 0
    assert (first.q == again.q).all()
    assert not np.allclose(first.q, other.q)


def test_damped_finds_all_of_a_nonredundant_arm():
    q = np.array([0.2, 0.4, -0.8, 0.3, 0.6, -0.2])
    found = solve_ik(PUMA, PUMA.forward(q), q, all_solutions=True)
    assert len(found.solutions) == 8


def test_history_is_complete_and_ends_at_the_solution():
    pose = PANDA.forward([0.4, -0.5, 0.3, -1.9, 0.2, 1.6, 0.5])
    solution = solve_ik(PANDA, pose, history=True)
    rows = [row for row in solution.history if row.restart == solution.restarts]
    assert [row.k for row in rows] == list(range(len(rows)))
    assert (rows[-1].q == solution.q).all()
    assert len(solution.history) == solution.iterations + solution.restarts + 1
    assert solve_ik(PANDA, pose).history == ()


# -- closed forms through solve_ik


def test_analytic_gives_every_turn_within_limits():
    model = RobotModel.from_urdf(ur5e(), "tool")
    q = np.array([0.3, -1.0, 1.2, -0.4, 0.8, 0.5])
    solution = solve_ik(model, model.forward(q), q, "analytic", all_solutions=True)
    plain = solve_ik(model, model.forward(q), q, "analytic", all_solutions=True, respect_limits=False)
    # Five joints go to ±2π and so have two turns for every angle, joint 3 has one.
    assert len(solution.solutions) == len(plain.solutions) * 2**5 >= 4 * 2**5
    assert np.allclose(solution.solutions[0], q, atol=1e-9)
    assert (np.array(solution.solutions) <= model.upper).all()
    assert (np.array(solution.solutions) >= model.lower).all()


def test_analytic_keeps_the_joint_that_is_free():
    q = np.array([0.7, math.pi / 2, 0.0, 0.1, 0.5, 0.2])
    solution = solve_ik(PUMA, PUMA.forward(q), q, "analytic")
    assert np.allclose(solution.q, q, atol=1e-7)
    assert "joint 1" in solution.free[0]


def test_swivel_angle_of_the_start_is_kept_until_limits_forbid_it():
    model = RobotModel.from_urdf(shoulder_elbow_wrist(), "tool")
    q = np.array([0.3, 0.7, -0.4, 1.1, 0.5, -0.8, 0.2])
    assert np.allclose(solve_ik(model, model.forward(q), q, "analytic").q, q, atol=1e-9)
    narrow = 0.2
    model.set_limits(lower=q - narrow, upper=q + narrow)
    start = np.clip(q + np.array([0.2, 0.0, -0.2, 0.0, 0.0, 0.0, 0.0]), model.lower, model.upper)
    solution = solve_ik(model, model.forward(q), start, "analytic")
    assert solution.converged
    assert (np.abs(solution.q - q) <= narrow).all()


def test_other_six_joint_arms_need_the_extra_or_get_it():
    model = RobotModel.from_urdf(crossed_shoulder(), "tool")
    q = np.array([0.3, 0.4, -0.5, 0.6, 0.7, -0.8])
    try:
        import eaik  # noqa: F401
    except ImportError:
        with pytest.raises(ArgumentError, match=r"ik_controller\[analytic\]"):
            solve_ik(model, model.forward(q), q, "analytic")
    else:
        solution = solve_ik(model, model.forward(q), q, "analytic", all_solutions=True)
        assert len(solution.solutions) == 8
        assert min(np.abs(one - q).max() for one in solution.solutions) < 1e-9


# -- input that is no good


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"pose": np.full(7, math.nan)}, "pose"),
        ({"pose": np.zeros(7)}, "quaternion"),
        ({"pose": pose_at(0.2, 1.3, 0.0, (0.0, 0.0, 0.0, 1.1))}, "quaternion"),
        ({"pose": np.zeros(6)}, "pose"),
        ({"pose": pin.SE3(2.0 * np.eye(3), np.zeros(3))}, "pose"),
        ({"pose": pin.SE3(np.diag([1.0, 1.0, -1.0]), np.zeros(3))}, "pose"),
        ({"pose": pin.SE3(np.eye(3), np.array([0.0, math.nan, 0.0]))}, "pose"),
        ({"q0": (0.0, 0.0, 0.0)}, "q0"),
        ({"q0": (0.0, math.nan)}, "q0"),
        ({"method": "magic"}, "newton, damped, transpose, analytic"),
        ({"axes": "xyq"}, "axes"),
        ({"axes": ""}, "axes"),
        ({"axes": "zx"}, "axes"),
        ({"frame": "tool"}, "base, body, space"),
        ({"frame": "space"}, "axes"),
        ({"frame": "space", "axes": "xyzrpy"}, "frame"),
        ({"step": 0.0}, "step"),
        ({"step": math.nan}, "step"),
        ({"step": (0.5, 0.5, 0.5)}, "step"),
        ({"step": lambda k: 0.5}, "step"),
        ({"method": "newton", "step": lambda k: -1.0}, "step"),
        ({"position_tolerance": -1.0}, "position_tolerance"),
        ({"orientation_tolerance": math.nan}, "orientation_tolerance"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"max_iterations": 2.5}, "max_iterations"),
        ({"restarts": -1}, "restarts"),
        ({"clamp": 0.0}, "clamp"),
        ({"method": "newton", "inverse": "psuedo"}, "pseudo"),
        ({"method": "newton", "inverse": "damped", "inverse_options": {"damping": -1.0}}, "damping"),
        ({"method": "newton", "orientation_error": "euler"}, "exponential_base"),
        ({"swivel": 0.3}, "swivel"),
        ({"method": "analytic", "swivel": 0.3}, "swivel"),
        ({"method": "analytic", "axes": "x"}, "axes"),
    ],
)
def test_bad_arguments_are_named(options, named):
    options = {"pose": pose_at(0.2, 1.3), "q0": (0.25, 0.75), "axes": "xy", **options}
    with pytest.raises(ArgumentError, match=named) as caught:
        solve_ik(PLANAR, options.pop("pose"), options.pop("q0"), **options)
    assert "\n" not in str(caught.value)


def test_links_of_no_length_are_named():
    for urdf, words in ((arms.planar_2r(0.0, 1.0), "joints 1 and 2"), (arms.planar_2r(1.0, 0.0), "tool point")):
        with pytest.raises(ArgumentError, match=words):
            solve_ik(RobotModel.from_urdf(urdf, "tool"), pose_at(0.2, 0.3), method="analytic", axes="xy")


def test_arms_without_a_closed_form_are_told_which_have_one():
    for urdf in (arms.skewed_7(), arms.scara()):
        with pytest.raises(ArgumentError, match="PUMA type 6R"):
            solve_ik(RobotModel.from_urdf(urdf, "tool"), pose_at(0.2, 0.3), method="analytic")


def test_closed_form_of_a_real_puma_by_its_axes_alone():
    model = RobotModel.from_urdf(puma_560(), "tool")
    q = np.array([0.3, 0.5, -0.7, 0.4, 0.9, -4.5])
    solution = solve_ik(model, model.forward(q), q, "analytic", all_solutions=True)
    assert np.allclose(solution.solutions[0], q, atol=1e-9)  # joint 6 beyond -π: the turn that fits is listed


@pytest.mark.skipif(not HAS_NUMBA, reason="Numba is not installed: the plain source is what runs already")
def test_compiled_and_plain_source_agree():
    from ik_controller.kinematics import levenberg_marquardt as lm
    from ik_controller.kinematics.chain import table_of

    pose = PANDA.forward([0.4, -0.5, 0.3, -1.9, 0.2, 1.6, 0.5])
    results = []
    for function in (lm.descend, lm.descend.py_func):
        q = np.array([0.2, 0.2, 0.2, -1.5, 0.2, 1.2, 0.2])
        ended = function(
            table_of(PANDA), np.ascontiguousarray(pose.rotation), pose.translation.copy(), np.ones(6), np.eye(3),
            PANDA.lower, PANDA.upper, PANDA.prismatic, np.ones(7), math.inf, 1e-9, 1e-9, 30, False, q, np.empty((0, 9)),
        )  # fmt: skip
        results.append((ended[0], ended[1], q))
    assert results[0][:2] == results[1][:2]
    assert np.allclose(results[0][2], results[1][2], atol=1e-12)
