"""Several arms: two of one model in one process; namespaces; each with its own loop, names, parameters, recording."""

from __future__ import annotations

import re
import signal
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped
from published import recorded
from rig import CLI, NODE, ROOT, Rig, figure_bag, values_of
from sensor_msgs.msg import JointState
from test_services import replayed

ARMS = {"left": 1.0, "right": -1.0}
HOME = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]


def two_arms(folder: Path) -> Path:
    """Write a URDF of two Pandas on one base, at y = ±0.4 m."""
    panda = (ROOT / "config" / "panda" / "robot.urdf").read_text(encoding="utf-8")
    inside = panda[panda.index(">", panda.index("<robot")) + 1 : panda.rindex("</robot>")]
    inside = re.sub(r"<material[^>]*/>|<material.*?</material>", "", inside)  # two of one name are refused
    parts = ['<robot name="two_arms"><link name="world"/>']
    for side, sign in ARMS.items():
        parts.append(re.sub(r'(name|link)="(panda_\w+)"', rf'\1="{side}_\2"', inside))
        parts.append(
            f'<joint name="{side}_mount" type="fixed"><parent link="world"/><child link="{side}_panda_link0"/>'
            f'<origin xyz="0 {0.4 * sign} 0"/></joint>'
        )
    file = folder / "two_arms.urdf"
    file.write_text("".join(parts) + "</robot>", encoding="utf-8")
    return file


def test_two_arms_of_one_model_in_one_process(rig: Rig) -> None:
    urdf = two_arms(rig.folder)
    sections = [f"/ik_controller: {{ros__parameters: {{arms: {list(ARMS)}}}}}"]
    for side in ARMS:
        sections.append(
            f"/{side}: {{ros__parameters: {{urdf: {urdf}, tip_frame: {side}_panda_hand_tcp, rate: 100.0, "
            f"record_folder: {rig.folder / 'runs'}}}}}"
        )
        rig.hear(side, DiagnosticStatus, f"/{side}/status")
        rig.hear(f"{side}_error", TwistStamped, f"/{side}/tracking_error")
        rig.start_sim("--urdf", str(urdf), "--tip", f"{side}_panda_hand_tcp", "--rate", "200", "--start",
                      *map(str, HOME))  # fmt: skip
    file = rig.folder / "parameters.yaml"
    file.write_text("\n".join(sections), encoding="utf-8")
    node = rig.start("node", [*NODE, "--ros-args", "--params-file", str(file)])
    for side in ARMS:
        status = rig.until_new(side, lambda s: "holding" in s.message, f"{side} to hold")
        assert (status.name, status.hardware_id) == (side, "two_arms")

    publishers = {side: rig._listener.create_publisher(PoseStamped, f"/{side}/target_pose", 10) for side in ARMS}

    def arrive(*sides: str) -> bool:
        """Send each side's target, 0.3 m before its base, and tell whether all of them are there."""
        for side in sides:
            target = PoseStamped()
            target.header.frame_id = f"{side}_panda_link0"
            target.pose.position.x, target.pose.position.z = 0.3, 0.5
            target.pose.orientation.x, target.pose.orientation.w = 1.0, 0.0
            publishers[side].publish(target)
        return all("tracking" in rig.heard[side][-1].message and error(rig.heard[f"{side}_error"]) for side in sides)

    def error(heard: list[TwistStamped]) -> bool:
        v = heard[-1].twist.linear if heard else None
        return v is not None and max(abs(v.x), abs(v.y), abs(v.z)) < 1e-3

    rig.until(lambda: arrive("left"), "the left arm to arrive")
    assert "holding" in rig.heard["right"][-1].message
    rig.until(lambda: arrive("left", "right"), "both to arrive")

    # Only one of them rests; and only one of them records.
    assert rig.change_state("deactivate", "/left")
    rig.until_new("right", lambda s: "tracking" in s.message or "holding" in s.message)
    assert rig.state("/right") == "active"
    node.send(signal.SIGTERM)
    assert node.wait() == 0, node.err
    bags = {side: [bag for bag in rig.bags() if f"run_{side}_" in bag.name] for side in ARMS}
    for side in ARMS:
        (bag,) = bags[side]
        assert replayed(bag).identical
        names = {name for command in recorded(bag, "/joint_commands") for name in command.name}
        assert names == {f"{side}_panda_joint{i}" for i in range(1, 8)}
        assert recorded(bag, f"/{side}/target_pose")


