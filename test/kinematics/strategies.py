"""hypothesis strategies for rotations, with samples at and near the angles 0 and π."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from hypothesis import strategies as st


@st.composite
def unit_vectors(draw: st.DrawFn) -> np.ndarray:
    """Any direction (3,), and the axes themselves."""
    if draw(st.booleans()):
        axis = np.zeros(3)
        axis[draw(st.integers(0, 2))] = draw(st.sampled_from((1.0, -1.0)))
        return axis
    z, longitude = draw(st.floats(-1.0, 1.0)), draw(st.floats(-math.pi, math.pi))
    level = math.sqrt(1.0 - z * z)
    return np.array([level * math.cos(longitude), level * math.sin(longitude), z])


def angles(largest: float = math.pi) -> st.SearchStrategy[float]:
    """Angles in [0, largest], often close to 0, π/2 or π."""
    tiny = st.floats(-12.0, -1.0).map(lambda exponent: 10.0**exponent)
    near = [tiny, *(tiny.map(lambda d, a=a: a - d) for a in (math.pi / 2, math.pi) if a <= largest + 1e-12)]
    exact = st.sampled_from([a for a in (0.0, math.pi / 2, math.pi) if a <= largest])
    return st.one_of(st.floats(0.0, largest), exact, *near).filter(lambda a: a <= largest)


@st.composite
def rotation_vectors(draw: st.DrawFn, largest: float = math.pi) -> np.ndarray:
    """Exponential coordinates (3,), angle up to `largest`."""
    return draw(unit_vectors()) * draw(angles(largest))


def rotations() -> st.SearchStrategy[np.ndarray]:
    """Rotation matrices (3, 3)."""
    return rotation_vectors().map(pin.exp3)


def finite_vectors(size: int, bound: float = 3.0) -> st.SearchStrategy[np.ndarray]:
    """Vectors (size,) with entries up to `bound`."""
    return st.lists(st.floats(-bound, bound), min_size=size, max_size=size).map(np.array)
