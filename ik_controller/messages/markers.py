"""Markers: a visualization_msgs/MarkerArray as changes to the world: what RViz shows is what the arm keeps away from.

CUBE, SPHERE and CYLINDER, by namespace and id; a sphere or cylinder whose scales differ is taken as wide as its widest.
Placed once, on arrival, in any link of the model; colour, lifetime and frame_locked have no meaning here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ik_controller.errors import MessageError, ModelError, choices
from ik_controller.kinematics.collision_world import Solid, World, box, cylinder, sphere
from ik_controller.kinematics.model import pose_from
from ik_controller.messages import cdr

_ADD, _DELETE, _DELETE_ALL = 0, 2, 3
_CUBE, _SPHERE, _CYLINDER = 1, 2, 3
MARK = "/"  # in the names of what came as a marker, and of nothing else


def take_markers(data: bytes, world: World, placement: Callable[[str], Any]) -> None:
    """Put the solids of a MarkerArray into the world; `placement(frame)` gives a frame's `pin.SE3` in the base frame.

    Raises MessageError, and changes nothing then: a marker of another type, a scale that is not positive, a bad pose or
    frame.
    """
    changes: list[tuple[str, Solid | None]] = []
    for marker in cdr.decode(cdr.MARKERS, data).markers:
        name = f"{marker.ns or 'marker'}{MARK}{marker.id}"
        if marker.action == _ADD:
            changes.append((name, _solid(name, marker, placement)))
        elif marker.action == _DELETE:
            changes.append((name, None))
        elif marker.action == _DELETE_ALL:
            changes.append(("", None))
        else:
            raise MessageError(
                f"marker '{name}' has action {marker.action}; legal: 0 (add), 2 (delete), 3 (delete all)"
            )
    for name, solid in changes:
        if not name:
            world.keep(lambda kept: MARK not in kept)
        elif solid is None:
            world.remove(name)
        else:
            world.put(name, solid)


def _solid(name: str, marker: Any, placement: Callable[[str], Any]) -> Solid:
    x, y, z = marker.scale.x, marker.scale.y, marker.scale.z
    if not (np.isfinite((x, y, z)).all() and min(x, y, z) > 0.0):
        raise MessageError(f"marker '{name}' has scale {[x, y, z]}: need more than 0 m")
    if marker.type == _CUBE:
        solid = box(x, y, z)
    elif marker.type == _SPHERE:
        solid = sphere(0.5 * max(x, y, z))
    elif marker.type == _CYLINDER:
        solid = cylinder(0.5 * max(x, y), z)
    else:
        legal = choices(("1 (cube)", "2 (sphere)", "3 (cylinder)"))
        raise MessageError(f"marker '{name}' has type {marker.type}; legal: {legal}")
    p, r = marker.pose.position, marker.pose.orientation
    try:
        pose = pose_from((p.x, p.y, p.z, r.x, r.y, r.z, r.w), f"marker '{name}'")
    except ModelError as error:
        raise MessageError(str(error)) from None
    return solid.at(placement(marker.header.frame_id) * pose)
