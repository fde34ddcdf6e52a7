"""Spec: what is known of one parameter besides its name; from it come checks, bounds in words and the table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ik_controller.errors import ParameterError, choices

_AT_START = ("robot", "arms", "autostart")  # the other read-only ones can be changed before the node is configured


@dataclass(frozen=True)
class Spec:
    """What is known of one parameter besides its name; `kind` is its Python type as text; `read_only` while the node is
    configured.
    """

    name: str
    kind: str
    default: Any
    section: str
    description: str
    unit: str
    low: float | None
    high: float | None
    legal: tuple[str, ...]
    lengths: tuple[int, ...]
    read_only: bool

    @property
    def at_start(self) -> bool:
        """Whether it can only be given when the node's process starts."""
        return self.name in _AT_START

    @property
    def bounds(self) -> str:
        """The legal values as text, for error lines and the table."""
        if self.legal:
            return choices(self.legal)
        low = "" if self.low is None else f"≥ {self.low:g}"
        high = "" if self.high is None else f"≤ {self.high:g}"
        return ", ".join(part for part in (low, high) if part)


def parameter(
    default: Any,
    section: str,
    description: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    legal: tuple[str, ...] = (),
    lengths: tuple[int, ...] = (),
    read_only: bool = False,
) -> Any:
    """Return a dataclass field with what its Spec says besides name, type and default."""
    metadata = {
        "section": section,
        "description": description,
        "unit": unit,
        "low": low,
        "high": high,
        "legal": legal,
        "lengths": lengths,
        "read_only": read_only,
    }
    return field(default=default, metadata=metadata)


def checked(spec: Spec, value: Any) -> Any:
    """Return the value as its own type, or raise ParameterError in one line."""

    def fail(need: str) -> ParameterError:
        return ParameterError(f"{spec.name} = {value!r}: need {need}")

    if spec.kind == "bool":
        if not isinstance(value, bool):
            raise fail("true or false")
        return value
    if spec.kind == "str":
        if not isinstance(value, str):
            raise fail("text")
        if spec.legal and value not in spec.legal:
            raise fail(f"one of {spec.bounds}")
        return value
    if spec.kind == "float":
        return _number(spec, value, fail)
    if isinstance(value, (str, bytes, Mapping)) or not hasattr(value, "__iter__"):
        if spec.kind != "tuple[float, ...]" or isinstance(value, (str, bytes, Mapping)):
            raise fail("a list")
        value = [value]  # one number for a list of one
    items = list(value)
    if spec.kind == "tuple[str, ...]":
        if not all(isinstance(item, str) for item in items):
            raise fail("a list of names")
        return tuple(items)
    if spec.lengths and len(items) not in spec.lengths:
        raise fail(f"{' or '.join(str(length) for length in spec.lengths)} values, got {len(items)}")
    return tuple(_number(spec, item, fail) for item in items)


def _number(spec: Spec, value: Any, fail: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise fail("a number" if spec.kind == "float" else "a list of numbers")
    try:
        number = float(value)
    except OverflowError:
        number = math.nan
    if math.isnan(number) or (math.isinf(number) and spec.section != "limits"):
        raise fail("a finite number")
    if (spec.low is not None and number < spec.low) or (spec.high is not None and number > spec.high):
        raise fail(f"{spec.bounds} {spec.unit}".strip())
    return number


def table(specs: Iterable[Spec], sections: Iterable[str]) -> str:
    """Return the Markdown table of parameters, section by section, for the documentation."""
    lines: list[str] = []
    parameters = list(specs)
    for section in sections:
        lines += [f"### {section.capitalize()}", "", "| name | type | default | unit | legal | description |"]
        lines.append("|---|---|---|---|---|---|")
        for spec in parameters:
            if spec.section == section:
                kind = {"tuple[float, ...]": "list of float", "tuple[str, ...]": "list of str"}.get(
                    spec.kind, spec.kind
                )
                default = ", ".join(f"{v:g}" for v in spec.default) if isinstance(spec.default, tuple) else spec.default
                shown = f"`{str(default).lower() if spec.kind == 'bool' else default}`" if default != "" else ""
                fixed = "Fixed at start." if spec.at_start else "Fixed while configured."
                fixed = f" {fixed}" if spec.read_only else ""
                lines.append(
                    f"| `{spec.name}` | {kind} | {shown} | {spec.unit} | {spec.bounds} | {spec.description}{fixed} |"
                )
        lines.append("")
    return "\n".join(lines)
