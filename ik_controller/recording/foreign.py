"""Bags that are not MCAP, read through `rosbags`: rosbag2's sqlite3 and ROS 1."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.serde import SerdeError

from ik_controller.errors import BagError
from ik_controller.recording.reader import BagReader, Message, Topic
from ik_controller.recording.schema import typestore


class ForeignBag(BagReader):
    """A sqlite3 or ROS 1 bag with the interface of `BagReader`: messages by log time, data always as ROS 2's CDR.

    ROS 1 messages of types that ROS 2 Jazzy's common packages do not have are left out. Raises BagError if rosbags
    cannot read the bag.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, [])
        with self._opened() as reader:
            self.topics = [
                Topic(
                    name=connection.topic,
                    type_name=connection.msgtype,
                    count=connection.msgcount,
                    qos="",
                    type_hash=connection.digest if reader.is2 else "",
                    schema=connection.msgdef.data,
                    encoding="cdr",
                )
                for connection in reader.connections
                if _usable(connection)
            ]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Yield the messages (of these topics, or all) in order of log time."""
        ours = typestore()
        sequences: dict[str, int] = {}
        with self._opened() as reader:
            wanted = [c for c in reader.connections if _usable(c) and (topics is None or c.topic in topics)]
            try:
                for connection, log_time, data in reader.messages(wanted) if wanted else ():
                    topic, kind = connection.topic, connection.msgtype
                    number = sequences[topic] = sequences.get(topic, 0) + 1
                    if not reader.is2:  # field by field, because ROS 1's Header has one field more
                        data = bytes(ours.serialize_cdr(reader.deserialize(data, kind), kind))
                    yield Message(topic, log_time, bytes(data), number)
            except (AnyReaderError, SerdeError) as error:
                raise BagError(f"bag '{self.path}' is damaged: {error}") from None

    def _opened(self) -> closing[AnyReader]:
        try:
            reader = AnyReader([self.path], default_typestore=typestore())
            reader.open()
        except Exception as error:  # rosbags, sqlite3 and the decompressors raise what they like
            raise BagError(f"cannot read bag '{self.path}': {error}") from None
        return closing(reader)


def _usable(connection: Connection) -> bool:
    return isinstance(connection.ext, ConnectionExtRosbag2) or connection.msgtype in typestore().fielddefs
