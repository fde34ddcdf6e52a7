"""A simulated arm, the node and a target streamer; everything stops when the targets have been sent.

ros2 launch ik_controller demo.launch.py robot:=panda targets:=BAG rate:=1000
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, ExecuteProcess, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage, FindPackageShare

PACKAGE = "ik_controller"


def generate_launch_description() -> LaunchDescription:
    """Return the three processes and the arguments robot, targets and rate."""
    robot, targets, rate = LaunchConfiguration("robot"), LaunchConfiguration("targets"), LaunchConfiguration("rate")
    share = FindPackageShare(PACKAGE)
    command = ExecutableInPackage(PACKAGE, PACKAGE)
    arguments = [
        DeclareLaunchArgument("robot", default_value="panda", description="Bundled robot: panda or ur5e."),
        DeclareLaunchArgument(
            "targets",
            default_value=[PathJoinSubstitution([share, "bags", robot]), "_figure_eight"],
            description="Bag of target poses and twists to stream; the robot's own figure-eight unless given.",
        ),
        DeclareLaunchArgument("rate", default_value="1000.0", description="Control cycles a second, 100 to 1000 [Hz]."),
    ]
    arm = ExecuteProcess(cmd=[command, "sim", "--robot", robot], name="arm", output="screen")
    node = Node(
        package=PACKAGE,
        executable="ik_controller_node",
        name="ik_controller",
        parameters=[
            PathJoinSubstitution([share, "config", robot, "parameters.yaml"]),
            {"rate": ParameterValue(rate, value_type=float)},
        ],
        output="screen",
    )
    streamer = ExecuteProcess(cmd=[command, "stream", targets, "--patience", "60"], name="streamer", output="screen")
    end = RegisterEventHandler(
        OnProcessExit(target_action=streamer, on_exit=[EmitEvent(event=Shutdown(reason="all targets sent"))])
    )
    return LaunchDescription([*arguments, end, arm, node, streamer])
