"""Targets: from samples that arrive late, early or in bursts to the reference of each cycle.

Samples are kept by their own time. At time τ (now, or now − delay when interpolating) the reference is, in this order:
between two samples, a cubic of their poses and twists; after the last sample, its pose carried on by its twist and by
the change of the last twists. A pose stream is live while samples *arrive*; a trajectory is live to its end and then
holds its last point. The kind that arrived last is followed.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.kernel import agreed_rate, carry_on
from ik_controller.control.reference import Reference
from ik_controller.control.segment import Segment
from ik_controller.parameters import ControllerParameters

Array = NDArray[np.float64]

_NO_CHANGE = np.zeros(6)
_KEPT = 64  # samples of a stream; more only where the delay of interpolation reaches further back, up to
_MOST = 4096


@dataclass
class _Sample:
    time: int  # [ns], our clock
    stamp: int  # [ns], the sender's clock: what tells which twist belongs to which pose
    position: Array
    rotation: Array
    twist: Array | None


class Targets:
    """Collects targets, all times in integer nanoseconds of one clock; `reference(now, dt)` gives the cycle's set
    point.
    """

    def __init__(self, parameters: ControllerParameters) -> None:
        self._segment: tuple[_Sample, _Sample, Segment] | None = None  # the last one asked for
        self.set_parameters(parameters)
        self.clear()

    def set_parameters(self, parameters: ControllerParameters) -> None:
        """Take new parameters between two cycles."""
        self._timeout = int(parameters.command_timeout * 1e9)
        self._tolerance = int(parameters.stamp_tolerance * 1e9)
        interpolate = parameters.reference_mode == "interpolate"
        self._delay = int(parameters.reference_delay * 1e9) if interpolate else 0
        self._segment = None  # its slopes depend on the timeout

    def clear(self) -> None:
        """Forget all targets."""
        self._samples: list[_Sample] = []
        self._times: list[int] = []
        self._twists: list[tuple[int, int, Array]] = []  # (time, stamp, twist) in the order of arrival
        self._acceleration: Array | None = None
        self._trajectory = False
        self._joints: tuple[Array, Array] | None = None
        self._pose_arrival = self._twist_arrival = self._joints_arrival = -(1 << 62)
        self._clock: dict[str, int] = {}
        self._segment = None

    # -- what arrives

    def add_pose(self, stamp: int, arrival: int, position: Array, rotation: Array) -> None:
        """Take one pose of a stream: `stamp` 0 means at arrival; position (3,) [m], rotation (3, 3), base frame."""
        if self._trajectory or arrival - self._pose_arrival > self._timeout:
            self._restart()
        self._pose_arrival = arrival
        self._joints = None
        time = self._own_time("pose", stamp, arrival)
        stamp = stamp or arrival
        twist = next((value for _, at, value in reversed(self._twists) if at == stamp), None)
        self._insert(_Sample(time, stamp, position, rotation, twist))
        count = len(self._samples)
        if count > _MOST or (count > _KEPT and self._times[1] <= arrival - self._delay):
            del self._samples[0], self._times[0]

    def add_twist(self, stamp: int, arrival: int, twist: Array) -> None:
        """Take one twist (6,) (v, ω) [m/s, rad/s], base frame: of the pose with the same stamp, or a velocity
        command.
        """
        self._twist_arrival = arrival
        self._joints = None
        if self._trajectory:
            self._restart()
        time = self._own_time("twist", stamp, arrival)
        stamp = stamp or arrival
        if self._twists and self._twists[-1][1] == stamp:
            self._twists.pop()  # a repeated stamp: the later message counts
        self._twists.append((time, stamp, twist))
        del self._twists[:-_KEPT]
        self._acceleration = self._estimate_acceleration()
        for sample in reversed(self._samples[-_KEPT:]):
            if sample.stamp == stamp:
                sample.twist = twist
                self._segment = None
                break

    def set_trajectory(self, arrival: int, points: list[tuple[int, Array, Array, Array | None]]) -> None:
        """Replace all by timed poses (time [ns], position, rotation, twist or None), times rising."""
        self._restart()
        self._trajectory = True
        self._joints = None
        self._pose_arrival = arrival
        for time, position, rotation, twist in points:
            self._insert(_Sample(time, time, position, rotation, twist))
        for end in (0, -1):
            if self._samples[end].twist is None:
                self._samples[end].twist = np.zeros(6)

    def set_joints(self, arrival: int, position: Array, velocity: Array) -> None:
        """Take a joint-space target: position (n,), velocity (n,)."""
        self._restart()
        self._joints_arrival = arrival
        self._joints = position, velocity

    def _restart(self) -> None:
        self._samples, self._times, self._trajectory, self._segment = [], [], False, None

    def _own_time(self, stream: str, stamp: int, arrival: int) -> int:
        """Return the sample's time on our clock: its stamp; or, from a foreign clock, its stamp shifted to arrivals."""
        if stamp == 0:
            return arrival
        if abs(arrival - stamp) <= self._tolerance:
            return stamp
        # The smallest delay seen is the best guess of the clocks' difference; a larger jump is a clock that was set.
        offset = self._clock.get(stream)
        seen = arrival - stamp
        if offset is None or seen < offset or seen - offset > self._tolerance:
            self._clock[stream] = offset = seen
        return stamp + offset

    def _insert(self, sample: _Sample) -> None:
        index = bisect.bisect_left(self._times, sample.time)
        if index < len(self._times) and self._times[index] == sample.time:
            self._samples[index] = sample  # a repeated stamp: the later message counts
        else:
            self._times.insert(index, sample.time)
            self._samples.insert(index, sample)
        self._segment = None

    def state(self) -> dict[str, Any]:
        """Return all that is kept as JSON types, for `restore`; floats come back bit for bit."""
        return {
            "samples": [
                (
                    s.time,
                    s.stamp,
                    s.position.tolist(),
                    s.rotation.tolist(),
                    None if s.twist is None else s.twist.tolist(),
                )
                for s in self._samples
            ],
            "twists": [(time, stamp, twist.tolist()) for time, stamp, twist in self._twists],
            "trajectory": self._trajectory,
            "joints": None if self._joints is None else [values.tolist() for values in self._joints],
            "arrivals": (self._pose_arrival, self._twist_arrival, self._joints_arrival),
            "clock": self._clock,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Take a state of `state`."""
        self.clear()
        for time, stamp, position, rotation, twist in state["samples"]:
            rate = None if twist is None else np.array(twist)
            self._insert(_Sample(time, stamp, np.array(position), np.array(rotation), rate))
        self._twists = [(time, stamp, np.array(twist)) for time, stamp, twist in state["twists"]]
        self._acceleration = self._estimate_acceleration()
        self._trajectory = bool(state["trajectory"])
        joints = state["joints"]
        self._joints = None if joints is None else (np.array(joints[0]), np.array(joints[1]))
        self._pose_arrival, self._twist_arrival, self._joints_arrival = state["arrivals"]
        self._clock = dict(state["clock"])

    # -- what is asked

    def age(self, now: int) -> float | None:
        """Return the seconds since a target arrived, None if none ever did."""
        latest = max(self._pose_arrival, self._twist_arrival, self._joints_arrival)
        return None if latest < 0 else (now - latest) * 1e-9

    def reference(self, now: int, dt: float) -> Reference | None:
        """Return the reference for the cycle from `now` [ns] to now + dt [s]; None where no target is live."""
        if self._joints is not None:
            live = now - self._joints_arrival <= self._timeout
            return Reference(joints=self._joints[0], joint_velocity=self._joints[1]) if live else None
        if self._samples and (self._trajectory or now - self._pose_arrival <= self._timeout):
            return self._pose_reference(now - self._delay if not self._trajectory else now, dt)
        if self._twists and now - self._twist_arrival <= self._timeout:
            return Reference(twist=self._twists[-1][2])
        return None

    def _pose_reference(self, time: int, dt: float) -> Reference:
        index = bisect.bisect_right(self._times, time)
        if 0 < index < len(self._samples):
            before, after = self._samples[index - 1], self._samples[index]
            if self._trajectory or after.time - before.time <= self._timeout:
                return self._between(index - 1, time, dt)
        # Before the first sample, or after the last one: carry its pose on.
        sample = self._samples[max(index - 1, 0)]
        twist = None if self._trajectory else self._twist_of(sample)
        if twist is None:
            return Reference(sample.position, sample.rotation, np.zeros(6))
        ahead = (time - sample.time) * 1e-9
        rate = self._acceleration if self._acceleration is not None and ahead > 0.0 else _NO_CHANGE
        pose, mean = np.empty((4, 3)), np.empty(6)
        carry_on(sample.position, sample.rotation, twist, rate, ahead, dt, pose, mean)
        return Reference(pose[3], pose[:3], mean)

    def _twist_of(self, sample: _Sample) -> Array | None:
        """Return the sample's twist, or while that is still on its way, the last one if fresh."""
        if sample.twist is not None:
            return sample.twist
        if self._twists and abs(self._twists[-1][0] - sample.time) <= self._timeout:
            return self._twists[-1][2]
        return None

    def _estimate_acceleration(self) -> Array | None:
        """Return the twist's rate (6,) from the last three, by component the smaller of the last two differences, 0
        where they disagree in sign (minmod): second order on a smooth motion, no overshoot at a step, little noise.
        """
        if len(self._twists) < 3:
            return None
        last = sorted(self._twists[-6:], key=lambda entry: entry[0])  # some may have overtaken others
        (t0, _, v0), (t1, _, v1), (t2, _, v2) = last[-3:]
        if not (t0 < t1 < t2 and t2 - t0 <= self._timeout):
            return None
        rate: Array = agreed_rate(v0, v1, v2, 1e-9 * (t1 - t0), 1e-9 * (t2 - t1))
        return rate

    def _between(self, index: int, time: int, dt: float) -> Reference:
        before, after = self._samples[index], self._samples[index + 1]
        kept = self._segment
        if kept is None or kept[0] is not before or kept[1] is not after:
            start = (before.position, before.rotation, self._slope(index))
            end = (after.position, after.rotation, self._slope(index + 1))
            kept = self._segment = before, after, Segment((after.time - before.time) * 1e-9, start, end)
        segment = kept[2]
        ahead = (time - before.time) * 1e-9
        position, rotation = segment.at(ahead)
        # The secant over the cycle, cut at the segment's end: the next segment starts there with the same twist.
        span = min(dt, max(segment.duration - ahead, 1e-9))
        end_position, end_rotation = segment.at(ahead + span)
        turn = pin.log3(end_rotation @ rotation.T)
        return Reference(position, rotation, np.concatenate((end_position - position, turn)) / span)

    def _slope(self, index: int) -> Array:
        """Return the sample's twist, or one from its neighbours: the mean of both sides, weighted by nearness."""
        sample = self._samples[index]
        if sample.twist is not None:
            return sample.twist
        slopes, gaps = [], []
        for other in (index - 1, index + 1):
            if 0 <= other < len(self._samples):
                near = self._samples[other]
                gap = (near.time - sample.time) * 1e-9
                if abs(gap) * 1e9 <= self._timeout or self._trajectory:
                    turn = pin.log3(near.rotation @ sample.rotation.T)
                    slopes.append(np.concatenate((near.position - sample.position, turn)) / gap)
                    gaps.append(abs(gap))
        if not slopes:
            return np.zeros(6)
        if len(slopes) == 1:
            return slopes[0]
        return (slopes[0] * gaps[1] + slopes[1] * gaps[0]) / (gaps[0] + gaps[1])
