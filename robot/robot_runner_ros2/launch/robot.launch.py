"""On the robot: ros2 launch robot_runner_ros2 robot.launch.py network_address:=http://192.168.1.10:8000/."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

NAMESPACE = ("namespace", "", "of the robot, such as /alice")
#: Name, default and meaning of each argument; the parameter of the same name has a dot for the first underscore.
TASKS = [
    ("network_address", "", "what the task network fetches"),
    ("network_rate", 0.0, "requests a second; 0: one after the other"),
    ("video_source", "camera", "camera, topic or synthetic"),
    ("video_device", "0", "number or file of the camera"),
    ("video_topic", "camera/image_raw/compressed", "of the camera's node, where the source is topic"),
    ("video_width", 2592, "pixels"),
    ("video_height", 1944, "pixels"),
    ("video_rate", 15.0, "frames a second"),
    ("video_file", "~/.ros/robot_runner_video.avi", "overwritten by each recording"),
]
WATCHDOG = [
    ("heartbeat_timeout", 0.4, "s that a run may be silent before the robot is stopped"),
    ("command_timeout", 0.0, "s that cmd_vel may be silent while the robot moves; 0: for ever"),
]


def generate_launch_description():
    """Return the tasks' node and the watchdog, with an argument for each of their parameters."""
    arguments = [
        DeclareLaunchArgument(name, default_value=str(default), description=meaning)
        for name, default, meaning in [NAMESPACE, *TASKS, *WATCHDOG]
    ]
    tasks = {name.replace("_", ".", 1): _value(name, default) for name, default, _ in TASKS}
    watchdog = {name: _value(name, default) for name, default, _ in WATCHDOG}
    return LaunchDescription([*arguments, _node("task_node", tasks), _node("watchdog_node", watchdog)])


def _value(name, default):
    return ParameterValue(LaunchConfiguration(name), value_type=type(default))


def _node(executable, parameters):
    return Node(
        package="robot_runner_ros2",
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[parameters],
        output="screen",
        respawn=True,
    )
