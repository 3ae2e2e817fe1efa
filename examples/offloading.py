"""Offloading: what does it cost a robot to detect objects itself, and what to have them detected on a base station?

The protocol is that of published studies with a TurtleBot3: where the software runs, how large its images are and how
fast the robot drives is varied; the robot is placed by a person, its battery is never low, and the first run of each
placement only warms up. Here the robot is simulated, and the base station is this computer: `--set base=lab@base` names
another one.
"""

import sys

from robot_runner import (
    ExperimentConfig,
    Factor,
    Gate,
    Guard,
    GuardAction,
    Host,
    OperatorStep,
    Question,
    RobotRunnerContext,
    RunTableModel,
    WarmUp,
    all_of,
    battery_above,
    battery_below,
    topic_above,
    topic_present,
    treatment,
)
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3, Program

#: Stands for the software under test: says that it is ready once it finds something, and keeps that in its log.
DETECTOR = """
import itertools, sys, time
width, log = int(sys.argv[1]), open(sys.argv[2], "w")
for found in itertools.count():
    print(f"{time.time():.3f} an object, {width} pixels wide", file=log, flush=True)
    if found == 0:
        print("ready to detect", flush=True)
    time.sleep(0.05)
"""


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "offloading"
    robot = "simulated"
    base = "local"
    log = "/tmp/detections.log"  # noqa: S108 - on the base station, where it is fetched from
    repetitions = 3
    attempts = 2
    gates = [Gate(all_of(battery_above(40), topic_present("/odom")), timeout_s=600)]
    guards = [Guard(battery_below(15), GuardAction.STOP)]
    operator_steps = [
        OperatorStep("place the robot at A", when_changes="Placement", ask=[Question("Light", float, unit="lx", low=0)])
    ]

    def __init__(self) -> None:
        self.hosts = {"base": Host(address=self.base, fetch=[self.log])}
        self.plugins = [
            Program(
                [sys.executable, "-c", DETECTOR, treatment("Width"), self.log], name="Detector", ready="ready to detect"
            ),
            # Computation: the robot detects objects itself. Network: it sends its images to the base station.
            BasicTurtlebot3(task_factor="Placement", speed=treatment("Speed"), sleep_s=1, drive_s=4, task_s=5),
            Ina219(),
        ]

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [Factor("Placement", ["Computation", "Network"]), Factor("Width", [320, 640]), Factor("Speed", [0.1, 0.2])],
            repetitions=self.repetitions,
            data_columns=["Energy", "Duration", "Distance", "StartupTime", "Detections"],
            shuffle=True,
            blocks="Placement",
            seed=1,
            warm_up=WarmUp(1, per="Placement"),
        )

    def start_measurement(self, context: RobotRunnerContext) -> None:
        topic_above("/battery_state", "sensor_msgs/BatteryState", "voltage", 10.0).wait(context, timeout_s=5)

    def populate_run_data(self, context: RobotRunnerContext) -> dict[str, int]:
        (log,) = context.host("base").fetch(self.log)
        return {"Detections": len(log.read_text().splitlines())}
