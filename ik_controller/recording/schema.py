"""Schema text and type hash of ROS message types, as rosbag2 stores them, without ROS installed.

The definitions come from `rosbags` (its Jazzy type store). They equal the `.msg` files of the ROS packages but for
comments and blank lines; the hashes (RIHS01, REP 2016) equal those in the packages' `.json` files. Both are tested.
"""

from __future__ import annotations

import difflib
import re
from functools import cache, lru_cache
from typing import NamedTuple

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ik_controller.errors import BagError, choices
from ik_controller.messages.cdr import EXTRA_TYPES

ENCODING = "ros2msg"
"""Schema encoding of MCAP for the text made here: root definition, then each dependency under a line of 80 `=`."""

# Default values of fields do not survive rosbags' parser. These are all there are in the common packages.
_DEFAULTS = {
    "geometry_msgs/Quaternion": {"float64 x": "0", "float64 y": "0", "float64 z": "0", "float64 w": "1"},
    "rcl_interfaces/ParameterDescriptor": {"bool read_only": "false", "bool dynamic_typing": "false"},
    "sensor_msgs/NavSatStatus": {"int8 status": "-2"},
    "type_description_interfaces/FieldType": {"uint8 type_id": "0"},
}

_SEPARATOR = "=" * 80 + "\nMSG: "


class MessageSchema(NamedTuple):
    """What a bag says about a message type: full name ("pkg/msg/Type"), definition text, type hash ("RIHS01_…")."""

    name: str
    text: str
    type_hash: str


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """Return the message types of ROS 2 Jazzy; also encodes and decodes their messages (CDR)."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in EXTRA_TYPES.items():
        store.register(get_types_from_msg(text, name))
    return store


@cache
def message_schema(type_name: str) -> MessageSchema:
    """Return definition text and type hash of a ROS message type ("pkg/msg/Type" or "pkg/Type").

    Raises BagError if ROS 2 Jazzy's common packages have no such type.
    """
    parts = type_name.split("/")
    full = "/".join([parts[0], "msg", parts[1]]) if len(parts) == 2 else type_name
    known = typestore().fielddefs
    if full not in known:
        close = difflib.get_close_matches(full, known, n=3, cutoff=0.5)
        raise BagError(f"unknown message type '{type_name}'; did you mean: {choices(close)}?")
    generated, _ = typestore().generate_msgdef(full, ros_version=2)
    root, *dependencies = generated.split(_SEPARATOR)
    text = _section(full.replace("/msg/", "/"), root)
    for dependency in dependencies:
        name, _, body = dependency.partition("\n")
        text += f"{_SEPARATOR}{name}\n{_section(name, body)}"
    return MessageSchema(full, text, typestore().hash_rihs01(full))


def _section(name: str, body: str) -> str:
    """Return one definition as its package wrote it: types of the own package by short name, default values."""
    body = re.sub(rf"^{re.escape(name.split('/')[0])}/", "", body, flags=re.MULTILINE)
    for field, value in _DEFAULTS.get(name, {}).items():
        body = re.sub(rf"^{field}$", f"{field} {value}", body, flags=re.MULTILINE)
    return body
