"""References from samples that arrive late, early, in bursts, out of order or by another clock, against the truth."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest
from motions import difference, figure_eight, figure_eight_twist, moved, rms

from ik_controller import ControllerParameters
from ik_controller.control.segment import Segment
from ik_controller.control.targets import Targets

MS = 1_000_000
START = 1_790_000_000_000 * MS  # the epoch of the runs [ns]
HOME = pin.SE3(pin.exp3(np.array([0.3, 2.0, 0.5])), np.array([0.4, 0.1, 0.5]))
DELAY = 30 * MS


def parameters(**changes) -> ControllerParameters:
    return ControllerParameters(**changes)


def targets(mode: str = "extrapolate", **changes) -> Targets:
    return Targets(parameters(reference_mode=mode, reference_delay=DELAY / 1e9, **changes))


def add(collector: Targets, kind: str, stamp: int, arrival: int, pose, twist) -> None:
    if kind == "pose":
        collector.add_pose(stamp, arrival, pose.translation.copy(), pose.rotation.copy())
    else:
        collector.add_twist(stamp, arrival, twist.copy())


def stream(latency, seconds=1.5, kinds=("pose", "twist"), period=10 * MS, clock=0, stamped=True, seed=0):
    """Return messages (arrival, stamp, kind, pose, twist) of the figure-eight, in the order of arrival."""
    rng, messages = np.random.default_rng(seed), []
    for k in range(int(seconds * 1e9 / period)):
        t = k * period
        pose, twist = figure_eight(HOME, t * 1e-9), figure_eight_twist(HOME, t * 1e-9)
        for kind in kinds:
            arrival = START + t + int(latency(rng, k) * MS)
            messages.append((arrival, START + t + clock if stamped else 0, kind, pose, twist))
    return sorted(messages, key=lambda message: message[0])


def errors(mode: str, messages, seconds=1.4, settle=0.3, collector=None):
    """Return (errors of the pose (k, 6), errors of the end that the twist leads to (k, 6)) at 1 kHz."""
    collector = collector or targets(mode)
    pending, now_errors, then_errors = list(messages), [], []
    for cycle in range(int(seconds * 1000)):
        now = START + cycle * MS
        while pending and pending[0][0] <= now:
            arrival, stamp, kind, pose, twist = pending.pop(0)
            add(collector, kind, stamp, arrival, pose, twist)
        reference = collector.reference(now, 1e-3)
        if cycle < settle * 1000:
            continue
        t = cycle * 1e-3 - (DELAY / 1e9 if mode == "interpolate" else 0.0)
        here = pin.SE3(reference.rotation, reference.position)
        now_errors.append(difference(here, figure_eight(HOME, t)))
        end = moved(here, reference.twist * 1e-3)
        then_errors.append(difference(end, figure_eight(HOME, t + 1e-3)))
    return np.array(now_errors), np.array(then_errors)


ARRIVALS = {
    "on time": lambda rng, k: 0.0,
    "jittered": lambda rng, k: rng.uniform(0.0, 5.0),
    "late": lambda rng, k: 15.0,
    "early": lambda rng, k: -rng.uniform(0.0, 20.0),
    "in bursts of three": lambda rng, k: (2 - k % 3) * 10.0,
    "out of order": lambda rng, k: rng.uniform(0.0, 15.0),
}


@pytest.mark.parametrize("arrival", ARRIVALS.values(), ids=ARRIVALS)
@pytest.mark.parametrize(("mode", "limit"), [("extrapolate", 20e-6), ("interpolate", 1e-6)])
def test_pose_and_twist_at_100_hz_follow_the_truth(mode, limit, arrival):
    now, then = errors(mode, stream(arrival))
    assert rms(now[:, :3]) < limit
    assert rms(then[:, :3]) < limit
    assert rms(now[:, 3:]) < 2 * limit
    if mode == "interpolate" and arrival is not ARRIVALS["out of order"]:
        assert rms(now[:, :3]) < 1e-9  # nothing is missing: only the cubic's own O(h⁴)


@pytest.mark.parametrize("clock", [-20 * 86400 * 1000 * MS, 3 * 86400 * 1000 * MS, 700 * MS])
@pytest.mark.parametrize("mode", ["extrapolate", "interpolate"])
def test_a_foreign_clock_costs_its_latency_and_no_more(mode, clock):
    """Only the spacing of the stamps is used, shifted by the smallest latency seen: 0.2 ms here, at 0.2 m/s."""
    steady = errors(mode, stream(lambda rng, k: 0.0, clock=clock))[0]
    assert rms(steady[:, :3]) < (20e-6 if mode == "extrapolate" else 1e-9)
    now, _ = errors(mode, stream(lambda rng, k: 0.2 + rng.uniform(0.0, 5.0), clock=clock), seconds=1.4)
    assert rms(now[:, :3]) < 0.25 * 0.8e-3  # at most 0.8 ms of the fastest motion


def test_poses_find_their_twists_on_a_foreign_clock():
    """Twists come 4 ms after their poses and by their own latency: matched by stamp they serve as end slopes."""
    messages = [
        (arrival + (4 * MS if kind == "twist" else 0), *rest)
        for arrival, *rest in stream(lambda rng, k: 0.0, clock=-(10**15))
        for kind in [rest[1]]
    ]
    now, _ = errors("interpolate", sorted(messages, key=lambda m: m[0]))
    assert rms(now[:, :3]) < 1e-9


def test_poses_alone_are_interpolated():
    now, then = errors("interpolate", stream(ARRIVALS["jittered"], kinds=("pose",)))
    assert rms(now[:, :3]) < 1e-7
    assert rms(then[:, :3]) < 1e-7


def test_poses_alone_are_held_when_extrapolating():
    now, _ = errors("extrapolate", stream(ARRIVALS["on time"], kinds=("pose",)))
    fastest = max(np.linalg.norm(figure_eight_twist(HOME, t)[:3]) for t in np.arange(0.3, 1.4, 0.01))
    assert np.linalg.norm(now[:, :3], axis=1).max() < fastest * 0.0101


def test_a_twist_alone_is_a_velocity_command():
    collector = targets()
    twist = np.array([0.1, 0, 0, 0, 0, 0.2])
    collector.add_twist(0, START, twist)
    reference = collector.reference(START + 50 * MS, 1e-3)
    assert reference.position is None
    np.testing.assert_array_equal(reference.twist, twist)
    assert collector.reference(START + 101 * MS, 1e-3) is None


@pytest.mark.parametrize("mode", ["extrapolate", "interpolate"])
def test_zero_stamps_mean_the_time_of_arrival(mode):
    """With equal latencies nothing is lost but the pairing's exactness of arrival."""
    now, _ = errors(mode, stream(ARRIVALS["on time"], stamped=False))
    assert rms(now[:, :3]) < (20e-6 if mode == "extrapolate" else 1e-6)


