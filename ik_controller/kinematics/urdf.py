"""Urdf: what a URDF says of links and joints, read before Pinocchio so that a mistake gets one clear line.

Pinocchio gives a continuous joint two coordinates (cos, sin); here it becomes a revolute joint without limits, so that
q stays one number a joint.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ik_controller.errors import ModelError, choices

MOVABLE = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class Mimic:
    """q = multiplier · q_leader + offset."""

    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Joint:
    """One URDF joint: limits [rad or m], velocity limit [rad/s or m/s], 0 where the URDF states none."""

    name: str
    kind: str
    parent: str
    child: str
    lower: float
    upper: float
    velocity: float
    mimic: Mimic | None

    def resolve_mimic(self, urdf: Urdf) -> tuple[str, float, float]:
        """Return (leader, factor, offset) with chains of mimics followed to a joint that mimics none."""
        name, factor, offset = self.name, 1.0, 0.0
        seen = set()
        while (mimic := urdf.joints[name].mimic) is not None:
            if name in seen:
                raise ModelError(f"joint '{self.name}' mimics itself")
            seen.add(name)
            offset += factor * mimic.offset
            factor *= mimic.multiplier
            name = mimic.leader
        return name, factor, offset

    def mimic_value(self, urdf: Urdf, locked: Mapping[str, float]) -> float:
        """Return the value of a mimic joint whose leader is locked (0 unless given)."""
        name, factor, offset = self.resolve_mimic(urdf)
        return factor * locked.get(name, 0.0) + offset


class Urdf:
    """A parsed URDF: `text`, `name`, `root_link`, `links`, `joints` by name, `movable` joint names."""

    def __init__(self, text: str, source: str = "URDF") -> None:
        """Parse URDF text. Raises ModelError naming `source` where it is not a URDF."""
        self.text = text
        try:
            self._root = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise ModelError(f"{source}: not well-formed XML: {error}") from None
        if self._root.tag != "robot":
            raise ModelError(f"{source}: the root element is <{self._root.tag}>, need <robot>")
        if "xacro" in text and any(element.tag.startswith("{") for element in self._root.iter()):
            raise ModelError(f"{source}: this is xacro, expand it first: xacro FILE > robot.urdf")
        self.name = self._root.get("name", "")
        self.links = [link.get("name", "") for link in self._root.findall("link")]
        self.joints = {joint.name: joint for joint in map(self._joint, self._root.findall("joint"))}
        for joint in self.joints.values():
            for link in (joint.parent, joint.child):
                if link not in self.links:
                    raise ModelError(f"{source}: joint '{joint.name}' names link '{link}', which does not exist")
            if joint.mimic is not None and joint.mimic.leader not in self.joints:
                raise ModelError(f"{source}: joint '{joint.name}' mimics '{joint.mimic.leader}', which does not exist")
        self._above = {joint.child: joint for joint in self.joints.values()}
        elements = len(self._root.findall("joint"))
        for kind, names, count in (("link", self.links, len(self.links)), ("joint", list(self.joints), elements)):
            if len(set(names)) < count:
                raise ModelError(f"{source}: two {kind}s have the same name")
            if "" in names:
                raise ModelError(f"{source}: a {kind} has no name")
        for joint in self.joints.values():
            if self._above[joint.child] is not joint:
                other = self._above[joint.child].name
                raise ModelError(f"{source}: link '{joint.child}' hangs on two joints, '{joint.name}' and '{other}'")
        roots = [link for link in self.links if link not in self._above]
        if len(roots) != 1:
            raise ModelError(f"{source}: need one root link, found {len(roots)}: {choices(roots)}")
        self.root_link = roots[0]
        self._check_no_loop(source)
        self.movable = [joint.name for joint in self.joints.values() if joint.kind in MOVABLE]

    @classmethod
    def load(cls, path_or_xml: str | Path) -> Urdf:
        """Read a URDF from a file, or from text that holds a '<'. Raises ModelError where there is none."""
        if isinstance(path_or_xml, str) and "<" in path_or_xml:
            return cls(path_or_xml)
        path = Path(path_or_xml)
        try:
            return cls(path.read_text(encoding="utf-8"), str(path))
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "not text"
            raise ModelError(f"URDF '{path}' cannot be read: {reason}") from None

    def _check_no_loop(self, source: str) -> None:
        rooted = {self.root_link}
        for link in self.links:
            path: dict[str, None] = {}
            while link not in rooted:
                if link in path:
                    raise ModelError(f"{source}: the links {choices(path)} form a loop that hangs on nothing")
                path[link] = None
                link = self._above[link].parent
            rooted.update(path)

    @staticmethod
    def _joint(element: ElementTree.Element) -> Joint:
        name, kind = element.get("name", ""), element.get("type", "")

        def number(tag: str, attribute: str, default: float) -> float:
            child = element.find(tag)
            text = None if child is None else child.get(attribute)
            try:
                value = default if text is None else float(text)
            except ValueError:
                raise ModelError(f"joint '{name}': <{tag} {attribute}='{text}'> is not a number") from None
            if math.isnan(value):
                raise ModelError(f"joint '{name}': <{tag} {attribute}='{text}'> is not a number")
            return value

        def link(tag: str) -> str:
            child = element.find(tag)
            if child is None or not child.get("link"):
                raise ModelError(f"joint '{name}' has no <{tag} link=…>")
            return child.get("link", "")

        for tag, attribute in (("origin", "xyz"), ("origin", "rpy"), ("axis", "xyz")):
            child = element.find(tag)
            text = None if child is None else child.get(attribute)
            if text is not None and not _is_vector(text):
                raise ModelError(f"joint '{name}': <{tag} {attribute}='{text}'> is not 3 finite numbers")
            if tag == "axis" and kind in MOVABLE and text is not None and not any(map(float, text.split())):
                raise ModelError(f"joint '{name}': <axis xyz='{text}'> has no direction")

        lower, upper = number("limit", "lower", 0.0), number("limit", "upper", 0.0)
        if kind == "continuous":
            lower, upper = -math.inf, math.inf
        elif kind in MOVABLE and not lower < upper:
            raise ModelError(f"joint '{name}': lower limit {lower} is not below upper limit {upper}")
        mimic = None
        follower = element.find("mimic")
        if follower is not None:
            factor = number("mimic", "multiplier", 1.0)
            if factor == 0.0:
                raise ModelError(f"joint '{name}': <mimic multiplier='0'> leaves it no motion, make it a fixed joint")
            mimic = Mimic(follower.get("joint", ""), factor, number("mimic", "offset", 0.0))
        return Joint(name, kind, link("parent"), link("child"), lower, upper, number("limit", "velocity", 0.0), mimic)

    def chain(self, base: str, tip: str) -> list[Joint]:
        """Return the movable joints from link `base` to link `tip`, base first.

        Raises ModelError: unknown link, tip not below base, a joint type without one axis.
        """
        for role, link in (("base", base), ("tip", tip)):
            if link not in self.links:
                raise ModelError(
                    f"{role} frame '{link}' is not a link of '{self.name}'; there are: {choices(self.links)}"
                )
        joints: list[Joint] = []
        link = tip
        while link != base:
            joint = self._above.get(link)
            if joint is None:
                raise ModelError(f"tip frame '{tip}' does not hang below base frame '{base}'")
            if joint.kind not in (*MOVABLE, "fixed"):
                legal = choices((*MOVABLE, "fixed"))
                raise ModelError(f"joint '{joint.name}' between '{base}' and '{tip}' is {joint.kind}; legal: {legal}")
            if joint.kind != "fixed":
                joints.append(joint)
            link = joint.parent
        return joints[::-1]

    def collision_elements(self) -> list[tuple[str, ElementTree.Element]]:
        """Return (link name, <collision> element) of every collision shape, in the order of the file."""
        return [(link.get("name", ""), e) for link in self._root.findall("link") for e in link.findall("collision")]

    def pinocchio_text(self) -> str:
        """Return the URDF with continuous joints as revolute ones without limits and without mimic tags."""
        root = ElementTree.fromstring(self.text)
        for element in root.findall("joint"):
            for mimic in element.findall("mimic"):
                element.remove(mimic)
            if element.get("type") in ("continuous", "revolute", "prismatic"):
                if element.get("type") == "continuous":
                    element.set("type", "revolute")
                for limit in element.findall("limit"):
                    element.remove(limit)
                bounds = {"lower": "-1e9", "upper": "1e9", "velocity": "1e9", "effort": "1e9"}
                ElementTree.SubElement(element, "limit", bounds)
        for link in root.findall("link"):
            for kind in ("visual", "collision", "inertial"):
                for element in link.findall(kind):
                    link.remove(element)
        return ElementTree.tostring(root, encoding="unicode")


def _is_vector(text: str) -> bool:
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        return False
    return len(values) == 3 and all(map(math.isfinite, values))


def same_arm(text: str, other: str) -> bool:
    """Say whether two well-formed URDFs differ in nothing that the control depends on, such as looks or masses."""
    return _essence(ElementTree.fromstring(text)) == _essence(ElementTree.fromstring(other))


_LOOKS = ("visual", "material", "inertial", "dynamics", "transmission", "gazebo", "ros2_control")


def _essence(element: ElementTree.Element) -> tuple[object, ...]:
    attributes = {name: tuple(map(_word, value.split())) for name, value in element.attrib.items()}
    below = sorted((_essence(child) for child in element if child.tag not in _LOOKS), key=repr)
    return str(element.tag), sorted(attributes.items()), below


def _word(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word
