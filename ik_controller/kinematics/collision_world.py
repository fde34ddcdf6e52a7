"""World: the solids around the arm, by name: spheres, capsules, cylinders, boxes, half-spaces; from a YAML file or by
hand.

    obstacles:
      table: {half_space: {normal: [0, 0, 1], offset: 0.0}}
      crate: {box: {size: [0.4, 0.3, 0.2]}, position: [0.5, 0.0, 0.1], orientation: [0, 0, 0, 1]}
      post:  {cylinder: {radius: 0.05, length: 1.0}, position: [0.3, 0.4, 0.5]}
      lamp:  {capsule: {radius: 0.04, length: 0.3}, position: [0.0, 0.5, 0.9], frame: base_link}
      ball:  {sphere: {radius: 0.1}, position: [0.4, -0.3, 0.6]}
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.errors import ModelError, ParameterError, choices
from ik_controller.kinematics.collision_distance import BOX, CAPSULE, CYLINDER, HALF_SPACE
from ik_controller.kinematics.model import pose_from
from ik_controller.parameter_file import read_yaml

Array = NDArray[np.float64]

# Shape → the names and lengths of its sizes.
SHAPES = {
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "half_space": {"normal": 3, "offset": 1},
}
_KEYS = ("position", "orientation", "frame")


class Solid(NamedTuple):
    """One solid: `kind` and `size` (3,) as in `collision_distance`, its frame in the base frame, and `bound` [m], the
    radius about its centre that holds it all (inf for a half-space).
    """

    kind: int
    size: tuple[float, float, float]
    rotation: tuple[tuple[float, ...], ...]
    center: tuple[float, ...]
    bound: float

    def at(self, placement: Any) -> Solid:
        """Return the solid in the frame of a `pin.SE3` instead of the base's."""
        place = placement * pin.SE3(np.array(self.rotation), np.array(self.center))
        return self._replace(rotation=tuple(map(tuple, place.rotation.tolist())), center=tuple(place.translation))


_UPRIGHT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def sphere(radius: float) -> Solid:
    """Return a ball [m] about the origin."""
    return capsule(radius, 0.0)


def capsule(radius: float, length: float) -> Solid:
    """Return a capsule about the origin, its axis of `length` [m] along z, the balls at its ends beyond that."""
    return Solid(CAPSULE, (0.5 * length, radius, 0.0), _UPRIGHT, (0.0, 0.0, 0.0), 0.5 * length + radius)


def cylinder(radius: float, length: float) -> Solid:
    """Return a cylinder [m] about the origin, axis along z."""
    return Solid(CYLINDER, (0.5 * length, radius, 0.0), _UPRIGHT, (0.0, 0.0, 0.0), math.hypot(0.5 * length, radius))


def box(x: float, y: float, z: float) -> Solid:
    """Return a box of these edge lengths [m] about the origin."""
    half = (0.5 * x, 0.5 * y, 0.5 * z)
    return Solid(BOX, half, _UPRIGHT, (0.0, 0.0, 0.0), math.hypot(*half))


def half_space(normal: Array, offset: float) -> Solid:
    """Return all points with n·p ≤ offset [m], n the unit vector along `normal` (3,), which points out of it."""
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), n).toRotationMatrix()
    return Solid(HALF_SPACE, (0.0, 0.0, 0.0), tuple(map(tuple, turn.tolist())), tuple((offset * n).tolist()), math.inf)


