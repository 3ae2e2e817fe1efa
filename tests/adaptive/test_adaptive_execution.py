"""A search and a race go on from their results; whatever kills the orchestrator, the same runs come next."""

from __future__ import annotations

import csv
import shutil
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import HEAD, written_config

from robot_runner.analysis import analyse, load_results, write_report
from robot_runner.analysis.figures.style import FigureFormat
from robot_runner.analysis.planning.registered import registered
from robot_runner.analysis.report.writing import ReportFormat
from robot_runner.cli.excluding import exclude_runs
from robot_runner.cli.extension import ExtensionRequest, extend_experiment
from robot_runner.core.config.loader import load_config
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.config.registered_config import registration_content
from robot_runner.core.design.asking import AdaptiveDesign, Told
from robot_runner.core.design.batches import as_configured
from robot_runner.core.design.extended_design import Additions
from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.notices import NextDecided, Notice, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.registration import write_registration
from robot_runner.replication.explanation import explain_run
from robot_runner.replication.replicating import prepare_replication

if TYPE_CHECKING:
    from pathlib import Path

WITH_DESIGNS = HEAD.replace(
    "from robot_runner import *", "from robot_runner import *\nfrom robot_runner.adaptive import *"
)
ALL_SPEEDS = "[0.02 * step for step in range(1, 12)]"
TABLE = """\
    def create_run_table(self):
        return RunTableModel(
            [Factor("Speed", [0.02 * step for step in range(1, 12)])], repetitions=2, shuffle=True, seed=3,
            data_columns=[Measure("Energy", "J")], design={design},
        )
"""
SEARCH = 'Optimise("Energy", "minimise", runs=16, at_a_time=2, confirm=3, baseline={"Speed": 0.04})'
RACE = 'Race("Energy", "minimise", at_most=8, confirm=2)'
#: The values of a run depend on its seed alone, so that an interrupted experiment yields the same table. Least at 0.17.
BODY = """
run_process = RunProcess.IN_PROCESS

def populate_run_data(self, context):
    from random import Random
    speed = context.combination["Speed"]
    return {"Energy": (9 / speed + 300 * speed) * (1 + Random(context.run_seed).gauss(0, 0.004))}
"""
#: Dies by SIGKILL at the step of the given number from the first thing on that was decided in this session.
DYING = """
import os, signal, sys
from pathlib import Path
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution import progress_manager, recovered_table
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.storage.journal import Journal

step, steps = int(sys.argv[2]), []

def dying(function, is_step):
    def called(*given, **named):
        if steps or is_step(given):
            if len(steps) == step:
                os.kill(os.getpid(), signal.SIGKILL)
            steps.append(function.__name__)
        return function(*given, **named)
    return called

Journal.append = dying(Journal.append, lambda given: given[1] in {"decided", "extended"})
recovered_table.write_run_table = dying(recovered_table.write_run_table, lambda given: False)
progress_manager.write_manifest = dying(progress_manager.write_manifest, lambda given: False)
execute_experiment(prepare_or_refuse(Path(sys.argv[1])), SilentObserver())
"""


class Recording(SilentObserver):
    def __init__(self) -> None:
        self.decided: list[NextDecided] = []

    def notice(self, notice: Notice) -> None:
        if isinstance(notice, NextDecided):
            self.decided.append(notice)


def with_design(
    folder: Path, design: str = SEARCH, body: str = BODY, *, speeds: str = ALL_SPEEDS, repetitions: int = 2
) -> Path:
    folder.mkdir(exist_ok=True)
    table = TABLE.replace(ALL_SPEEDS, speeds).replace("repetitions=2", f"repetitions={repetitions}")
    return written_config(folder, body, table=table.replace("{design}", design), head=WITH_DESIGNS)


def execute(config: Path, **asked: Any) -> tuple[Any, list[NextDecided]]:
    observer = Recording()
    finished = execute_experiment(prepare_or_refuse(config), observer, resumption=Resumption(**asked))
    return finished, observer.decided


