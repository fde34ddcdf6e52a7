"""Write docs/parameters.md and the table of reasons in docs/node.md from their definitions. Run by `make docs`."""

from __future__ import annotations

from pathlib import Path

from ik_controller.parameters import table
from ik_controller.ros import reasons

START, END = "<!-- reasons: made by scripts/make_docs.py -->", "<!-- end -->"

HEAD = """# Parameters

Made from `ik_controller/parameters.py` by `make docs`. Set them in a parameter file (`--params-file`), on the command
line (`-p name:=value`) or at run time (`ros2 param set`); a bundled robot's own are in `config/NAME/parameters.yaml`.
Lists of joint values follow the model's joint order.

"""


def page() -> str:
    """Return the page's text."""
    return HEAD + table().rstrip() + "\n"


def node_page(text: str) -> str:
    """Return docs/node.md with its table of reasons made anew."""
    before, _, rest = text.partition(START)
    return before + START + "\n\n" + reasons.table() + "\n\n" + END + rest.partition(END)[2]


if __name__ == "__main__":
    node = Path(__file__).resolve().parent.parent / "docs" / "node.md"
    node.write_text(node_page(node.read_text(encoding="utf-8")), encoding="utf-8")
    target = Path(__file__).resolve().parent.parent / "docs" / "parameters.md"
    target.parent.mkdir(exist_ok=True)
    target.write_text(page(), encoding="utf-8")
    print(f"written: {target}")
