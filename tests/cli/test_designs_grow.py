"""What of a design can grow does, and what cannot is refused with the reason and what can be done."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import HEAD

from robot_runner.cli.extension import ExtensionRequest, extend_experiment
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.design.extended_design import Additions, NewFactor
from robot_runner.core.errors import DesignError

if TYPE_CHECKING:
    from collections.abc import Callable

DESIGNS = f"from robot_runner.designs import *\n{HEAD}"
TABLE = """
    def create_run_table(self):
        factors = [Factor("Task", ["a", "b"]), Factor("Floor", ["wood", "tiles"]), Factor("Speed", [1, 2])]
        return RunTableModel(factors, data_columns=["Energy"], design=DESIGN)
"""
BODY = """
run_process = RunProcess.IN_PROCESS
claims = []
def populate_run_data(self, context):
    return {"Energy": len(str(context.combination))}
"""


@pytest.mark.long
def test_one_factor_at_a_time_takes_further_treatments(execute: Callable[..., Any]) -> None:
    table = TABLE.replace("DESIGN", 'OneFactorAtATime(base={"Speed": 1})')
    first = execute(BODY, head=DESIGNS, table=table)
    assert len(first.table) == 4
    added = Additions(treatments={"Speed": ["3"], "Floor": ["carpet"]})
    extend_experiment(prepare_or_refuse(first.config), ExtensionRequest(added=added, as_written=True))
    done = execute(BODY, head=DESIGNS, table=table)
    assert {row["status"] for row in done.table} == {"Done"}
    rows = [(row["Task"], row["Floor"], row["Speed"]) for row in done.table]
    assert rows[4:] == [("a", "carpet", "1"), ("a", "wood", "3")]
    extend_experiment(prepare_or_refuse(first.config), ExtensionRequest(added=Additions(repetitions=2)))
    again = execute(BODY, head=DESIGNS, table=table)
    assert sorted((row["Task"], row["Floor"], row["Speed"]) for row in again.table[6:]) == sorted(rows)


@pytest.mark.long
@pytest.mark.parametrize("design", ["FractionalFactorial(resolution=3)", "CoveringArray()", "DOptimal(runs=6)"])
def test_a_design_that_would_choose_others_is_refused_with_what_can_be_done(
    execute: Callable[..., Any], design: str
) -> None:
    first = execute(BODY, head=DESIGNS, table=TABLE.replace("DESIGN", design))
    experiment = prepare_or_refuse(first.config)
    more = extend_experiment(experiment, ExtensionRequest(added=Additions(repetitions=2), dry_run=True))
    assert len(more.runs) == len(first.table)
    for added in (Additions(treatments={"Speed": ["3"]}), Additions(factors={"Load": NewFactor("0", ("1",))})):
        with pytest.raises(DesignError) as refused:
            extend_experiment(experiment, ExtensionRequest(added=added))
        assert "chose its combinations from the factors as the config has them" in str(refused.value)
        assert "Add repetitions, or execute an experiment of its own" in str(refused.value)


@pytest.mark.long
@pytest.mark.parametrize("design", ["CentralComposite(centre=3)", "BoxBehnken()"])
def test_a_further_repetition_of_a_surface_has_all_its_centre_points(execute: Callable[..., Any], design: str) -> None:
    factors = ", ".join(f'Factor("{name}", Range(0, 1, step=0.1))' for name in "XYZ")
    table = f"""
    def create_run_table(self):
        return RunTableModel([{factors}], data_columns=["Energy"], design={design})
"""
    first = execute(BODY, head=DESIGNS, table=table)
    planned = sorted((row["X"], row["Y"], row["Z"]) for row in first.table)
    for repetition in (2, 3):  # the table counts repetitions from the second one on
        added = Additions(repetitions=repetition)
        more = extend_experiment(prepare_or_refuse(first.config), ExtensionRequest(added=added)).runs
        assert sorted(run.combination.texts for run in more) == planned
        assert {run.repetition for run in more} == {repetition}
        assert execute(BODY, head=DESIGNS, table=table).finished.done_count == repetition * len(planned)
