"""Shapes: they move as the model's joints do."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("viser")

from ik_controller.kinematics.model import RobotModel
from ik_controller.robots import build_model, bundled_parameters
from ik_controller.view.shapes import ArmShapes

MESHES = """<robot name="r"><link name="a"/><link name="b"><visual><geometry><mesh filename="package://none/x.stl"/>
</geometry></visual></link><link name="c"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint><joint name="k" type="revolute">
<parent link="b"/><child link="c"/><origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""


@pytest.mark.parametrize("robot", ["panda", "ur5e"])
def test_shapes_are_where_the_links_are(robot):
    model = build_model(bundled_parameters(robot))
    shapes = ArmShapes(model)
    assert not shapes.note
    q = model.middle() + 0.2
    placements = shapes.place(q)
    data = model.pin_model.createData()
    pin.forwardKinematics(model.pin_model, data, q)
    for joint, placement in placements.items():
        if 0 < joint < model.pin_model.njoints:  # the full robot's first joints are the chain's
            assert np.allclose(placement.homogeneous, data.oMi[joint].homogeneous, atol=1e-12)
    # The shapes reach as far as the tool.
    points = np.vstack([placements[m.joint].act(v) for m in shapes.meshes for v in m.vertices[::10]])
    assert np.linalg.norm(points - model.forward(q).translation, axis=1).min() < 0.15


def test_base_frame_elsewhere():
    parameters = bundled_parameters("panda")
    model = RobotModel.from_urdf(build_model(parameters).urdf_text, "panda_link7", "panda_link1")
    shapes = ArmShapes(model)
    root = shapes.place(np.zeros(model.n))[0]  # what stands below the base is placed by its inverse
    assert np.allclose(root.translation, [0.0, 0.0, -0.333], atol=1e-9)


def test_missing_mesh_files_are_named_and_a_stick_figure_drawn():
    model = RobotModel.from_urdf(MESHES, "c")
    shapes = ArmShapes(model)
    assert "package://none/x.stl" in shapes.note or "none" in shapes.note
    assert {mesh.joint for mesh in shapes.meshes} == {1, 2}
