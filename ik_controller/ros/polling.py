"""Polling: subscriptions that the loop empties itself, as the bytes on the wire.

An executor rebuilds its wait set in Python at every wake-up; polling costs a fifth of that, and makes a cycle a
function of the messages taken at its start, which is what makes exact replay possible.
"""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy


class PolledGroup(CallbackGroup):  # type: ignore[misc]
    """A callback group that never executes: the executor leaves its subscriptions out of its wait set."""

    def can_execute(self, entity: Any) -> bool:
        """Say no."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Say no."""
        return False


class PolledSubscription:
    """A raw subscription; `take` returns the next message's bytes, or None.

    Who takes from it also destroys it, or afterwards: so no take needs rclpy's guard against that, which costs as much
    as the take.
    """

    def __init__(
        self,
        node: Node,
        group: PolledGroup,
        message_type: Any,
        topic: str,
        depth: int,
        reliable: bool,
        latched: bool = False,
    ) -> None:
        # Best effort takes from reliable and from best-effort publishers alike.
        reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=depth, reliability=reliability, durability=durability)
        self.subscription = node.create_subscription(
            message_type, topic, lambda _: None, qos, callback_group=group, raw=True
        )
        self.topic: str = self.subscription.topic_name
        self._handle = self.subscription.handle
        self._type = self.subscription.msg_type

    def take(self) -> bytes | None:
        """Return the oldest message not yet taken."""
        taken = self._handle.take_message(self._type, True)
        return None if taken is None else taken[0]

    def latest(self) -> bytes | None:
        """Return the newest message not yet taken, and drop those before it."""
        newest = None
        while (data := self.take()) is not None:
            newest = data
        return newest
