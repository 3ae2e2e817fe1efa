"""The experiment of the Robot Runner paper (Swanborn and Malavolta, ICSE 2021), on the embedded robot.

Three tasks, each executed five times in a random order, while energy, CPU and memory are measured.
"""

from pathlib import Path

from robot_runner import Author, ExperimentConfig, Factor, OperationType, RunTableModel
from robot_runner.plugins.profilers import Ina219, PsUtil
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    """What the paper's Listing 1 describes; the robot is simulated, and no user has to continue between two runs."""

    experiment_name = "basic_experiment"
    results_output_path = Path()  # beside this file
    operation_type = OperationType.AUTO
    robot = "simulated"
    plugins = [BasicTurtlebot3(), Ina219(), PsUtil()]

    # Named in a replication package (robot-runner pack). ORCID's fictitious researcher holds the place: name yourself.
    authors = [
        Author(
            "Josiah Carberry",
            orcid="0000-0002-1825-0097",
            affiliation="Brown University",
            affiliation_url="https://ror.org/05gq02987",
        )
    ]
    licence = "CC-BY-4.0"
    citation = "https://doi.org/10.1109/ICSE-Companion52605.2021.00029"

    def create_run_table(self) -> RunTableModel:
        """Return the run table of the paper's Fig. 3: 15 runs."""
        run_table = RunTableModel(
            factors=[Factor("Task", ["Computation", "Video", "Network"]), Factor("Repetition", range(1, 6))],
            data_columns=["CPU", "Memory", "Energy"],
        )
        run_table.randomize_runs_order(seed=2021)  # the same order each time
        return run_table
