"""Pushed into obstacles and into itself: the distance stays, the arm comes to rest without chatter, and backs out."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pinocchio as pin
import pytest
import wire

from ik_controller import Controller, Reference
from ik_controller.control import obstacles
from ik_controller.control.obstacles import Scene
from ik_controller.control.status import Limit
from ik_controller.errors import IkControllerError, ParameterError
from ik_controller.kinematics.chain import chain_of
from ik_controller.kinematics.collision import joint_frames, pair_distances, place_capsules
from ik_controller.kinematics.collision_world import World, box, capsule, cylinder, half_space, sphere
from ik_controller.messages.cdr import JointStateWriter
from ik_controller.session import Session

DT = 1e-3
TOLERANCE = 1e-4  # [m] that the issue allows below the minimum distance
WATCHED = {"self_collision": True, "obstacle_avoidance": True}


class Measured:
    """The least distance [m] between an arm's moving capsules and a world that stands still, by Coal."""

    def __init__(self, model, arm, world) -> None:
        self.coal = coal = pytest.importorskip("coal")
        self.arm, self.chain = arm, tuple(chain_of(model))
        self.moving = np.flatnonzero(arm.joint >= 0)
        lengths = np.linalg.norm(arm.ends[:, 1] - arm.ends[:, 0], axis=1)
        self.half = 0.5 * lengths + arm.radius
        self.bodies = [coal.Capsule(r, max(length, 1e-9)) for r, length in zip(arm.radius, lengths, strict=True)]
        kind, size, turn, center, bound = world.arrays()
        make = (
            lambda s: coal.Capsule(s[1], max(2 * s[0], 1e-9)),
            lambda s: coal.Box(*(2 * s)),
            lambda s: coal.Cylinder(s[1], 2 * s[0]),
            lambda s: coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
        )
        self.solids = [
            (make[k](s), coal.Transform3s(r, c), c, b)
            for k, s, r, c, b in zip(kind, size, turn, center, bound, strict=True)
        ]

    def __call__(self, q) -> float:
        coal, arm, m, placed = self.coal, self.arm, len(self.chain[3]), np.empty(self.arm.ends.shape)
        rotation, position = np.empty((m, 3, 3)), np.empty((m, 3))
        joint_frames(self.chain, q, rotation, position, np.empty((m, 3)))
        place_capsules(arm.joint, arm.ends, rotation, position, placed)
        middles, least = 0.5 * (placed[:, 0] + placed[:, 1]), np.inf
        for solid, pose, center, bound in self.solids:
            away = np.sqrt(((middles - center) ** 2).sum(axis=1)) - bound - self.half
            for k in self.moving[np.argsort(away[self.moving])]:
                if away[k] > least:
                    break
                axis = placed[k, 1] - placed[k, 0]
                axis = axis if axis.any() else np.array([0.0, 0.0, 1.0])
                turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).toRotationMatrix()
                at = coal.Transform3s(turn, middles[k])
                request, result = coal.DistanceRequest(), coal.DistanceResult()
                least = min(least, coal.distance(self.bodies[k], at, solid, pose, request, result))
        return least


def world_distance(model, arm, world, q) -> float:
    """Return the least distance [m] between the moving capsules and the world, by Coal."""
    return Measured(model, arm, world)(q)


def in_the_way(kind: int, random: np.random.Generator, pose: pin.SE3):
    if kind == 0:
        return box(*random.uniform(0.05, 0.4, 3)).at(pose)
    if kind == 1:
        return sphere(random.uniform(0.03, 0.2)).at(pose)
    if kind == 2:
        return cylinder(random.uniform(0.02, 0.15), random.uniform(0.1, 0.8)).at(pose)
    if kind == 3:
        return capsule(random.uniform(0.02, 0.1), random.uniform(0.1, 0.6)).at(pose)
    normal = random.normal(size=3)
    return half_space(normal, float(normal @ pose.translation / np.linalg.norm(normal)))


def free_start(model, arm, random):
    low, high = np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi)
    while True:
        q = random.uniform(low, high)
        if pair_distances(model, arm, arm.pairs, q).min() > 0.01:
            return q


