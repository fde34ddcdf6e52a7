"""Shapes: what a URDF's links look like, as triangle meshes that move with Pinocchio's joints."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray

from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.urdf import Urdf

Array = NDArray[np.float64]

_ROUND = 20  # corners of a circle
_BONE_RADIUS = 0.02  # of the stick figure that stands in for an arm without shapes [m]


class Mesh(NamedTuple):
    """Triangles that move with a joint: `vertices` (k, 3) [m] in the joint's frame, `faces` (f, 3), `color` 0…255."""

    joint: int
    vertices: Array
    faces: NDArray[np.int64]
    color: tuple[int, int, int]


class ArmShapes:
    """The whole robot's shapes, placed for a model's joints: `meshes`; `note` says what could not be shown."""

    def __init__(self, model: RobotModel, folders: Sequence[str | Path] = ()) -> None:
        """Take the visuals of the model's URDF; `folders` are searched for the packages of its mesh files.

        Where mesh files are missing, links are drawn by their other shapes, or as sticks from joint to joint.
        """
        urdf = Urdf.load(model.urdf_text)
        self._model = model
        self._full: Any = pin.buildModelFromXML(urdf.pinocchio_text())
        self._data: Any = self._full.createData()
        self._q = pin.neutral(self._full)
        self._index = [self._full.idx_qs[self._full.getJointId(name)] for name in list(model.pin_model.names)[1:]]
        self._base = self._full.getFrameId(model.base_frame, pin.FrameType.BODY)
        self.note = ""
        self.meshes = self._visuals(urdf.text, [*map(str, folders), *_package_folders()])
        if not self.meshes:
            self.meshes = self._sticks()

    def place(self, q: Array) -> dict[int, Any]:
        """Return the placement (`pin.SE3`, base frame) of each joint that carries meshes, at q (n,)."""
        expanded = self._model.expand(np.asarray(q, dtype=float))
        for index, value in zip(self._index, expanded, strict=True):
            self._q[index] = value
        pin.forwardKinematics(self._full, self._data, self._q)
        base = pin.updateFramePlacement(self._full, self._data, self._base).inverse()
        return {mesh.joint: base * self._data.oMi[mesh.joint] for mesh in self.meshes}

    def _visuals(self, urdf: str, folders: list[str]) -> list[Mesh]:
        try:
            geometry = pin.buildGeomFromUrdfString(self._full, urdf, pin.GeometryType.VISUAL, package_dirs=folders)
        except (ValueError, RuntimeError) as error:
            self.note = f"mesh files not found, drawn without: {' '.join(str(error).split())[:120]}"
            try:
                geometry = pin.buildGeomFromUrdfString(self._full, _without_meshes(urdf), pin.GeometryType.VISUAL)
            except (ValueError, RuntimeError):
                return []
        parts: dict[tuple[int, tuple[int, int, int]], list[Any]] = {}
        for item in geometry.geometryObjects:
            mesh = _triangles(item)
            if mesh is not None:
                mesh.apply_transform(item.placement.homogeneous)
                red, green, blue = (round(255 * float(c)) for c in item.meshColor[:3])
                parts.setdefault((item.parentJoint, (red, green, blue)), []).append(mesh)
        merged = {key: trimesh.util.concatenate(meshes) for key, meshes in parts.items()}
        return [Mesh(joint, m.vertices, m.faces, color) for (joint, color), m in merged.items()]

    def _sticks(self) -> list[Mesh]:
        """Return a stick from each joint to those that hang on it."""
        meshes = []
        for joint in range(1, self._full.njoints):
            parent, end = self._full.parents[joint], self._full.jointPlacements[joint].translation
            ball = trimesh.creation.icosphere(subdivisions=2, radius=1.6 * _BONE_RADIUS)
            meshes.append(Mesh(joint, ball.vertices, ball.faces, (90, 98, 112)))
            if np.linalg.norm(end) > 1e-3:
                bone = trimesh.creation.cylinder(radius=_BONE_RADIUS, segment=(np.zeros(3), end), sections=_ROUND)
                meshes.append(Mesh(parent, bone.vertices, bone.faces, (200, 204, 210)))
        return meshes


def _triangles(item: Any) -> Any:
    """Return a geometry object as a `trimesh.Trimesh`, None for a kind that is not drawn."""
    shape = item.geometry
    if isinstance(shape, coal.Box):
        return trimesh.creation.box(extents=2.0 * shape.halfSide)
    if isinstance(shape, coal.Sphere):
        return trimesh.creation.icosphere(subdivisions=2, radius=shape.radius)
    if isinstance(shape, coal.Cylinder):
        return trimesh.creation.cylinder(radius=shape.radius, height=2.0 * shape.halfLength, sections=_ROUND)
    if isinstance(shape, coal.Capsule):
        mesh = trimesh.creation.capsule(height=2.0 * shape.halfLength, radius=shape.radius, count=(_ROUND, _ROUND))
        return mesh.apply_translation((0.0, 0.0, 0.0))
    if isinstance(shape, coal.BVHModelBase):
        corners = (shape.tri_indices(i) for i in range(shape.num_tris))
        faces = [(t[0], t[1], t[2]) for t in corners]
        return trimesh.Trimesh(vertices=np.array(shape.vertices()), faces=faces, process=False)
    return None


def _without_meshes(urdf: str) -> str:
    root = ElementTree.fromstring(urdf)
    for link in root.iter("link"):
        for visual in [v for v in link.findall("visual") if v.find("geometry/mesh") is not None]:
            link.remove(visual)
    return ElementTree.tostring(root, encoding="unicode")


def _package_folders() -> list[str]:
    """Return where ROS looks for packages: the share folders of sourced installations."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    packages = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    return [str(Path(prefix) / "share") for prefix in prefixes if prefix] + [path for path in packages if path]
