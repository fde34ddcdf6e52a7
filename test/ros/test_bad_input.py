"""Every bad message over DDS: rejected, counted, told in ~/status with the reason, and the node goes on."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Transform, Twist, TwistStamped
from rig import Rig, values_of
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

NAN, INF = float("nan"), float("inf")
JOINTS = [f"panda_joint{i}" for i in range(1, 8)]
HOME = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]


def pose(frame: str = "panda_link0", x: float = 0.4, q: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.z = x, 0.4
    o = message.pose.orientation
    o.x, o.y, o.z, o.w = q
    return message


def twist(frame: str = "panda_link0", x: float = 0.0) -> TwistStamped:
    message = TwistStamped()
    message.header.frame_id = frame
    message.twist.linear.x = x
    return message


def joints(names: list[str] = JOINTS, position: list[float] = HOME, velocity: list[float] | None = None) -> JointState:
    return JointState(name=names, position=position, velocity=velocity or [])


def trajectory(
    *seconds: int, frame: str = "panda_link0", transforms: int = 1, velocities: int = 0, x: float = 0.4
) -> Any:
    message = MultiDOFJointTrajectory()
    message.header.frame_id = frame
    for second in seconds:
        point = MultiDOFJointTrajectoryPoint(
            transforms=[Transform() for _ in range(transforms)], velocities=[Twist() for _ in range(velocities)]
        )
        for transform in point.transforms:
            transform.translation.x = x
        point.time_from_start.sec = second
        message.points.append(point)
    return message


def named(message: Any, name: str) -> Any:
    message.joint_names = [name]
    return message


BAD: dict[str, tuple[str, Any, str]] = {
    # what is wrong: role, message, what the reason must name
    "pose: NaN": ("target_pose", pose(x=NAN), "finite"),
    "pose: infinite": ("target_pose", pose(x=-INF), "finite"),
    "pose: NaN quaternion": ("target_pose", pose(q=(NAN, 0.0, 0.0, 1.0)), "finite"),
    "pose: zero quaternion": ("target_pose", pose(q=(0.0, 0.0, 0.0, 0.0)), "quaternion is zero"),
    "pose: quaternion off unit": ("target_pose", pose(q=(0.0, 0.0, 0.0, 1.002)), "norm 1.002"),
    "pose: empty frame": ("target_pose", pose(frame=""), "frame_id is empty; legal: "),
    "pose: unknown frame": ("target_pose", pose(frame="map"), "'map' is unknown: no link of the model"),
    "twist: NaN": ("target_twist", twist(x=NAN), "finite"),
    "twist: unknown frame": ("target_twist", twist(frame="tool"), "'tool' is unknown: no link of the model"),
    "joints: NaN": ("target_joints", joints(position=[NAN, *HOME[1:]]), "panda_joint1"),
    "joints: one missing": ("target_joints", joints(JOINTS[1:], HOME[1:]), "missing: panda_joint1"),
    "joints: one doubled": ("target_joints", joints([*JOINTS, JOINTS[2]], [*HOME, 0.0]), "twice: panda_joint3"),
    "joints: all unknown": ("target_joints", joints(["a", "b"], [0.0, 0.0]), "panda_joint1"),
    "joints: too few positions": ("target_joints", joints(position=HOME[:6]), "6 values in position for 7 names"),
    "joints: too few velocities": ("target_joints", joints(velocity=[0.0]), "1 values in velocity for 7 names"),
    "joints: NaN velocity": ("target_joints", joints(velocity=[NAN] * 7), "finite"),
    "trajectory: no points": ("target_trajectory", trajectory(), "no points"),
    "trajectory: times fall": ("target_trajectory", trajectory(2, 1), "point 1: time_from_start"),
    "trajectory: no transform": ("target_trajectory", trajectory(1, transforms=0), "0 transforms, need 1"),
    "trajectory: two velocities": ("target_trajectory", trajectory(1, velocities=2), "2 velocities"),
    "trajectory: unknown frame": ("target_trajectory", trajectory(1, frame="map"), "'map' is unknown"),
    "trajectory: NaN": ("target_trajectory", trajectory(1, x=NAN), "finite"),
    "trajectory: other joint": ("target_trajectory", named(trajectory(1), "base"), "panda_hand_tcp"),
}


def rested(status: Any) -> bool:
    """At rest, with joint states that are not late at this very moment."""
    return str(status.message).startswith("holding: no live target")


def rejections(status: Any) -> int:
    return int(values_of(status)["rejected"])


@pytest.mark.parametrize("case", BAD)
def test_a_bad_target_is_rejected_counted_and_told(live: Rig, case: str) -> None:
    role, message, reason = BAD[case]
    publisher = live.publisher(role)
    before = live.until_new("status", lambda s: True)
    publisher.publish(message)
    status = live.until_new("status", lambda s: rested(s) and rejections(s) > rejections(before), "a rejection")
    told = values_of(status)
    assert rejections(status) == rejections(before) + 1
    assert int(told[f"rejected_{role}"]) == int(values_of(before).get(f"rejected_{role}", 0)) + 1
    assert told["last_rejected"].startswith(f"{role}: ")
    assert reason in told["last_rejected"]
    assert "\n" not in told["last_rejected"]
    # It goes on, and did not move.
    command = live.until_new("joint_commands", lambda c: True)
    assert not np.any(command.velocity)
    assert "rejected" in live.node.err


BAD_STATES: dict[str, tuple[Callable[[], JointState], str]] = {
    "NaN": (lambda: joints(position=[*HOME[:6], NAN]), "panda_joint7"),
    "one missing": (lambda: joints(JOINTS[:6], HOME[:6]), "missing: panda_joint7"),
    "one doubled": (lambda: joints([*JOINTS, JOINTS[0]], [*HOME, 1.0]), "twice: panda_joint1"),
    "too many positions": (lambda: joints(position=[*HOME, 0.0]), "8 values in position for 7 names"),
    "too few velocities": (lambda: joints(velocity=[0.0] * 6), "6 values in velocity for 7 names"),
}


@pytest.mark.parametrize("case", BAD_STATES)
def test_a_bad_joint_state_is_rejected_counted_and_told(live: Rig, case: str) -> None:
    make, reason = BAD_STATES[case]
    publisher = live.publisher("joint_states")
    before = live.until_new("status", lambda s: True)
    sent: list[float] = []

    def rejected() -> Any:
        # Sent again after a while: a node that is held up takes only the last of all joint states that have come.
        if not sent or time.monotonic() > sent[-1] + 2.0:
            publisher.publish(make())
            sent.append(time.monotonic())
        status = live.heard["status"][-1]
        return status if rested(status) and rejections(status) > rejections(before) else None

    status = live.until(rejected, "a rejection")
    assert 1 <= rejections(status) - rejections(before) <= len(sent)
    assert reason in values_of(status)["last_rejected"]
    if len(sent) > 1:
        live.until_new("status", lambda s: "rejected" not in values_of(s)["reasons"], "all of them to be taken")
    assert "NaN" not in str(live.until_new("current_pose", lambda m: True))


def test_joint_states_of_other_joints_beside_ours_are_no_mistake(live: Rig) -> None:
    publisher = live.publisher("joint_states")
    before = live.until_new("status", lambda s: True)
    publisher.publish(joints(["gripper", "lift"], [1.0, 2.0]))
    after = live.until_new("status", lambda s: True)
    after = live.until_new("status", lambda s: True)
    assert rejections(after) == rejections(before)


def test_joints_in_another_order_are_matched_by_name(live: Rig) -> None:
    """The names reversed, and a joint that is not ours among them: the arm goes where each name says."""
    goal = np.array(live.heard["joint_commands"][-1].position) + 0.02 * np.arange(1, 8)
    names, position = [*JOINTS[::-1], "gripper"], [*goal[::-1], 9.0]
    publisher = live.publisher("target_joints")

    def there() -> bool:
        publisher.publish(joints(names, position))
        return bool(np.abs(np.array(live.heard["joint_commands"][-1].position) - goal).max() < 1e-3)

    live.until(there, "the arm to arrive")
    live.until_status("holding")


def test_the_recording_holds_what_was_rejected_and_replays(live: Rig) -> None:
    from test_services import replayed

    (bag,) = live.bags()[-1:]
    live.call("record", False)
    result = replayed(bag)
    assert result.identical
    assert result.rejected == rejections(live.until_new("status", lambda s: True))
    live.call("record", True)
