"""Transport: Fast DDS without its shared memory, which holds up who publishes.

Where a process opens another one's shared-memory port and finds it busy, Fast DDS 2.14 sleeps for a third of a second
in whoever publishes (`Port::healthy_check`), and longer where its owner was killed. For a 1 kHz loop that is a stop:
one `ros2 topic echo` or `ros2 param get` in three or so beside it was enough. Over UDP on the same host, with the same
nodes, nothing is held up. Who chooses a transport keeps it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

_PROFILE = Path(__file__).with_name("udp_on_this_host.xml")
# Each of these says which transports there are to be.
_CHOICES = ("FASTDDS_BUILTIN_TRANSPORTS", "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
_PROFILE_HERE = "DEFAULT_FASTRTPS_PROFILES.xml"  # Fast DDS reads it from the working folder


def leave_shared_memory() -> None:
    """Set this process's environment, before rclpy's `init`, so that it takes part in the graph over UDP."""
    os.environ.update(over_udp(os.environ, Path()))


def over_udp(environment: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Return what to set in an environment for that, for a process that works in `folder`: nothing where somebody has
    chosen, or where it is another middleware.
    """
    if "fastrtps" not in environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"):
        return {}
    if any(environment.get(name) for name in _CHOICES) or (folder / _PROFILE_HERE).exists():
        return {}
    near = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
    if not near and environment.get("ROS_LOCALHOST_ONLY", "0") != "1":
        return {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    if environment.get("ROS_STATIC_PEERS"):
        return {}
    # In this range rmw_fastrtps adds shared memory whatever is set; so the profile keeps to this host instead.
    changes = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT", "FASTRTPS_DEFAULT_PROFILES_FILE": str(_PROFILE)}
    return {**changes, "ROS_LOCALHOST_ONLY": "0"} if environment.get("ROS_LOCALHOST_ONLY") == "1" else changes
