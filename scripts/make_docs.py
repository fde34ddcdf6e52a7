"""Write docs/parameters.md, the table of all parameters, from their one definition. Run by `make docs`."""

from __future__ import annotations

from pathlib import Path

from ik_controller.parameters import table

HEAD = """# Parameters

Made from `ik_controller/parameters.py` by `make docs`. Set them in a parameter file (`--params-file`), on the command
line (`-p name:=value`) or at run time (`ros2 param set`); a bundled robot's own are in `config/NAME/parameters.yaml`.
Lists of joint values follow the model's joint order.

"""


def page() -> str:
    """Return the page's text."""
    return HEAD + table().rstrip() + "\n"


if __name__ == "__main__":
    target = Path(__file__).resolve().parent.parent / "docs" / "parameters.md"
    target.parent.mkdir(exist_ok=True)
    target.write_text(page(), encoding="utf-8")
    print(f"written: {target}")
