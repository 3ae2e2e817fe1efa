"""What a mission of the embedded robot costs in processor time, beside its physics alone."""

from __future__ import annotations

import resource
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco

from benchmarks.table import Row, print_table
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.simulator.model import burger_model
from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND
from robot_runner.simulator.simulated_devices import SimulatedHost, SimulatedSerialLine
from robot_runner.simulator.simulated_link import SimulatedRobotLink
from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

if TYPE_CHECKING:
    from collections.abc import Callable

_TIMES = 5
_FEW, _MANY = 2, 12
_TWIST = "geometry_msgs/Twist"
_TRIGGER = "std_srvs/Trigger"
_SECONDS = 95.0

#: The example of the paper: what begins and ends it is paid by few runs as by many, and not by a run.
_EXPERIMENT = """
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins.profilers import Ina219, PsUtil
from robot_runner.plugins.systems import BasicTurtlebot3

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "missions"
    results_output_path = {folder!r}
    robot = "simulated"
    plugins = [BasicTurtlebot3(task="Video"), Ina219(), PsUtil()]

    def create_run_table(self):
        return RunTableModel([Factor("Run", range({runs}))], data_columns=["CPU", "Memory", "Energy"], seed=1)
"""


def main() -> None:
    """Measure the mission of the paper's Fig. 4, with all that its plugins listen to, and the same steps of physics."""
    bare, heard, sensed, few, many = _least(
        _physics,
        lambda: _mission(with_imu=False),
        lambda: _mission(with_imu=True),
        lambda: _execute(_FEW),
        lambda: _execute(_MANY),
    )
    figures = [
        ("with power meter, on-board computer, odometry", heard, 2.2),
        ("and the inertial sensor at 200 Hz", sensed, 5),
        ("a whole run: forked, measured, evaluated, recorded", (many - few) / (_MANY - _FEW), 3.2),
    ]
    rows = [
        Row(figure, f"{cost:.3f} s", f"{bare:.3f} s (MuJoCo's steps)", f"{cost / bare:.1f}", f"{bound:g}")
        for figure, cost, bound in figures
    ]
    print_table(f"The embedded robot: processor time of {_SECONDS:.0f} s of mission, the least of {_TIMES}", rows)


def _least(*measured: Callable[[], object]) -> list[float]:
    """Return the least processor time of each, s; they take turns, so that a busy moment of the machine meets all."""
    rounds = [[_processor_time(each) for each in measured] for _ in range(_TIMES)]
    return [min(times) for times in zip(*rounds, strict=True)]


def _processor_time(measured: Callable[[], object]) -> float:
    begun = _used()
    measured()
    return _used() - begun


def _used() -> float:
    """Return the processor time of this process and of its children that have ended, user and system, s."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in usages)


def _physics() -> None:
    """Make the steps with all that MuJoCo computes unless it is told otherwise, so that no change of ours moves it."""
    parameters = Turtlebot3Parameters()
    radii = (parameters.wheel_radius, parameters.wheel_radius)
    model = mujoco.MjModel.from_xml_string(burger_model(parameters, radii))
    model.opt.disableflags = 0
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_step(model, data, nstep=round(_SECONDS * STEPS_PER_SECOND))


def _execute(runs: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config.py"
        path.write_text(_EXPERIMENT.format(folder=folder, runs=runs), encoding="utf-8")
        finished = execute_experiment(prepare_or_refuse(path), SilentObserver())
    if finished.done_count != runs:
        raise SystemExit(f"{runs - finished.done_count} of {runs} runs are not done")


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
