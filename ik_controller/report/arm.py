"""The arm for a page's 3-D view: its joints in series, and the simple solids of its URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
import pinocchio as pin

from ik_controller.kinematics.model import RobotModel

_MOST_SOLIDS = 300
_GREY = "#b8bdc6"


def joints(model: RobotModel) -> list[dict[str, Any]]:
    """Return each joint of the chain: its placement in the frame before it (R by rows, then t [m]), its axis, and how
    it follows q: value = factor · q[leader] + offset.
    """
    pin_model, found = model.pin_model, []
    for k in range(1, pin_model.njoints):
        subspace = pin_model.joints[k].createData().S.ravel()  # linear, then angular, in the joint's own frame
        prismatic = bool(np.abs(subspace[:3]).any())
        leader, factor, offset = k - 1, 1.0, 0.0
        if model.expansion is not None and model.expansion_offset is not None:
            leader = int(np.argmax(np.abs(model.expansion[k - 1])))
            factor, offset = float(model.expansion[k - 1, leader]), float(model.expansion_offset[k - 1])
        found.append(
            {
                "parent": int(pin_model.parents[k]),
                "placement": _numbers(pin_model.jointPlacements[k]),
                "axis": (subspace[:3] if prismatic else subspace[3:]).tolist(),
                "prismatic": prismatic,
                "leader": leader,
                "factor": factor,
                "offset": offset,
            }
        )
    return found


def tool(model: RobotModel) -> list[float]:
    """Return the tool's placement in the last joint's frame, R by rows, then t [m]."""
    return _numbers(model.pin_model.frames[model.tool_id].placement)


def solids(model: RobotModel) -> list[dict[str, Any]]:
    """Return the boxes, cylinders and spheres that the URDF shows, each in its joint's frame (0: the base); meshes are
    left out.
    """
    root = ElementTree.fromstring(model.urdf_text)
    colors = {element.get("name"): _color(element) for element in root.findall("material")}
    found: list[dict[str, Any]] = []
    for link in root.findall("link"):
        name = link.get("name", "")
        if not model.pin_model.existFrame(name, pin.FrameType.BODY):
            continue
        frame = model.pin_model.frames[model.pin_model.getFrameId(name, pin.FrameType.BODY)]
        for visual in link.findall("visual"):
            shape = next(iter(visual.find("geometry") or ()), None)
            size = None if shape is None else _size(shape)
            if shape is None or size is None or len(found) >= _MOST_SOLIDS:
                continue
            material = visual.find("material")
            own = None if material is None else _color(material) or colors.get(material.get("name"))
            placement = frame.placement * _origin(visual.find("origin"))
            found.append(
                {
                    "joint": int(frame.parentJoint),
                    "placement": _numbers(placement),
                    "shape": shape.tag,
                    "size": size,
                    "color": own or _GREY,
                }
            )
    return found


def _size(shape: ElementTree.Element) -> list[float] | None:
    """Return box: three edges; cylinder: radius, length; sphere: radius [m]; None for what is none of these."""
    names = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}.get(shape.tag)
    try:
        return None if names is None else [float(part) for name in names for part in shape.get(name, "").split()]
    except ValueError:
        return None


def _origin(element: ElementTree.Element | None) -> Any:
    if element is None:
        return pin.SE3.Identity()
    xyz, rpy = (np.array([float(part) for part in element.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)


def _color(material: ElementTree.Element) -> str | None:
    color = material.find("color")
    if color is None:
        return None
    try:
        parts = [round(255 * min(max(float(part), 0.0), 1.0)) for part in color.get("rgba", "").split()[:3]]
    except ValueError:
        return None
    return "#" + "".join(f"{part:02x}" for part in parts) if len(parts) == 3 else None


def _numbers(placement: Any) -> list[float]:
    return [*placement.rotation.ravel().tolist(), *placement.translation.tolist()]
