"""A run's bag: which topics it has, what describes the run, and the record of each cycle.

What a replay needs, in the order in which it happened: the inputs as consumed (their log time is the cycle that took
them), events (pause, parameters, the state at the start), the command, and a cycle record that closes each cycle. The
model and the parameters are in the metadata record `ik_controller.run`; the model also as topic robot_description.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ik_controller.errors import BagError
from ik_controller.messages import cdr
from ik_controller.messages.commands import OUTPUTS
from ik_controller.messages.inputs import INPUTS
from ik_controller.parameters import ControllerParameters
from ik_controller.recording.provenance import code, digest, software
from ik_controller.recording.reader import BagReader
from ik_controller.recording.rosbag2 import Qos
from ik_controller.recording.writer import BagWriter, WriterStatus
from ik_controller.session import Session

METADATA = "ik_controller.run"

# Role → message type of everything a run's bag may hold, inputs first.
ROLES = {
    **INPUTS,
    "robot_description": cdr.STRING,
    "joint_commands": cdr.JOINT_STATE,
    "command_output": "",  # the command as sent, where that is of another type: `messages.commands`
    "current_pose": cdr.POSE,
    "tracking_error": cdr.TWIST,
    "status": "diagnostic_msgs/msg/DiagnosticStatus",
    "events": cdr.STRING,
    "cycle": cdr.CYCLE,
}


def default_topics(node: str = "/ik_controller") -> dict[str, str]:
    """Return role → topic of a node without namespace and remapping."""
    public = ("joint_states", "joint_commands", "robot_description")
    return {role: f"/{role}" if role in public else f"{node}/{role}" for role in ROLES}


class RunWriter:
    """Records a session's run into a folder that must be new or empty; `write` and `cycle` never wait and never
    raise.
    """

    def __init__(self, folder: Path, session: Session, topics: dict[str, str], patient: bool = False) -> None:
        """`patient`: wait rather than lose, for runs that are not in real time. Raises BagError where the folder cannot
        be written.
        """
        parameters = session.parameters
        self.writer = BagWriter(
            folder,
            compression=parameters.record_compression,
            max_segment_bytes=round(1e6 * parameters.record_max_size) or None,
            max_segment_seconds=parameters.record_max_duration or None,
            patient=patient,
        )
        self.folder = folder
        latched = Qos(durability="transient_local", depth=1)
        kinds = {**ROLES, "command_output": OUTPUTS[session.parameters.command_output][0]}
        if session.parameters.command_output == "joint_state":
            del kinds["command_output"]
        self._channels = {
            role: self.writer.channel(topics[role], kind, latched if role == "robot_description" else None)
            for role, kind in kinds.items()
            if role in topics  # a run of an older version knows fewer
        }
        self._cycle = self._channels["cycle"]
        self.writer.metadata(
            METADATA,
            {
                "parameters": json.dumps(session.parameters.as_mapping()),
                "topics": json.dumps(topics),
                "software": json.dumps(software()),
                "cycle_fields": json.dumps(cdr.CYCLE_FIELDS),
                "urdf": session.model.urdf_text,
                "model": digest(session.model.urdf_text),
                "code": code(),
            },
        )

    def begin(self, session: Session, now: int) -> None:
        """Write what a replay starts from: the model and the session's state."""
        self.write("robot_description", now, cdr.encode(cdr.message(cdr.STRING, session.model.urdf_text)))
        self.event(now, session.state())

    def write(self, role: str, now: int, data: bytes) -> None:
        """Record one message as bytes at `now` [ns]."""
        self.writer.write(self._channels[role], now, data)

    def event(self, now: int, event: str) -> None:
        """Record an event, as given to `Session.apply`."""
        self.write("events", now, cdr.encode(cdr.message(cdr.STRING, event)))

    def cycle(self, index: int, now: int, code: int, late: int, work: int, published: int) -> None:
        """Close a cycle; see `cdr.encode_cycle`."""
        self.writer.write(self._cycle, now, cdr.encode_cycle(index, now, code, late, work, published))

    def close(self) -> WriterStatus:
        """Seal the bag."""
        return self.writer.close()


@dataclass(frozen=True)
class RunInfo:
    """What a bag says of its run: parameters, URDF text, role → topic, software versions, `code` that made it."""

    parameters: ControllerParameters
    urdf: str
    topics: dict[str, str]
    software: dict[str, str]
    code: str = ""

    @classmethod
    def of(cls, bag: BagReader) -> RunInfo | None:
        """Return what the bag holds, None for a bag that no node of ours wrote. Raises BagError if it is damaged."""
        if METADATA not in bag.metadata_names():
            return None
        record = bag.metadata(METADATA)
        try:
            values: dict[str, Any] = json.loads(record["parameters"])
            if record.get("model", digest(record["urdf"])) != digest(record["urdf"]):
                raise ValueError("the robot's model is not the one that was recorded")
            return cls(
                parameters=ControllerParameters.from_mapping(values),
                urdf=record["urdf"],
                topics=json.loads(record["topics"]),
                software=json.loads(record["software"]),
                code=record.get("code", ""),
            )
        except (KeyError, ValueError) as error:
            raise BagError(f"bag '{bag.path}': metadata '{METADATA}' is damaged: {error}") from None
