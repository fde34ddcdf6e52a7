"""The simulated arm and the target streamer as processes of their own, without the node between."""

from __future__ import annotations

import json
import signal

import numpy as np
from geometry_msgs.msg import PoseStamped
from published import stamp
from rig import CLI, Rig, figure_bag
from sensor_msgs.msg import JointState

NAMES = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
START = [0.1, -1.5, 1.5, -1.5, -1.5, 0.2]


def test_the_simulated_arm(rig: Rig) -> None:
    sim = rig.start_sim("--robot", "ur5e", "--rate", "200", "--start", *map(str, START), "--lag", "0.05")
    rig.until(lambda: len(rig.heard["joint_states"]) > 20, "joint_states")
    first = rig.heard["joint_states"][0]
    assert list(first.name) == NAMES
    assert list(first.position) == START
    assert not np.any(first.velocity)

    # A command goes through the lag: each state is on the way, none beyond.
    goal = np.array(START) + 0.1
    publisher = rig.publisher("joint_commands")

    def rejected() -> bool:
        # A joint is missing. Again and again: the arm may not have found this publisher yet.
        publisher.publish(JointState(name=NAMES[:-1], position=goal[:-1].tolist()))
        return "missing: wrist_3_joint" in sim.err

    rig.until(rejected, "the rejection")
    assert list(rig.heard["joint_states"][-1].position) == START
    publisher.publish(JointState(name=NAMES[::-1], position=goal[::-1].tolist()))
    rig.until(lambda: np.abs(np.array(rig.heard["joint_states"][-1].position) - goal).max() < 1e-4, "the goal")
    way = np.array([state.position for state in rig.heard["joint_states"]]) - START
    assert (np.diff(way, axis=0) >= -1e-12).all()
    assert way.max() <= 0.1 + 1e-12
    share = 1.0 - np.exp(-0.005 / 0.05)
    moved = way[np.flatnonzero(way[:, 0] > 0.0)[:10], 0]
    np.testing.assert_allclose(moved, 0.1 * (1.0 - (1.0 - share) ** np.arange(1, len(moved) + 1)), atol=1e-9)
    assert set(np.diff([stamp(state) for state in rig.heard["joint_states"]]) % 5_000_000) == {0}
    sim.send(signal.SIGINT)
    assert sim.wait() == 0, sim.err


def test_the_streamer_sends_all_in_order_once_the_node_is_ready(rig: Rig) -> None:
    targets = figure_bag(rig.folder / "targets", 1.0)
    heard: list[PoseStamped] = []
    subscription = rig._listener.create_subscription(PoseStamped, "/arm/target_pose", lambda _: None, 1000)
    rig._listener.create_subscription(*twist_topic(), lambda _: None, 1000)
    sign = rig._listener.create_publisher(PoseStamped, "/arm/current_pose", 10)
    streamer = rig.start("stream", [*CLI, "stream", str(targets), "--node", "arm", "--patience", "60", "--json"])

    def ended() -> bool:
        sign.publish(PoseStamped())
        with subscription.handle:
            while (taken := subscription.handle.take_message(PoseStamped, False)) is not None:
                heard.append(taken[0])
        return streamer.popen.poll() is not None

    rig.until(ended, "the streamer to end")
    ended()
    assert streamer.wait() == 0, streamer.err
    assert json.loads(streamer.out) == {"sent": 202}
    assert len(heard) == 101
    # New stamps, of today, at the bag's spacing.
    stamps = np.array([stamp(pose) for pose in heard])
    assert set(np.diff(stamps)) == {10_000_000}
    assert {pose.header.frame_id for pose in heard} == {"panda_link0"}


def twist_topic():
    from geometry_msgs.msg import TwistStamped

    return TwistStamped, "/arm/target_twist"
