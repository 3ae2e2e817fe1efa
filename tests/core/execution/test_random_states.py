"""Random numbers of runs: each run has others, and the same wherever and whenever it is executed."""

from __future__ import annotations

import csv
import random
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.random_states import seed_random_numbers

DRAWING = """
import random
import numpy as np
from robot_runner import ExperimentConfig, Factor, RunTableModel

np.random.seed(1)
random.seed(1)

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "drawing"

    def before_run(self, context):
        context.share(drawn=random.random() + np.random.normal())

    def populate_run_data(self, context):
        before = context.plugin_data["config"]["drawn"]
        return {"Python": random.random(), "NumPy": np.random.normal(), "Before": before}

    def create_run_table(self):
        return RunTableModel([Factor("A", [1, 2])], repetitions=2, seed=5, data_columns=["Python", "NumPy", "Before"])
"""


def drawn(folder: Path, **settings: str) -> list[tuple[str, ...]]:
    config = folder / "drawing.py"
    folder.mkdir()
    config.write_text(DRAWING, encoding="utf-8")
    finished = execute_experiment(prepare_or_refuse(config, settings), SilentObserver())
    assert finished.done_count == 4, finished.failures
    with (folder / "experiments" / "drawing" / "run_table.csv").open(encoding="utf-8", newline="") as file:
        return [(row["Python"], row["NumPy"], row["Before"]) for row in csv.DictReader(file)]


@pytest.mark.long
def test_each_run_draws_numbers_of_its_own_and_the_same_in_each_kind_of_process(tmp_path: Path) -> None:
    state, of_numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - which the config seeds
    try:
        forked = drawn(tmp_path / "forked")
        assert len(set(forked)) == 4
        for number in range(3):
            assert len({each[number] for each in forked}) == 4
        assert all(float(python) + float(numpy) != float(before) for python, numpy, before in forked)
        assert drawn(tmp_path / "together", workers="2") == forked
        assert drawn(tmp_path / "anew", run_process="spawn") == forked
        assert drawn(tmp_path / "here", run_process="in_process") == forked
    finally:
        random.setstate(state)
        np.random.set_state(of_numpy)  # noqa: NPY002


def test_what_was_not_imported_is_not_seeded_and_what_was_is(monkeypatch: pytest.MonkeyPatch) -> None:
    state, seeds = random.getstate(), []
    try:
        monkeypatch.setitem(sys.modules, "numpy.random", SimpleNamespace(seed=seeds.append))
        monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(manual_seed=seeds.append))
        seed_random_numbers(2**32 - 1)
        monkeypatch.delitem(sys.modules, "numpy.random")
        monkeypatch.delitem(sys.modules, "torch")
        seed_random_numbers(7)
    finally:
        random.setstate(state)
    assert seeds == [2**32 - 1] * 2
