# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""One zone: plant, controller, monitor, operator, and a recorder if asked for.

ros2 launch ros2_deepc zone.launch.py plant:=net3 seed:=1 record:=true
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

CONFIG = PathJoinSubstitution([FindPackageShare("ros2_deepc"), "config", [LaunchConfiguration("plant"), ".yaml"]])


def argument(name, default, description, choices=None):
    return DeclareLaunchArgument(name, default_value=default, description=description, choices=choices)


def generate_launch_description():
    namespace, params, seed, mode, record = (
        LaunchConfiguration(name) for name in ("namespace", "params_file", "seed", "mode", "record")
    )
    seed = ParameterValue(seed, value_type=int)
    lockstep = ParameterValue(PythonExpression(["'", mode, "' == 'lockstep'"]), value_type=bool)

    def readers(count):
        """Readers to wait for, so that the first sample reaches the recorder, too."""
        return ParameterValue(PythonExpression([str(count), " + ('", record, "' == 'true')"]), value_type=int)

    def node(package, role, condition=None, **parameters):
        return Node(
            package=package,
            executable=f"{role}_node",
            name=role,
            namespace=namespace,
            parameters=[params, {"use_sim_time": lockstep, **parameters}],
            condition=condition,
            output="screen",
        )

    return LaunchDescription(
        [
            argument("plant", "wscc9", "registered plant; also names the default params_file"),
            argument("namespace", LaunchConfiguration("plant"), "one namespace a plant or zone"),
            argument("params_file", CONFIG, "YAML with the parameters of all nodes"),
            argument("seed", "0", "seed of the initial state and of the excitation"),
            argument("mode", "lockstep", "who drives the loop", ["lockstep", "realtime"]),
            argument("record", "false", "record every topic into a bag", ["true", "false"]),
            argument("bag", "bag", "folder of the bag, must not exist yet"),
            node("plant_sim", "plant", seed=seed, mode=ParameterValue(mode, value_type=str), readers=readers(2)),
            node("ros2_deepc", "controller", seed=seed, readers_inputs=readers(2)),
            node("ros2_deepc", "monitor"),
            node("ros2_deepc", "operator", readers=readers(1)),
            node("ros2_deepc", "recorder", IfCondition(record), folder=LaunchConfiguration("bag")),
        ]
    )