def folder_of(config: Path) -> ExperimentFolder:
    return ExperimentFolder(config.parent / "results" / "trial")


def rows_of(config: Path) -> list[dict[str, str]]:
    with folder_of(config).run_table.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def planned(config: Path) -> list[tuple[str, ...]]:
    columns = ("run_id", "status", "Speed", "Repetition", "batch", "Energy")
    return [tuple(row[name] for name in columns) for row in rows_of(config)]


def records(config: Path, *kinds: str) -> list[dict[str, Any]]:
    return [dict(record) for record in read_journal(folder_of(config).journal, kinds=set(kinds))]


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[NextDecided]]:
    """Return a config whose search was executed, and what was decided; read it only."""
    config = with_design(tmp_path_factory.mktemp("searched"))
    return config, execute(config)[1]


def test_the_first_runs_of_a_search_over_a_range_are_resumed_without_a_warning(tmp_path: Path) -> None:
    config = with_design(tmp_path, speeds="Range(0.02, 0.22, step=0.02)")
    execute(config, only=("r_1",))
    finished, _ = execute(config, only=("r_2",))
    assert finished.findings == ()
    assert finished.done_count == 2


def test_a_search_finds_the_best_within_its_runs_and_confirms_it(searched: tuple[Path, list[NextDecided]]) -> None:
    config, decided = searched
    rows = rows_of(config)
    exploring, confirming = ([row for row in rows if row["batch"] == batch] for batch in ("1", "2"))
    assert len(exploring) == 16
    speeds = [row["Speed"] for row in exploring]
    assert {speeds.count(speed) for speed in speeds} == {2}, "no combination is tried twice"
    best = min(set(speeds), key=lambda speed: sum(float(row["Energy"]) for row in exploring if row["Speed"] == speed))
    assert 0.14 < float(best) < 0.2
    assert sorted({row["Speed"] for row in confirming}) == sorted({"0.04", best})
    assert len(confirming) == 6
    assert [notice.added for notice in decided] == [4, 2, 6, 0]
    assert decided[-1].run_count == len(rows)
    design = read_manifest(folder_of(config).manifest)["design"]
    assert design["parameters"]["directions"] == {"Energy": "minimise"}
    assert [batch.get("role") for batch in design["batches"]] == [None, "confirmation"]
    status = read_status(folder_of(config).root)
    assert "Energy: Speed " in status.decided
    assert status.todo == 0
    (batch,) = explain_run(folder_of(config).root, "r_22", ["batch"]).values
    assert dict(batch.facts)["Runs"].endswith("Z to confirm what was found"), "and is no extension"


@pytest.mark.long
@pytest.mark.usefixtures("optuna_here")
def test_what_was_decided_is_asked_again_from_the_journal_alone(searched: tuple[Path, list[NextDecided]]) -> None:
    config, _ = searched
    model = as_configured(prepare_or_refuse(config).model)
    assert isinstance(model.design, AdaptiveDesign)
    asking = model.design.asking(model.factors, model.allowed, model.repetitions)
    runs = prepare_or_refuse(config).model.plan()
    values = {row["run_id"]: {"Energy": float(row["Energy"])} for row in rows_of(config)}
    for record in records(config, "decided", "extended"):
        decided = [run["run"] for run in record["runs"]]
        before = [Told(run, values[run.run_id]) for run in runs if run.number < int(decided[0].removeprefix("r_"))]
        again = {(str(combination["Speed"]), number) for combination, number in asking.ask(before).runs}
        assert again == {(run["combination"]["Speed"], run["repetition"]) for run in record["runs"]}


@pytest.mark.long
def test_killed_at_any_step_of_a_decision_it_goes_on_as_if_nothing_had_happened(
    tmp_path: Path, searched: tuple[Path, list[NextDecided]]
) -> None:
    config = with_design(tmp_path)
    for step in (0, 1, 3, 2):  # before the record and after it, in the table, in the manifest
        command = [sys.executable, "-c", DYING, str(config), str(step)]
        killed = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert killed.returncode in {-signal.SIGKILL, 0}, killed.stderr
    finished, _ = execute(config)
    assert finished.todo_count == 0
    assert planned(config) == planned(searched[0])
    names = [record.get("name", "batch") for record in records(config, "decided", "extended")]
    assert names == ["combination 6", "combination 8", "batch"], "nothing is decided twice"
    starts = [record["run"] for record in records(config, "attempt_started")]
    assert len(set(starts)) == len(planned(config))


