"""A simulated arm, the node and a target streamer; everything stops when the targets have been sent.

ros2 launch ik_controller demo.launch.py robot:=panda targets:=BAG rate:=1000
ros2 launch ik_controller demo.launch.py view:=true
"""

from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.conditions import IfCondition, UnlessCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "ik_controller"


def verb(*words: Any, **options: Any) -> Node:
    """Return a verb of the command line as a process, in the namespace of all."""
    namespace = LaunchConfiguration("namespace")
    return Node(
        package=PACKAGE, executable=PACKAGE, arguments=list(words), namespace=namespace, output="screen", **options
    )


def generate_launch_description() -> LaunchDescription:
    """Return the processes and the arguments."""
    robot, targets, rate = LaunchConfiguration("robot"), LaunchConfiguration("targets"), LaunchConfiguration("rate")
    view, port = LaunchConfiguration("view"), LaunchConfiguration("port")
    share = FindPackageShare(PACKAGE)
    arguments = [
        DeclareLaunchArgument("robot", default_value="panda", description="Bundled robot: panda or ur5e."),
        DeclareLaunchArgument(
            "targets",
            default_value=[PathJoinSubstitution([share, "bags", robot]), "_figure_eight"],
            description="Bag of target poses and twists to stream; the robot's own figure-eight unless given.",
        ),
        DeclareLaunchArgument("rate", default_value="1000.0", description="Control cycles a second, 100 to 1000 [Hz]."),
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of all processes."),
        DeclareLaunchArgument(
            "view",
            default_value="false",
            choices=["true", "false"],
            description="Serve the live page too; the targets are then repeated until Ctrl-C.",
        ),
        DeclareLaunchArgument("port", default_value="8080", description="Port of the live page on this machine."),
    ]
    arm = verb("sim", "--robot", robot)
    node = Node(
        package=PACKAGE,
        executable="ik_controller_node",
        name="ik_controller",
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            PathJoinSubstitution([share, "config", robot, "parameters.yaml"]),
            {"rate": ParameterValue(rate, value_type=float)},
        ],
        output="screen",
    )
    stream = ("stream", targets, "--patience", "300")  # the very first run compiles
    once = verb(*stream, condition=UnlessCondition(view))
    again = verb(*stream, "--loop", condition=IfCondition(view))
    page = verb("view", "--port", port, condition=IfCondition(view))
    end = RegisterEventHandler(
        OnProcessExit(target_action=once, on_exit=[EmitEvent(event=Shutdown(reason="all targets sent"))])
    )
    # The node first: an argument that it does not take ends the launch, which leaves behind what runs already.
    return LaunchDescription([*arguments, end, node, arm, once, again, page])
