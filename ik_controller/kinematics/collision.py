"""ArmCollision: the arm as capsules on its joints, and the pairs of them that must stay apart.

Left out are pairs of one body, of neighbouring links (joined by a joint, links without shapes skipped), those that an
SRDF disables, those whose distance never changes, and those that are too near in the rest posture or nearly everywhere,
because their shapes are too wide to tell; of these there is a note.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.errors import ModelError
from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.chain import chain_of
from ik_controller.kinematics.collision_distance import segments_apart
from ik_controller.kinematics.collision_shapes import link_capsules
from ik_controller.kinematics.model import RobotModel
from ik_controller.kinematics.scratch import scratch, scratch_table
from ik_controller.kinematics.urdf import Urdf

Array = NDArray[np.float64]

_SAMPLES = 300  # configurations that pairs are tried in
_NEARLY_ALWAYS = 0.95  # share of them in which a pair that is too near is left out
_CONSTANT = 1e-3  # [m] within which a distance never changes


class ArmCollision(NamedTuple):
    """S capsules: `links` their links' names; `joint` (S,) the joint that carries each, −1 for the base; `ends`
    (S, 2, 3) [m] in that joint's frame of `chain`; `radius` (S,) [m]; `pairs` (P, 2) of them that must stay apart;
    `reach` (n,) the most [m/rad, or 1] that a capsule moves with each coordinate; `notes`: pairs left out, and why.
    """

    links: tuple[str, ...]
    joint: NDArray[np.int64]
    ends: Array
    radius: Array
    pairs: NDArray[np.int64]
    reach: Array
    notes: tuple[str, ...] = ()

    def state(self) -> dict[str, Any]:
        """Return what `restored` needs, as JSON types."""
        return {name: value.tolist() if hasattr(value, "tolist") else list(value)
                for name, value in self._asdict().items()}  # fmt: skip

    @classmethod
    def restored(cls, state: Mapping[str, Any]) -> ArmCollision:
        """Return what `state` was taken of, bit for bit."""
        return cls(
            links=tuple(state["links"]),
            joint=np.array(state["joint"], dtype=np.int64),
            ends=np.array(state["ends"], dtype=float).reshape(-1, 2, 3),
            radius=np.array(state["radius"], dtype=float),
            pairs=np.array(state["pairs"], dtype=np.int64).reshape(-1, 2),
            reach=np.array(state["reach"], dtype=float),
            notes=tuple(state["notes"]),
        )


def arm_collision(
    model: RobotModel,
    rest: Array | None = None,
    *,
    minimum: float = 0.0,
    self_collision: bool = True,
    srdf: str | Path | None = None,
    folder: Path | None = None,
) -> ArmCollision:
    """Return the model's capsules and pairs; `rest` (n,): a posture in which all is well, the middle unless given.

    `minimum` [m]: nearer than this is too near; `self_collision`: look for pairs at all; `srdf`: file with
    <disable_collisions>; `folder`: the URDF's, for meshes.
    Raises ModelError: a shape or mesh that cannot be used, no shape at all, an SRDF that cannot be read.
    """
    urdf = Urdf(model.urdf_text)
    frames = {f.name: f for f in model.pin_model.frames if f.type == pin.FrameType.BODY}
    capsules = [c for c in link_capsules(urdf, folder) if c.link in frames]
    if not capsules:
        raise ModelError(
            f"robot '{urdf.name}' has no <collision> shapes: nothing can be kept apart; add some to its URDF, "
            "or switch self_collision and obstacles off"
        )
    turned = _turned_frames(model)
    joint = np.array([frames[c.link].parentJoint - 1 for c in capsules], dtype=np.int64)
    ends = np.empty((len(capsules), 2, 3))
    for k, capsule in enumerate(capsules):
        placement = frames[capsule.link].placement
        if joint[k] >= 0:
            placement = turned[joint[k]] * placement
        ends[k] = placement.act(capsule.start), placement.act(capsule.end)
    radius = np.array([c.radius for c in capsules])
    links = tuple(c.link for c in capsules)
    reach = _reach(model, joint, ends, radius)
    no_pairs = np.zeros((0, 2), dtype=np.int64)
    arm = ArmCollision(links, joint, ends, radius, no_pairs, reach)
    if not self_collision:
        return arm
    disabled = _disabled(srdf) if srdf else frozenset()
    pairs, notes = _pairs(model, arm, _neighbours(urdf, set(links)) | disabled, rest, minimum)
    return arm._replace(pairs=pairs, notes=notes)


def _turned_frames(model: RobotModel) -> list[Any]:
    """Return for each joint its Pinocchio frame in the frame that the chain has for it."""
    data = model.pin_model.createData()
    q = np.zeros(model.n)
    pin.forwardKinematics(model.pin_model, data, model.expand(q))
    chain = chain_of(model)
    m = len(chain.leader)
    rotation, position = np.empty((m, 3, 3)), np.empty((m, 3))
    joint_frames(tuple(chain), q, rotation, position, np.empty((m, 3)))
    return [pin.SE3(rotation[k], position[k]).inverse() * data.oMi[k + 1] for k in range(m)]


def _reach(model: RobotModel, joint: NDArray[np.int64], ends: Array, radius: Array) -> Array:
    """Return how far [m/rad, 1] any capsule can be from each coordinate's axis, whatever the configuration."""
    chain = chain_of(model)
    m = len(chain.leader)
    far = np.zeros(m)  # from each joint's origin to the farthest capsule on it
    for k in range(len(joint)):
        if joint[k] >= 0:
            far[joint[k]] = max(far[joint[k]], float(np.linalg.norm(ends[k], axis=1).max() + radius[k]))
    reach, beyond = np.zeros(model.n), 0.0
    for k in range(m - 1, -1, -1):
        beyond = max(beyond, far[k])
        lead, gain = chain.leader[k], abs(chain.factor[k])
        reach[lead] += gain * (1.0 if chain.prismatic[k] else beyond)
        travel = 0.0
        if chain.prismatic[k]:
            ends_of_travel = np.array([model.lower[lead], model.upper[lead]])
            travel = float(np.abs(ends_of_travel[np.isfinite(ends_of_travel)]).max(initial=0.0)) * gain
        beyond += float(np.linalg.norm(chain.translation[k])) + travel
    return reach