@pytest.mark.long
def test_a_replication_of_what_was_killed_behind_a_decision_has_its_runs_and_goes_on_deciding(tmp_path: Path) -> None:
    config = with_design(tmp_path, RACE, speeds="[0.1, 0.16, 0.17]", repetitions=3)
    command = [sys.executable, "-c", DYING, str(config), "1"]  # before the table has the runs that were decided on
    assert subprocess.run(command, capture_output=True, timeout=120, check=False).returncode == -signal.SIGKILL
    (first,) = records(config, "decided")
    assert {run["run"] for run in first["runs"]}.isdisjoint(row["run_id"] for row in rows_of(config))
    replication = prepare_replication(folder_of(config).root, tmp_path / "again", {})
    assert replication.findings == ()
    execute_experiment(replication.experiment, SilentObserver())
    execute(config)
    again = load_results(replication.experiment.folder.root)
    assert list(again.runs["run_id"].astype(str)) == [row["run_id"] for row in rows_of(config)]
    assert again.manifest["design"]["source"] == "config"


def test_a_lost_table_and_manifest_come_back(tmp_path: Path, searched: tuple[Path, list[NextDecided]]) -> None:
    config = tmp_path / "copy" / "config.py"
    shutil.copytree(searched[0].parent, config.parent)
    folder_of(config).run_table.unlink()
    status = read_status(folder_of(config).root)
    assert (status.run_count, status.todo) == (22, 0), "the journal has what was added"
    folder_of(config).manifest.unlink()
    _, decided = execute(config)
    assert [notice.added for notice in decided] == [0]
    assert planned(config) == planned(searched[0])


@pytest.mark.long
@pytest.mark.usefixtures("optuna_here")
def test_failed_and_excluded_runs_are_told_so_and_the_search_goes_on(tmp_path: Path) -> None:
    failing = BODY.replace(
        "    speed =", '    if context.combination["Speed"] > 0.2: raise RuntimeError("stuck")\n    speed ='
    )
    config = with_design(tmp_path, 'Optimise("Energy", runs=16, at_a_time=3)', failing)
    finished, decided = execute(config)
    assert {row["Speed"] for row in rows_of(config) if row["status"] == "Failed"} == {"0.22"}
    assert records(config, "judged")[-1]["known"]["without_value"] == 1
    assert [notice.added for notice in decided] == [6, 0]
    assert len(finished.failed) == 2
    best = records(config, "judged")[-1]["known"]["best"][0]["combination"]["Speed"]
    exclude_runs(folder_of(config), [row["run_id"] for row in rows_of(config) if row["Speed"] == best], "carried")
    execute(config)
    assert records(config, "judged")[-1]["known"]["best"][0]["combination"]["Speed"] != best


@pytest.mark.long
@pytest.mark.usefixtures("optuna_here")
def test_nothing_is_said_to_be_confirmed_of_which_no_confirming_run_has_a_value(tmp_path: Path) -> None:
    stuck = BODY.replace(
        "    speed =",
        "    if context.repetition > 2 and context.combination['Speed'] > 0.05: raise OSError('stuck')\n    speed =",
    )
    config = with_design(tmp_path, 'Optimise("Energy", runs=12, at_a_time=3, confirm=2)', stuck)
    _, decided = execute(config)
    assert decided[-1].told.endswith("The runs that were to confirm it have no value")
    results = load_results(folder_of(config).root)
    written = write_report(results, kind=ReportFormat.MARKDOWN, output=tmp_path / "report", figures=[])
    report = written.document.read_text(encoding="utf-8")
    assert "What was found by searching is not confirmed" in report
    assert "None of the 2 runs that were to confirm it is done." in report


