"""Distances in closed form against Coal's, and nearest points against brute force."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ik_controller.kinematics.collision_distance import point_apart, segment_apart, segments_apart
from ik_controller.kinematics.collision_world import World, box, capsule, cylinder, half_space, sphere

seeds = st.integers(0, 2**32 - 1)
SOLIDS = {
    "box": (lambda: box(0.3, 0.2, 0.5), lambda: coal.Box(0.3, 0.2, 0.5)),
    "sphere": (lambda: sphere(0.2), lambda: coal.Sphere(0.2)),
    "cylinder": (lambda: cylinder(0.1, 0.6), lambda: coal.Cylinder(0.1, 0.6)),
    "capsule": (lambda: capsule(0.1, 0.6), lambda: coal.Capsule(0.1, 0.6)),
    "half_space": (
        lambda: half_space(np.array([0.0, 0.6, 0.8]), 0.1),
        lambda: coal.Halfspace(np.array([0.0, 0.6, 0.8]), 0.1),
    ),
}


def placed(random: np.random.Generator) -> pin.SE3:
    turn = pin.Quaternion(random.normal(size=4)).normalized().toRotationMatrix()
    return pin.SE3(turn, random.uniform(-0.6, 0.6, 3))


def coal_distance(first, at, second, there) -> float:
    request = coal.DistanceRequest()
    request.gjk_tolerance = 1e-9
    pose = [coal.Transform3s(p.rotation, p.translation) for p in (at, there)]
    return coal.distance(first, pose[0], second, pose[1], request, coal.DistanceResult())


def ends(pose: pin.SE3, length: float):
    return pose.act(np.array([0.0, 0.0, -0.5 * length])), pose.act(np.array([0.0, 0.0, 0.5 * length]))


@pytest.mark.parametrize("name", SOLIDS)
@given(seed=seeds)
def test_capsule_to_solid_as_coal_has_it(name, seed):
    random = np.random.default_rng(seed)
    ours, theirs = SOLIDS[name]
    at, there = placed(random), placed(random)
    length, radius = random.uniform(0.0, 0.5), 0.05
    world = World()
    world.put("it", ours().at(there))
    kind, size, turn, center, _ = world.arrays()
    point, normal = np.empty(3), np.empty(3)
    a0, a1 = ends(at, length)
    distance, share = segment_apart(kind[0], size[0], turn[0], center[0], a0, a1, point, normal)
    np.testing.assert_allclose(point, a0 + share * (a1 - a0), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normal), 1.0, atol=1e-12)
    if distance - radius > 1e-3:  # Coal's own search is good for contactless pairs
        theirs_distance = coal_distance(coal.Capsule(radius, max(length, 1e-9)), at, theirs(), there)
        assert abs(distance - radius - theirs_distance) < 2e-6
    # The nearest of many points, also where Coal's depth is another one.
    scratch = np.empty(3)
    others = [
        point_apart(kind[0], size[0], turn[0], center[0], a0 + s * (a1 - a0), scratch) for s in np.linspace(0, 1, 101)
    ]
    assert min(others) >= distance - 1e-9
    assert min(others) <= distance + 0.01 * length


@pytest.mark.parametrize("name", SOLIDS)
@given(seed=seeds)
def test_the_normal_is_the_distances_gradient(name, seed):
    random = np.random.default_rng(seed)
    world = World()
    world.put("it", SOLIDS[name][0]().at(placed(random)))
    kind, size, turn, center, _ = world.arrays()
    point, normal, other = random.uniform(-0.8, 0.8, 3), np.empty(3), np.empty(3)
    here = point_apart(kind[0], size[0], turn[0], center[0], point, normal)
    step = 1e-6 * random.normal(size=3)
    there = point_apart(kind[0], size[0], turn[0], center[0], point + step, other)
    if np.linalg.norm(normal - other) < 1e-3:  # not across an inner edge
        assert abs(there - here - normal @ step) < 1e-9


@given(seed=seeds, parallel=st.booleans(), flat=st.booleans())
def test_two_capsules_as_coal_has_them(seed, parallel, flat):
    random = np.random.default_rng(seed)
    at, there = placed(random), placed(random)
    if parallel:
        there = pin.SE3(at.rotation, there.translation)
    lengths = 0.0 if flat else random.uniform(0.01, 0.6), random.uniform(0.01, 0.6)
    a, b = np.empty(3), np.empty(3)
    apart = segments_apart(*ends(at, lengths[0]), *ends(there, lengths[1]), a, b)
    np.testing.assert_allclose(np.linalg.norm(a - b), apart, atol=1e-12)
    first, second = coal.Capsule(0.0, max(lengths[0], 1e-9)), coal.Capsule(0.0, lengths[1])
    assert abs(apart - coal_distance(first, at, second, there)) < 1e-6