def approach(robot, seed: int, cycles: int):
    """Push into something at random, then back out the way it came; distances and accelerations are looked at."""
    random = np.random.default_rng(seed)
    model, parameters = robot.model, robot.parameters.replace(WATCHED)
    scene = Scene.of(model, parameters)
    arm, kind = scene.arm, seed % 6  # 5: into itself
    q = free_start(model, arm, random)
    tool = model.forward(q)
    while kind < 5:
        turn = pin.Quaternion(random.normal(size=4)).normalized().toRotationMatrix()
        center = tool.translation + 0.25 * random.normal(size=3)
        scene.world.put("solid", in_the_way(kind, random, pin.SE3(turn, center)))
        if world_distance(model, arm, scene.world, q) > 0.03:
            break
    if kind == 5 or seed % 4 == 3:
        there = free_start(model, arm, random)
        reference = (
            Reference.joint(-q if kind == 5 else there) if seed % 4 == 3 else Reference.pose(model.forward(there))
        )
    else:
        way = random.uniform(0.8, 2.0) * (center - tool.translation)
        reference = Reference.pose(pin.SE3(tool.rotation, tool.translation + way))
    controller = Controller(model, parameters, scene)
    controller.reset(q)
    measure = Measured(model, arm, scene.world)
    least, before, path = [np.inf, np.inf], controller.velocity, [q]
    rested = 0  # cycles; once at rest, there is no more to be seen of the push
    for k in range(8 * cycles + 4000):
        if k < cycles:
            rested = rested + 1 if np.abs(before).max() < 1e-7 else 0
            path.append(controller.position)
            if rested > 200:
                cycles = k + 1
        elif np.abs(controller.position - path[-1]).max() < 0.02:  # paced, so that it does not cut corners
            if len(path) == 1 and np.abs(controller.position - q).max() < 1e-3:
                break
            path = path[:1] if len(path) < 20 else path[:-10]
        if k >= cycles:
            reference = Reference.joint(path[-1])
        step = controller.step(controller.position, reference, DT)
        assert (np.abs(step.velocity - before) <= model.acceleration_limit * DT * (1.0 + 1e-9) + 1e-14).all()
        before = step.velocity
        least[0] = min(least[0], pair_distances(model, arm, arm.pairs, step.position).min())
        if len(scene.world) and k % 5 == 0:
            least[1] = min(least[1], measure(step.position))
    assert not controller.fault
    assert least[0] >= parameters.self_minimum_distance - TOLERANCE
    assert least[1] >= parameters.minimum_distance - TOLERANCE
    np.testing.assert_allclose(controller.position, q, atol=1e-3)


@pytest.mark.parametrize("seed", range(12))
def test_pushed_at_random_it_keeps_its_distance(robot, seed):
    approach(robot, seed, 400)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(500))
def test_pushed_at_random_it_keeps_its_distance_soak(robot, seed):
    approach(robot, 1000 + seed, 2000)


def pressed(robot, solid=None, name="solid"):
    """Return a controller at home with a solid below the tool, and the pose 0.3 m under it."""
    parameters = robot.parameters.replace(WATCHED)
    scene = Scene.of(robot.model, parameters)
    home = robot.model.forward(robot.home)
    below = pin.SE3(home.rotation, home.translation - np.array([0.0, 0.0, 0.3]))
    if solid is None:
        solid = box(0.4, 0.4, 0.1).at(pin.SE3(np.eye(3), home.translation - np.array([0.0, 0.0, 0.2])))
    scene.world.put(name, solid)
    controller = Controller(robot.model, parameters, scene)
    controller.reset(robot.home)
    return controller, home, below


def test_pressed_on_a_box_it_slides_rests_says_why_and_lets_go(robot):
    controller, home, below = pressed(robot)
    aside = pin.SE3(below.rotation, below.translation + np.array([0.03, 0.03, 0.0]))
    for _ in range(4000):
        step = controller.step(controller.position, Reference.pose(aside), DT)
    assert np.abs(step.velocity).max() < 1e-4  # no chatter
    assert step.status.limit is Limit.OBSTACLE
    assert step.status.pair[1] == "solid"
    assert abs(step.status.distance - 0.02) < 1e-4
    assert "an obstacle is near" in step.status.sentence(robot.model.joint_names)
    # It slid along the face: only the way into it is missing.
    assert np.abs(step.error[:2]).max() < 5e-3
    for _ in range(1500):
        step = controller.step(controller.position, Reference.pose(home), DT)
    assert np.abs(step.error).max() < 1e-3
    assert step.status.limit is Limit.NONE


def test_velocities_decay_when_it_comes_to_rest(robot):
    controller, _, below = pressed(robot)
    speeds = []
    for _ in range(4000):
        step = controller.step(controller.position, Reference.pose(below), DT)
        speeds.append(np.abs(step.velocity).max())
    tail = [max(speeds[k : k + 200]) for k in range(2400, 4000, 200)]
    assert all(later <= earlier for earlier, later in itertools.pairwise(tail))


