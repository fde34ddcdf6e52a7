"""The kernel's forward kinematics and Jacobian against Pinocchio, on every kind of joint."""

from __future__ import annotations

import math

import arms
import numpy as np
import pytest
from arms_closed_form import CLOSED_FORMS

from ik_controller.kinematics.chain import PinocchioChain, chain_kinematics, model_kinematics, table_of
from ik_controller.kinematics.levenberg_marquardt import (
    damped_step_kernel,
    damped_step_numpy,
    rotation_log_kernel,
    rotation_log_pinocchio,
)
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.rotation import exp_rotation

MIMIC = """<robot name="mimic"><link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="tool"/>
<joint name="lead" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0 0.1" rpy="0.1 0.2 0.3"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
<joint name="follow" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.3 0 0"/><axis xyz="0 -1 0.2"/>
<limit lower="-2" upper="2" velocity="1" effort="1"/><mimic joint="lead" multiplier="-1.5" offset="0.2"/></joint>
<joint name="slide" type="prismatic"><parent link="b"/><child link="c"/><origin xyz="0.2 0 0"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1" velocity="1" effort="1"/></joint>
<joint name="mount" type="fixed"><parent link="c"/><child link="tool"/><origin xyz="0 0.1 0.2" rpy="1 0 0"/></joint>
</robot>"""

URDFS = {name: urdf for name, (urdf, _, _) in CLOSED_FORMS.items()} | {
    "skewed_7": arms.skewed_7(),
    "scara": arms.scara(),
    "mimic": MIMIC,
}


def evaluate(function, chain, model, q):
    rotation, position, jacobian = np.empty((3, 3)), np.empty(3), np.empty((6, model.n))
    function(chain, q, rotation, position, jacobian)
    return np.concatenate((rotation.ravel(), position, jacobian.ravel()))


@pytest.mark.parametrize("name", URDFS)
def test_kernel_equals_pinocchio(name):
    model = RobotModel.from_urdf(URDFS[name], "tool")
    rng = np.random.default_rng(1)
    for offset in (None, [0.1, -0.2, 0.05, 0.0, math.sin(0.3), 0.0, math.cos(0.3)]):
        if offset is not None:
            model.set_tool_offset(offset)  # the chain must follow
        for _ in range(20):
            q = rng.uniform(-3.0, 3.0, model.n)
            by_kernel = evaluate(chain_kinematics, table_of(model), model, q)
            by_pinocchio = evaluate(model_kinematics, PinocchioChain(model), model, q)
            assert np.abs(by_kernel - by_pinocchio).max() < 1e-12


@pytest.mark.parametrize("angle", [0.0, 1e-14, 1e-9, 1e-4, 1.0, 3.0, 3.0999, 3.1001, math.pi - 1e-7, math.pi - 1e-12])
def test_rotation_log_equals_pinocchio(angle):
    rng = np.random.default_rng(2)
    for _ in range(20):
        axis = rng.normal(size=3)
        turn = exp_rotation(axis / np.linalg.norm(axis) * angle)
        rotation = exp_rotation(rng.normal(size=3))
        desired = turn @ rotation
        kernel, pinocchio = np.empty(3), np.empty(3)
        rotation_log_kernel(desired, rotation, kernel)
        rotation_log_pinocchio(desired, rotation, pinocchio)
        # Near π round-off decides between the two ways round.
        nearest = min(np.abs(kernel - pinocchio).max(), np.abs(kernel + pinocchio).max() if angle > 3.14 else 9.0)
        assert nearest < 1e-7 if angle > 3.14 else 1e-12
        assert np.abs(exp_rotation(kernel) @ rotation - desired).max() < 1e-9


def test_damped_step_equals_lapack():
    rng = np.random.default_rng(3)
    for n in (1, 2, 6, 7, 9):
        jacobian, gradient = rng.normal(size=(6, n)), rng.normal(size=n)
        free = rng.random(n) < 0.7
        kernel, lapack = np.empty(n), np.empty(n)
        damped_step_kernel(jacobian, gradient, free, 0.01, kernel)
        damped_step_numpy(jacobian, gradient, free, 0.01, lapack)
        assert np.abs(kernel - lapack).max() < 1e-10 * max(1.0, np.abs(lapack).max())
        assert (kernel[~free] == 0.0).all()
