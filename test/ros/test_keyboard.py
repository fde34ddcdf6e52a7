"""Keyboard and joystick without ROS: what is held, what a device's messages mean."""

from __future__ import annotations

import numpy as np
import pytest

from ik_controller.errors import ParameterError
from ik_controller.ros.joystick import JoyMapping, load
from ik_controller.ros.keyboard import NUDGE, Held, events
from ik_controller.share import share_folder


def test_a_tap_is_a_nudge_and_silence_lets_go():
    held = Held()
    held.press("w", 10.0)
    assert held.keys(10.0 + 0.9 * NUDGE) == {"w"}
    assert held.keys(10.0 + 1.1 * NUDGE) == set()


def test_repeats_go_on_without_a_gap():
    held = Held()
    for time in (10.0, 10.5, 10.53, 10.56, 10.59):  # as a terminal repeats a held key
        held.press("w", time)
    assert held.keys(10.6) == {"w"}
    assert held.keys(10.8) == set()


def test_a_terminal_that_tells_releases():
    held = Held()
    assert events("\x1b[119;1:1u") == [("w", "press")]
    assert events("\x1b[119;1:3u\x1b[97;1:2u") == [("w", "release"), ("a", "repeat")]
    held.press("w", 10.0, told=True)
    assert held.keys(99.0) == {"w"}
    held.release("w")
    assert held.keys(99.0) == set()


def test_other_sequences_are_skipped():
    assert events("w\x1b[Aq\x1b[1;5C") == [("w", "type"), ("q", "type")]
    assert events("\x1b") == [("\x1b", "type")]


def test_bundled_mappings():
    for file in sorted((share_folder() / "config" / "joy").glob("*.yaml")):
        mapping = load(file)
        rest = [0.0] * 8
        assert mapping.twist(rest, [0] * 12) is None
    gamepad = load(share_folder() / "config" / "joy" / "gamepad.yaml")
    buttons = [0] * 11
    buttons[gamepad.deadman] = 1
    resting = gamepad.twist([0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0], buttons)  # triggers rest at 1
    assert np.array_equal(resting, np.zeros(6))
    forward = gamepad.twist([0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0], buttons)
    assert np.array_equal(forward, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_deadzone_has_no_step_and_bad_values_move_nothing():
    mapping = JoyMapping(axes={"vx": [0, 1.0]}, deadzone=0.2)
    assert mapping.twist([0.2], []) is None
    assert mapping.twist([0.2001], [])[0] == pytest.approx(0.0001 / 0.8)
    assert mapping.twist([float("nan")], []) is None
    assert mapping.twist([], []) is None
    assert mapping.twist([-3.0], [])[0] == -1.0


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("axes: {vq: [0, 1]}", "vx"),
        ("axes: {vx: 3}", "index, factor"),
        ("speed: 1", "linear_speed"),
        ("deadzone: 2", "deadzone"),
        ("- 1", "axes"),
        ("{", "is not YAML"),
    ],
)
def test_mistakes_in_a_mapping_are_named(tmp_path, text, named):
    file = tmp_path / "joy.yaml"
    file.write_text(text)
    with pytest.raises(ParameterError, match=named):
        load(file)
    with pytest.raises(ParameterError, match="cannot be read"):
        load(tmp_path / "none.yaml")
