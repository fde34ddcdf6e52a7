"""Every python block of README.md and docs/*.md runs as it stands; every picture and page named there exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
ROOT = DOCS.parent
PAGES = [ROOT / "README.md", ROOT / "bags" / "README.md", *sorted(DOCS.glob("*.md"))]


def blocks():
    """Yield every python block with its page and line."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for match in re.finditer(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
            line = text.count("\n", 0, match.start()) + 1
            yield pytest.param(page, line, match[1], id=f"{page.name}:{line}")


@pytest.mark.parametrize(("page", "line", "code"), list(blocks()))
def test_example_runs(page, line, code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # Blank lines before the code make a traceback point into the page.
    exec(compile("\n" * line + code, str(page), "exec"), {"__name__": "__main__"})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text):
        assert (page.parent / target).exists(), target


def test_every_picture_is_made_by_a_script_and_shown_on_a_page():
    script = "".join(path.read_text(encoding="utf-8") for path in DOCS.glob("pictures*.py"))
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    pictures = sorted(path.stem for path in (DOCS / "images").glob("*.png"))
    assert pictures
    for name in pictures:
        assert f"def {name}(" in script, name
        assert f"images/{name}.png" in pages, name
