"""A launch file for an installed ROS 2: `ros2 launch $(foreglow ros2 launch-file) source:=DRIVE`.

Launch arguments: `source` (empty if your own nodes publish the camera and the car's data), `arguments` (for all compute
nodes, such as `--config car.toml`), `namespace`. A node that dies is started again.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, GroupAction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression

COMPUTE = ("proposals", "classifier", "distance", "tracking", "beam")


def generate_launch_description() -> LaunchDescription:
    """The six nodes, each in a process of its own."""
    source, arguments, namespace = (LaunchConfiguration(name) for name in ("source", "arguments", "namespace"))
    ros_arguments = [" --ros-args -r __ns:=", namespace]
    nodes = [
        ExecuteProcess(
            cmd=[["foreglow ros2 ", name, " ", arguments, *ros_arguments]],
            name=f"foreglow_{name}",
            output="screen",
            respawn=True,
            respawn_delay=0.5,
            shell=True,
        )
        for name in COMPUTE
    ]
    player = ExecuteProcess(
        cmd=[["foreglow ros2 source ", source, *ros_arguments]], name="foreglow_source", output="screen", shell=True
    )
    has_source = IfCondition(PythonExpression(["'", source, "' != ''"]))
    return LaunchDescription(
        [
            DeclareLaunchArgument("source", default_value="", description="what `foreglow ros2 source` plays"),
            DeclareLaunchArgument("arguments", default_value="", description="for all nodes but the source"),
            DeclareLaunchArgument("namespace", default_value="/", description="of all topics"),
            *nodes,
            GroupAction([player], condition=has_source),
        ]
    )