@pytest.mark.parametrize("mode", ["extrapolate", "interpolate"])
def test_repeated_stamps_and_quaternion_signs_do_no_harm(mode):
    """Rotations come in as matrices, so a sign of the quaternion is none; repeats replace what they repeat."""
    messages = stream(ARRIVALS["on time"])
    twice = [message for message in messages for _ in range(2)]
    now, then = errors(mode, twice)
    once = errors(mode, messages)
    np.testing.assert_array_equal(now, once[0])
    np.testing.assert_array_equal(then, once[1])


def test_a_repeated_stamp_with_another_pose_takes_the_later_message():
    collector, other = targets(), moved(HOME, np.array([0.1, 0, 0, 0, 0, 0]))
    for pose in (HOME, other):
        collector.add_pose(START, START, pose.translation, pose.rotation)
    np.testing.assert_array_equal(collector.reference(START, 1e-3).position, other.translation)


def test_a_long_delay_has_the_samples_it_needs():
    """A fast stream interpolated far in the past: 0.2 s at 1 kHz are 200 samples."""
    collector = Targets(parameters(reference_mode="interpolate", reference_delay=0.2, command_timeout=0.5))
    for k in range(600):
        stamp = START + k * MS
        collector.add_pose(stamp, stamp, np.array([k * 1e-3, 0.0, 0.0]), np.eye(3))
    reference = collector.reference(stamp, 1e-3)
    np.testing.assert_allclose(reference.position, [0.399, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(reference.twist, [1.0, 0, 0, 0, 0, 0], atol=1e-9)


# -- trajectories

TIMES = [0, 120, 200, 350, 500, 640, 700]


def trajectory(velocities: bool):
    return [
        (
            START + t * MS,
            figure_eight(HOME, t * 1e-3).translation,
            figure_eight(HOME, t * 1e-3).rotation,
            figure_eight_twist(HOME, t * 1e-3) if velocities else None,
        )
        for t in TIMES
    ]


@pytest.mark.parametrize(("velocities", "limit"), [(True, 3e-5), (False, 3e-3)])
def test_a_trajectory_is_met_at_its_points_and_smooth_between(velocities, limit):
    collector = targets()
    collector.set_trajectory(START - 50 * MS, trajectory(velocities))
    for t in TIMES:
        reference = collector.reference(START + t * MS, 1e-3)
        truth = figure_eight(HOME, t * 1e-3)
        assert np.abs(difference(pin.SE3(reference.rotation, reference.position), truth)).max() < 1e-12
    found, ends = [], []
    for t in range(TIMES[-1]):
        reference = collector.reference(START + t * MS, 1e-3)
        here = pin.SE3(reference.rotation, reference.position)
        found.append(difference(here, figure_eight(HOME, t * 1e-3)))
        led = moved(here, 1e-3 * reference.twist)  # a reference is good until the next one is asked for
        after = collector.reference(START + (t + 1) * MS, 1e-3)
        ends.append(difference(led, pin.SE3(after.rotation, after.position)))
    assert rms(np.array(found)[:, :3]) < limit
    assert np.abs(ends).max() < 1e-12  # the twist is the secant: it leads to the next cycle's pose


def test_a_trajectory_holds_its_first_point_before_and_its_last_after():
    collector = targets()
    collector.set_trajectory(START - 500 * MS, trajectory(False))
    for at, point in ((-400, 0), (701, -1), (100_000, -1)):
        reference = collector.reference(START + at * MS, 1e-3)
        np.testing.assert_allclose(reference.position, trajectory(False)[point][1], atol=1e-15)
        assert not reference.twist.any()


def test_the_kind_that_arrived_last_is_followed():
    collector, twist = targets(), np.array([0.1, 0, 0, 0, 0, 0])
    now = START
    for kind in (
        "trajectory",
        "twist",
        "trajectory",
        "pose",
        "joints",
        "trajectory",
        "joints",
        "twist",
        "joints",
        "pose",
    ):
        now += 10 * MS
        if kind == "trajectory":
            collector.set_trajectory(now, trajectory(True))
        elif kind == "twist":
            collector.add_twist(now, now, twist)
        elif kind == "pose":
            collector.add_pose(now, now, np.full(3, 9.0), np.eye(3))
        else:
            collector.set_joints(now, np.ones(7), np.zeros(7))
        reference = collector.reference(now, 1e-3)
        assert (reference.joints is not None) == (kind == "joints")
        assert (reference.position is None) == (kind in ("joints", "twist"))
        if kind in ("pose", "trajectory"):
            assert (abs(reference.position[0] - 9.0) < 0.1) == (kind == "pose")


# -- going stale


def test_targets_go_stale_by_arrival_not_by_stamp():
    collector = targets(command_timeout=0.1)
    collector.add_pose(START - 300 * MS, START, HOME.translation, HOME.rotation)  # an old stamp, just arrived
    assert collector.reference(START + 100 * MS, 1e-3) is not None
    assert collector.reference(START + 101 * MS, 1e-3) is None
    collector.set_joints(START, np.zeros(7), np.zeros(7))
    assert collector.reference(START + 100 * MS, 1e-3) is not None
    assert collector.reference(START + 101 * MS, 1e-3) is None
    assert collector.age(START + 250 * MS) == pytest.approx(0.25)
    collector.clear()
    assert collector.age(START) is None


@pytest.mark.parametrize("mode", ["extrapolate", "interpolate"])
def test_after_a_gap_nothing_of_before_is_used(mode):
    """A stream that stops for 2 s and goes on elsewhere: no interpolation across the gap, no old twist."""
    collector = targets(mode)
    for message in stream(ARRIVALS["on time"], seconds=0.5):
        add(collector, message[2], message[1], message[0], *message[3:])
    assert collector.reference(START + 2000 * MS, 1e-3) is None
    again, elsewhere = START + 2500 * MS, moved(HOME, np.array([1.0, 0, 0, 0, 0, 0]))
    for k in range(6):
        stamp = again + k * 10 * MS
        collector.add_pose(stamp, stamp, elsewhere.translation, elsewhere.rotation)
        for late in (0, 5):
            reference = collector.reference(stamp + late * MS, 1e-3)
            np.testing.assert_allclose(reference.position, elsewhere.translation, atol=1e-12)
            np.testing.assert_allclose(reference.twist, 0.0, atol=1e-9)


# -- the state


@pytest.mark.parametrize("mode", ["extrapolate", "interpolate"])
@pytest.mark.parametrize("clock", [0, 10**15])
@pytest.mark.parametrize("kinds", [("pose",), ("pose", "twist"), ("twist",)])
def test_a_restored_state_goes_on_with_the_same_bits(mode, clock, kinds):
    messages = stream(ARRIVALS["out of order"], seconds=0.6, kinds=kinds, clock=clock)
    one, two = targets(mode), None
    for cycle in range(600):
        now = START + cycle * MS
        if cycle == 215:
            one.set_parameters(parameters(reference_mode=mode, reference_delay=DELAY / 1e9, command_timeout=0.05))
        if cycle == 216:
            two = targets(mode, command_timeout=0.05)
            two.restore(json.loads(json.dumps(one.state())))
        while messages and messages[0][0] <= now:
            arrival, stamp, kind, pose, twist = messages.pop(0)
            for collector in filter(None, (one, two)):
                add(collector, kind, stamp, arrival, pose, twist)
        if two is not None:
            assert bits(one.reference(now, 1e-3)) == bits(two.reference(now, 1e-3))
        else:
            one.reference(now, 1e-3)
    assert json.dumps(one.state()) == json.dumps(two.state())


def test_trajectories_and_joint_targets_survive_in_the_state():
    one, two = targets(), targets()
    for fill in (
        lambda: one.set_trajectory(START, trajectory(False)),
        lambda: one.set_joints(START, np.array([0.1, 1 / 3]), np.array([0.2, 1e-300])),
    ):
        fill()
        two.restore(json.loads(json.dumps(one.state())))
        for t in (0, 33, 99):
            assert bits(one.reference(START + t * MS, 1e-3)) == bits(two.reference(START + t * MS, 1e-3))


def bits(reference):
    if reference is None:
        return None
    fields = ("position", "rotation", "twist", "joints", "joint_velocity")
    values = [getattr(reference, field) for field in fields]
    return [None if value is None else np.asarray(value).tobytes() for value in values]


# -- the segment between two samples


def places(segment):
    """Return what tells where a segment is at a time [s]."""

    def at(time):
        poses, twists = np.empty((1, 4, 3)), np.empty((1, 6))
        segment.references(np.array([time]), 1e-3, poses, twists)
        return pin.SE3(poses[0, :3], poses[0, 3])

    return at


def test_a_segment_meets_poses_and_twists_and_is_of_fourth_order():
    def worst(h):
        found = []
        for t in (0.3, 1.1, 2.0):
            ends = [(figure_eight(HOME, u), figure_eight_twist(HOME, u)) for u in (t, t + h)]
            at = places(Segment(h, *((pose.translation, pose.rotation, twist) for pose, twist in ends)))
            for s, (pose, _) in zip((0.0, h), ends, strict=True):
                assert np.abs(difference(at(s), pose)).max() < 1e-12
            for s, (_, twist) in zip((0.0, h), ends, strict=True):
                np.testing.assert_allclose(difference(at(s + 1e-5), at(s - 1e-5)) / 2e-5, twist, atol=1e-6)
            between = np.linspace(0.1, 0.9, 9) * h
            found += [np.abs(difference(at(s), figure_eight(HOME, t + s))).max() for s in between]
        return max(found)

    assert worst(0.4) / worst(0.2) > 13.0  # 2⁴ = 16


def test_a_segment_turns_far_the_short_way():
    turn = np.array([0.0, 0.0, 3.0])
    segment = Segment(1.0, (np.zeros(3), np.eye(3), np.zeros(6)), (np.ones(3), pin.exp3(turn), np.zeros(6)))
    half = places(segment)(0.5)
    np.testing.assert_allclose(pin.log3(half.rotation), turn / 2, atol=1e-12)
    np.testing.assert_allclose(half.translation, 0.5, atol=1e-12)
