"""The definitions of types that are known without any ROS, beside those of the stores of `rosbags`.

Sources, as of each distribution's branch, whose fields are the same on the wire: `example_interfaces` and `nav2_msgs`
(Apache 2.0), `control_msgs`, `ackermann_msgs`, `actionlib_tutorials`, `move_base_msgs` and `action_msgs` (BSD,
Apache 2.0); rcl_interfaces and lifecycle_msgs 1.2 (Humble) and later; tf2_msgs of noetic, dynamic_reconfigure 1.7;
gazebo_msgs, webots_ros, ros_gz_interfaces and simulation_interfaces, without comments and constants, which say nothing
of the bytes.
"""

from __future__ import annotations

#: Type stores hold messages only. These services are the same in all distributions of both generations.
_STANDARD = {
    "std_srvs/Empty.srv": "---\n",
    "std_srvs/SetBool.srv": "bool data\n---\nbool success\nstring message\n",
    "std_srvs/Trigger.srv": "---\nbool success\nstring message\n",
}

#: A car's command; both generations have the same.
_CAR = "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\nfloat32 acceleration\nfloat32 jerk\n"
_FIBONACCI = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n"
#: Not in Foxy's Nav2.
_ESTIMATE = "builtin_interfaces/Duration estimated_time_remaining\n"
_NAVIGATED = f"""geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
{_ESTIMATE}int16 number_of_recoveries
float32 distance_remaining
"""
#: What Nav2's results are made of: it changed with Iron, and with Jazzy.
_NAVIGATION_RESULTS = {"humble": "std_msgs/Empty result", "iron": "uint16 error_code"}
_LATEST_NAVIGATION_RESULT = "uint16 NONE=0\nuint16 error_code\nstring error_msg"
_TRAJECTORY_RESULT = """int32 SUCCESSFUL=0
int32 INVALID_GOAL=-1
int32 INVALID_JOINTS=-2
int32 OLD_HEADER_TIMESTAMP=-3
int32 PATH_TOLERANCE_VIOLATED=-4
int32 GOAL_TOLERANCE_VIOLATED=-5
int32 error_code
string error_string
"""
_TRAJECTORY_FEEDBACK = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
"""
_TRAJECTORY = f"""trajectory_msgs/JointTrajectory trajectory
control_msgs/JointTolerance[] path_tolerance
control_msgs/JointTolerance[] goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
{_TRAJECTORY_RESULT}---
{_TRAJECTORY_FEEDBACK}"""
_MULTI_DOF_TRAJECTORY = f"""trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
control_msgs/JointTolerance[] path_tolerance
control_msgs/JointComponentTolerance[] component_path_tolerance
control_msgs/JointTolerance[] goal_tolerance
control_msgs/JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
{_TRAJECTORY_RESULT}---
{_TRAJECTORY_FEEDBACK}string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
"""
_COMPONENT_TOLERANCE = """uint16 X_AXIS=1
uint16 Y_AXIS=2
uint16 Z_AXIS=3
uint16 TRANSLATION=4
uint16 ROTATION=5
string joint_name
uint16 component
float64 position
float64 velocity
float64 acceleration
"""
_CANCEL_GOAL = """action_msgs/GoalInfo goal_info
---
int8 ERROR_NONE=0
int8 ERROR_REJECTED=1
int8 ERROR_UNKNOWN_GOAL_ID=2
int8 ERROR_GOAL_TERMINATED=3
int8 return_code
action_msgs/GoalInfo[] goals_canceling
"""
_TOLERANCE = "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n"

# What nodes offer for their parameters and their life cycle, and the nodes of ROS 1 that can be set while they run.

_PARAMETERS = {
    "GetParameters": "string[] names\n---\nrcl_interfaces/ParameterValue[] values\n",
    "SetParameters": "rcl_interfaces/Parameter[] parameters\n---\nrcl_interfaces/SetParametersResult[] results\n",
    "SetParametersAtomically": (
        "rcl_interfaces/Parameter[] parameters\n---\nrcl_interfaces/SetParametersResult result\n"
    ),
    "ListParameters": "string[] prefixes\nuint64 depth\n---\nrcl_interfaces/ListParametersResult result\n",
    "DescribeParameters": "string[] names\n---\nrcl_interfaces/ParameterDescriptor[] descriptors\n",
    "GetParameterTypes": "string[] names\n---\nuint8[] types\n",
}
_RECONFIGURE = {
    "BoolParameter.msg": "string name\nbool value\n",
    "IntParameter.msg": "string name\nint32 value\n",
    "StrParameter.msg": "string name\nstring value\n",
    "DoubleParameter.msg": "string name\nfloat64 value\n",
    "GroupState.msg": "string name\nbool state\nint32 id\nint32 parent\n",
    "Config.msg": (
        "BoolParameter[] bools\nIntParameter[] ints\nStrParameter[] strs\nDoubleParameter[] doubles\n"
        "GroupState[] groups\n"
    ),
    "Reconfigure.srv": "Config config\n---\nConfig config\n",
}
_LIFE_CYCLE = {
    "ChangeState": "lifecycle_msgs/Transition transition\n---\nbool success\n",
    "GetState": "---\nlifecycle_msgs/State current_state\n",
    "GetAvailableStates": "---\nlifecycle_msgs/State[] available_states\n",
    "GetAvailableTransitions": "---\nlifecycle_msgs/TransitionDescription[] available_transitions\n",
}

# By what simulators are reset and paused.

_STATE = "geometry_msgs/Pose pose\ngeometry_msgs/Twist twist\nstring reference_frame\n"
_SIMULATORS_ROS1 = {
    "gazebo_msgs/ModelState.msg": f"string model_name\n{_STATE}",
    "gazebo_msgs/SetModelState.srv": "gazebo_msgs/ModelState model_state\n---\nbool success\nstring status_message\n",
    "webots_ros/get_bool.srv": "bool ask\n---\nbool value\n",
    "webots_ros/set_int.srv": "int32 value\n---\nbool success\n",
}
_SIMULATORS_ROS2 = {
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


def bundled_definitions(generation: int, distro: str) -> dict[str, str]:
    """Return the definitions that are known without any ROS, by name and suffix, for a distribution of ROS 1 or 2.

    ROS 1 has no Nav2; its actions are there for a simulated one.

    Example:
        >>> bundled_definitions(1, "noetic")["webots_ros/set_int.srv"].splitlines()
        ['int32 value', '---', 'bool success']
    """
    result = _NAVIGATION_RESULTS["humble"] if distro in {"foxy", "galactic"} else _NAVIGATION_RESULTS.get(distro)
    navigated = _NAVIGATED.replace(_ESTIMATE, "") if distro == "foxy" else _NAVIGATED
    result = f"{result or _LATEST_NAVIGATION_RESULT}\n---\n{navigated}"
    found = {
        **_STANDARD,
        "ackermann_msgs/AckermannDrive.msg": _CAR,
        "ackermann_msgs/AckermannDriveStamped.msg": "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n",
        "control_msgs/JointTolerance.msg": _TOLERANCE,
        "example_interfaces/Fibonacci.action": _FIBONACCI,
        "nav2_msgs/NavigateToPose.action": f"geometry_msgs/PoseStamped pose\nstring behavior_tree\n---\n{result}",
        "nav2_msgs/NavigateThroughPoses.action": "geometry_msgs/PoseStamped[] poses\nstring behavior_tree\n---\n"
        f"{result}int16 number_of_poses_remaining\n",
        "gazebo_msgs/ModelStates.msg": "string[] name\ngeometry_msgs/Pose[] pose\ngeometry_msgs/Twist[] twist\n",
    }
    if generation == 1:
        return found | {
            "actionlib_tutorials/Fibonacci.action": _FIBONACCI,
            "move_base_msgs/MoveBase.action": "geometry_msgs/PoseStamped target_pose\n---\n---\n"
            "geometry_msgs/PoseStamped base_position\n",
            "control_msgs/FollowJointTrajectory.action": _TRAJECTORY,
            "tf2_msgs/TFMessage.msg": "geometry_msgs/TransformStamped[] transforms\n",
            **{f"dynamic_reconfigure/{name}": text for name, text in _RECONFIGURE.items()},
            **_SIMULATORS_ROS1,
        }
    return found | {
        "action_msgs/CancelGoal.srv": _CANCEL_GOAL,
        "control_msgs/JointComponentTolerance.msg": _COMPONENT_TOLERANCE,
        "control_msgs/FollowJointTrajectory.action": _TRAJECTORY if distro == "foxy" else _MULTI_DOF_TRAJECTORY,
        **{f"rcl_interfaces/{name}.srv": text for name, text in _PARAMETERS.items()},
        **{f"lifecycle_msgs/{name}.srv": text for name, text in _LIFE_CYCLE.items()},
        **_SIMULATORS_ROS2,
    }
