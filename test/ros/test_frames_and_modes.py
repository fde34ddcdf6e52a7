"""Over DDS: frames of the model and of TF, modes, the tool, and goals; each run replays bit for bit."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from geometry_msgs.msg import PoseStamped, TransformStamped
from rig import Rig, values_of
from test_bad_input import HOME, JOINTS, joints, pose, twist
from test_services import replayed
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ik_controller.robots import build_model, bundled_parameters

STAND_INS = Path(__file__).parent / "stand_ins"
CAMERA = pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.5])), np.array([0.1, 0.0, 0.2]))


@pytest.fixture(scope="module")
def model() -> Any:
    return build_model(bundled_parameters("panda"))


@pytest.fixture(scope="module")
def tf(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A rig whose node finds tf2_ros (our stand-in, fed by /test_tf)."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(STAND_INS), before]))
    with closing(Rig(tmp_path_factory.mktemp("tf"))) as made:
        try:
            made.sim = made.start_sim("--rate", "250")
            made.node = made.start_node(robot="panda", rate=250.0, transform_timeout=0.3)
        finally:
            os.environ.pop("PYTHONPATH")
            if before is not None:
                os.environ["PYTHONPATH"] = before
        made.until_commanding()
        made.until_status("holding")
        made.transforms = made._listener.create_publisher(TransformStamped, "/test_tf", 10)
        made.until(made.transforms.get_subscription_count, "the listener of TF")
        made.until_known("/ik_controller")
        yield made


def transform(stamp: int) -> TransformStamped:
    message = TransformStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    message.header.frame_id, message.child_frame_id = "panda_link0", "camera"
    t, r = message.transform.translation, message.transform.rotation
    t.x, t.y, t.z, r.x, r.y, r.z, r.w = pin.SE3ToXYZQUAT(CAMERA).tolist()
    return message


def stamped(frame: str, values: np.ndarray, stamp: int = 0) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    p, o = message.pose.position, message.pose.orientation
    p.x, p.y, p.z, o.x, o.y, o.z, o.w = values.tolist()
    return message


def tool_of(rig: Rig, model: Any) -> Any:
    return model.forward(np.array(rig.heard["joint_commands"][-1].position))


def go(rig: Rig, model: Any, send: Any, goal: Any) -> None:
    """Send again and again until the commanded tool is at a pose."""

    def there() -> bool:
        send()
        return bool(np.abs(tool_of(rig, model).translation - goal.translation).max() < 1e-4)

    rig.until(there, "the tool to arrive")
    rig.until_status("holding")


def test_targets_in_a_frame_of_tf_are_followed_and_replay_without_tf(tf: Rig, model: Any) -> None:
    publisher = tf.publisher("target_pose")
    goal = tool_of(tf, model) * pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.03]))
    inside = pin.SE3ToXYZQUAT(CAMERA.actInv(goal))

    def send() -> None:
        now = time.time_ns()
        publisher.publish(stamped("camera", inside, now))  # its transform comes a little later: it waits
        tf.transforms.publish(transform(now + 10**9))

    go(tf, model, send, goal)
    tf.call("record", False)
    (bag,) = tf.bags()[-1:]
    result = replayed(bag)
    assert result.identical
    assert int(values_of(tf.until_new("status", lambda s: True)).get("rejected_target_pose", 0)) == result.rejected
    tf.call("record", True)


def test_a_late_transform_is_told_and_then_rejected(tf: Rig) -> None:
    publisher = tf.publisher("target_pose")
    before = values_of(tf.until_new("status", lambda s: True))
    publisher.publish(stamped("lens", np.array([0.4, 0, 0.4, 1.0, 0, 0, 0])))
    status = tf.until_new("status", lambda s: int(values_of(s)["rejected"]) > int(before["rejected"]), "a rejection")
    told = values_of(status)["last_rejected"]
    assert told.startswith("target_pose: frame_id 'lens' is unknown: no link of the model, and TF has no transform to")
    assert "'panda_link0' within 0.3" in told
    assert "does not exist" in told
    waiting = [s for s in tf.heard["status"] if "waiting for TF from 'lens' to 'panda_link0'" in s.message]
    assert all("transform" in values_of(s)["reasons"] for s in waiting)


def test_without_tf2_a_foreign_frame_is_rejected_and_says_so(live: Rig) -> None:
    publisher = live.publisher("target_pose")
    before = values_of(live.until_new("status", lambda s: True))
    publisher.publish(pose("map"))
    status = live.until_new("status", lambda s: int(values_of(s)["rejected"]) > int(before["rejected"]), "a rejection")
    assert "'map' is unknown: no link of the model, and tf2 is not installed" in values_of(status)["last_rejected"]


def test_targets_in_a_link_of_the_model_are_followed(live: Rig, model: Any) -> None:
    """A pose in the frame of a link that the arm itself moves; each message goes by where that link is then."""
    publisher = live.publisher("target_pose")
    goal = tool_of(live, model) * pin.SE3(np.eye(3), np.array([0.0, 0.02, 0.0]))
    base = pin.SE3ToXYZQUAT(goal)

    def send() -> None:
        publisher.publish(stamped("panda_link0", base))

    go(live, model, send, goal)
    twists = live.publisher("target_twist")
    start = tool_of(live, model)

    def turned() -> bool:
        twists.publish(twist("panda_hand_tcp", 0.05))
        return bool(np.linalg.norm(tool_of(live, model).translation - start.translation) > 0.02)

    live.until(turned, "the tool to move along its own x axis")
    way = start.rotation.T @ (tool_of(live, model).translation - start.translation)
    np.testing.assert_allclose(way / np.linalg.norm(way), [1.0, 0.0, 0.0], atol=1e-2)
    live.until_status("holding")


def test_a_mode_rejects_other_kinds(live: Rig) -> None:
    publisher = live.publisher("target_joints")
    assert live.set_parameters(mode="pose").successful
    live.until_new("status", lambda s: values_of(s)["mode"] == "pose")
    before = values_of(live.until_new("status", lambda s: True))
    publisher.publish(joints())
    status = live.until_new("status", lambda s: int(values_of(s)["rejected"]) > int(before["rejected"]), "a rejection")
    assert "target_joints: not followed in mode 'pose'" in values_of(status)["last_rejected"]
    assert live.set_parameters(mode="auto").successful


def test_unitless_twists_beyond_one_are_rejected(live: Rig) -> None:
    publisher = live.publisher("target_twist")
    assert live.set_parameters(twist_unit="unitless").successful
    before = values_of(live.until_new("status", lambda s: True))
    publisher.publish(twist(x=1.5))
    status = live.until_new("status", lambda s: int(values_of(s)["rejected"]) > int(before["rejected"]), "a rejection")
    assert "need −1 to 1, twist_unit is unitless" in values_of(status)["last_rejected"]
    assert live.set_parameters(twist_unit="speed").successful


def path(*points: tuple[float, list[float]], names: list[str] = JOINTS) -> JointTrajectory:
    message = JointTrajectory(joint_names=names)
    for seconds, position in points:
        point = JointTrajectoryPoint(positions=position)
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(seconds * 1e9), 10**9)
        message.points.append(point)
    return message


def test_a_joint_trajectory_is_followed_to_its_goal_and_the_status_says_so(live: Rig) -> None:
    kind, topic = JointTrajectory, "/ik_controller/target_joint_trajectory"
    from rig import SENT

    SENT.setdefault("target_joint_trajectory", (kind, topic))
    publisher = live.publisher("target_joint_trajectory")
    goal = (np.array(HOME) + 0.1).tolist()
    status, sent_at = live.until_new("status", lambda s: True), 0.0

    def reached() -> bool:
        nonlocal status, sent_at
        status = live.heard["status"][-1]
        # A hold-up of the process ends a trajectory.
        if values_of(status)["goal"] != "under way" and time.monotonic() > sent_at + 3.0:
            publisher.publish(path((0.6, goal), (1.0, HOME)))
            sent_at = time.monotonic()
        home = np.abs(np.array(live.heard["joint_commands"][-1].position) - HOME).max() < 1e-9  # it may be sent twice
        return home and "goal reached: 'panda_joint" in status.message

    live.until(reached, "the goal")
    assert values_of(status)["goal"].startswith("reached: ")
    farthest = max(np.abs(np.array(c.position) - HOME).max() for c in live.heard["joint_commands"][-1000:])
    assert farthest > 0.09
    for message, reason in (
        (path((1.0, HOME[:6])), "point 0 has 6 positions, need 7"),
        (path((1.0, HOME[:6]), names=JOINTS[:6]), "missing: panda_joint7"),
    ):
        before = values_of(live.until_new("status", lambda s: True))
        publisher.publish(message)
        status = live.until_new(
            "status", lambda s, b=before: int(values_of(s)["rejected"]) > int(b["rejected"]), "a rejection"
        )
        assert reason in values_of(status)["last_rejected"]
    # A twist of zero ends it.
    live.publisher("target_twist").publish(twist())
    live.until_new("status", lambda s: s.message.startswith("holding: no live target"))


def test_the_tool_changes_at_run_time_and_current_pose_with_it(live: Rig, model: Any) -> None:
    before = live.until_new("current_pose", lambda m: True).pose.position
    assert live.set_parameters(tool_offset=[0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]).successful
    after = live.until_new("current_pose", lambda m: abs(m.pose.position.z - before.z) > 0.05).pose.position
    hand = tool_of(live, model)
    np.testing.assert_allclose(hand.act(np.array([0, 0, 0.1])), [after.x, after.y, after.z], atol=1e-6)
    assert live.set_parameters(tool_offset=[]).successful
    (bag,) = live.bags()[-1:]
    live.call("record", False)
    assert replayed(bag).identical
    live.call("record", True)
