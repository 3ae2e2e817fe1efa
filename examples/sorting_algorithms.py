"""An experiment without any robot: how long do two sorting algorithms take on the same numbers?

Everything is done by the config's own callbacks: no plugins, no links.
"""

import random
import time
from itertools import pairwise

from robot_runner import ExperimentConfig, Factor, RobotRunnerContext, RunTableModel


def insertion_sort(numbers: list[float]) -> list[float]:
    ordered = numbers.copy()
    for end in range(1, len(ordered)):
        number, place = ordered[end], end
        while place > 0 and ordered[place - 1] > number:
            ordered[place] = ordered[place - 1]
            place -= 1
        ordered[place] = number
    return ordered


ALGORITHMS = {"insertion sort": insertion_sort, "timsort": sorted}


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "sorting_algorithms"
    largest = 2000  # --set largest=100 makes it quicker

    def create_run_table(self) -> RunTableModel:
        return RunTableModel(
            factors=[
                Factor("Algorithm", list(ALGORITHMS)),
                Factor("Size", [self.largest // 10, self.largest]),
            ],
            repetitions=3,
            data_columns=["Seconds", "IsSorted"],
            shuffle=True,
            seed=7,
        )

    def start_run(self, context: RobotRunnerContext) -> None:
        # The run's own seed: other numbers in each run, and the same again when the run is repeated.
        draw = random.Random(context.run_seed)  # noqa: S311 - reproducible, not secret
        self.numbers = [draw.random() for _ in range(context.combination["Size"])]

    def launch_mission(self, context: RobotRunnerContext) -> None:
        sort = ALGORITHMS[context.combination["Algorithm"]]
        began = time.perf_counter()
        self.ordered = sort(self.numbers)
        self.seconds = time.perf_counter() - began

    def populate_run_data(self, context: RobotRunnerContext) -> dict[str, object]:
        return {"Seconds": self.seconds, "IsSorted": all(one <= other for one, other in pairwise(self.ordered))}
