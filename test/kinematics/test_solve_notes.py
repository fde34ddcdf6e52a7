"""The 2R example of 000/003: both printed tables, and what of them cannot be reproduced (N7)."""

from __future__ import annotations

import arms
import numpy as np
import pytest

from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.solve import solve_ik

POSE = (0.2, 1.3, 0.0, 0.0, 0.0, 0.0, 1.0)
START, STEP = (0.25, 0.75), 0.75
INVERSE = """-0.33284 2.6711
0.80552 2.1025
0.46906 1.9316
0.53554 1.7697
0.55729 1.7227
0.56308 1.7104
0.56455 1.7073
0.56492 1.7065
0.56501 1.7063
0.56503 1.7062"""
# row → (θ₁, θ₂) with the digits that are printed
TRANSPOSE = {
    1: ("1.8362", "1.3412"),
    2: ("0.4667", "1.1025"),
    3: ("1.1215", "1.6233"),
    4: ("0.45264", "1.415"),
    5: ("0.83519", "1.7273"),
    26: ("0.56522", "1.7063"),
    27: ("0.56492", "1.7061"),
    28: ("0.56514", "1.7063"),
    29: ("0.56498", "1.7062"),
    30: ("0.5650", "1.7062"),
}


def rows(method, iterations, start=START, step=STEP):
    model = RobotModel.from_urdf(arms.planar_2r(), "tool")
    tight = {"position_tolerance": 1e-12, "respect_limits": False}
    solution = solve_ik(
        model, POSE, start, method, axes="xy", step=step, max_iterations=iterations, history=True, **tight
    )
    assert [row.k for row in solution.history] == list(range(iterations + 1))
    return np.array([row.q for row in solution.history])


def printed(text):
    """Return the number and half a unit of its last digit; the print drops zeros at the end, so five digits count."""
    number = float(text)
    return number, 0.5 * 10.0 ** -(5 if number < 1.0 and len(text) > 6 else 4)


def test_inverse_method_all_ten_rows_to_the_printed_digits():
    computed = rows("newton", 10)[1:]
    assert [f"{a:.5g} {b:.5g}" for a, b in computed] == INVERSE.splitlines()


@pytest.mark.parametrize("row", [2, 3, 4, 5, 27, 28, 29, 30])
def test_transpose_method_every_row_follows_from_the_printed_row_before(row):
    """Within what the last printed digits of both rows leave open (the first table row of each run has none before)."""
    before = [printed(text) for text in TRANSPOSE[row - 1]]
    centre = np.array([number for number, _ in before])
    computed = rows("transpose", 1, centre)[1]
    # How far the row before's rounding can move this one: the sum over its two numbers.
    spread = sum(
        np.abs(rows("transpose", 1, centre + half * np.eye(2)[i])[1] - computed) for i, (_, half) in enumerate(before)
    )
    for value, slack, text in zip(computed, spread, TRANSPOSE[row], strict=True):
        number, half = printed(text)
        assert abs(value - number) <= half + slack


def test_transpose_method_row_26_lies_on_the_orbit_but_one_iteration_later():
    """From printed row 5 the numbers of printed row 26 come after 22 iterations, not 21."""
    orbit = rows("transpose", 22, (0.83519, 1.7273))
    goal = np.array([0.56522, 1.7063])
    assert np.abs(orbit[22] - goal).max() < 1e-4
    assert np.abs(orbit[21] - goal).max() > 3e-4


def test_transpose_method_what_cannot_be_reproduced():
    """Row 1 does not follow from the printed start (0.25, 0.75) with step 0.75, nor with any other scalar step."""
    first = rows("transpose", 1)[1]
    assert [f"{a:.4f}" for a in first] == ["1.5582", "1.6618"]
    direction = (first - START) / STEP
    needed = (np.array([1.8362, 1.3412]) - START) / direction
    assert abs(needed[0] - needed[1]) > 0.4


def test_both_reach_the_misprinted_solution():
    for method, iterations in (("newton", 40), ("transpose", 400)):
        model = RobotModel.from_urdf(arms.planar_2r(), "tool")
        solution = solve_ik(model, POSE, START, method, axes="xy", step=STEP, max_iterations=iterations)
        assert solution.converged
        assert np.allclose(solution.q, [0.5650, 1.7062], atol=1e-4)  # printed: 0.5650 and 0.7062
