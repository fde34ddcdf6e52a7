"""Order of the integrators, drift in open loop, decay at the rates of K, resolved motion rate (N10, N13)."""

from __future__ import annotations

import math

import arms
import numpy as np
import pinocchio as pin
import pytest

from ik_controller.errors import ArgumentError
from ik_controller.kinematics.integrate import follow, integrate, joint_velocity, pose_error, resolved_rate
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.orientation_error import ORIENTATION_ERRORS

PUMA = RobotModel.from_urdf(arms.puma(), "tool")
Q0 = np.array([0.2, -0.6, 1.9, 0.3, -0.9, 0.2])
START = PUMA.forward(Q0)
OMEGA = np.array([0.1, -0.2, 0.3])  # [rad/s]


def circle(t):
    """A circle of 0.1 m in 4 s with the tool turning: pose at t, from the pose at Q0."""
    phase = math.pi / 2 * t
    p = START.translation + 0.1 * np.array([0, math.cos(phase) - 1, math.sin(phase)])
    return pin.SE3(pin.exp3(OMEGA * t) @ START.rotation, p)


def circle_twist(t):
    phase = math.pi / 2 * t
    return np.concatenate((0.05 * math.pi * np.array([0, -math.sin(phase), math.cos(phase)]), OMEGA))


def final_error(dt, method="euler", gain=0.0):
    motion = follow(PUMA, Q0, 4.0, dt, twist=circle_twist, reference=circle, method=method, gain=gain)
    return float(np.linalg.norm(motion.error[-1]))


@pytest.mark.parametrize(("method", "order"), [("euler", 1), ("midpoint", 2), ("rk4", 4)])
def test_the_drift_falls_with_the_order_of_the_method(method, order):
    coarse, fine = final_error(0.1, method), final_error(0.05, method)
    assert math.log2(coarse / fine) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize(("method", "order"), [("euler", 1), ("midpoint", 2), ("rk4", 4)])
def test_each_method_has_its_order_on_a_known_solution(method, order):
    def error(dt):
        t, q = integrate(lambda t, q: -q + np.array([t]), [1.0], 2.0, dt, method)
        return abs(q[-1, 0] - (t[-1] - 1 + 2 * math.exp(-t[-1])))

    assert math.log2(error(0.1) / error(0.05)) == pytest.approx(order, abs=0.15)


def test_open_loop_drifts_and_feedback_takes_the_drift_away():
    motion = follow(PUMA, Q0, 4.0, 0.02, twist=circle_twist, reference=circle)
    distance = np.linalg.norm(motion.error[:, :3], axis=1)
    assert distance[0] < 1e-15
    assert distance[-1] > 1e-3  # never made up for
    closed = follow(PUMA, Q0, 4.0, 0.02, twist=circle_twist, reference=circle, gain=20.0)
    assert np.linalg.norm(closed.error[-1]) < 0.1 * np.linalg.norm(motion.error[-1])


def test_feedback_alone_lags_behind_a_moving_target_and_feedforward_does_not():
    lagging = follow(PUMA, Q0, 4.0, 0.01, reference=circle, gain=20.0, method="rk4")
    # ė = ẋ_d − K e: the lag is speed / K.
    assert np.linalg.norm(lagging.error[-1, :3]) == pytest.approx(0.05 * math.pi / 20.0, rel=0.1)
    fed = follow(PUMA, Q0, 4.0, 0.01, twist=circle_twist, reference=circle, gain=20.0, method="rk4")
    assert np.linalg.norm(fed.error[-1]) < 1e-7


def test_the_error_decays_at_the_rates_of_K():
    K = np.array([2.0, 4.0, 8.0, 1.0, 3.0, 6.0])
    target = pin.SE3(
        pin.exp3(np.array([0.02, 0.02, 0.02])) @ START.rotation, START.translation + np.array([0.02, -0.02, 0.02])
    )
    motion = follow(PUMA, Q0, 1.0, 0.01, reference=lambda t: target, gain=K, method="rk4")
    measured = -np.log(motion.error[-1] / motion.error[0])
    np.testing.assert_allclose(measured, K, rtol=0.02)


