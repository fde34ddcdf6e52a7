"""The one exception base class: a mistake in configuration or input, told in one clear line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


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


def short_names(names: Sequence[str]) -> list[str]:
    """Return names without what all of them begin with, up to a `_`: panda_joint1, panda_joint2 → joint1, joint2."""
    cut = 0
    for index, letters in enumerate(zip(*names, strict=False)):
        if len(set(letters)) > 1:
            break
        if letters[0] == "_":
            cut = index + 1
    return [name[cut:] for name in names] if len(names) > 1 else list(names)
