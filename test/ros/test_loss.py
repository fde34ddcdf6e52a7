"""When something goes away: joint states stop, the process is told to end, or killed; waiting for the model's text."""

from __future__ import annotations

import bisect
import json
import signal
import subprocess

import numpy as np
import pytest
from published import assert_limits_hold, recorded, restarts_of, stamp
from rig import CLI, Rig, environment, figure_bag
from test_services import at_rest

from ik_controller.messages import cdr
from ik_controller.recording.reader import open_bag
from ik_controller.recording.replay import replay
from ik_controller.robots import build_model, bundled_parameters


def model():
    return build_model(bundled_parameters("panda"))


def test_joint_states_stop_and_come_back_elsewhere(rig: Rig) -> None:
    targets = figure_bag(rig.folder / "targets", 12.0)
    sim = rig.start_sim("--rate", "500")
    node = rig.start_node(robot="panda", rate=250.0)
    rig.until_status("holding")
    rig.start("stream", [*CLI, "stream", str(targets), "--loop"])
    rig.until_new("joint_commands", lambda c: np.abs(c.velocity).max() > 0.1, "the arm to move")
    sim.send(signal.SIGKILL)
    status = rig.until_status("joint states have stopped")
    assert status.level == b"\x02"
    rig.until(lambda: not np.any(rig.heard["joint_commands"][-1].velocity), "the arm to halt")
    rig.until_status("joint states have stopped")
    halted = len(rig.heard["joint_commands"])
    rig.until_status("joint states have stopped")
    assert len(rig.heard["joint_commands"]) == halted

    elsewhere = [0.3, -0.5, 0.2, -2.0, 0.1, 1.7, 0.6]
    rig.start_sim("--rate", "500", "--start", *map(str, elsewhere))
    first = rig.until(lambda: rig.heard["joint_commands"][halted:], "commands again")[0]
    assert list(first.position) == elsewhere
    assert not np.any(first.velocity)
    rig.until_status("tracking")
    node.send(signal.SIGINT)
    assert node.wait() == 0, node.err
    (bag,) = rig.bags()
    sent = recorded(bag, "/joint_commands")  # all of them: a listener that is held up itself misses some
    assert at_rest(sent[-1])
    assert_limits_hold(sent, model(), 4_000_000, restarts_of(bag))
    assert replay(open_bag(bag)).identical


def test_model_from_the_topic_and_sigterm_while_moving(rig: Rig) -> None:
    targets = figure_bag(rig.folder / "targets", 12.0)
    tip = {"tip_frame": "panda_hand_tcp", "base_frame": "panda_link0"}
    node = rig.start_node(**tip, rate=200.0)
    rig.until(lambda: "waiting for the topic robot_description" in node.err, "the node to wait")
    rig.start_sim("--rate", "400")
    rig.until_status("holding")
    rig.start("stream", [*CLI, "stream", str(targets), "--loop"])
    rig.until_new("joint_commands", lambda c: np.abs(c.velocity).max() > 0.1, "the arm to move")
    moving = rig.heard["joint_commands"][-1]
    node.send(signal.SIGTERM)
    assert node.wait() == 0, node.err
    (bag,) = rig.bags()
    sent = recorded(bag, "/joint_commands")
    assert stamp(sent[-1]) > stamp(moving)
    assert at_rest(sent[-1])
    arm = model()
    arm.set_limits(acceleration=4.0 * arm.velocity_limit)  # the URDF has none: full speed in 0.25 s
    assert_limits_hold(sent, arm, 5_000_000, restarts_of(bag))
    assert open_bag(bag).complete
    assert replay(open_bag(bag)).identical
    # A replay of a run whose model came by topic needs no URDF either.
    (text,) = recorded(bag, "/robot_description")
    assert "panda_joint7" in text.data


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_end_while_paused_and_while_waiting(rig: Rig, number: int) -> None:
    """Without any joint state; paused; and without a robot: the node ends at once, cleanly."""
    node = rig.start_node(robot="panda", rate=200.0)
    rig.until_status("waiting for the first joint state")
    rig.call("pause", True)
    rig.until_status("paused")
    node.send(number)
    assert node.wait() == 0, node.err
    assert "Traceback" not in node.err
    (bag,) = rig.bags()
    assert open_bag(bag).complete
    assert replay(open_bag(bag)).identical is None  # nothing was commanded


def test_the_end_while_waiting_for_a_robot(rig: Rig) -> None:
    node = rig.start_node(tip_frame="tool")
    rig.until(lambda: "waiting for the topic robot_description" in node.err, "the node to wait")
    node.send(signal.SIGTERM)
    assert node.wait() == 0, node.err
    assert rig.bags() == []


def test_sigkill_loses_at_most_100_ms_and_the_rest_replays(rig: Rig) -> None:
    targets = figure_bag(rig.folder / "targets", 12.0)
    rig.start_sim("--rate", "1000")
    node = rig.start_node(robot="panda", rate=1000.0)
    rig.until_status("holding")
    rig.start("stream", [*CLI, "stream", str(targets), "--loop"])
    rig.until_new("joint_commands", lambda c: np.abs(c.velocity).max() > 0.2, "the arm to move")
    rig.until_status("tracking")
    node.send(signal.SIGKILL)
    node.wait()
    rig.listen()
    (bag,) = rig.bags()
    assert not open_bag(bag).complete

    command = [*CLI, "recover", str(bag), "--json"]
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment(rig.domain), timeout=180, check=False
    )
    assert done.returncode in (0, 3), done.stderr
    answer = json.loads(done.stdout)
    assert set(answer) >= {"messages", "lost_bytes", "output"}
    whole = open_bag(answer["output"])
    assert whole.complete
    assert sum(topic.count or 0 for topic in whole.topics) == answer["messages"]

    kept = [cdr.stamp_of(cdr.decode(cdr.JOINT_STATE, m.data)) for m in whole.messages(["/joint_commands"])]
    heard = [stamp(c) for c in rig.heard["joint_commands"]]
    # All that was heard up to the end of the recording is in it; a busy machine lets us miss some, never the recorder.
    assert set(heard[: bisect.bisect_right(heard, kept[-1])]) <= set(kept)
    assert (np.diff(kept) > 0).all()
    # How late commands came is how long the machine held up the node, or us: it is no loss of the recorder's.
    late = max(arrival - at for arrival, at in list(zip(rig.arrivals["joint_commands"], heard, strict=True))[-500:])
    assert heard[-1] - kept[-1] <= 100_000_000 + late
    result = replay(whole)
    assert result.identical
    assert result.commands >= len(kept)
    # And without recovery: a replay of the cut-off bag takes what is whole, and says so.
    cut = replay(open_bag(bag))
    assert cut.identical
    assert not cut.complete
    assert cut.cycles == result.cycles