def _neighbours(urdf: Urdf, with_shapes: set[str]) -> frozenset[frozenset[str]]:
    """Return pairs of links that a joint joins, links without shapes skipped."""
    above = {joint.child: joint.parent for joint in urdf.joints.values()}
    found = set()
    for link in with_shapes:
        parent = above.get(link)
        while parent is not None and parent not in with_shapes:
            parent = above.get(parent)
        if parent is not None:
            found.add(frozenset((link, parent)))
    return frozenset(found)


def _disabled(srdf: str | Path) -> frozenset[frozenset[str]]:
    """Return the pairs of links that an SRDF file disables. Raises ModelError where it cannot be read."""
    try:
        root = ElementTree.parse(srdf).getroot()
    except OSError as error:
        raise ModelError(f"SRDF '{srdf}' cannot be read: {error.strerror}") from None
    except ElementTree.ParseError as error:
        raise ModelError(f"SRDF '{srdf}' is not well-formed XML: {error}") from None
    pairs = ((e.get("link1", ""), e.get("link2", "")) for e in root.iter("disable_collisions"))
    return frozenset(frozenset(pair) for pair in pairs)


def _pairs(
    model: RobotModel, arm: ArmCollision, left_out: frozenset[frozenset[str]], rest: Array | None, minimum: float
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the pairs (P, 2) to keep apart and notes on those that are too near always or at rest."""
    count = len(arm.links)
    candidates = [
        (a, b)
        for a in range(count)
        for b in range(a + 1, count)
        if arm.joint[a] != arm.joint[b] and frozenset((arm.links[a], arm.links[b])) not in left_out
    ]
    pairs = np.array(candidates, dtype=np.int64).reshape(-1, 2)
    if not candidates:
        return pairs, ()
    low = np.where(np.isfinite(model.lower), model.lower, -math.pi)
    high = np.where(np.isfinite(model.upper), model.upper, math.pi)
    random = np.random.default_rng(0)
    resting = pair_distances(model, arm, pairs, model.middle() if rest is None else rest)
    anywhere = np.array([pair_distances(model, arm, pairs, random.uniform(low, high)) for _ in range(_SAMPLES)])
    constant = np.ptp(np.vstack((anywhere, resting)), axis=0) < _CONSTANT
    always = np.mean(anywhere < minimum, axis=0) >= _NEARLY_ALWAYS
    too_near = ((resting < minimum) | always) & ~constant
    why = {(arm.links[a], arm.links[b]): ever for (a, b), ever in zip(pairs[too_near], always[too_near], strict=True)}
    notes = tuple(
        f"'{a}' and '{b}': capsules that are within {minimum:g} m {'nearly everywhere' if ever else 'at rest'} "
        "are not kept apart"
        for (a, b), ever in why.items()
    )
    return pairs[~(constant | too_near)], notes


def pair_distances(model: RobotModel, arm: ArmCollision, pairs: NDArray[np.int64], q: Array) -> Array:
    """Return the distances (P,) [m] of pairs (P, 2) of capsules at q (n,), negative where they overlap."""
    result = np.empty(len(pairs))
    chain = tuple(chain_of(model))
    _distances(chain, arm.joint, arm.ends, arm.radius, pairs, np.asarray(q, dtype=float), result)
    return result


@compiled
def _distances(
    chain: Any,
    joint: NDArray[np.int64],
    ends: Array,
    radius: Array,
    pairs: NDArray[np.int64],
    q: Array,
    result: Array,
) -> None:
    placed, a, b = np.empty(ends.shape), np.empty(3), np.empty(3)
    m = chain[3].shape[0]
    rotation, position, axes = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    joint_frames(chain, q, rotation, position, axes)
    place_capsules(joint, ends, rotation, position, placed)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        apart = segments_apart(placed[i, 0], placed[i, 1], placed[j, 0], placed[j, 1], a, b)
        result[k] = apart - radius[i] - radius[j]


@compiled
def joint_frames(chain: Any, q: Array, rotation: Array, position: Array, axes: Array) -> None:
    """Write rotation (m, 3, 3), position (m, 3) [m] and axis (m, 3) of every joint of a `Chain`, as a tuple, at q (n,).

    The frame moves with the joint; a revolute joint's axis passes through its position.
    """
    rotations, translations, prismatic, leader, factor, offset = chain
    r, p, fixed = scratch_table(3, 3), scratch(3), scratch_table(3, 3)
    for i in range(3):
        p[i] = 0.0
        for j in range(3):
            r[i, j] = 1.0 if i == j else 0.0
    for k in range(leader.shape[0]):
        for i in range(3):
            p[i] += r[i, 0] * translations[k, 0] + r[i, 1] * translations[k, 1] + r[i, 2] * translations[k, 2]
            for j in range(3):
                fixed[i, j] = r[i, 0] * rotations[k, 0, j] + r[i, 1] * rotations[k, 1, j] + r[i, 2] * rotations[k, 2, j]
        value = factor[k] * q[leader[k]] + offset[k]
        c, s = (1.0, 0.0) if prismatic[k] else (math.cos(value), math.sin(value))
        for i in range(3):
            r[i, 0] = c * fixed[i, 0] + s * fixed[i, 1]
            r[i, 1] = c * fixed[i, 1] - s * fixed[i, 0]
            r[i, 2] = fixed[i, 2]
            if prismatic[k]:
                p[i] += value * fixed[i, 2]
            axes[k, i] = fixed[i, 2]
            position[k, i] = p[i]
            rotation[k, i, 0], rotation[k, i, 1], rotation[k, i, 2] = r[i, 0], r[i, 1], r[i, 2]


@compiled
def place_capsules(joint: NDArray[np.int64], ends: Array, rotation: Array, position: Array, placed: Array) -> None:
    """Write the capsules' ends (S, 2, 3) in the base frame, given the joints' frames."""
    for s in range(joint.shape[0]):
        k = joint[s]
        for e in range(2):
            for i in range(3):
                if k < 0:
                    placed[s, e, i] = ends[s, e, i]
                else:
                    placed[s, e, i] = (
                        position[k, i]
                        + rotation[k, i, 0] * ends[s, e, 0]
                        + rotation[k, i, 1] * ends[s, e, 1]
                        + rotation[k, i, 2] * ends[s, e, 2]
                    )