def test_two_models_in_namespaces_of_their_own(rig: Rig) -> None:
    nodes = {"/cell/a/arm": "panda", "/cell/b/arm": "ur5e"}
    sections = ["/**: {ros__parameters: {rate: 100.0, record: false, arms: [a/arm, b/arm]}}"]
    for name, robot in nodes.items():
        sections.append(f"{name}: {{ros__parameters: {{robot: {robot}}}}}")
        rig.hear(name, DiagnosticStatus, f"{name}/status")
    file = rig.folder / "parameters.yaml"
    file.write_text("\n".join(sections), encoding="utf-8")
    node = rig.start("node", [*NODE, "--ros-args", "-r", "__ns:=/cell", "--params-file", str(file)])
    for name, robot in nodes.items():
        status = rig.until_new(name, lambda s: "waiting for the first joint state" in s.message, f"{name} to wait")
        assert (status.name, status.hardware_id) == (name[1:], robot)
        assert values_of(status)["recorder"] == "off"
    assert {status.name for array in rig.heard["diagnostics"] for status in array.status} <= {n[1:] for n in nodes}
    assert rig.change_state("deactivate", "/cell/a/arm")
    assert rig.state("/cell/b/arm") == "active"
    node.send(signal.SIGINT)
    assert node.wait() == 0, node.err


def test_two_arms_in_namespaces_of_their_own_each_with_its_arm(rig: Rig) -> None:
    """Nodes, arms and streamer by `-r __ns:=`; the joints have the same names, so nothing else tells them apart."""
    states: dict[str, list[JointState]] = {}
    for side in ARMS:
        namespace = ["-r", f"__ns:=/{side}"]
        rig.start_sim("--rate", "200", "--ros-args", *namespace)
        rig.start_node(*namespace, robot="panda", rate=200.0)
        rig.hear(side, DiagnosticStatus, f"/{side}/ik_controller/status")
        rig.hear(f"{side}_states", JointState, f"/{side}/joint_states")
        states[side] = rig.heard[f"{side}_states"]
    for side in ARMS:
        rig.until_new(side, lambda s: "holding" in s.message, f"{side} to hold")
        rig.until(lambda side=side: states[side], f"joint states of {side}")
    start = list(states["right"][-1].position)
    targets = str(figure_bag(rig.folder / "targets", 0.5))
    rig.start("stream", [*CLI, "stream", targets, "--loop", "--patience", "60", "--ros-args", "-r", "__ns:=/left"])

    def moved() -> bool:
        return max(abs(a - b) for a, b in zip(states["left"][-1].position, start, strict=True)) > 0.002

    rig.until(moved, "left to move")
    assert list(states["right"][-1].position) == start
    for process in rig.processes:
        process.send(signal.SIGINT)
    assert [process.wait() for process in rig.processes] == [0] * len(rig.processes)
    for side in ARMS:
        (bag,) = [bag for bag in rig.bags() if f"run_{side}_" in bag.name]
        assert replayed(bag).identical
        assert len(recorded(bag, f"/{side}/joint_commands")) > 10
        assert bool(recorded(bag, f"/{side}/ik_controller/target_pose")) == (side == "left")


def test_a_mistake_in_one_arm_ends_the_process_and_names_it(rig: Rig) -> None:
    file = rig.folder / "parameters.yaml"
    file.write_text(
        "/ik_controller: {ros__parameters: {arms: [left, right]}}\n/**: {ros__parameters: {robot: panda}}\n"
        "/right: {ros__parameters: {posture: [0.0]}}\n",
        encoding="utf-8",
    )
    node = rig.start("node", [*NODE, "--ros-args", "--params-file", str(file), "-p", "record:=false"])
    assert node.wait() == 2
    line = node.err.splitlines()[-1]
    assert line.startswith("ik_controller_node: /right: posture: 1 values, need 7")
    assert "Traceback" not in node.err
