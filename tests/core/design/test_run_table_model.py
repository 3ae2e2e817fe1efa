"""The run-table model checks a design as a whole and puts its runs in order."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError

if TYPE_CHECKING:
    from robot_runner.core.design.run_table_model import RunTable

TASK = Factor("Task", ["Computation", "Video", "Network"])
SPEED = Factor("Speed", [0.1, 0.2])


def findings_of(*arguments: Any, **keywords: Any) -> list[str]:
    with pytest.raises(DesignError) as caught:
        RunTableModel(*arguments, **keywords)
    return [str(finding) for finding in caught.value.findings]


def rows(table: RunTable) -> list[tuple[Any, ...]]:
    return [(*run.combination.values(), run.repetition) for run in table]


def test_the_papers_listing_gives_its_fifteen_runs_in_a_random_order() -> None:
    run_table = RunTableModel(
        factors=[TASK, Factor("Repetition", range(1, 6))],
        data_columns=["CPU", "Memory", "Energy"],
    )
    run_table.create_experiment_run_table()
    run_table.randomize_runs_order()
    plan = run_table.plan()
    assert sorted(rows(plan)) == sorted((task, number, 1) for task in TASK.treatments for number in range(1, 6))
    assert [run.run_id for run in plan] == [f"r_{number}" for number in range(1, 16)]
    assert run_table.data_columns == ("CPU", "Memory", "Energy")
    assert run_table.shuffle
    assert not run_table.seed_is_given


def test_as_written_the_first_factor_is_the_slowest_and_repetitions_come_after_all_combinations() -> None:
    model = RunTableModel([Factor("A", [1, 2]), Factor("B", ["x", "y"])], repetitions=2)
    once = [(1, "x"), (1, "y"), (2, "x"), (2, "y")]
    assert rows(model.plan()) == [(*pair, 1) for pair in once] + [(*pair, 2) for pair in once]


def test_both_calls_of_the_paper_work_in_either_order_and_may_be_returned() -> None:
    first = RunTableModel([TASK], seed=1)
    first.create_experiment_run_table()
    shuffled = first.randomize_runs_order()
    second = RunTableModel([TASK])
    second.randomize_runs_order(seed=1)
    assert rows(second.create_experiment_run_table()) == rows(shuffled) == rows(first.plan())
    assert shuffled.model is first
    assert shuffled.seed == first.seed == 1


def test_the_seed_is_drawn_once_and_recorded() -> None:
    model = RunTableModel([Factor("N", range(50))], shuffle=True)
    other = RunTableModel([Factor("N", range(50))], shuffle=True)
    assert not model.seed_is_given
    assert model.seed != other.seed  # one in four thousand million to be equal
    assert rows(model.plan()) == rows(model.plan())
    assert rows(RunTableModel([Factor("N", range(50))], shuffle=True, seed=model.seed).plan()) == rows(model.plan())


def test_a_recorded_seed_takes_the_place_of_a_drawn_one_and_not_of_a_given_one() -> None:
    drawn = RunTableModel([Factor("N", range(50))], shuffle=True)
    given = RunTableModel([Factor("N", range(50))], shuffle=True, seed=7)
    assert drawn.plan(seed=7).seed == 7
    assert rows(drawn.plan(seed=7)) == rows(given.plan(seed=8)) == rows(given.plan())
    assert rows(drawn.plan()) != rows(drawn.plan(seed=7))
    assert drawn.seed == drawn.plan().seed != 7


def test_the_order_from_a_seed_is_the_same_in_every_version() -> None:
    table = RunTableModel([Factor("N", range(8))], shuffle=True, seed=2021).plan()
    assert [run.combination["N"] for run in table] == [4, 0, 5, 2, 1, 3, 7, 6]


def test_the_number_zero_is_a_seed() -> None:
    model = RunTableModel([TASK], seed=0)
    assert (model.seed, model.seed_is_given) == (0, True)


def test_blocks_of_repetitions_are_complete_and_stay_in_order() -> None:
    table = RunTableModel([TASK, SPEED], repetitions=3, shuffle=True, seed=5, blocks="Repetition").plan()
    assert [run.block for run in table] == [run.repetition for run in table] == [1] * 6 + [2] * 6 + [3] * 6
    assert [run.combination["Task"] for run in table[:3]] != list(TASK.treatments)


def test_blocks_of_a_factor_are_complete_and_stay_in_order() -> None:
    model = RunTableModel([SPEED, TASK], repetitions=2)
    table = model.randomize_runs_order(seed=3, blocks=TASK)
    assert [run.combination["Task"] for run in table] == [task for task in TASK.treatments for _ in range(4)]
    assert [run.block for run in table] == [1] * 4 + [2] * 4 + [3] * 4
    assert model.blocks == "Task"


def test_blocks_without_shuffling_keep_runs_together_in_the_order_as_written() -> None:
    table = RunTableModel([SPEED, TASK], blocks="Task").plan()
    assert rows(table)[:3] == [(0.1, "Computation", 1), (0.2, "Computation", 1), (0.1, "Video", 1)]


def test_a_block_that_is_excluded_leaves_no_gap() -> None:
    table = RunTableModel([TASK, SPEED], [{"Task": "Computation"}], blocks="Task").plan()
    assert [run.block for run in table] == [1, 1, 2, 2]


def test_a_factor_may_be_called_repetition_where_there_are_none() -> None:
    model = RunTableModel([TASK, Factor("Repetition", range(1, 3))], blocks="Repetition", shuffle=True)
    assert [run.combination["Repetition"] for run in model.plan()] == [1, 1, 1, 2, 2, 2]


@pytest.mark.parametrize(
    ("factors", "finding"),
    [
        ([], "factors: there are none → Give at least one Factor(...)."),
        (5, "factors: 5 is of type int → Give a list of Factor(...)."),
        ([TASK, "Speed"], "factors[1]: 'Speed' is of type str → Give a Factor(name, treatments)."),
        ([TASK, Factor("Task", [1])], "factors[1]: factor 'Task' is given twice → Rename or remove it."),
        (
            [Factor("A", range(100_000)), Factor("B", range(1000))],
            (
                "factors: the design has 100,000,000 runs before exclusions; 10,000,000 is the most → "
                "Give fewer treatments or repetitions."
            ),
        ),
    ],
)
def test_factors_that_make_no_design_are_refused(factors: Any, finding: str) -> None:
    assert findings_of(factors) == [finding]


def test_a_design_of_more_runs_than_python_writes_is_refused_with_their_power_of_ten() -> None:
    (finding,) = findings_of([Factor(f"F{number}", range(10)) for number in range(5000)])
    assert "the design has 10^5000 runs before exclusions" in finding


def test_a_single_factor_is_no_list_of_factors() -> None:
    assert findings_of(TASK)[0].endswith("is of type Factor → Give a list of Factor(...).")


@pytest.mark.parametrize(
    ("keywords", "finding"),
    [
        ({"repetitions": 0}, "repetitions: 0 is less than 1 → Give a whole number from 1."),
        ({"repetitions": True}, "repetitions: True is of type bool → Give a whole number from 1."),
        ({"repetitions": 2.0}, "repetitions: 2.0 is of type float → Give a whole number from 1."),
        ({"shuffle": "yes"}, "shuffle: 'yes' is of type str → Give True or False."),
        ({"seed": -1}, "seed: the seed is -1 → Give a whole number from 0, or leave it out."),
        ({"seed": 1 << 1024}, "seed: the seed has 1,025 bits → Give a whole number from 0, or leave it out."),
        ({"seed": "7"}, "seed: '7' is of type str → Give a whole number from 0, or leave it out."),
        ({"blocks": "task"}, "blocks: there is nothing called 'task' to make blocks of → Did you mean 'Task'?"),
        (
            {"blocks": "Repetition"},
            (
                "blocks: there is nothing called 'Repetition' to make blocks of → "
                "Give repetitions=2 or more, or name a factor."
            ),
        ),
        (
            {"data_columns": "Energy"},
            ("data_columns: 'Energy' is of type str → Give a list of names, or leave it out for all measures."),
        ),
        ({"data_columns": ["A", "A"]}, "data_columns[1]: column 'A' is given twice → Remove one."),
        (
            {"data_columns": ["Task"]},
            "data_columns[0]: 'Task' is the name of a factor → Rename the factor or the measure.",
        ),
        (
            {"data_columns": ["Run_ID"]},
            "data column 'Run_ID': the run table has a column of that name already → Choose another name.",
        ),
        (
            {"data_columns": ["Repetition"], "repetitions": 2},
            (
                "data column 'Repetition': the run table has a column of that name already → "
                "Choose another name, or leave out repetitions= and vary it as a factor."
            ),
        ),
        ({"data_columns": [1]}, "data column 1: the name is of type int → Give a string."),
    ],
)
def test_settings_that_make_no_design_are_refused(keywords: dict[str, Any], finding: str) -> None:
    assert findings_of([TASK, SPEED], **keywords) == [finding]


def test_a_factor_called_repetition_and_repetitions_exclude_each_other() -> None:
    assert findings_of([Factor("Repetition", [1, 2])], repetitions=3) == [
        (
            "factor 'Repetition': the run table has a column of that name already → "
            "Choose another name, or leave out repetitions= and vary it as a factor."
        )
    ]


def test_everything_that_is_wrong_is_listed_at_once() -> None:
    findings = findings_of([TASK], [{"Tsk": 1}], repetitions=0, data_columns=["x", "x"], seed=-1, blocks="Tusk")
    assert [finding.partition(":")[0] for finding in findings] == [
        "repetitions",
        "data_columns[1]",
        "seed",
        "blocks",
        "exclude_combinations[0]",
    ]


def test_a_wrong_call_for_a_random_order_changes_nothing() -> None:
    model = RunTableModel([TASK], seed=1)
    with pytest.raises(DesignError, match="nothing called 'Tsk'"):
        model.randomize_runs_order(seed=5, blocks="Tsk")
    assert (model.seed, model.blocks, model.shuffle) == (1, None, False)
