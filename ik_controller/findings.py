"""Finding: one thing that the doctor has to say."""

from __future__ import annotations

from typing import NamedTuple


class Finding(NamedTuple):
    """`level` is "error", "warning" or "ok"; `subject`: what it is about; what is wrong, and how to mend it."""

    level: str
    subject: str
    message: str
    remedy: str = ""
