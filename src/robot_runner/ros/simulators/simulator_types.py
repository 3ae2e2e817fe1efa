"""What the types are made of by which simulators are reset and paused, so that their packages need not be installed.

From the packages gazebo_msgs (of ROS 1 and ROS 2), webots_ros, ros_gz_interfaces and simulation_interfaces. Comments
and constants, which say nothing of the bytes, are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

_STATE = "geometry_msgs/Pose pose\ngeometry_msgs/Twist twist\nstring reference_frame\n"
_ROS1 = {
    "gazebo_msgs/ModelState.msg": f"string model_name\n{_STATE}",
    "gazebo_msgs/SetModelState.srv": "gazebo_msgs/ModelState model_state\n---\nbool success\nstring status_message\n",
    "webots_ros/get_bool.srv": "bool ask\n---\nbool value\n",
    "webots_ros/set_int.srv": "int32 value\n---\nbool success\n",
}
_ROS2 = {
    "gazebo_msgs/EntityState.msg": f"string name\n{_STATE}",
    "gazebo_msgs/SetEntityState.srv": "gazebo_msgs/EntityState state\n---\nbool success\n",
    "ros_gz_interfaces/Entity.msg": "uint64 id\nstring name\nuint8 type\n",
    "ros_gz_interfaces/WorldReset.msg": "bool all false\nbool time_only false\nbool model_only false\n",
    "ros_gz_interfaces/WorldControl.msg": (
        "bool pause\nbool step\nuint32 multi_step 0\nros_gz_interfaces/WorldReset reset\nuint32 seed\n"
        "builtin_interfaces/Time run_to_sim_time\n"
    ),
    "ros_gz_interfaces/ControlWorld.srv": "ros_gz_interfaces/WorldControl world_control\n---\nbool success\n",
    "ros_gz_interfaces/SetEntityPose.srv": (
        "ros_gz_interfaces/Entity entity\ngeometry_msgs/Pose pose\n---\nbool success\n"
    ),
    "simulation_interfaces/Result.msg": "uint8 result\nstring error_message\n",
    "simulation_interfaces/SimulationState.msg": "uint8 state\n",
    "simulation_interfaces/ResetSimulation.srv": "uint8 scope\n---\nsimulation_interfaces/Result result\n",
    "simulation_interfaces/SetSimulationState.srv": (
        "simulation_interfaces/SimulationState state\n---\nsimulation_interfaces/Result result\n"
    ),
}
_BOTH = {
    "gazebo_msgs/ModelStates.msg": "string[] name\ngeometry_msgs/Pose[] pose\ngeometry_msgs/Twist[] twist\n",
}


def simulator_types(generation: int) -> Mapping[str, str]:
    """Return the definition of each type of a generation of ROS, by its name and suffix.

    Example:
        >>> simulator_types(1)["webots_ros/set_int.srv"].splitlines()
        ['int32 value', '---', 'bool success']
    """
    return MappingProxyType(_BOTH | (_ROS1 if generation == 1 else _ROS2))
