"""Start the node and, with ``publish_description:=true``, robot_state_publisher with the gripper alone."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "wsg_gripper_driver"
ARGUMENTS = (
    ("address", "", "Address of the gripper, such as tcp://192.168.1.20"),
    ("name", "wsg_gripper", "Name of the node"),
    ("namespace", "", "Namespace of the node"),
    ("prefix", "", "Prefix of the joint names"),
    ("parameters", PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "gripper.yaml"]), "Parameter file"),
    ("publish_description", "false", "Start robot_state_publisher"),
)


def generate_launch_description() -> LaunchDescription:
    value = {name: LaunchConfiguration(name) for name, _, _ in ARGUMENTS}
    xacro = PathJoinSubstitution([FindPackageShare(PACKAGE), "urdf", "gripper.urdf.xacro"])
    description = Command(["xacro ", xacro, " prefix:='", value["prefix"], "'"])
    text = {name: ParameterValue(value[name], value_type=str) for name in ("address", "prefix")}
    return LaunchDescription(
        [DeclareLaunchArgument(name, default_value=default, description=help) for name, default, help in ARGUMENTS]
        + [
            LifecycleNode(
                package=PACKAGE,
                executable="wsg_gripper",
                name=value["name"],
                namespace=value["namespace"],
                parameters=[text, value["parameters"]],
                output="screen",
            ),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                namespace=value["namespace"],
                parameters=[{"robot_description": ParameterValue(description, value_type=str)}],
                condition=IfCondition(value["publish_description"]),
            ),
        ]
    )
