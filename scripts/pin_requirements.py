"""Write requirements*.txt: every package pinned for every Python.

    python scripts/pin_requirements.py python3.10 python3.11 python3.12 python3.13

Asks pip of each interpreter for the newest set that fits together (nothing is installed) and merges the answers;
where versions differ between Pythons a line carries an environment marker. Takes some minutes.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VERSIONS = ("3.10", "3.11", "3.12", "3.13")

# Each file adds to those before it.
FILES = {
    "requirements.txt": (
        "What the package needs to run and to be installed, ROS apart; numba is optional and speeds up offline work.",
        ["numpy", "pin", "mcap", "rosbags", "PyYAML", "zstandard", "lz4", "matplotlib", "daqp",
         "numba", "setuptools"],
    ),
    "requirements-view.txt": ("What the live page (ik_controller view) needs besides.", ["viser"]),
    "requirements-dev.txt": (
        "What tests and lint need besides.",
        ["pytest", "pytest-xdist", "hypothesis", "ruff", "mypy", "mcap-ros2-support", "example-robot-data",
         "catkin_pkg", "playwright", "pyarrow"],
    ),
    "requirements-ros.txt": (
        "ROS 2 Jazzy as wheels; left out where a ROS installation is sourced, whose rclpy is used instead.",
        ["ros-jazzy-rclpy", "ros-jazzy-common-interfaces", "ros-jazzy-rmw-fastrtps-cpp"],
    ),
}  # fmt: skip


def resolve(python: Path, wanted: list[str], constraints: dict[str, str]) -> dict[str, str]:
    """Return name → version of all that pip would install for `wanted`."""
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
        file.writelines(f"{name}=={version}\n" for name, version in constraints.items())
        file.flush()
        command = [str(python), "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed",
                   "--constraint", file.name, "--report", "-", *wanted]  # fmt: skip
        report = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
    return {
        item["metadata"]["name"].lower().replace("_", "-"): item["metadata"]["version"] for item in report["install"]
    }


def lines(pins: dict[str, dict[str, str]]) -> list[str]:
    """Return requirement lines for name → {Python version: package version}, markers only where needed."""
    result = []
    for name, by_python in sorted(pins.items()):
        for version in dict.fromkeys(by_python.values()):
            pythons = [python for python in VERSIONS if by_python.get(python) == version]
            if pythons == list(VERSIONS):
                marker = ""
            elif len(pythons) == 1:
                marker = f' ; python_version == "{pythons[0]}"'
            elif pythons[-1] == VERSIONS[-1]:
                marker = f' ; python_version >= "{pythons[0]}"'
            else:
                marker = f' ; python_version <= "{pythons[-1]}"'
            result.append(f"{name}=={version}{marker}")
    return result


def main(interpreters: list[str]) -> None:
    """Resolve all files together for each interpreter, then tell which file each package belongs to."""
    answers: dict[str, dict[str, dict[str, str]]] = {file: {} for file in FILES}
    for interpreter in interpreters:
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([interpreter, "-m", "venv", folder], check=True)
            python = Path(folder) / "bin" / "python"
            subprocess.run([python, "-m", "pip", "install", "--quiet", "--upgrade", "pip"], check=True)
            code = "import sys; print('%d.%d' % sys.version_info[:2])"
            tag = subprocess.run([python, "-c", code], check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
            everything = resolve(python, [name for _, names in FILES.values() for name in names], {})
            wanted: list[str] = []
            seen: set[str] = set()
            for file, (_, names) in FILES.items():
                wanted += names
                subset = everything if file == list(FILES)[-1] else resolve(python, wanted, everything)
                for name in subset.keys() - seen:
                    answers[file].setdefault(name, {})[tag] = everything[name]
                seen |= subset.keys()
        print(f"Python {tag}: {len(everything)} packages")
    for file, (purpose, names) in FILES.items():
        head = [f"# {purpose}", f"# Made by scripts/pin_requirements.py for: {', '.join(names)}"]
        (ROOT / file).write_text("\n".join(head + lines(answers[file])) + "\n")


if __name__ == "__main__":
    if len(sys.argv) != len(VERSIONS) + 1:
        sys.exit(f"give an interpreter for each of Python {', '.join(VERSIONS)}")
    main(sys.argv[1:])
