"""Any arm: the node with a bundled robot, a URDF or robot_description, and its topics remapped to the driver's.

ros2 launch ik_controller arm.launch.py robot:=ur5e command_output:=position_array
ros2 launch ik_controller arm.launch.py params_file:=my_arm.yaml joint_states:=/left/joint_states namespace:=left
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# Launch argument → what it is. Given ones become parameters; what is left empty keeps the parameter file's value.
PARAMETERS = {
    "robot": "Bundled robot, panda or ur5e; empty: urdf, else the topic robot_description.",
    "urdf": "URDF file of any other robot; empty: the topic robot_description.",
    "tip_frame": "Link that carries the tool; needed with urdf and robot_description.",
    "base_frame": "Link in which targets are expressed; empty: the root link.",
    "rate": "Control cycles a second, 100 to 1000 [Hz]; empty: 1000.",
    "command_output": "Type of the commands: joint_state, joint_trajectory, position_array, velocity_array.",
    "command_topic": "Where the driver takes commands; empty: the usual topic of the type, joint_commands at first.",
    "record": "Record every run (true or false); empty: true.",
    "record_folder": "Folder that gets one bag a run; empty: runs, where ros2 launch was started.",
    "autostart": "Configure and activate at once (true or false); empty: true.",
    "use_sim_time": "Take the time from /clock (true or false); empty: false.",
}
TOPICS = {
    "joint_states": "The driver's measured joints, sensor_msgs/JointState.",
    "robot_description": "The robot's URDF as a latched std_msgs/String.",
}


def start(context: LaunchContext) -> list[Node]:
    """Return the node, with the parameters and remappings that were given."""
    given = {name: LaunchConfiguration(name).perform(context) for name in (*PARAMETERS, *TOPICS)}
    file = LaunchConfiguration("params_file").perform(context)
    values = {name: plain(given[name]) for name in PARAMETERS if given[name]}
    return [
        Node(
            package="ik_controller",
            executable="ik_controller_node",
            name=LaunchConfiguration("name"),
            namespace=LaunchConfiguration("namespace"),
            parameters=[*([file] if file else []), values],
            remappings=[(topic, given[topic]) for topic in TOPICS],
            output="screen",
        )
    ]


def plain(text: str) -> bool | float | str:
    """Return a launch argument's text as the type that it is written as."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return float(text)
    except ValueError:
        return text


def generate_launch_description() -> LaunchDescription:
    """Return the node and its arguments."""
    arguments = [
        DeclareLaunchArgument("params_file", default_value="", description="Parameter file; empty: none."),
        DeclareLaunchArgument("name", default_value="ik_controller", description="The node's name."),
        DeclareLaunchArgument("namespace", default_value="", description="The node's namespace."),
        *(DeclareLaunchArgument(name, default_value="", description=text) for name, text in PARAMETERS.items()),
        *(DeclareLaunchArgument(name, default_value=name, description=text) for name, text in TOPICS.items()),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=start)])
