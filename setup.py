"""Packaging for both worlds: `colcon build` (ament_python) and `pip install`."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "ik_controller"
SHARE = Path("share") / NAME


def share_files(*folders):
    """Return (target folder, files) for each folder below those named, keeping the tree."""
    found = {}
    for folder in folders:
        for file in sorted(Path(folder).rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                found.setdefault(str(SHARE / file.parent), []).append(str(file))
    return list(found.items())


setup(
    name=NAME,
    version="0.1.0",
    description="Kinematic motion controller for ROS 2 arms, recorded to MCAP and replayed bit for bit",
    license="Apache-2.0",
    maintainer="The ik_controller maintainers",
    maintainer_email="maintainers@ik-controller.org",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "report/assets/*", "ros/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (str(SHARE), ["package.xml"]),
        *share_files("config", "bags", "launch"),
    ],
    python_requires=">=3.10,<3.14",
    # Lower bounds only; what the tests ran with is pinned in requirements.txt.
    install_requires=[
        "numpy>=1.26",
        "pin>=3.4",
        "mcap>=1.2",
        "rosbags>=0.10.7",
        "PyYAML>=6.0",
        "zstandard>=0.22",
        "lz4>=4.3",
        "matplotlib>=3.8",
        "daqp>=0.7",
    ],
    extras_require={
        "fast": ["numba>=0.60"],
        "analytic": ["eaik>=1.2"],
        "view": ["viser>=1.0"],
        "parquet": ["pyarrow>=14"],
        "ros": ["ros-jazzy-rclpy", "ros-jazzy-common-interfaces", "ros-jazzy-rmw-fastrtps-cpp"],
        "test": ["pytest", "hypothesis", "mcap-ros2-support", "example-robot-data"],
    },
    entry_points={
        "console_scripts": [
            "ik_controller = ik_controller.cli:run",
            "ik_controller_node = ik_controller.ros.__main__:run",
        ],
    },
    zip_safe=False,
)
