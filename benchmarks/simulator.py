"""How long a mission of the embedded robot takes beside its physics alone."""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING

import mujoco

from benchmarks.table import Row, print_table
from robot_runner.simulator.model import burger_model
from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND
from robot_runner.simulator.simulated_devices import SimulatedHost, SimulatedSerialLine
from robot_runner.simulator.simulated_link import SimulatedRobotLink
from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

if TYPE_CHECKING:
    from collections.abc import Callable

_TIMES = 5
_BOUND = 2.0
_TWIST = "geometry_msgs/Twist"
_TRIGGER = "std_srvs/Trigger"
_SECONDS = 95.0


def main() -> None:
    """Time the mission of the paper's Fig. 4, with all that its plugins listen to, and the same steps of physics."""
    bare = _median(_physics)
    rows = [
        _row("with power meter, on-board computer, odometry", _median(lambda: _mission(with_imu=False)), bare),
        _row("and the inertial sensor at 200 Hz", _median(lambda: _mission(with_imu=True)), bare),
    ]
    print_table(f"The embedded robot: {_SECONDS:.0f} s of mission, median of {_TIMES}", rows)


def _row(figure: str, seconds: float, floor: float) -> Row:
    ratio = f"{seconds / floor:.1f}"
    return Row(figure, f"{seconds:.2f} s", f"{floor:.2f} s (MuJoCo's steps)", ratio, f"{_BOUND:.0f} s")


def _median(measured: Callable[[], object]) -> float:
    return statistics.median(_seconds(measured) for _ in range(_TIMES))


def _seconds(measured: Callable[[], object]) -> float:
    begun = time.perf_counter()
    measured()
    return time.perf_counter() - begun


def _physics() -> None:
    parameters = Turtlebot3Parameters()
    radii = (parameters.wheel_radius, parameters.wheel_radius)
    model = mujoco.MjModel.from_xml_string(burger_model(parameters, radii))
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_step(model, data, nstep=round(_SECONDS * STEPS_PER_SECOND))


def _mission(*, with_imu: bool) -> None:
    simulation = Simulation(seed=1)
    sleep = simulation.clock.sleep
    link, line = SimulatedRobotLink(simulation), SimulatedSerialLine(simulation)
    sampler = SimulatedHost(simulation).sample_utilisation(10)
    link.subscribe("odom", "nav_msgs/Odometry", lambda _: None)
    if with_imu:
        link.subscribe("imu", "sensor_msgs/Imu", lambda _: None)
    sleep(5)
    _drive(link, linear=0.2)
    sleep(10)
    _drive(link)
    for _ in range(3):
        sleep(5)
        link.call("task/video/start", _TRIGGER)
        sleep(10)
        link.call("task/video/stop", _TRIGGER)
    sleep(5)
    _drive(link, angular=0.21)
    sleep(15)
    _drive(link, linear=0.2)
    sleep(10)
    _drive(link)
    sleep(5)
    line.drain()
    sampler.stop()
    for opened in (link, line, simulation):
        opened.close()


def _drive(link: SimulatedRobotLink, *, linear: float = 0.0, angular: float = 0.0) -> None:
    link.publish("cmd_vel", _TWIST, {"linear": {"x": linear}, "angular": {"z": angular}})


if __name__ == "__main__":
    main()
