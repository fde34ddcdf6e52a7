"""Services and parameters of a running node: pause, reset, record, parameters; each change replays bit-identically."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from published import recorded
from rig import Rig

from ik_controller.recording.reader import open_bag
from ik_controller.recording.replay import Replay, replay

TURNS = itertools.cycle((1.0, -1.0))


@contextmanager
def moving(rig: Rig) -> Iterator[None]:
    """Keep the tool moving by a twist alone, up one time and down the next, until the block ends; then at rest."""
    message = TwistStamped()
    message.header.frame_id = "panda_link0"
    message.twist.linear.z = 0.1 * next(TURNS)
    with rig.sending("target_twist", message):
        rig.until_new("joint_commands", lambda c: np.abs(c.velocity).max() > 0.05, "the arm to move")
        yield
    rig.until_status("holding")


def at_rest(command: Any) -> bool:
    return not np.any(command.velocity)


def replayed(bag: Path) -> Replay:
    """Replay a bag that the node is sealing or has sealed."""
    by = time.monotonic() + 30.0
    while not (bag / "metadata.yaml").exists() or not open_bag(bag).complete:
        assert time.monotonic() < by, "the bag has not been sealed"
        time.sleep(0.02)
    result = replay(open_bag(bag))
    assert result.commands > 0
    return result


@pytest.fixture
def bag(live: Rig) -> Iterator[Any]:
    """Return a function that ends the recording of this test, begun in the middle of the run, and gives its folder."""
    live.call("record", False)
    live.until_new("status", lambda s: any(v.key == "recorder" and v.value == "off" for v in s.values), "no recorder")
    answer = live.call("record", True)
    assert answer.success
    folder = Path(answer.message.removeprefix("recording to "))
    assert folder.is_dir()

    def ended() -> Path:
        assert live.call("record", False).message == "sealing the bag"
        assert live.call("record", False).message == "nothing was being recorded"
        return folder

    yield ended
    live.call("record", True)


def test_pause_brakes_and_going_on_starts_at_the_measured_position(live: Rig, bag: Any) -> None:
    with moving(live):
        assert live.call("pause", True).success
        assert live.until_status("paused").level == b"\x01"
        live.until(lambda: at_rest(live.heard["joint_commands"][-1]), "the arm to stop")
        live.until_status("paused")
        number = len(live.heard["joint_commands"])
        # Paused, nothing is commanded although targets come; meanwhile somebody else moves the arm.
        elsewhere = live.heard["joint_commands"][-1]
        elsewhere = type(elsewhere)(name=elsewhere.name, position=np.array(elsewhere.position) + 0.1)
        live.until_status("paused")
        assert len(live.heard["joint_commands"]) == number
        publisher = live.publisher("joint_commands")

        def moved() -> bool:
            publisher.publish(elsewhere)  # again and again: the arm may not have found this publisher yet
            heard = live.heard["joint_states"]
            return bool(heard) and list(heard[-1].position) == list(elsewhere.position)

        live.until(moved, "the arm to move")
        live.until_status("paused")
        number = len(live.heard["joint_commands"])
        assert live.call("pause", False).success
        first = live.until(lambda: live.heard["joint_commands"][number:], "commands")[0]
        assert list(first.position) == list(elsewhere.position)
        assert at_rest(first)
        live.until_status("tracking")
    assert replayed(bag()).identical


def test_reset_brakes_first_and_goes_on(live: Rig, bag: Any) -> None:
    with moving(live):
        answer = live.call("reset")
        assert answer.success
        live.until_new("joint_commands", at_rest, "the arm to stop")
        live.until_new("joint_commands", lambda c: not at_rest(c), "the arm to go on")
    assert replayed(bag()).identical


def test_a_recording_that_starts_while_the_arm_moves_replays_bit_identically(live: Rig) -> None:
    live.call("record", False)
    before = set(live.bags())
    with moving(live):
        first = live.call("record", True)
        assert first.success
        again = live.call("record", True)
        assert "already" in again.message
        live.until_status("tracking")
        live.call("record", False)
        second = live.call("record", True)
        assert second.success
        assert second.message != first.message
        live.until_status("tracking")
        live.call("record", False)
    new = sorted(set(live.bags()) - before)
    assert len(new) == 2
    for folder in new:
        assert replayed(folder).identical
        assert len(recorded(folder, "/joint_commands")) > 0
        (model,) = recorded(folder, "/robot_description")
        assert "<robot" in model.data
    live.call("record", True)


def test_a_changed_parameter_acts_is_recorded_and_replays_bit_identically(live: Rig, bag: Any) -> None:
    with moving(live):
        assert live.set_parameters(gain=20.0).successful
        live.until_status("tracking")
        assert live.set_parameters(velocity_scale=0.05, posture_gain=0.5).successful
        live.until_status("velocity limit")
        assert live.set_parameters(velocity_scale=1.0, posture_gain=1.0, gain=[50.0]).successful
        live.until_status("tracking")
    folder = bag()
    assert replayed(folder).identical
    events = [m.data for m in recorded(folder, "/ik_controller/events")]
    assert any('"gain": 20.0' in event for event in events)
    assert any('"velocity_scale": 0.05' in event for event in events)
    assert live.get_parameter("velocity_scale") == 1.0


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"gain": 1000.0}, "gain"),  # times the cycle time above 1
        ({"gain": -1.0}, "gain"),
        ({"gain": "fast"}, "gain"),
        ({"damping": -0.1}, "damping"),
        ({"orientation_error": "euler"}, "exponential_base"),  # a legal choice
        ({"posture": [0.0, 0.0]}, "posture"),
        ({"rate": 500.0}, "read-only"),
        ({"robot": "ur5e"}, "read-only"),
        ({"tool_offset": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 2.0]}, "quaternion"),
        ({"mode": "both"}, "trajectory"),
        ({"gian": 1.0}, "unknown parameter 'gian'; did you mean: gain"),
    ],
)
def test_parameters_that_do_not_fit_are_refused_with_the_reason(live: Rig, values: dict[str, Any], named: str) -> None:
    result = live.set_parameters(**values)
    assert not result.successful
    assert named in result.reason


def test_parameters_are_taken_all_or_none(live: Rig) -> None:
    before = live.get_parameter("posture_gain")
    assert not live.set_parameters(posture_gain=before + 1.0, damping=-1.0).successful
    assert not live.set_parameters(posture_gain=before + 1.0, rate=500.0).successful
    assert live.get_parameter("posture_gain") == before