@pytest.mark.long
@pytest.mark.parametrize("design", ["search", "race"])
def test_what_was_confirmed_is_named_where_it_is_not_the_best_any_more(
    tmp_path: Path, searched: tuple[Path, list[NextDecided]], design: str
) -> None:
    if design == "search":
        config = tmp_path / "copy" / "config.py"
        shutil.copytree(searched[0].parent, config.parent)
    else:
        table = TABLE.replace("0.02 * step for step in range(1, 12)", "0.1, 0.17").replace("=2", "=3")
        config = written_config(tmp_path, BODY, table=table.replace("{design}", RACE), head=WITH_DESIGNS)
        execute(config)
    rows = rows_of(config)
    (best,) = {row["Speed"] for row in rows if row["batch"] == "2"} - {"0.04"}
    exclude_runs(
        folder_of(config), [row["run_id"] for row in rows if row["Speed"] == best and row["batch"] == "1"], "carried"
    )
    execute(config)
    said = read_status(folder_of(config).root).decided
    assert "The confirming runs were of Speed" in said
    assert f"Speed {best}" in said.partition("The confirming runs were of")[2]


def test_a_race_drops_what_is_clearly_worse_and_keeps_its_blocks_balanced(tmp_path: Path) -> None:
    config = with_design(tmp_path, RACE, speeds="[0.1, 0.16, 0.17, 0.18]", repetitions=3)
    _, decided = execute(config)
    rows = rows_of(config)
    assert "dropped: Speed 0.1 (worse than Speed" in decided[0].told
    racing = [row for row in rows if row["batch"] == "1"]
    blocks = [[row["Speed"] for row in racing if row["Repetition"] == str(number)] for number in range(1, 9)]
    assert sorted(blocks[0]) == sorted(blocks[2]) == ["0.1", "0.16", "0.17", "0.18"]
    assert "0.1" not in blocks[3]
    assert all(len(block) == len(set(block)) for block in blocks)
    left = {row["Speed"] for row in rows if row["batch"] == "2"}
    assert left <= {"0.16", "0.17", "0.18"}
    assert len(rows) == len(racing) + 2 * len(left)
    numbers = [run["block"] for record in records(config, "decided") for run in record["runs"]]
    assert numbers[0] == 4
    assert numbers == sorted(numbers)


@pytest.mark.long
def test_side_by_side_the_same_is_decided(tmp_path: Path, searched: tuple[Path, list[NextDecided]]) -> None:
    config = with_design(tmp_path, body=BODY.replace("IN_PROCESS", "FORK\nworkers = 2\nclaims = []"))
    execute(config)
    assert planned(config) == planned(searched[0])
    config.write_text(config.read_text(encoding="utf-8").replace("workers = 2", "workers = 5"), encoding="utf-8")
    (found,) = (each for each in prepare(config).findings if "at a time" in each.problem)
    assert found.problem == "4 of the runs are decided on at a time, which is fewer than there are workers, 5"
    assert found.fix == "Give the design at_a_time=3."


@pytest.mark.long
@pytest.mark.usefixtures("optuna_here")
def test_a_registered_search_is_no_deviation_and_its_replication_executes_the_same_runs(tmp_path: Path) -> None:
    config = with_design(tmp_path, speeds="Range(0.02, 0.22, step=0.02)")
    preparation = prepare(config)
    assert preparation.experiment is not None
    experiment = preparation.experiment
    loaded = load_config(config)
    content = registration_content(loaded, experiment.model, experiment.parameters, experiment.columns)
    assert content["design"]["parameters"]["runs"] == 16
    seal = {**content, "registered_at": "2026-01-01T00:00:00.000Z", "power": None}
    write_registration(config.with_suffix(".registration.json"), seal)
    execute(config)
    results = load_results(folder_of(config).root).confirming
    told = registered(results, analyse(results))
    assert told is not None
    assert (told.deviations, told.problem) == ((), "")
    replication = prepare_replication(folder_of(config).root, tmp_path / "again", {}).experiment
    execute_experiment(replication, SilentObserver())
    again = load_results(replication.folder.root)
    columns = ["run_id", "Speed", "Repetition", "batch", "Energy"]
    assert again.runs[columns].astype(str).equals(results.with_exploration.runs[columns].astype(str))
    assert again.confirming_batches == (2,)


