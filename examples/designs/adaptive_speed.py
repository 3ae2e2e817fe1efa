"""The most economical speed of the simulated TurtleBot3, found in a quarter of the runs of a full scan.

The robot drives out and back at a speed that the search decides on. What is searched for is the least energy per metre
of way. Then the best speed and the slowest one are executed five times each: these runs confirm it, and are analysed.

Do not expect an optimum in the middle: this robot draws some 9.5 W standing still, and driving adds little to it, so
that whatever is over sooner costs less. That the fastest speed is best is what the search is to find out.
"""

from robot_runner import ExperimentConfig, Factor, Measure, Range, RobotRunnerContext, RunTableModel, treatment
from robot_runner.adaptive import Optimise
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "adaptive_speed"
    robot = "simulated"
    plugins = [
        BasicTurtlebot3(
            speed=treatment("Speed"), task_factor=None, task="Computation", task_s=0.1, sleep_s=0.1, rotate_s=15
        ),
        Ina219(),
    ]
    # Of 41 speeds from 0.02 to 0.22 m/s: a quarter of them, and 10 runs that confirm the best.
    runs = 10
    confirm = 5

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            [Factor("Speed", Range(0.02, 0.22, step=0.005, unit="m/s"))],
            data_columns=[Measure("EnergyPerMetre", "J/m", "Energy for a metre of way."), "Energy", "Distance"],
            shuffle=True,
            design=Optimise(
                "EnergyPerMetre", "minimise", runs=self.runs, confirm=self.confirm, baseline={"Speed": 0.02}
            ),
        )

    def populate_run_data(self, context: RobotRunnerContext) -> dict[str, float]:
        energy, distance = (context.measures[name] for name in ("Energy", "Distance"))
        return {"EnergyPerMetre": energy / distance}
