"""A stand-in for tf2_ros, which no wheel has: what we use of its interface, fed by TransformStamped on /test_tf.

Transforms hold from their stamp on; a look-up of a later time than the last stamp raises, as tf2's extrapolation does.
"""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import TransformStamped


class ExtrapolationException(Exception):
    """The time asked for is later than what is known."""


class LookupException(Exception):
    """The frame is not known."""


class Buffer:
    def __init__(self) -> None:
        self.known: dict[tuple[str, str], TransformStamped] = {}

    def lookup_transform(self, target_frame: str, source_frame: str, time: Any) -> TransformStamped:
        found = self.known.get((target_frame, source_frame))
        if found is None:
            raise LookupException(f'"{source_frame}" passed to lookupTransform argument source_frame does not exist.')
        newest = found.header.stamp.sec * 10**9 + found.header.stamp.nanosec
        if time.nanoseconds > newest:
            raise ExtrapolationException("Lookup would require extrapolation into the future.")
        return found


class TransformListener:
    def __init__(self, buffer: Buffer, node: Any) -> None:
        self._node = node
        self._buffer = buffer
        self._subscription = node.create_subscription(TransformStamped, "/test_tf", self._take, 10)

    def _take(self, message: TransformStamped) -> None:
        self._buffer.known[message.header.frame_id, message.child_frame_id] = message

    def unregister(self) -> None:
        self._node.destroy_subscription(self._subscription)


class TransformBroadcaster:
    def __init__(self, node: Any) -> None:
        self._publisher = node.create_publisher(TransformStamped, "/test_tf_sent", 10)

    def sendTransform(self, transform: TransformStamped) -> None:
        self._publisher.publish(transform)
