"""The built-in plugins that operate a robot, and the software under test."""

from __future__ import annotations

from robot_runner.core.doors import open_door

TYPE_CHECKING = False
if TYPE_CHECKING:
    from robot_runner.meters.machine.tuned_machine import Tune as Tune
    from robot_runner.ros.lifecycle_states import Lifecycle as Lifecycle
    from robot_runner.ros.missions.action_mission import ActionMission as ActionMission
    from robot_runner.ros.missions.together import Together as Together
    from robot_runner.ros.missions.topic_mission import TopicMission as TopicMission
    from robot_runner.ros.missions.waypoints import Waypoints as Waypoints
    from robot_runner.ros.play_bag import PlayBag as PlayBag
    from robot_runner.ros.ros_parameters import RosParameters as RosParameters
    from robot_runner.ros.simulators.simulation_system import Simulation as Simulation
    from robot_runner.ros.turtlebot3.basic_turtlebot3 import BasicTurtlebot3 as BasicTurtlebot3
    from robot_runner.simulator.simulated_world import SimulatedWorld as SimulatedWorld
    from robot_runner.subjects.compose_project import ComposeProject as ComposeProject
    from robot_runner.subjects.program import Program as Program
    from robot_runner.subjects.ros_launch import RosLaunch as RosLaunch
    from robot_runner.subjects.ros_node import RosNode as RosNode
else:
    __getattr__, __dir__ = open_door(__name__)