@pytest.mark.parametrize("name", list(ORIENTATION_ERRORS))
def test_every_orientation_error_closes_the_loop(name):
    target = pin.SE3(pin.exp3(np.array([0.2, -0.1, 0.3])) @ START.rotation, START.translation)
    motion = follow(PUMA, Q0, 3.0, 0.02, reference=lambda t: target, gain=5.0, orientation=name)
    assert np.linalg.norm(motion.error[-1]) < 1e-5


def test_a_full_gain_matrix_is_taken():
    K = np.diag([5.0] * 6)
    K[0, 1] = K[1, 0] = 2.0
    target = pin.SE3(START.rotation, START.translation + np.array([0.01, 0.0, 0.0]))
    f = joint_velocity(PUMA, reference=lambda t: target, gain=K)
    np.testing.assert_allclose(PUMA.jacobian(Q0) @ f(0.0, Q0), [0.05, 0.02, 0, 0, 0, 0], atol=1e-12)


def test_resolved_motion_rate_is_one_euler_step_of_the_law_with_K_one_over_dt():
    target = pin.SE3(
        pin.exp3(np.array([0.02, 0.0, -0.01])) @ START.rotation, START.translation + np.array([0.01, 0.0, 0.02])
    )
    q = resolved_rate(PUMA, Q0, target, steps=1)[-1]
    dt = 0.01
    motion = follow(PUMA, Q0, dt, dt, reference=lambda t: target, gain=1 / dt)
    np.testing.assert_allclose(motion.q[-1], q, atol=1e-12)


def test_resolved_motion_rate_gets_closer_with_more_steps():
    target = pin.SE3(START.rotation, START.translation + np.array([0.0, 0.1, 0.1]))
    errors = [np.linalg.norm(pose_error(PUMA, resolved_rate(PUMA, Q0, target, n)[-1], target)) for n in (1, 10, 100)]
    assert errors[0] > 10 * errors[1] > 100 * errors[2]


def test_near_a_singularity_damping_bounds_the_joint_velocity():
    q = Q0.copy()
    q[4] = 1e-4  # the wrist almost straight
    twist = [0, 0, 0, 0.3, 0.2, 0.1]
    wild = joint_velocity(PUMA, lambda t: twist)(0.0, q)
    calm = joint_velocity(PUMA, lambda t: twist, inverse="numerical_filtering")(0.0, q)
    assert np.abs(wild).max() > 100 > 10 > np.abs(calm).max()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: follow(PUMA, Q0, 1.0, 0.1, method="heun"), "integration method 'heun' is unknown; legal: euler, mid"),
        (lambda: follow(PUMA, Q0, 1.0, 0.1, gain=1.0), "gain: feedback needs a reference pose"),
        (lambda: joint_velocity(PUMA, reference=circle, gain=-1.0), "gain: must be positive definite"),
        (lambda: joint_velocity(PUMA, reference=circle, gain=[1, 1, 1, 1, 1, 0]), "gain: must be positive definite"),
        (lambda: joint_velocity(PUMA, reference=circle, gain=[1, 2]), "gain: need a finite number, 6 values or a"),
        (lambda: joint_velocity(PUMA, reference=circle, gain=math.nan), "gain: need a finite number"),
        (lambda: follow(PUMA, Q0, 0.0, 0.1), "duration: need a value > 0"),
        (lambda: follow(PUMA, Q0, 1.0, -0.1), "dt: need a value > 0"),
        (lambda: follow(PUMA, [0.0], 1.0, 0.1), r"q0: need shape \(6,\), got \(1,\)"),
        (lambda: follow(PUMA, Q0, 1.0, 0.1, twist=lambda t: [1.0]), r"twist\(t\): need shape \(6,\)"),
        (lambda: follow(PUMA, Q0, 1.0, 0.1, inverse="svd"), "inverse method 'svd' is unknown"),
        (lambda: follow(PUMA, Q0, 1.0, 0.1, orientation="rpy"), "orientation error 'rpy' is unknown"),
        (lambda: resolved_rate(PUMA, Q0, START, 0), "steps: need at least 1, got 0"),
    ],
)
def test_bad_input_is_one_line_that_names_the_argument(call, message):
    with pytest.raises(ArgumentError, match=message):
        call()
