"""The law's J⁺ by name (N5): every inverse of the library can be chosen, and gives what the library gives."""

from __future__ import annotations

import numpy as np
import pytest
from motions import bundled

from ik_controller import Controller, ControllerParameters, Reference
from ik_controller.errors import ParameterError
from ik_controller.kinematics.inverses import INVERSES, inverse
from ik_controller.parameters import INVERSES as NAMES

DT = 1e-3
TWIST = np.array([0.02, -0.01, 0.03, 0.05, 0.02, -0.04])


def test_every_inverse_of_the_library_is_a_choice():
    assert set(NAMES) == set(INVERSES)


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_the_velocity_is_that_of_the_named_inverse(name, method):
    robot = bundled(name)
    n = robot.model.n
    weights = {"weighted_right": np.linspace(1.0, 3.0, n), "weighted_left": np.linspace(1.0, 3.0, 6)}.get(method)
    values = {"inverse": method, "damping": 0.1, "singular_value_threshold": 0.5}
    if weights is not None:
        values["inverse_weights"] = weights.tolist()
    impossible = {"panda": ("exact", "left", "weighted_left"), "ur5e": ()}[name]
    parameters = robot.parameters.replace(values)
    if method in impossible:
        with pytest.raises(ParameterError, match=f"inverse = '{method}' does not fit"):
            Controller(robot.model, parameters)
        return
    controller = Controller(robot.model, parameters)
    q = robot.home.copy()
    controller.reset(q)
    controller.step(q, None, DT)
    step = controller.step(q, Reference.velocity(0.01 * TWIST), DT)
    options = {"weight": weights, "damping": 0.1, "threshold": 0.05 if method == "damped_manipulability" else 0.5}
    taken = {key: options[key] for key in options if key in INVERSES[method].options}
    expected = inverse(robot.model.jacobian(q), method, **taken) @ (0.01 * TWIST)
    np.testing.assert_allclose(step.velocity, expected, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("method", [m for m in NAMES if m not in ("exact", "left", "weighted_left", "transpose")])
def test_every_choice_tracks_and_stays_within_limits(method):
    robot = bundled("panda")
    values = {"inverse": method, "damping": 1e-3, "inverse_weights": [1.0] * 7 if method == "weighted_right" else []}
    controller = Controller(robot.model, robot.parameters.replace(values))
    q = robot.home.copy()
    controller.reset(q)
    target = robot.model.forward(q)
    target.translation[:] += (0.05, -0.05, 0.05)
    previous = np.zeros(7)
    for _ in range(1500):
        step = controller.step(q, Reference.pose(target), DT)
        assert (np.abs(step.velocity - previous) <= robot.model.acceleration_limit * DT * (1.0 + 1e-9)).all()
        q, previous = step.position, step.velocity
    np.testing.assert_allclose(robot.model.forward(q).translation, target.translation, atol=1e-6)


def test_at_a_singularity_an_inverse_that_does_not_exist_gives_way_to_the_damped_one():
    robot = bundled("ur5e")
    controller = Controller(robot.model, ControllerParameters(inverse="exact"))
    q = np.zeros(6)  # stretched out, wrist aligned
    controller.reset(q)
    controller.step(q, None, DT)
    step = controller.step(q, Reference.velocity(TWIST), DT)
    assert np.isfinite(step.velocity).all()
    assert step.status.damped
