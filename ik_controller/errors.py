"""The one exception base class: a mistake in configuration or input, told in one clear line."""

from __future__ import annotations

from collections.abc import Iterable


class IkControllerError(Exception):
    """A mistake in configuration or input. Its text is one line that names the thing and the legal choices."""


class ModelError(IkControllerError):
    """The robot model cannot be built: URDF, frame, joint or robot name."""


class ParameterError(IkControllerError):
    """A parameter is unknown, of the wrong type or out of bounds."""


class ArgumentError(IkControllerError):
    """An argument of a library function has the wrong shape, value or name."""


class MessageError(IkControllerError):
    """A message is not usable: not finite, wrong names, wrong lengths, unknown frame."""


class BagError(IkControllerError):
    """A bag is missing, cut off, not MCAP, or lacks what is asked of it."""


def choices(names: Iterable[str]) -> str:
    """Return the legal names as text for an error line: "a, b, c"."""
    return ", ".join(names) or "(none)"
