"""Keyboard: which keys are held in a terminal.

A terminal tells presses, not releases; a held key shows as a press repeated after half a second or so. So a first press
counts for a nudge of `NUDGE`, repeats go on without a gap, and silence means let go: the keyboard is its own dead man's
switch. Terminals with the kitty protocol tell releases too; there a key counts exactly as long as it is down.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import sys
import termios
import tty
from typing import Any

NUDGE = 0.12  # [s] that a single press counts
_REPEAT = 0.15  # [s] without a repeat after which a key is let go
_FIRST_REPEAT = 0.9  # [s] within which a second press is a repeat of the first
_PUSH, _POP = "\x1b[>11u", "\x1b[<u"  # kitty: event types, all keys as codes
_EVENT = re.compile(r"\x1b\[(\d+)(?::\d+)*(?:;\d*(?::(\d))?)?(?:;[\d:]*)?u")


class Held:
    """The keys that are held, from their presses; times [s] of one clock."""

    def __init__(self) -> None:
        self._until: dict[str, float] = {}  # key → when it counts as let go; inf where its release will be told
        self._seen: dict[str, float] = {}

    def press(self, key: str, now: float, *, told: bool = False) -> None:
        """Note a press or repeat; `told`: its release will be told."""
        repeated = now - self._seen.get(key, -1e9) < _FIRST_REPEAT
        self._until[key] = float("inf") if told else now + (_REPEAT if repeated else NUDGE)
        self._seen[key] = now

    def release(self, key: str) -> None:
        """Note a release."""
        self._until.pop(key, None)
        self._seen.pop(key, None)

    def keys(self, now: float) -> set[str]:
        """Return the keys held now."""
        self._until = {key: until for key, until in self._until.items() if now < until}
        return set(self._until)


def events(text: str) -> list[tuple[str, str]]:
    """Return what a terminal sent as (key, "press", "repeat", "release" or "type": a press without told release)."""
    found: list[tuple[str, str]] = []
    while text:
        match = _EVENT.match(text)
        if match:
            key = chr(int(match[1])) if int(match[1]) < 0x110000 else ""
            found.append((key, {"2": "repeat", "3": "release"}.get(match[2] or "1", "press")))
            text = text[match.end() :]
        elif text.startswith("\x1b["):  # another sequence, an arrow key say
            end = next((i for i, c in enumerate(text[2:], start=2) if "@" <= c <= "~"), len(text) - 1)
            text = text[end + 1 :]
        else:
            found.append((text[0], "type"))
            text = text[1:]
    return found


class Terminal:
    """The terminal in raw mode while it is entered; `read` returns what was typed since."""

    def __init__(self) -> None:
        self._before: list[Any] | None = None

    def __enter__(self) -> Terminal:
        self._before = termios.tcgetattr(sys.stdin)
        tty.setcbreak(sys.stdin)
        sys.stdout.write(_PUSH)
        sys.stdout.flush()
        return self

    def __exit__(self, *_: object) -> None:
        sys.stdout.write(_POP)
        sys.stdout.flush()
        if self._before is not None:
            with contextlib.suppress(termios.error):
                termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def read(self, wait: float) -> str:
        """Return what was typed, waiting up to `wait` [s] for the first of it."""
        if not select.select([sys.stdin], [], [], wait)[0]:
            return ""
        return os.read(sys.stdin.fileno(), 4096).decode("utf-8", "replace")
