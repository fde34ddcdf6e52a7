"""Closed forms where arms are singular: nothing missing at boundaries, shoulder, elbow, wrist; the case reported."""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_closed_form_solutions import arm, configuration, distance, solve_all

PUMA_A2, PUMA_A3 = 0.432, 0.433


def stretched(q, joint):
    q = q.copy()
    q[joint] = 0.0
    return q


def puma_over_shoulder(q):
    """θ₃ such that a₂c₂ + a₃c₂₃ = 0: the wrist point on axis 1."""
    q = q.copy()
    q[1] = 0.4 * q[1]
    q[2] = math.acos(-PUMA_A2 * math.cos(q[1]) / PUMA_A3) - q[1]
    return q


def stanford_over_shoulder(q):
    q = q.copy()
    q[1] = 0.0 if q[1] > 0.0 else -math.pi
    return q


# name of the arm → what is singular → (how to make it so, what `free` says, solutions of the pose)
CASES = {
    "planar_2r boundary": ("planar_2r", lambda q: stretched(q, 1), None, 1),
    "planar_2r folded": ("planar_2r", lambda q: np.array([q[0], math.pi - 1e-12]), None, 1),
    "planar_3r boundary": ("planar_3r", lambda q: stretched(q, 1), None, 1),
    "wrist": ("wrist", lambda q: np.array([q[0], math.pi / 2, q[2]]), "wrist singularity", 1),
    "puma wrist": ("puma", lambda q: stretched(q, 4), "wrist singularity", None),
    "puma wrist at pi": ("puma", lambda q: np.array([*q[:4], math.pi, q[5]]), "wrist singularity", None),
    "puma elbow": ("puma", lambda q: stretched(q, 2), None, 4),
    "puma elbow and wrist": ("puma", lambda q: stretched(stretched(q, 2), 4), "wrist singularity", None),
    "puma shoulder": ("puma", puma_over_shoulder, "shoulder singularity", None),
    "puma shoulder and wrist": ("puma", lambda q: stretched(puma_over_shoulder(q), 4), "shoulder singularity", None),
    "puma upright": ("puma", lambda q: np.array([q[0], math.pi / 2, 0.0, *q[3:]]), "shoulder singularity", 2),
    "stanford wrist": ("stanford", lambda q: stretched(q, 4), "wrist singularity", None),
    "ur5e wrist": ("ur5e", lambda q: stretched(q, 4), "wrist singularity", None),
    "ur5e elbow": ("ur5e", lambda q: stretched(q, 2), None, None),
    "seven wrist": ("seven", lambda q: stretched(q, 5), "wrist singularity", None),
    "seven shoulder": ("seven", lambda q: stretched(q, 1), "wrist singularity", None),
    "seven stretched": ("seven", lambda q: stretched(q, 3), "elbow stretched", 4),
    "seven stretched upright": ("seven", lambda q: stretched(stretched(q, 3), 1), "elbow stretched", None),
    "seven at zero": ("seven", lambda q: np.zeros(7), "elbow stretched", 1),
}


def check(case, poses, seed):
    name, make, sentence, count = CASES[case]
    model, form, axes = arm(name)
    rng = np.random.default_rng(seed)
    for _ in range(poses):
        q = make(configuration(model, rng))
        solutions, free = solve_all(model, form, axes, q)
        assert min((distance(q, one) for one in solutions), default=math.inf) < 1e-5, q
        for k, one in enumerate(solutions):
            assert all(distance(one, other) > 1e-6 for other in solutions[:k])
        assert bool(free) == (sentence is not None), free
        if sentence is not None:
            assert any(sentence in text for text in free)
        if count is not None:
            assert len(solutions) == count, q


@pytest.mark.parametrize("case", CASES)
def test_generating_configuration_is_found_and_free_joints_reported(case):
    check(case, 12, seed=5)


@pytest.mark.soak
@pytest.mark.parametrize("case", CASES)
def test_a_thousand_singular_poses(case):
    check(case, 1000, seed=6)


@pytest.mark.parametrize("name", ["puma", "puma_560", "stanford", "ur5e", "seven"])
@pytest.mark.parametrize("power", [-3, -6, -9, -12])
def test_next_to_singularities(name, power):
    """Close to a singularity solutions come together; the generating one is still met, and every one maps back.

    At a wrist angle θ round-off ε turns the outer wrist joints by ε / θ, which is all that is allowed here.
    """
    model, form, axes = arm(name)
    rng = np.random.default_rng(7)
    for joint in (2, 4) if name != "stanford" else (4,):
        for _ in range(5):
            q = configuration(model, rng)
            q[joint] = 10.0**power
            solutions, _ = solve_all(model, form, axes, q)
            assert min(distance(q, one) for one in solutions) < max(1e-5, 1e-13 / q[joint]), (joint, q)


@pytest.mark.parametrize("name", ["puma", "puma_560", "stanford", "seven"])
def test_the_set_is_closed_under_the_wrist_flip(name):
    """(θ₄ + π, −θ₅, θ₆ + π) is the other wrist of axes z y z or x y x, wherever the arm is."""
    model, form, axes = arm(name)
    last = 4 if name == "seven" else 3
    rng = np.random.default_rng(8)
    for _ in range(20):
        q = configuration(model, rng)
        solutions, _ = solve_all(model, form, axes, q)
        for one in solutions:
            flipped = one.copy()
            flipped[last : last + 3] = one[last] + math.pi, -one[last + 1], one[last + 2] + math.pi
            assert min(distance(flipped, other) for other in solutions) < 1e-6