class World:
    """Solids by name, in the order in which they came; `arrays` is what the compiled functions take."""

    def __init__(self) -> None:
        self._solids: dict[str, Solid] = {}
        self._arrays: tuple[Any, ...] | None = None

    def __len__(self) -> int:
        return len(self._solids)

    @property
    def names(self) -> tuple[str, ...]:
        """The names, in the order of `arrays`."""
        return tuple(self._solids)

    def put(self, name: str, solid: Solid) -> None:
        """Add a solid, or put it in the place of the one of that name."""
        self._solids[name] = solid
        self._arrays = None

    def remove(self, name: str) -> None:
        """Remove a solid; nothing happens where there is none of that name."""
        if self._solids.pop(name, None) is not None:
            self._arrays = None

    def keep(self, wanted: Callable[[str], bool]) -> None:
        """Keep the solids whose names are wanted."""
        self._solids = {name: solid for name, solid in self._solids.items() if wanted(name)}
        self._arrays = None

    def arrays(self) -> tuple[Any, ...]:
        """Return kind (W,), size (W, 3), rotation (W, 3, 3), centre (W, 3), bound (W,)."""
        if self._arrays is None:
            solids = list(self._solids.values())
            self._arrays = (
                np.array([s.kind for s in solids], dtype=np.int64),
                np.array([s.size for s in solids], dtype=float).reshape(-1, 3),
                np.array([s.rotation for s in solids], dtype=float).reshape(-1, 3, 3),
                np.array([s.center for s in solids], dtype=float).reshape(-1, 3),
                np.array([s.bound for s in solids], dtype=float),
            )
        return self._arrays

    def state(self) -> dict[str, Any]:
        """Return the solids as JSON types, for `restore`; floats come back bit for bit, infinite ones as text."""
        return {name: [*solid[:4], str(solid.bound)] for name, solid in self._solids.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take a state of `state`."""
        self._arrays = None
        self._solids = {
            name: Solid(kind, tuple(size), tuple(map(tuple, rotation)), tuple(center), float(bound))
            for name, (kind, size, rotation, center, bound) in state.items()
        }


def read_world(path: str | Path, placement: Callable[[str], Any]) -> World:
    """Return the world of a YAML file; `placement(frame)` gives a link's `pin.SE3` in the base frame.

    Raises ParameterError naming the file, the obstacle and what is legal; ModelError of `placement`.
    """
    content = read_yaml(path, "obstacle file")
    entries = content.get("obstacles") if isinstance(content, dict) else None
    if not isinstance(entries, dict):
        raise ParameterError(f"obstacle file '{path}': need a mapping 'obstacles' of names and shapes")
    world = World()
    for name, entry in entries.items():
        if "/" in str(name):  # such names are the markers'
            raise ParameterError(f"obstacle file '{path}': '{name}': a name must not have a '/'")
        try:
            world.put(str(name), _solid(entry).at(placement(str(entry.get("frame", "")))))
        except (ParameterError, ModelError) as error:
            raise ParameterError(f"obstacle file '{path}': '{name}': {error}") from None
    return world


def _solid(entry: Any) -> Solid:
    shapes = [key for key in entry if key in SHAPES] if isinstance(entry, dict) else []
    if len(shapes) != 1:
        raise ParameterError(f"need one shape of {choices(SHAPES)}")
    (shape,) = shapes
    unknown = [str(key) for key in entry if key not in (shape, *_KEYS)]
    if unknown:
        raise ParameterError(f"unknown key '{unknown[0]}'; legal: {choices((shape, *_KEYS))}")
    values = entry[shape]
    sizes = SHAPES[shape]
    if not isinstance(values, dict) or set(values) - set(sizes) or set(sizes) - set(values) - {"offset"}:
        raise ParameterError(f"{shape} needs {choices(sizes)}")
    given = {key: _vector(f"{shape} {key}", values.get(key, 0.0), count) for key, count in sizes.items()}
    if shape == "half_space":
        if not np.linalg.norm(given["normal"]) > 1e-9:
            raise ParameterError("half_space normal has no direction")
        solid = half_space(np.array(given["normal"]), given["offset"][0])
    else:
        for key, numbers in given.items():
            if min(numbers) <= 0.0:
                raise ParameterError(f"{shape} {key} = {values[key]}: need more than 0 m")
        flat = [number for numbers in given.values() for number in numbers]
        makers: dict[str, Callable[..., Solid]] = {
            "box": box,
            "sphere": sphere,
            "cylinder": cylinder,
            "capsule": capsule,
        }
        solid = makers[shape](*flat)
    place = [
        *_vector("position", entry.get("position", [0, 0, 0]), 3),
        *_vector("orientation", entry.get("orientation", [0, 0, 0, 1]), 4),
    ]
    return solid.at(pose_from(place, "orientation"))


def _vector(name: str, value: Any, count: int) -> list[float]:
    items = value if isinstance(value, list) else [value]
    numeric = all(isinstance(item, (int, float)) and not isinstance(item, bool) for item in items)
    if len(items) != count or not numeric or not all(map(math.isfinite, items)):
        raise ParameterError(f"{name} = {value!r}: need {count} finite number{'s' if count > 1 else ''}")
    return [float(item) for item in items]
