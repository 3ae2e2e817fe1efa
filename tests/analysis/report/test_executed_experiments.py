"""What the analysis tells of experiments that were executed with a person, and with what came after their runs.

The tests of executions fork their process many times, which is dear once the analysis has been imported into it:
docs/decisions/0062-small-processes-for-the-tests.md.
"""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from tests.conftest import written_config
from tests.core.execution.conftest import execute_in
from tests.core.execution.test_operator import TABLE, VOLTAGE, Person, steps
from tests.core.execution.test_orchestrated_events import PUBLISHING, TWO_RUNS

from robot_runner.analysis import load_results
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.threats_section import threats_of
from robot_runner.analysis.statistics.experiment_statistics import analyse
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.orchestrator import execute_experiment

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.long
def test_nothing_is_said_of_what_nobody_was_asked(tmp_path: Path) -> None:
    body = f"""
    {steps(f'OperatorStep("swap the battery", every=3, ask=[{VOLTAGE}])')}
    def populate_run_data(self, context):
        return {{"Energy": None if context.run_id == "r_2" else 1.0}}
    """
    config = written_config(tmp_path, body, table=TABLE)
    with closing(Person(lambda _: "11\n")) as person:
        finished = execute_experiment(prepare_or_refuse(config), person)
    results = load_results(finished.folder)
    assert results.runs["voltage"].fillna(0.0).tolist() == [11.0, 0.0, 0.0, 11.0]
    told = results.quality[["run_id", "measure", "quality"]]
    assert [each for each in told.itertuples(index=False, name=None) if each[2] != "good"] == [
        ("r_2", "Energy", "missing")
    ]
    threats = [each.title for each in threats_of(Material(results, analyse(results)))]
    assert [each for each in threats if "missing" in each] == ["Energy has missing values"]


def test_what_continue_published_is_among_what_runs_published(tmp_path: Path) -> None:
    executed = execute_in(tmp_path, PUBLISHING, table=TWO_RUNS)
    (tmp_path / "results" / "trial" / "run_table.csv").unlink()
    assert execute_in(tmp_path, PUBLISHING, table=TWO_RUNS).finished.done_count == 2
    published = load_results(executed.folder).published
    assert published.loc[published["measure"] == "Energy", "value"].tolist() == [4.5]
