"""An experiment for Robot Runner: which tasks of a robot cost how much energy?

Execute it as it is (a simulated robot, some seconds), then make it yours:

    robot-runner check {file}      says what is wrong
    robot-runner plan {file}       shows the run table before anything is executed
    robot-runner {file}            executes it; again, and it resumes
"""

from pathlib import Path

from robot_runner import (
    ExperimentConfig,
    ExperimentContext,
    Factor,
    Measure,
    OperationType,
    RobotRunnerContext,
    RunTableModel,
)
from robot_runner.plugins.profilers import Ina219, PsUtil
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    """The experiment: static parameters, run table, and what happens at its events."""

    # ---- Static parameters. Any of them can be set from outside: robot-runner {file} --set robot=simulated

    # Names the experiment and its folder. Another name is another experiment.
    experiment_name = "my_experiment"

    # Where that folder is made; a relative path begins where this file is.
    results_output_path = Path("experiments")

    # AUTO starts each run by itself; SEMI waits before each run until you say so.
    operation_type = OperationType.AUTO

    # What you do before a run, and what you are asked then, a measure of that run: import OperatorStep and Question.
    # operator_steps = [OperatorStep("swap the battery", every=5, ask=[Question("voltage", float, unit="V")])]

    # How long the robot rests between two runs.
    time_between_runs_in_ms = 0

    # How the robot is reached. "simulated" is the TurtleBot3 that comes with Robot Runner.
    robot = "simulated"

    # What the experiment requires of a real robot's ROS; a simulated robot needs none.
    # required_ros_version = 1
    # required_ros_distro = "noetic"

    # What operates the robot and what measures: `robot-runner plugins` lists what is installed.
    plugins = [
        BasicTurtlebot3(sleep_s=1, drive_s=4, task_s=4, rotate_s=12),  # a short mission; 95 s with its defaults
        Ina219(),
        PsUtil(),
    ]

    # ---- The run table: what is varied, how often, in which order, and which measures each run yields.

    def create_run_table(self) -> RunTableModel:
        """Return the model of the run table."""
        run_table = RunTableModel(
            factors=[Factor("Task", ["Computation", "Video", "Network"])],
            repetitions=2,
            data_columns=[
                "Energy",
                "CPU",
                "Memory",
                Measure("EnergyPerMeter", "J/m", "Energy drawn over the mission, for each metre of the way."),
            ],
        )
        # The seed is recorded with the results; give one, randomize_runs_order(seed=1), for the same order each time.
        run_table.randomize_runs_order()
        return run_table

    # ---- Events, in their order. Keep those that you need; plugins have them, too.

    def before_experiment(self, context: ExperimentContext) -> None:
        """Prepare what all runs share. Called once; prints to the terminal."""

    def before_run(self, context: RobotRunnerContext) -> None:
        """Prepare the robot's surroundings. From here on `context.combination` tells what this run varies."""

    def start_run(self, context: RobotRunnerContext) -> None:
        """Start what this run needs. From here to `populate_run_data`, what you print goes to the run's log."""
        print(f"{context.run_id}: {context.combination['Task']}, repetition {context.repetition}")

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Start a measurement of your own; the profilers have started theirs by now."""

    def launch_mission(self, context: RobotRunnerContext) -> None:
        """Do what is to be measured, beside what the system plugin does; to wait, use `context.clock.sleep(5)`."""

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """Stop your own measurement. Called whatever happened since `start_measurement`."""

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Stop what `start_run` started. Called whatever happened since then."""

    def populate_run_data(self, context: RobotRunnerContext) -> dict[str, float | None]:
        """Add to the measures of the plugins, or override them: what is returned goes into the run table."""
        energy, distance = context.measures["Energy"], context.measures["Distance"]
        if not isinstance(energy, float) or not isinstance(distance, float) or distance == 0:
            return {"EnergyPerMeter": None}  # no value: never a guess
        return {"EnergyPerMeter": energy / distance}

    def continue_experiment(self, context: RobotRunnerContext) -> None:
        """Say what is to be done before `context.next_run`. SEMI only, before you are asked to press ENTER."""

    def after_experiment(self, context: ExperimentContext) -> None:
        """Tidy up what `before_experiment` prepared. Called whatever happened in between."""
