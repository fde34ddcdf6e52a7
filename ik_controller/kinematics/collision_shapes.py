"""Collision shapes of an arm: every <collision> of its URDF becomes capsules that enclose it, once, at configuration.

A capsule is a segment with a radius: the distance of two is a formula, round all over, and costs a hundredth of a
mesh's. Spheres, and cylinders with balls at their ends, stay exactly what they are; boxes, bare cylinders and meshes
get the enclosing capsule of least volume, a mesh up to four of them.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.errors import ModelError, choices
from ik_controller.kinematics.urdf import Urdf

Array = NDArray[np.float64]

SHAPES = ("box", "cylinder", "sphere", "capsule", "mesh")
_RADII = 40  # tried for the capsule of least volume
_CIRCLE_STEPS = 60  # of the search for the narrowest cylinder about an axis
_WORTH_SPLITTING = 0.75  # two capsules in place of one must save a quarter of its volume
_SPLITS = 2  # a mesh becomes at most 2² capsules
_EDGE, _MANY = 0.03, 20_000  # a mesh's triangles are cut to edges [m] of this length, or to so many
_INSIDE = 1e-6  # [m] a capsule that sticks out of another by no more is left out


class Capsule(NamedTuple):
    """All points within `radius` [m] of the segment between `start` and `end` (3,) [m], in the frame of `link`."""

    link: str
    start: Array
    end: Array
    radius: float


def link_capsules(urdf: Urdf, folder: Path | None = None) -> list[Capsule]:
    """Return capsules that enclose the collision shapes of all links; `folder`: where the URDF lies, to find meshes.

    Raises ModelError: an unknown or malformed geometry, a mesh that cannot be found or read.
    """
    found: list[Capsule] = []
    elements = urdf.collision_elements()
    for link in urdf.links:
        own = [element for name, element in elements if name == link]
        balls = [c for e in own if e.find("geometry/sphere") is not None for c in _of(link, e, folder, [])]
        mine = [c for element in own for c in _of(link, element, folder, balls)]
        # A ball at the end of a cylinder, and whatever else lies inside another.
        mine.sort(key=_volume, reverse=True)
        kept: list[Capsule] = []
        for capsule in mine:
            if not any(_inside(capsule, other) for other in kept):
                kept.append(capsule)
        found += kept
    return found


def _of(link: str, element: Element, folder: Path | None, balls: list[Capsule]) -> Iterator[Capsule]:
    origin = element.find("origin")
    place = pin.SE3.Identity()
    if origin is not None:
        place.translation = np.array(_numbers(link, origin, "xyz", 3, "0 0 0"))
        place.rotation = pin.rpy.rpyToMatrix(np.array(_numbers(link, origin, "rpy", 3, "0 0 0")))
    geometry = element.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None or shape.tag not in SHAPES:
        given = "none" if shape is None else f"<{shape.tag}>"
        raise ModelError(f"link '{link}': its <collision> has {given} as geometry; legal: {choices(SHAPES)}")
    if shape.tag in ("sphere", "capsule", "cylinder"):
        (radius,) = _numbers(link, shape, "radius", 1)
        (length,) = (0.0,) if shape.tag == "sphere" else _numbers(link, shape, "length", 1)
        half = np.array([0.0, 0.0, 0.5 * length])
        ends = (place.act(-half), place.act(half))
        if shape.tag == "cylinder" and not all(_has_ball(balls, end, radius) for end in ends):
            corners = np.array([(x, y, z) for z in (-half[2], half[2]) for x, y in _square(radius)])
            fitted = [enclosing(corners, np.eye(3)[2:])]
        else:
            fitted = [(-half, half, radius)]
    elif shape.tag == "box":
        x, y, z = 0.5 * np.array(_numbers(link, shape, "size", 3))
        corners = np.array([(i * x, j * y, k * z) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
        fitted = [enclosing(corners, np.eye(3))]
    else:
        scale = np.array(_numbers(link, shape, "scale", 3, "1 1 1"))
        fitted = _split(_finer(_triangles(link, shape.get("filename", ""), folder) * scale), _SPLITS)
    for start, end, radius in fitted:
        yield Capsule(link, place.act(start), place.act(end), float(radius))


def _square(radius: float) -> tuple[tuple[float, float], ...]:
    return (radius, 0.0), (0.0, radius), (-radius, 0.0), (0.0, -radius)


def _numbers(link: str, element: Element, attribute: str, count: int, default: str = "") -> list[float]:
    text = element.get(attribute, default)
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ModelError(f"link '{link}': <{element.tag} {attribute}='{text}'> is not {count} finite numbers")
    return values


def _has_ball(balls: list[Capsule], point: Array, radius: float) -> bool:
    """Tell whether one of the link's spheres rounds a cylinder's end off at `point` (3,)."""
    return any(float(np.linalg.norm(b.start - point)) + radius <= b.radius + _INSIDE for b in balls)


# -- fitting


def enclosing(points: Array, axes: Array) -> tuple[Array, Array, float]:
    """Return (start (3,), end (3,), radius) of the capsule of least volume about points (k, 3), along one of `axes`
    (j, 3).
    """
    best: tuple[float, tuple[Array, Array, float]] | None = None
    for axis in axes:
        across = np.linalg.svd(axis.reshape(1, 3))[2][1:]
        flat, height = points @ across.T, points @ axis
        middle = _circle(flat)
        wide = np.linalg.norm(flat - middle, axis=1)
        narrowest = float(wide.max())
        ball = math.hypot(narrowest, 0.5 * float(np.ptp(height)))
        for radius in np.linspace(narrowest, ball, _RADII):
            rise = np.sqrt(np.maximum(radius**2 - wide**2, 0.0))
            low, high = float((height + rise).min()), float((height - rise).max())
            if high < low:
                low = high = 0.5 * (low + high)
            start, end = middle @ across + low * axis, middle @ across + high * axis
            volume = math.pi * radius**2 * (high - low + 4.0 / 3.0 * radius)
            if best is None or volume < best[0]:
                best = volume, (start, end, float(radius))
    assert best is not None
    return best[1]


def _circle(points: Array) -> Array:
    """Return the centre (2,) of the smallest circle about points (k, 2): towards the farthest in ever shorter steps."""
    center: Array = 0.5 * (points.min(axis=0) + points.max(axis=0))
    best, least = center, math.inf
    for step in range(1, _CIRCLE_STEPS):
        away = points - center
        square = np.einsum("ij,ij->i", away, away)
        farthest = int(np.argmax(square))
        if square[farthest] < least:
            best, least = center, float(square[farthest])
        center = center + away[farthest] / (step + 1)
    return best


def _split(triangles: Array, times: int) -> list[tuple[Array, Array, float]]:
    """Return capsules about triangles (k, 3, 3): one, or those of two halves where that saves enough volume."""
    axes = _axes(triangles)
    whole = enclosing(np.unique(triangles.reshape(-1, 3), axis=0), axes)
    if times == 0:
        return [whole]
    middles = triangles.mean(axis=1)
    least, halves = _WORTH_SPLITTING * _total([whole]), (triangles, triangles)
    for axis in axes:
        along = middles @ axis
        upper = along > 0.5 * (along.min() + along.max())
        if upper.any() and not upper.all():
            both = triangles[upper], triangles[~upper]
            volume = _total([enclosing(np.unique(h.reshape(-1, 3), axis=0), _axes(h)) for h in both])
            if volume < least:
                least, halves = volume, both
    if halves[0] is triangles:
        return [whole]
    return [capsule for half in halves for capsule in _split(half, times - 1)]


def _axes(triangles: Array) -> Array:
    """Return the principal directions (3, 3), in rows, of what triangles (k, 3, 3) cover."""
    directions: Array = np.linalg.eigh(np.cov(triangles.reshape(-1, 3).T))[1].T
    return directions


def _finer(triangles: Array) -> Array:
    """Return triangles (k, 3, 3) cut in four until their edges are short, so that halves overlap little."""
    while True:
        edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
        long = edges > _EDGE
        if not long.any() or len(triangles) > _MANY:
            return triangles
        a, b, c = np.moveaxis(triangles[long], 1, 0)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        parts = [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        triangles = np.concatenate((triangles[~long], *parts))


def _total(fitted: Sequence[tuple[Array, Array, float]]) -> float:
    return sum(_volume(Capsule("", *one)) for one in fitted)


def _volume(capsule: Capsule) -> float:
    length = float(np.linalg.norm(capsule.end - capsule.start))
    return math.pi * capsule.radius**2 * (length + 4.0 / 3.0 * capsule.radius)


def _inside(capsule: Capsule, other: Capsule) -> bool:
    """Tell whether a capsule lies inside another: both its end balls do."""
    along = other.end - other.start
    square = float(along @ along)
    for point in (capsule.start, capsule.end):
        share = 0.0 if square == 0.0 else min(max(float((point - other.start) @ along) / square, 0.0), 1.0)
        away = float(np.linalg.norm(point - other.start - share * along))
        if away + capsule.radius > other.radius + _INSIDE:
            return False
    return True


# -- meshes


def _triangles(link: str, filename: str, folder: Path | None) -> Array:
    """Return a mesh's triangles (k, 3, 3) [m]. Raises ModelError where it cannot be found or read."""
    path = _mesh_path(link, filename, folder)
    import coal

    try:
        mesh = coal.MeshLoader().load(str(path), np.ones(3))
        points = np.array(mesh.vertices())
        corners = [[mesh.tri_indices(i)[j] for j in range(3)] for i in range(mesh.num_tris)]
    except (RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ModelError(f"link '{link}': collision mesh '{path}' cannot be read: {reason:.80}") from None
    if not corners or not np.isfinite(points).all():
        raise ModelError(f"link '{link}': collision mesh '{path}' holds no triangles")
    return points[np.array(corners)]


def _mesh_path(link: str, filename: str, folder: Path | None) -> Path:
    kind, _, rest = filename.rpartition("://")
    tried: list[Path] = []
    if kind == "file" or not kind:
        tried = [Path(rest) if rest.startswith("/") or folder is None else folder / rest]
    elif kind in ("package", "model"):
        above = [] if folder is None else [folder, *folder.resolve().parents]
        prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        packages = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
        roots = [*above, *(Path(p) / "share" for p in prefixes if p), *(Path(p) for p in packages if p)]
        tried = [root / rest for root in roots]
    for path in tried:
        if path.is_file():
            return path
    raise ModelError(
        f"link '{link}': collision mesh '{filename}' is not found: meshes are looked for beside the URDF and in "
        "AMENT_PREFIX_PATH and ROS_PACKAGE_PATH; or switch self_collision and obstacles off"
    )
