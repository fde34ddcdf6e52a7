"""Over DDS: two publishers on one input, and the markers for RViz."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped
from rig import Rig, values_of
from test_bad_input import twist
from test_services import moving
from visualization_msgs.msg import MarkerArray

from ik_controller.robots import build_model, bundled_parameters
from ik_controller.ros.publishers import name_of

TOPIC = "/ik_controller/target_twist"


def rejections(status: Any) -> int:
    return int(values_of(status)["rejected"])


def test_two_publishers_are_told_of_and_refused_if_wanted(live: Rig) -> None:
    first = live.publisher("target_twist")
    second = live._listener.create_publisher(TwistStamped, TOPIC, 10)
    try:
        said = "target_twist: 2 publishers on /ik_controller/target_twist: /test_listener, /test_listener"
        # A warning, unless the joint states are late at this very moment.
        status = live.until_new("status", lambda s: said in s.message and s.level == b"\x01", said)
        assert "publishers" in values_of(status)["reasons"]
        before = live.until_new("status", lambda s: True)
        with live.sending("target_twist", twist()):
            live.until_status("tracking")  # warned of, and taken
        assert live.set_parameters(second_publisher="refuse").successful

        def refused() -> bool:
            first.publish(twist())
            return rejections(live.heard["status"][-1]) > rejections(before)

        live.until(refused, "a rejection")
        assert values_of(live.heard["status"][-1])["last_rejected"].startswith("target_twist: 2 publishers on ")
        assert live.set_parameters(second_publisher="allow").successful
        live.until_new("status", lambda s: "publishers" not in values_of(s)["reasons"])
        assert live.set_parameters(second_publisher="refuse").successful
        live.until_status("2 publishers on")
    finally:
        live._listener.destroy_publisher(second)
    live.until_new("status", lambda s: "publishers" not in values_of(s)["reasons"])
    with moving(live):
        pass
    assert live.set_parameters(second_publisher="warn").successful


def test_discovery_may_tell_of_a_publisher_before_its_node() -> None:
    """As `rmw` has it then; seen now and then, on a busy machine."""
    unknown = SimpleNamespace(node_namespace="_NODE_NAMESPACE_UNKNOWN_", node_name="_NODE_NAME_UNKNOWN_")
    assert name_of(unknown) == "a node without a name yet"
    assert name_of(SimpleNamespace(node_namespace="/", node_name="teleop")) == "/teleop"


def test_markers_show_tool_path_and_self_motion_while_somebody_looks(live: Rig) -> None:
    model = build_model(bundled_parameters("panda"))
    found: list[MarkerArray] = []
    subscription = live._listener.create_subscription(MarkerArray, "/ik_controller/markers", lambda _: None, 10)

    def seen() -> bool:
        with subscription.handle:
            while (taken := subscription.handle.take_message(subscription.msg_type, False)) is not None:
                found.append(taken[0])
        return bool(found) and any(m.ns == "path" and len(m.points) > 5 for m in found[-1].markers)

    with moving(live):
        live.until(seen, "markers")
    live._listener.destroy_subscription(subscription)
    markers = found[-1].markers
    assert {"tool", "path", "null_space"} <= {m.ns for m in markers}
    assert all(m.header.frame_id == "panda_link0" for m in markers)
    (tool,) = [m for m in markers if m.ns == "tool"]
    shown = np.array([tool.points[0].x, tool.points[0].y, tool.points[0].z])
    commanded = [model.forward(np.array(c.position)).translation for c in live.heard["joint_commands"][-2000:]]
    assert np.abs(np.array(commanded) - shown).max(axis=1).min() < 1e-12
    for line in (m for m in markers if m.ns == "null_space"):  # the tool stays nearly where it is, the elbow does not
        end = line.points[-1]
        assert np.linalg.norm(np.array([end.x, end.y, end.z]) - shown) < 0.05