def test_a_lost_target_before_an_obstacle_still_stops_in_time(robot):
    for count in (60, 120, 180, 240, 300):
        controller, _, below = pressed(robot)
        for _ in range(count):
            controller.step(controller.position, Reference.pose(below), DT)
        while controller.velocity.any():
            step = controller.step(controller.position, None, DT)
        scene = controller.scene
        assert world_distance(robot.model, scene.arm, scene.world, step.position) >= 0.02 - TOLERANCE


def test_joint_targets_heed_obstacles_too(robot):
    controller, _, below = pressed(robot)
    for _ in range(3000):
        controller.step(controller.position, Reference.pose(below), DT)
    deeper = 2.0 * controller.position - robot.home
    controller.reset(robot.home)
    for _ in range(2500):
        step = controller.step(controller.position, Reference.joint(deeper), DT)
        assert world_distance(robot.model, controller.scene.arm, controller.scene.world, step.position) >= 0.0199
    assert step.status.limit is Limit.OBSTACLE


def test_an_arm_without_a_way_out_says_what_it_is_stuck_in(panda, monkeypatch):
    """Squeezed where no velocity keeps all rows: what the solver then leaves behind names nothing."""
    home, solve = panda.model.forward(panda.home), obstacles.daqp.solve

    def told(seed):
        random, unsolved, found = np.random.default_rng(seed), [], []

        def leaving_behind(*problem, **options):
            solution, value, flag, info = solve(*problem, **options)
            if flag != 1:
                unsolved.append(flag)
                info["lam"][:] = random.uniform(size=info["lam"].size)
            return solution, value, flag, info

        monkeypatch.setattr(obstacles.daqp, "solve", leaving_behind)
        controller, _, below = pressed(panda, box(0.4, 0.4, 0.4).at(pin.SE3(np.eye(3), home.translation)))
        controller.step(controller.position, Reference.pose(below), DT)  # the first command is where it is
        for _ in range(50):
            status = controller.step(controller.position, Reference.pose(below), DT).status
            found.append((status.limit, *status.pair, status.distance))
        assert unsolved
        return found

    once = told(1)
    assert all(limit is Limit.OBSTACLE and other == "solid" and away < 0.0 for limit, _, other, away in once)
    assert told(2) == once


def test_an_obstacle_that_comes_too_near_is_backed_away_from(robot):
    controller, home, _ = pressed(robot, sphere(0.05).at(pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0]))), "ball")
    world, arm = controller.scene.world, controller.scene.arm
    end = home.translation + np.array([0.0, 0.3, 0.0])
    reference = Reference.pose(home)
    for k in range(1500):
        # To 4 cm from the middle of the tool, at 0.1 m/s.
        place = end + (home.translation - end) * min(k / 2600.0, 0.5)
        world.put("ball", sphere(0.05).at(pin.SE3(np.eye(3), place)))
        step = controller.step(controller.position, reference, DT)
    for _ in range(1500):
        step = controller.step(controller.position, reference, DT)
    assert world_distance(robot.model, arm, world, step.position) >= 0.02 - TOLERANCE


def test_off_by_default_and_it_changes_no_bit_where_nothing_is_near(robot):
    assert Scene.of(robot.model, robot.parameters).arm is None
    far = box(0.1, 0.1, 0.1).at(pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.0])))
    watched, _, _ = pressed(robot, far)
    plain = Controller(robot.model, robot.parameters)
    plain.reset(robot.home)
    goal = robot.model.forward(robot.home + 0.1)
    for _ in range(200):
        ours = watched.step(watched.position, Reference.pose(goal), DT)
        theirs = plain.step(plain.position, Reference.pose(goal), DT)
        assert ours.position.tobytes() == theirs.position.tobytes()


# -- through the session


def markers(*entries, frame):
    return wire.markers(entries, frame)


def run(session, robot, cycles, at=1_000_000_000, q=None, feed=()):
    """Run a session on an ideal arm; return (commands, time, last step)."""
    write = JointStateWriter(robot.model.joint_names).write
    q, commands, step = np.array(robot.home if q is None else q), [], None
    for k in range(cycles):
        session.take("joint_states", write(at, q, np.zeros(robot.model.n)), at)
        for role, data in feed(k, at) if callable(feed) else ():
            session.take(role, data, at)
        step = session.cycle(at)
        if step is not None:
            q = step.position
            commands.append(step.position.tobytes())
        at += session.period
    return commands, at, step, q


