"""Does a robot that drives faster need less energy for the same task? Said before the first run, and then looked at.

The plan of the analysis is part of the config: what is asked, of which measure, with which test and at which level. The
report answers that first, and calls everything else exploratory.
"""

from robot_runner import AnalysisPlan, ExperimentConfig, Factor, Hypothesis, RunTableModel, treatment
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "speed_and_energy"
    robot = "simulated"
    repetitions = 5
    plugins = [BasicTurtlebot3(task="Video", speed=treatment("Speed")), Ina219()]
    analysis = AnalysisPlan(
        measures=["MeanPower"],
        secondary=["Energy", "PoseError"],
        hypotheses=[
            Hypothesis("The speed affects the mean power.", measure="MeanPower", factors="Speed"),
            Hypothesis(
                "At 0.2 m/s the mean power is no more than 0.5 W away from that at 0.1 m/s.",
                measure="MeanPower",
                factors="Speed",
                contrast={0.2: 1, 0.1: -1},
                within=0.5,
            ),
        ],
    )

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [Factor("Speed", [0.1, 0.15, 0.2])],
            repetitions=self.repetitions,
            data_columns=["MeanPower", "Energy", "Distance", "PoseError"],
            shuffle=True,
            seed=3,
        )
