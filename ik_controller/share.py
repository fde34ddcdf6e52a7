"""Where the package's own files are: config/ and bags/ in a checkout, or share/ik_controller of an installation."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from ik_controller.errors import BagError, ModelError, choices

NAME = "ik_controller"


def share_folder() -> Path:
    """Return the folder that holds config/, bags/ and launch/.

    Found in a checkout (also an editable install or `colcon build --symlink-install`), below the prefix of a pip or
    colcon installation, or by AMENT_PREFIX_PATH. Raises ModelError where none is.
    """
    for folder in _candidates():
        if (folder / "package.xml").is_file() and (folder / "config").is_dir():
            return folder
    raise ModelError(
        f"the files of {NAME} (config, bags) are not installed; looked in: {choices(map(str, _candidates()))}"
    )


def robot_names() -> list[str]:
    """Return the names of the bundled robots, sorted."""
    return sorted(file.parent.name for file in (share_folder() / "config").glob("*/robot.urdf"))


def robot_folder(name: str) -> Path:
    """Return the folder of a bundled robot, with robot.urdf and parameters.yaml. Raises ModelError if unknown."""
    names = robot_names()
    if name not in names:
        raise ModelError(f"unknown robot '{name}'; bundled robots: {choices(names)}")
    return share_folder() / "config" / name


def _candidates() -> Iterator[Path]:
    """Yield folders to look in; those beside this very module first, so that two installations never mix."""
    module = Path(__file__).resolve()
    yield module.parents[1]  # checkout
    below = Path("share") / NAME
    for prefix in module.parents[2:]:  # PREFIX/lib/python3.x/site-packages/ik_controller/share.py
        yield prefix / below
    yield Path(sys.prefix) / below
    for entry in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        yield Path(entry) / below


def bag_folder(name: str) -> Path:
    """Return the folder of a bundled bag. Raises BagError: unknown bag."""
    folder = share_folder() / "bags"
    if not (folder / name / "metadata.yaml").is_file():
        names = sorted(path.parent.name for path in folder.glob("*/metadata.yaml"))
        raise BagError(f"unknown bag '{name}'; there are: {choices(names)}")
    return folder / name
