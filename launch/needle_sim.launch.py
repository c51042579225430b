# SPDX-License-Identifier: Apache-2.0
"""Launch the simulator node, and RViz if asked to.

ros2 launch needle_sim_ros needle_sim.launch.py scene:=layered_inclusion_3d rviz:=true
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """Return the node with its most used parameters as launch arguments."""
    share = Path(get_package_share_directory("needle_sim_ros"))
    arguments = {
        "scene": ("gao2016", "a scene of the package, or a YAML file"),
        "record": ("", "folder to record sessions in; empty: do not record"),
        "rate": ("100.0", "ticks per second, Hz"),
        "publish_clock": ("false", "publish the simulated time on /clock"),
        "rviz": ("false", "start RViz too"),
    }
    kinds = {"scene": str, "record": str, "rate": float, "publish_clock": bool}
    parameters = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, kind in kinds.items()
    }
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=value, description=text)
                for name, (value, text) in arguments.items()
            ),
            Node(package="needle_sim_ros", executable="sim_node", parameters=[parameters]),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(share / "config" / "rviz" / "needle_sim.rviz")],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )
