"""A headless Chromium for tests of pages: what it prints to the console and every request it makes are kept.

Debian's `chromium`, driven by playwright; tests that need it are skipped where either is missing.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Iterator
from typing import Any

import pytest

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    "--no-sandbox",  # root has none
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
]
PATIENCE = 60_000.0  # [ms] before anything that should happen is taken for not happening


@contextlib.contextmanager
def browser() -> Iterator[Any]:
    """Yield a playwright Browser with an empty profile; skip the test where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("chromium is not installed")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        try:
            yield opened
        finally:
            opened.close()


class Watched:
    """A page whose `errors` (console errors and warnings, exceptions) and `requests` (URLs) are kept."""

    def __init__(self, opened: Any, **options: Any) -> None:
        """`options`: of playwright's Browser.new_page, such as viewport and color_scheme."""
        self.page = opened.new_page(**options)
        self.page.set_default_timeout(PATIENCE)
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", self._on_console)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))

    def _on_console(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.errors.append(f"{message.type}: {message.text}")

    def until(self, expression: str, argument: Any = None) -> Any:
        """Wait until a JavaScript expression is true, and return it; also on pages whose own policy forbids eval."""
        deadline = time.monotonic() + 1e-3 * PATIENCE
        while not (found := self.page.evaluate(expression, argument)):
            assert time.monotonic() < deadline, f"waited in vain for {expression}"
            time.sleep(0.02)
        return found

    def foreign_requests(self, *own: str) -> list[str]:
        """Return the requested addresses that do not begin with one of `own`; data and blob addresses go nowhere."""
        return [url for url in self.requests if not url.startswith((*own, "data:", "blob:"))]
