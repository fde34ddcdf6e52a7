"""In MoveIt Servo's place: its topic names, services and status codes, at the arm's driver.

ros2 launch ik_controller servo.launch.py robot:=panda command_topic:=/panda_arm_controller/joint_trajectory
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import SetParameter
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return arm.launch.py, whose arguments are all here too, with servo_interface on."""
    arguments = [
        DeclareLaunchArgument(
            "servo_name", default_value="servo_node", description="Name before MoveIt Servo's topics and services."
        ),
        DeclareLaunchArgument(
            "command_output",
            default_value="joint_trajectory",
            description="Type of the commands, as in arm.launch.py; joint_trajectory is what MoveIt Servo sends.",
        ),
    ]
    arm = PathJoinSubstitution([FindPackageShare("ik_controller"), "launch", "arm.launch.py"])
    return LaunchDescription(
        [
            *arguments,
            SetParameter("servo_interface", True),
            SetParameter("servo_name", LaunchConfiguration("servo_name")),
            IncludeLaunchDescription(arm),
        ]
    )
