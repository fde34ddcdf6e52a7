"""Publishers: who sends on the inputs; two who send targets fight over the arm, and somebody must send joint states."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

_EVERY = 0.5  # [s] between looks
_UNKNOWN = "_NODE_NAME_UNKNOWN_"  # what rmw calls it
_SEVERAL = ("joint_states", "obstacles")  # may have more than one publisher


class PublisherWatch:
    """Looks at how many publishers each input has, and warns or has a target input refused while there are two.

    `silence` says so where nobody publishes joint states, else it is empty.
    """

    def __init__(
        self, node: Node, topics: dict[str, str], policy: Callable[[], str], request: Callable[..., None]
    ) -> None:
        """`topics`: role → topic; `policy`: the parameter second_publisher; `request`: takes events of
        `Session.apply`.
        """
        self._node = node
        self._topics = {role: topic for role, topic in topics.items() if role not in _SEVERAL}
        self._feedback = topics["joint_states"]
        self.silence = ""
        self._policy = policy
        self._request = request
        self._reasons: dict[str, str] = {}  # role → what there is to say
        self._refused: set[str] = set()
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # a simulated one may stand
        self._timer = node.create_timer(_EVERY, self._look, clock=steady)

    @property
    def warnings(self) -> list[str]:
        """What there is to say about inputs with more than one publisher."""
        return [f"{role}: {reason}" for role, reason in sorted(self._reasons.items())]

    def _look(self) -> None:
        published = self._node.count_publishers(self._feedback) > 0
        self.silence = "" if published else f"nobody publishes on {self._feedback}"
        policy = self._policy()
        for role, topic in self._topics.items():
            reason = ""
            if policy != "allow" and self._node.count_publishers(topic) > 1:
                senders = self._node.get_publishers_info_by_topic(topic)
                names = sorted(name_of(sender) for sender in senders)
                if len(names) > 1:
                    reason = f"{len(names)} publishers on {topic}: {', '.join(names)}"
            if reason and reason != self._reasons.get(role):
                self._node.get_logger().warning(f"{reason}; stop all but one")
            if reason:
                self._reasons[role] = reason
            else:
                self._reasons.pop(role, None)
            refused = bool(reason) and policy == "refuse"
            if refused != (role in self._refused):
                self._request(do="refuse", role=role, reason=reason if refused else "")
                (self._refused.add if refused else self._refused.discard)(role)

    def close(self) -> None:
        """Stop looking."""
        self._node.destroy_timer(self._timer)


def name_of(endpoint: Any) -> str:
    """Return the full name of a publisher's or subscriber's node; discovery may tell of these before their node."""
    if endpoint.node_name == _UNKNOWN:
        return "a node without a name yet"
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
