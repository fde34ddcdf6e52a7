"""Targets: from samples that arrive late, early or in bursts to the reference of each cycle.

Samples are kept by their own time. At time τ (now, or now − delay when interpolating) the reference is, in this order:
between two samples, a cubic of their poses and twists; after the last sample, its pose carried on by its twist and by
the change of the last twists. A pose stream is live while samples *arrive*; a trajectory, of the tool or of joints, is
live to its end and then holds its last point. The kind that arrived last is followed.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.extrapolation import agreed_rate, carry_on
from ik_controller.control.joint_path import JointPath
from ik_controller.control.reference import Reference
from ik_controller.control.segment import Segment
from ik_controller.parameters import ControllerParameters

Array = NDArray[np.float64]

_NO_CHANGE = np.zeros(6)
_KEPT = 64  # samples of a stream; more only where the delay of interpolation reaches further back, up to
_MOST = 4096
_INSTANT = 1e-6  # [s] over which the twist at an instant of a trajectory is taken


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
        self._one = np.empty((1, 4, 3)), np.empty((1, 6))  # a cycle's pose and twist, made once for all
        self._followed = Reference(self._one[0][0, 3], self._one[0][0, :3], self._one[1][0])
        self._mode = "auto"
        self.clear()
        self.set_parameters(parameters)

    def set_parameters(self, parameters: ControllerParameters) -> None:
        """Take new parameters between two cycles."""
        self._timeout = int(parameters.command_timeout * 1e9)
        self._tolerance = int(parameters.stamp_tolerance * 1e9)
        interpolate = parameters.reference_mode == "interpolate"
        self._delay = int(parameters.reference_delay * 1e9) if interpolate else 0
        self._segment = None  # its slopes depend on the timeout
        if parameters.mode != self._mode:
            self._mode = parameters.mode
            self._keep_only(parameters.mode)

    def clear(self) -> None:
        """Forget all targets."""
        self._samples: list[_Sample] = []
        self._times: list[int] = []
        # (time, stamp, twist, the point that it is the velocity of or None for the tool) in the order of arrival
        self._twists: list[tuple[int, int, Array, Array | None]] = []
        self._newest_twist = -1  # no twist has a later stamp [ns]
        self._acceleration: Array | None = None
        self._trajectory = False
        self._take_over()
        self._pose_arrival = self._twist_arrival = self._joints_arrival = -(1 << 62)
        self._clock: dict[str, int] = {}
        self._segment = None

    def _take_over(self) -> None:
        """Forget the joint-space targets."""
        self._joints: tuple[Array, Array] | None = None
        self._jog: Array | None = None
        self._path: JointPath | None = None

    def _keep_only(self, mode: str) -> None:
        """Forget what a mode does not follow."""
        if mode in ("pose", "twist", "trajectory"):
            self._joints = self._jog = None
        if mode not in ("auto", "trajectory"):
            self._path = None
        if mode == ("pose" if self._trajectory else "trajectory") or mode in ("twist", "joints"):
            self._restart()
        if mode in ("trajectory", "joints"):
            self._twists, self._acceleration = [], None

    # -- what arrives

    def add_pose(self, stamp: int, arrival: int, position: Array, rotation: Array) -> None:
        """Take one pose of a stream: `stamp` 0 means at arrival; position (3,) [m], rotation (3, 3), base frame."""
        if self._trajectory or arrival - self._pose_arrival > self._timeout:
            self._restart()
        self._pose_arrival = arrival
        self._take_over()
        time = self._own_time("pose", stamp, arrival)
        stamp = stamp or arrival
        twist = None
        if stamp <= self._newest_twist:  # most often its twist comes after it
            twist = next((entry[2] for entry in reversed(self._twists) if entry[1] == stamp), None)
        self._insert(_Sample(time, stamp, position, rotation, twist))
        count = len(self._samples)
        if count > _MOST or (count > _KEPT and self._times[1] <= arrival - self._delay):
            del self._samples[0], self._times[0]

    def add_twist(self, stamp: int, arrival: int, twist: Array, point: Array | None = None) -> None:
        """Take one twist (6,) (v, ω) [m/s, rad/s], base frame: of the pose with the same stamp, or a velocity
        command, then of the tool's body at `point` (3,) [m], or of the tool point.
        """
        self._twist_arrival = arrival
        self._take_over()
        if self._trajectory:
            self._restart()
        time = self._own_time("twist", stamp, arrival)
        stamp = stamp or arrival
        if self._twists and self._twists[-1][1] == stamp:
            self._twists.pop()  # a repeated stamp: the later message counts
        self._twists.append((time, stamp, twist, point))
        self._newest_twist = max(self._newest_twist, stamp)
        del self._twists[:-_KEPT]
        self._acceleration = self._estimate_acceleration()
        for sample in reversed(self._samples[-_KEPT:]):
            if sample.stamp == stamp:
                sample.twist = twist
                self._segment = None
                break

    def set_trajectory(
        self, arrival: int, points: list[tuple[int, Array, Array, Array | None]], start: int | None = None
    ) -> None:
        """Replace all by timed poses (time [ns], position, rotation, twist or None), times rising.

        With `start` [ns], a trajectory that is followed goes on until then, and on from there to the first point.
        """
        kept: list[_Sample] = []
        if start is not None and self._trajectory and self._samples:
            begin = max(start, arrival)
            inner = [i for i, time in enumerate(self._times) if arrival < time < begin]
            kept = [self._sample_at(arrival)]
            for i in inner:
                sample = self._samples[i]
                kept.append(_Sample(sample.time, sample.time, sample.position, sample.rotation, self._slope(i)))
            if begin > arrival:
                kept.append(self._sample_at(begin))
            kept = [sample for sample in kept if sample.time < points[0][0]]
        self._restart()
        self._trajectory = True
        self._take_over()
        self._pose_arrival = arrival
        for sample in kept:
            self._insert(sample)
        for time, position, rotation, twist in points:
            self._insert(_Sample(time, time, position, rotation, twist))

    def set_joints(self, arrival: int, position: Array, velocity: Array) -> None:
        """Take a joint-space target: position (n,), velocity (n,)."""
        self._restart()
        self._take_over()
        self._joints_arrival = arrival
        self._joints = position, velocity

    def set_jog(self, arrival: int, velocity: Array) -> None:
        """Take joint velocities (n,) [rad/s, m/s]."""
        self._restart()
        self._take_over()
        self._joints_arrival = arrival
        self._jog = velocity

    def set_path(
        self, arrival: int, times: list[int], positions: Array, velocities: Array, start: int | None = None
    ) -> None:
        """Replace all by timed joint positions; see `JointPath`, and `set_trajectory` for `start`."""
        old, begin = self._path, max(start or 0, arrival)
        if start is not None and old is not None:
            kept_times, kept_positions, kept_velocities = old.before(begin)
            count = sum(time <= arrival for time in kept_times)
            heads = [time for time in dict.fromkeys((arrival, begin)) if time < times[0]]
            mid = [i for i in range(count, len(kept_times)) if kept_times[i] < times[0]]
            rows = [(time, *old.over(time, _INSTANT)) for time in heads]
            rows += [(kept_times[i], kept_positions[i], kept_velocities[i]) for i in mid]
            rows.sort(key=lambda row: row[0])
            times = [row[0] for row in rows] + times
            positions = np.vstack([row[1] for row in rows] + [positions])
            velocities = np.vstack([row[2] for row in rows] + [velocities])
        self._restart()
        self._take_over()
        self._joints_arrival = arrival
        self._path = JointPath(times, positions, velocities)

    def trajectory_end(self) -> tuple[int, tuple[Array, Array] | Array] | None:
        """Return when the trajectory that is followed ends [ns], and where: (position (3,), rotation (3, 3)) or joints
        (n,).
        """
        if self._path is not None:
            return self._path.times[-1], self._path.positions[-1]
        if self._trajectory and self._samples:
            last = self._samples[-1]
            return last.time, (last.position, last.rotation)
        return None

    def way(self) -> list[Array]:
        """Return the points (3,) of the tool's trajectory that is followed, for people to see."""
        return [sample.position for sample in list(self._samples)] if self._trajectory else []

    def _sample_at(self, time: int) -> _Sample:
        """Return the trajectory's pose and twist at `time` [ns] as a sample."""
        poses, twists = np.empty((1, 4, 3)), np.empty((1, 6))
        self._write(bisect.bisect_right(self._times, time), [time], _INSTANT, poses, twists)
        return _Sample(time, time, poses[0, 3], poses[0, :3], twists[0])

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
            "twists": [
                (time, stamp, twist.tolist(), None if point is None else point.tolist())
                for time, stamp, twist, point in self._twists
            ],
            "trajectory": self._trajectory,
            "joints": None if self._joints is None else [values.tolist() for values in self._joints],
            "jog": None if self._jog is None else self._jog.tolist(),
            "path": None if self._path is None else self._path.state(),
            "arrivals": (self._pose_arrival, self._twist_arrival, self._joints_arrival),
            "clock": self._clock,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Take a state of `state`."""
        self.clear()
        for time, stamp, position, rotation, twist in state["samples"]:
            rate = None if twist is None else np.array(twist)
            self._insert(_Sample(time, stamp, np.array(position), np.array(rotation), rate))
        self._twists = [
            (time, stamp, np.array(twist), np.array(point[0]) if point and point[0] is not None else None)
            for time, stamp, twist, *point in state["twists"]  # runs of version 0.1 have no point
        ]
        self._newest_twist = max((entry[1] for entry in self._twists), default=-1)
        self._acceleration = self._estimate_acceleration()
        self._trajectory = bool(state["trajectory"])
        joints = state["joints"]
        self._joints = None if joints is None else (np.array(joints[0]), np.array(joints[1]))
        self._jog = None if state.get("jog") is None else np.array(state["jog"])
        self._path = None if state.get("path") is None else JointPath.of(state["path"])
        self._pose_arrival, self._twist_arrival, self._joints_arrival = state["arrivals"]
        self._clock = dict(state["clock"])

    # -- what is asked

    def age(self, now: int) -> float | None:
        """Return the seconds since a target arrived, None if none ever did."""
        latest = max(self._pose_arrival, self._twist_arrival, self._joints_arrival)
        return None if latest < 0 else (now - latest) * 1e-9

    def reference(self, now: int, dt: float) -> Reference | None:
        """Return the reference for the cycle from `now` [ns] to now + dt [s], good until the next call; None where no
        target is live.
        """
        if self._path is not None:
            joints, velocity = self._path.over(now, dt)
            return Reference(joints=joints, joint_velocity=velocity)
        if self._joints is not None or self._jog is not None:
            if now - self._joints_arrival > self._timeout:
                return None
            if self._joints is None:
                return Reference(joint_velocity=self._jog)
            return Reference(joints=self._joints[0], joint_velocity=self._joints[1])
        if self._samples and (self._trajectory or now - self._pose_arrival <= self._timeout):
            time = now if self._trajectory else now - self._delay
            self._write(bisect.bisect_right(self._times, time), [time], dt, *self._one)
            return self._followed
        if self._twists and now - self._twist_arrival <= self._timeout and self._mode != "pose":
            return Reference(twist=self._twists[-1][2], about=self._twists[-1][3])
        return None

    def references(self, times: list[int], dt: float) -> tuple[Array, Array] | None:
        """Return the references of a pose stream for cycles from these times [ns], none before the last, to dt [s]
        later, as many as find it live: poses (k, 4, 3), rotation over position, and twists (k, 6); None where something
        else is followed.
        """
        count = bisect.bisect_right(times, self._pose_arrival + self._timeout)
        elsewhere = self._trajectory or self._path is not None or self._joints is not None or self._jog is not None
        if elsewhere or not count or not self._samples:
            return None
        poses, twists = np.empty((count, 4, 3)), np.empty((count, 6))
        done = 0
        while done < count:
            index, end = bisect.bisect_right(self._times, times[done] - self._delay), count
            if index < len(self._times):  # up to the next sample
                end = bisect.bisect_left(times, self._times[index] + self._delay, done, count)
            asked = [time - self._delay for time in times[done:end]]
            self._write(index, asked, dt, poses[done:end], twists[done:end])
            done = end
        return poses, twists

    def _write(self, index: int, times: list[int], dt: float, poses: Array, twists: Array) -> None:
        """Write the references at times [ns] that `index` samples are before."""
        sample = self._samples[max(index - 1, 0)]
        ahead = np.array([(time - sample.time) * 1e-9 for time in times])
        segment = self._segment_to(index)
        if segment is not None:
            segment.references(ahead, dt, poses, twists)
            return
        # Before the first sample, or after the last one: carry its pose on.
        twist = None if self._trajectory else self._twist_of(sample)
        if twist is None:
            poses[:, :3], poses[:, 3], twists[:] = sample.rotation, sample.position, 0.0
            return
        rate = _NO_CHANGE if self._acceleration is None else self._acceleration
        carry_on(sample.position, sample.rotation, twist, rate, ahead, dt, poses, twists)

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
        (t0, _, v0, _), (t1, _, v1, _), (t2, _, v2, _) = last[-3:]
        if not (t0 < t1 < t2 and t2 - t0 <= self._timeout):
            return None
        rate: Array = agreed_rate(v0, v1, v2, 1e-9 * (t1 - t0), 1e-9 * (t2 - t1))
        return rate

    def _segment_to(self, index: int) -> Segment | None:
        """Return the motion from the sample before a sample to it, None where there is none, or too long a gap."""
        if not 0 < index < len(self._samples):
            return None
        before, after = self._samples[index - 1], self._samples[index]
        if not (self._trajectory or after.time - before.time <= self._timeout):
            return None
        kept = self._segment
        if kept is None or kept[0] is not before or kept[1] is not after:
            start = (before.position, before.rotation, self._slope(index - 1))
            end = (after.position, after.rotation, self._slope(index))
            kept = self._segment = before, after, Segment((after.time - before.time) * 1e-9, start, end)
        return kept[2]

    def _slope(self, index: int) -> Array:
        """Return the sample's twist, or one from its neighbours: the mean of both sides, weighted by nearness."""
        sample = self._samples[index]
        if sample.twist is not None:
            return sample.twist
        if self._trajectory and index in (0, len(self._samples) - 1):
            return np.zeros(6)
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
