"""The link to the embedded robot keeps to the contract of links."""

from __future__ import annotations

from robot_runner.simulator.simulated_link import SimulatedRobotLink
from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.testing import RobotLinkContract


class TestSimulatedRobotLink(RobotLinkContract):
    def setup_method(self):
        self.simulation = Simulation(seed=1)

    def teardown_method(self):
        self.simulation.close()

    def make_link(self, namespace=""):
        return SimulatedRobotLink(self.simulation, namespace=namespace)

    def pass_time(self, seconds):
        self.simulation.clock.sleep(seconds)
