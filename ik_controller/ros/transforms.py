"""Transforms: targets in frames that only TF knows, by tf2 where it is installed.

A message in such a frame waits until TF has the transform at its stamp, and those after it on the same input with it.
What TF says becomes an event of the run, right before the message, so that a replay needs no TF.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import pinocchio as pin
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.time import Time

from ik_controller.messages import cdr
from ik_controller.parameters import ControllerParameters
from ik_controller.ros.optional import optional
from ik_controller.session import Session

_SECOND = 1_000_000_000
_MOST = 1000  # messages that wait; more are rejected


class _Waiting(NamedTuple):
    role: str
    data: bytes
    frame: str
    since: float


class Transforms:
    """Listens to TF. `sorted_in` puts events before messages, and messages that must wait back; `waiting` tells."""

    def __init__(self, node: Node, base_frame: str) -> None:
        self._base = base_frame
        self._queue: deque[_Waiting] = deque()
        self.waiting = ""
        tf2 = optional("tf2_ros")
        self._buffer: Any = None
        self._listener: Any = None
        if tf2 is not None:
            self._buffer = tf2.Buffer()
            self._listener = tf2.TransformListener(self._buffer, node)

    def sorted_in(
        self,
        messages: Iterable[tuple[str, bytes]],
        session: Session,
        now: int,
        apply: Callable[[dict[str, Any]], None],
    ) -> Iterator[tuple[str, bytes]]:
        """Yield what can be taken now: what has waited first, then `messages`; `apply` takes the events before them."""
        parameters = session.parameters
        for _ in range(len(self._queue)):
            if not self._resolved(self._queue[0], parameters, now, apply):
                break
            role, data, _, _ = self._queue.popleft()
            yield role, data
        for role, data in messages:
            frame = session.foreign_frame(role, data)
            if not frame and not (self._queue and any(entry.role == role for entry in self._queue)):
                yield role, data
                continue
            entry = _Waiting(role, data, frame, time.monotonic())
            full = len(self._queue) >= _MOST
            if not self._queue and (not frame or self._resolved(entry, parameters, now, apply)):
                yield role, data
            elif full:
                apply(_event(frame, "too many messages wait for their transforms"))
                yield role, data
            else:
                self._queue.append(entry)
        self.waiting = ""
        if self._queue:
            self.waiting = f"waiting for TF from '{self._queue[0].frame}' to '{self._base}'"

    def _resolved(
        self, entry: _Waiting, parameters: ControllerParameters, now: int, apply: Callable[[dict[str, Any]], None]
    ) -> bool:
        """Apply what TF says of an entry's frame, or why there is nothing; False while it should still wait."""
        if not entry.frame:
            return True
        if self._buffer is None:
            apply(_event(entry.frame, "tf2 is not installed"))
            return True
        seconds, nanoseconds = cdr.stamp_at(entry.data)
        stamp = seconds * _SECOND + nanoseconds
        if abs(now - stamp) > parameters.stamp_tolerance * 1e9:
            stamp = 0  # of another clock, or none: the latest
        try:
            found = self._buffer.lookup_transform(self._base, entry.frame, Time(nanoseconds=stamp))
        except Exception as error:  # tf2's own, which cannot be named where it may be missing
            waited = time.monotonic() - entry.since
            if waited < parameters.transform_timeout:
                return False
            said = " ".join(str(error).split())
            apply(_event(entry.frame, f"TF has no transform to '{self._base}' within {waited:.2f} s: {said}"))
            return True
        t, r = found.transform.translation, found.transform.rotation
        apply({"do": "transform", "frame": entry.frame, "pose": [t.x, t.y, t.z, r.x, r.y, r.z, r.w]})
        return True

    def close(self) -> None:
        """Stop listening."""
        if self._listener is not None:
            self._listener.unregister()
        self._queue.clear()


def _event(frame: str, reason: str) -> dict[str, Any]:
    return {"do": "transform", "frame": frame, "reason": reason}


class ToolFrame:
    """Sends the tool point's frame below the tip frame to TF, ten times a second; needs tf2_ros."""

    def __init__(self, node: Node, session: Session) -> None:
        self._node = node
        self._session = session
        self._broadcaster = optional("tf2_ros").TransformBroadcaster(node)
        self._timer = node.create_timer(0.1, self._tell)

    def _tell(self) -> None:
        message = TransformStamped()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.header.frame_id = self._session.model.tip_frame
        message.child_frame_id = self._session.parameters.tool_frame
        offset = pin.SE3ToXYZQUAT(self._session.model.tool_offset).tolist()
        t, r = message.transform.translation, message.transform.rotation
        t.x, t.y, t.z, r.x, r.y, r.z, r.w = offset
        self._broadcaster.sendTransform(message)

    def close(self) -> None:
        """Stop."""
        self._node.destroy_timer(self._timer)