def test_obstacles_by_topic_and_the_state_brings_them_back_bit_for_bit(robot):
    parameters = robot.parameters.replace(WATCHED)
    base, home = parameters.base_frame, robot.model.forward(robot.home)
    below = pin.SE3(home.rotation, home.translation - np.array([0.0, 0.0, 0.3]))
    here = home.translation - np.array([0.0, 0.0, 0.2])
    scene = markers(
        ("crate", 3, 1, 0, here, (0.4, 0.4, 0.1)), ("lamp", 0, 2, 0, here + 1.0, (0.1, 0.1, 0.1)), frame=base
    )
    session = Session(robot.model, parameters)

    def feed(k, at):
        yield "target_pose", wire.pose(wire.seven(below), base, at)
        if k == 0:
            yield "obstacles", scene

    _, at, step, q = run(session, robot, 900, feed=feed)
    assert not session.rejected, session.last_rejected
    assert step.status.limit is Limit.OBSTACLE
    assert step.status.pair[1] == "crate/3"
    twin = Session(robot.model, parameters, Scene())
    twin.apply(session.state())
    plain = lambda k, at: [("target_pose", wire.pose(wire.seven(below), base, at))]  # noqa: E731
    assert run(session, robot, 200, at, q, plain)[0] == run(twin, robot, 200, at, q, plain)[0]
    # Deleted, it is no longer in the way.
    session.take("obstacles", markers(("", 0, 0, 3, here, (1, 1, 1)), frame=base), at)
    assert len(session.controller.scene.world) == 0


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (("a", 1, 9, 0, (0, 0, 0), (1, 1, 1)), "type 9"),
        (("a", 1, 1, 7, (0, 0, 0), (1, 1, 1)), "action 7"),
        (("a", 1, 1, 0, (0, 0, 0), (1, -1, 1)), "scale"),
        (("a", 1, 1, 0, (0, 0, np.nan), (1, 1, 1)), "finite"),
    ],
)
def test_unusable_markers_are_rejected_and_change_nothing(robot, entry, words):
    session = Session(robot.model, robot.parameters.replace(WATCHED))
    good = ("b", 1, 1, 0, (2, 0, 0), (0.1, 0.1, 0.1))
    assert not session.take("obstacles", markers(good, entry, frame=robot.parameters.base_frame), 1)
    assert words in session.last_rejected
    assert len(session.controller.scene.world) == 0
    plain = Session(robot.model, robot.parameters)
    assert not plain.take("obstacles", markers(good, frame=robot.parameters.base_frame), 1)
    assert "obstacle_avoidance" in plain.last_rejected


# -- files


def test_a_yaml_file_of_every_shape(panda, tmp_path):
    file = tmp_path / "scene.yaml"
    file.write_text(
        """
obstacles:
  table: {half_space: {normal: [0, 0, 2], offset: -0.1}}
  crate: {box: {size: [0.4, 0.3, 0.2]}, position: [0.9, 0.0, 0.1], orientation: [0, 0, 0.7071068, 0.7071068]}
  post: {cylinder: {radius: 0.05, length: 1.0}, position: [0.3, 0.9, 0.5]}
  lamp: {capsule: {radius: 0.04, length: 0.3}, position: [0.0, 0.9, 0.9], frame: panda_link0}
  ball: {sphere: {radius: 0.1}, position: [0.4, -0.9, 0.6]}
""",
        encoding="utf-8",
    )
    scene = Scene.of(panda.model, panda.parameters.replace({"obstacles": str(file)}))
    assert scene.world.names == ("table", "crate", "post", "lamp", "ball")
    assert scene.arm is not None
    assert len(scene.arm.pairs) == 0  # itself is another switch
    restored = World()
    restored.restore(json.loads(json.dumps(scene.world.state())))
    for ours, theirs in zip(scene.world.arrays(), restored.arrays(), strict=True):
        assert ours.tobytes() == theirs.tobytes()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x: 1", "a mapping 'obstacles'"),
        ("obstacles: {a: {cone: {}}}", "one shape of box"),
        ("obstacles: {a: {sphere: {radius: -1}}}", "more than 0"),
        ("obstacles: {a: {sphere: {size: 1}}}", "sphere needs radius"),
        ("obstacles: {a: {sphere: {radius: 1}, colour: red}}", "unknown key 'colour'"),
        ("obstacles: {a: {sphere: {radius: 1}, frame: panda_link5}}", "not a link that is fixed"),
        ("obstacles: {a/b: {sphere: {radius: 1}}}", "must not have"),
        ("obstacles: {a: {half_space: {normal: [0, 0, 0]}}}", "no direction"),
    ],
)
def test_mistakes_in_the_file_are_told_in_one_line(panda, tmp_path, text, words):
    file = tmp_path / "scene.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(IkControllerError, match=words) as caught:
        Scene.of(panda.model, panda.parameters.replace({"obstacles": str(file)}))
    assert "\n" not in str(caught.value)


def test_influence_must_be_above_the_minimum(panda):
    with pytest.raises(ParameterError, match="influence_distance"):
        Controller(panda.model, panda.parameters.replace({"minimum_distance": 0.2}))
