"""Environments of the peers, kept in .venv-peers/, and arms as they can read them."""

from __future__ import annotations

import subprocess
import venv
import xml.etree.ElementTree as ElementTree
from pathlib import Path

HERE = Path(__file__).parent
ENVIRONMENTS = HERE.parents[2] / ".venv-peers"


def environment(script: str, packages: list[str]) -> Path | str:
    """Return the Python of a peer's environment, made on first use, or why there is none."""
    folder = ENVIRONMENTS / Path(script).stem
    python, ready = folder / "bin" / "python", folder / "ready"
    if ready.exists() and ready.read_text() == "\n".join(packages):
        return python
    venv.create(folder, with_pip=True, clear=True)
    # Where these have no wheel, they would be built for half an hour.
    done = subprocess.run(
        [python, "-m", "pip", "--disable-pip-version-check", "--no-input", "--quiet", "install",
         "--only-binary", "pin,placo,tsid", *packages],
        capture_output=True,
        text=True,
    )  # fmt: skip
    if done.returncode != 0:
        last = [line for line in done.stderr.splitlines() if line.strip()][-1:]
        return f"does not install: {''.join(last)[:90]}"
    ready.write_text("\n".join(packages))
    return python


def bare_urdf(path: Path, folder: Path) -> Path:
    """Return a copy without looks: some peers would load meshes from ROS packages that are not there."""
    tree = ElementTree.parse(path)
    for link in tree.getroot().findall("link"):
        for looks in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(looks)
    bare = folder / "robot.urdf"
    tree.write(bare)
    return bare
