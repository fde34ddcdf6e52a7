"""Write config/foxglove.json, a layout for Foxglove, and config/ik_controller.rviz, for the node's topics as they are.

    python scripts/make_views.py [FOLDER]

The fixed frame and the number of joints are the Panda's; both programs let one change the frame in a click.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import yaml

from ik_controller.recording.run import default_topics
from ik_controller.robots import build_model, bundled_parameters

CONFIG = Path(__file__).resolve().parent.parent / "config"
TOPICS = {**default_topics(), "diagnostics": "/diagnostics", "markers": "/ik_controller/markers"}
COLORS = ["#1f5fc4", "#e8710a", "#21803c", "#c2255c", "#7048c8", "#8a5a2b", "#0d8a94"]


def foxglove(frame: str, joints: tuple[str, ...]) -> dict[str, Any]:
    """Return the layout: the arm on the left, what it does below, errors, joints and services on the right."""

    def plot(title: str, *paths: tuple[str, str]) -> dict[str, Any]:
        series = [
            {"value": value, "label": label, "enabled": True, "timestampMethod": "receiveTime", "color": COLORS[k % 7]}
            for k, (value, label) in enumerate(paths)
        ]
        return {"title": title, "paths": series, "showXAxisLabels": True, "showYAxisLabels": True,
                "showLegend": True, "legendDisplay": "floating", "isSynced": True,
                "xAxisVal": "timestamp", "followingViewWidth": 10}  # fmt: skip

    def service(name: str, request: str, label: str) -> dict[str, Any]:
        return {"serviceName": f"/ik_controller/{name}", "requestPayload": request, "buttonText": label,
                "layout": "vertical", "timeoutSeconds": 5}  # fmt: skip

    error, commands = TOPICS["tracking_error"], TOPICS["joint_commands"]
    panels = {
        "3D!arm": {
            "followMode": "follow-none",
            "followTf": frame,
            "fixedFrame": frame,
            "scene": {},
            "cameraState": {"perspective": True, "distance": 2.2, "phi": 65, "thetaOffset": 45, "target": [0, 0, 0.4],
                            "targetOffset": [0, 0, 0.4], "targetOrientation": [0, 0, 0, 1], "fovy": 45, "near": 0.05,
                            "far": 100},
            "layers": {
                "grid": {"layerId": "foxglove.Grid", "instanceId": "grid", "label": "Grid", "visible": True,
                         "frameId": frame, "size": 2, "divisions": 20, "lineWidth": 1, "color": "#8899aa80",
                         "position": [0, 0, 0], "rotation": [0, 0, 0], "order": 1},
                "arm": {"layerId": "foxglove.Urdf", "instanceId": "arm", "label": "Arm", "visible": True,
                        "sourceType": "topic", "topic": TOPICS["robot_description"], "controlMode": "jointStates",
                        "jointStatesTopic": TOPICS["joint_states"], "displayMode": "visual", "order": 2},
            },
            "topics": {
                TOPICS["target_pose"]: {"visible": True, "type": "axis", "axisScale": 0.15},
                TOPICS["current_pose"]: {"visible": True, "type": "axis", "axisScale": 0.1},
                TOPICS["markers"]: {"visible": True},
            },
        },
        "Plot!position": plot("Position error [m]", *((f"{error}.twist.linear.{a}", a) for a in "xyz")),
        "Plot!orientation": plot("Orientation error [rad]", *((f"{error}.twist.angular.{a}", a) for a in "xyz")),
        "Plot!joints": plot(
            "Commanded joints [rad]", *((f"{commands}.position[{k}]", name) for k, name in enumerate(joints))
        ),
        "Plot!speeds": plot(
            "Commanded velocities [rad/s]", *((f"{commands}.velocity[{k}]", name) for k, name in enumerate(joints))
        ),
        "StateTransitions!status": {
            "isSynced": True,
            "paths": [
                {"value": f"{TOPICS['status']}.level", "label": "level", "timestampMethod": "receiveTime"},
                {"value": f"{TOPICS['status']}.message", "label": "what it does", "timestampMethod": "receiveTime"},
            ],
        },
        "RawMessages!status": {"topicPath": TOPICS["status"], "diffEnabled": False, "expansion": "all"},
        "DiagnosticSummary!all": {"minLevel": 0, "pinnedIds": [], "hardwareIdFilter": "", "sortByLevel": True,
                                  "topicToRender": TOPICS["diagnostics"]},
        "CallService!pause": service("pause", '{"data": true}', "Pause"),
        "CallService!resume": service("pause", '{"data": false}', "Go on"),
        "CallService!reset": service("reset", "{}", "Reset"),
        "Parameters!all": {},
    }  # fmt: skip
    return {"configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1},
            "layout": row(
                column("3D!arm", column("StateTransitions!status",
                                        row("RawMessages!status", "DiagnosticSummary!all")), 62),
                column(
                    column("Plot!position", "Plot!orientation"),
                    column(column("Plot!joints", "Plot!speeds"),
                           row(row("CallService!pause", row("CallService!resume", "CallService!reset"), 33),
                               "Parameters!all", 60), 70), 42), 55)}  # fmt: skip


def row(first: Any, second: Any, share: int = 50) -> dict[str, Any]:
    """Return two parts of the layout beside each other."""
    return {"direction": "row", "first": first, "second": second, "splitPercentage": share}


def column(first: Any, second: Any, share: int = 50) -> dict[str, Any]:
    """Return two parts of the layout below each other."""
    return {"direction": "column", "first": first, "second": second, "splitPercentage": share}


def rviz(frame: str) -> dict[str, Any]:
    """Return the RViz configuration: grid, arm, target, tool, and the node's markers."""

    def topic(name: str, durability: str = "Volatile") -> dict[str, Any]:
        return {"Value": TOPICS[name], "Depth": 5, "History Policy": "Keep Last", "Reliability Policy": "Reliable",
                "Durability Policy": durability}  # fmt: skip

    def pose(label: str, name: str, length: float) -> dict[str, Any]:
        return {"Class": "rviz_default_plugins/Pose", "Name": label, "Enabled": True, "Value": True, "Shape": "Axes",
                "Axes Length": length, "Axes Radius": 0.006, "Topic": topic(name)}  # fmt: skip

    displays = [
        {"Class": "rviz_default_plugins/Grid", "Name": "Grid", "Enabled": True, "Value": True, "Cell Size": 0.1,
         "Plane Cell Count": 20, "Color": "160; 160; 164", "Alpha": 0.5},
        {"Class": "rviz_default_plugins/RobotModel", "Name": "Arm", "Enabled": True, "Value": True,
         "Description Source": "Topic", "Description Topic": topic("robot_description", "Transient Local"),
         "Visual Enabled": True, "Collision Enabled": False},
        pose("Target", "target_pose", 0.15),
        pose("Tool", "current_pose", 0.1),
        {"Class": "rviz_default_plugins/MarkerArray", "Name": "Limits and targets", "Enabled": True, "Value": True,
         "Topic": topic("markers")},
    ]  # fmt: skip
    view = {"Class": "rviz_default_plugins/Orbit", "Name": "Current View", "Distance": 2.2, "Pitch": 0.45, "Yaw": 0.8,
            "Focal Point": {"X": 0.0, "Y": 0.0, "Z": 0.4}, "Target Frame": "<Fixed Frame>"}  # fmt: skip
    tools = [{"Class": f"rviz_default_plugins/{name}"} for name in ("MoveCamera", "Select", "FocusCamera", "Measure")]
    return {
        "Panels": [
            {"Class": "rviz_common/Displays", "Name": "Displays"},
            {"Class": "rviz_common/Views", "Name": "Views"},
        ],
        "Visualization Manager": {
            "Class": "",
            "Displays": displays,
            "Enabled": True,
            "Global Options": {"Background Color": "48; 48; 48", "Fixed Frame": frame, "Frame Rate": 30},
            "Name": "root",
            "Tools": tools,
            "Value": True,
            "Views": {"Current": view, "Saved": None},
        },
        "Window Geometry": {"Width": 1400, "Height": 900},
    }


def files() -> dict[str, str]:
    """Return file name → text."""
    model = build_model(bundled_parameters("panda"))
    return {
        "foxglove.json": json.dumps(foxglove(model.base_frame, model.joint_names), indent=1) + "\n",
        "ik_controller.rviz": yaml.safe_dump(rviz(model.base_frame), sort_keys=False),
    }


def main(folder: Path) -> None:
    """Write the files."""
    for name, text in files().items():
        (folder / name).write_text(text, encoding="utf-8")
        print(folder / name)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else CONFIG)