@pytest.mark.usefixtures("optuna_here")
def test_an_adaptive_experiment_is_not_extended_by_hand_and_goes_on_with_more_runs(tmp_path: Path) -> None:
    config = with_design(tmp_path, 'Optimise("Energy", runs=12)')
    execute(config)
    assert len(rows_of(config)) == 12
    preparation = prepare(config, is_for_here=False)
    assert preparation.experiment is not None
    with pytest.raises(ExecutionError, match="nothing is added by hand"):
        extend_experiment(preparation.experiment, ExtensionRequest(added=Additions(repetitions=3)))
    config.write_text(config.read_text(encoding="utf-8").replace("runs=12", "runs=14"), encoding="utf-8")
    execute(config, accept_changes=True)
    assert len(rows_of(config)) == 14


@pytest.mark.usefixtures("optuna_here")
def test_a_range_is_searched_in_its_steps(tmp_path: Path) -> None:
    moving = 'Factor("Speed", Range(0.02, 0.22, step=0.004), when={"Moves": "yes"}), Factor("Moves", ["yes", "no"])'
    table = TABLE.replace('Factor("Speed", [0.02 * step for step in range(1, 12)])', moving)
    design = 'Optimise("Energy", runs=16, at_a_time=3)'
    standing = BODY.replace('["Speed"]', '["Speed"] if context.combination["Moves"] == "yes" else 1')
    config = written_config(tmp_path, standing, table=table.replace("{design}", design), head=WITH_DESIGNS)
    execute(config)
    found = {(row["Speed"], row["Moves"]) for row in rows_of(config)}
    assert len(found) == 8
    assert {speed for speed, moves in found if moves == "no"} <= {"inactive"}
    assert all(0.02 <= float(speed) <= 0.22 for speed, moves in found if moves == "yes")
    _, again = execute(config)
    assert [notice.added for notice in again] == [0]


def test_validation_names_all_that_does_not_fit(tmp_path: Path) -> None:
    body = BODY + '\nrepeat_until = Precision("Energy", half_width="2 %", at_most=30)\n'
    found = prepare(with_design(tmp_path, 'Optimise("Enrgy", runs=16)', body)).findings
    assert {(finding.problem, finding.fix) for finding in found} == {
        ("there is no measure 'Enrgy' to decide by", "Did you mean 'Energy'?"),
        ("the design decides on the runs, and so would repeat_until", "Leave one of them out."),
    }


@pytest.mark.long
@pytest.mark.usefixtures("optuna_here")
def test_the_analysis_is_of_the_runs_that_confirm_and_refuses_to_test_those_of_a_search(
    tmp_path: Path, searched: tuple[Path, list[NextDecided]]
) -> None:
    results = load_results(folder_of(searched[0]).root)
    assert len(results.runs) == 22
    energy = analyse(results).measure("Energy")
    assert energy.overall is not None
    assert energy.overall.n == 6
    assert energy.test is not None
    assert (energy.test.effects[0].p_value or 1) < 0.001
    written = write_report(results, kind=ReportFormat.MARKDOWN, output=tmp_path / "report", figures=[FigureFormat.SVG])
    report = written.document.read_text(encoding="utf-8")
    assert "What was found by searching was measured again" in report
    assert "Confirmation: 6 runs (r\\_17 to r\\_22)" in report
    config = with_design(tmp_path / "searching", 'Optimise("Energy", runs=12)')
    execute(config)
    statistics = analyse(load_results(folder_of(config).root))
    energy = statistics.measure("Energy")
    assert energy.overall is not None
    assert energy.overall.n == 12
    assert (energy.test, energy.post_hoc, statistics.correlations) == (None, (), ())
    assert "they are exploratory" in energy.not_computed[0].why
