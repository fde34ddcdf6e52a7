"""Every condition has a sentence that names what holds the arm back."""

from __future__ import annotations

import pytest

from ik_controller.control.status import SENTENCES, Code, Limit, Status, in_words


def test_every_code_and_every_limit_has_a_sentence():
    assert set(SENTENCES) == set(Code)
    for limit in Limit:
        text = Status(Code.TRACKING, 0.4, limit, 1, pair=("hand", "table"), distance=0.021).sentence(("a", "b"))
        if limit is Limit.NONE:
            assert text == "tracking"
        else:
            assert "at 40 % of the wanted speed" in text
            assert ("'b'" in text) != ("hand and table, 0.021 m" in text)


def test_a_fault_says_its_reason():
    assert "joint 'a' leaves" in Status(Code.FAULT, reason="joint 'a' leaves its bounds").sentence()


@pytest.mark.parametrize(
    ("direction", "words"),
    [
        ((0, 0, 1, 0, 0, 0), "cannot move along z"),
        ((0, 0, 0, 0, -1, 0.01), "cannot turn about y"),
        ((0.6, 0, 0.8, 0, 0, 0.1), "cannot move along (0.60, 0.00, 0.80)"),
        ((1, 0, 0, 0, 0, 1), "cannot move along x together with turn about z"),
    ],
)
def test_a_singular_direction_in_words(direction, words):
    assert in_words(direction) == words


def test_the_closest_approach_tells_how_far_the_target_is():
    status = Status(Code.TRACKING, closest=True, feasible=False, position_error=0.25, orientation_error=0.0)
    assert "out of reach: at rest at the closest approach, 0.25 m and 0 rad away" in status.sentence()
    assert "cannot be kept within the limits" in Status(Code.TRACKING, feasible=False).sentence()
