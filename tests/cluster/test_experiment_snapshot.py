"""A config travels to workers as it stands on the disk."""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from robot_runner.cluster.experiment_snapshot import experiment_of, inputs_of, snapshot_of, task_here, texts_here
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.design.asking import DECIDED
from robot_runner.core.design.batch import Batch, BatchRun
from robot_runner.core.design.planned_runs import RunOrder
from robot_runner.core.errors import ConfigError
from robot_runner.core.execution.given_values import given_values
from robot_runner.core.execution.task import RunTask
from robot_runner.core.execution.worker import described_task, task_of
from robot_runner.core.storage import input_files
from robot_runner.core.storage.input_files import InputFile
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.manifest import write_manifest

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

CONFIG = """\
from places_of_this_study import PLACES

from robot_runner import ExperimentConfig, Factor, RunTableModel


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"

    def create_run_table(self):
        return RunTableModel([Factor("Place", PLACES)])
"""
PLACES = "# -*- coding: latin-1 -*-\nPLACES = ['Caf\N{LATIN SMALL LETTER E WITH ACUTE}', 'Lab']\n"


def test_a_module_in_another_encoding_travels_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "study.py").write_text(CONFIG, encoding="utf-8")
    neighbour = tmp_path / "places_of_this_study.py"
    neighbour.write_bytes(PLACES.encode("latin-1"))
    with own_modules():
        snapshot = json.loads(json.dumps(snapshot_of(prepare_or_refuse(tmp_path / "study.py", {}))))
    with own_modules():
        there = experiment_of(snapshot, tmp_path / "worker")
    assert (there.config_path.parent / neighbour.name).read_bytes() == neighbour.read_bytes()
    assert "Caf\N{LATIN SMALL LETTER E WITH ACUTE}" in next(iter(there.model.factors)).treatments


def test_a_worker_has_the_experiment_s_name_though_the_config_makes_another_each_time(tmp_path: Path) -> None:
    named = CONFIG.replace('"trial"', 'f"trial_{time.time_ns()}"').replace("PLACES)", "[1])")
    (tmp_path / "study.py").write_text(f"import time\n{named.partition('PLACES')[2]}", encoding="utf-8")
    here = prepare_or_refuse(tmp_path / "study.py", {})
    there = experiment_of(json.loads(json.dumps(snapshot_of(here))), tmp_path / "worker")
    assert there.parameters.experiment_name == here.parameters.experiment_name


REVISIONS = """\
from robot_runner import ExperimentConfig, Factor, RunTableModel

VERSION = Factor.revisions("Version", "repository", ["v1.0"])


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"

    def create_run_table(self):
        return RunTableModel([VERSION])
"""


def test_a_worker_without_the_work_tree_of_a_revision_executes_nothing(tmp_path: Path) -> None:
    (tmp_path / "study.py").write_text(REVISIONS, encoding="utf-8")
    experiment = prepare(tmp_path / "study.py", is_for_here=False).experiment
    assert experiment is not None
    (revision,) = experiment.model.factors[0].treatments
    tree = tmp_path / "tree"
    revision.prepare(commit="1a2b3c", path=str(tree))
    snapshot = snapshot_of(experiment)
    with pytest.raises(ConfigError, match=f"the work tree of 'v1.0' is not here: {tree}"):
        experiment_of(snapshot, tmp_path / "without")
    tree.mkdir()
    there = experiment_of(snapshot, tmp_path / "with")
    assert there.model.factors[0].treatments[0].path == str(tree)


def test_a_file_that_is_too_large_to_travel_has_to_be_the_same_on_the_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(input_files, "_LARGEST", 3)
    hall = tmp_path / "data" / "hall.csv"
    hall.parent.mkdir()
    hall.write_text("1,2\n", encoding="utf-8")
    kept = tmp_path / "kept"
    for path, content in input_files.kept_contents([InputFile(hall)], tmp_path / "study", kept).items():
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    with inputs_of(kept, tmp_path / "same"):
        assert input_files.input_file(hall) == hall
    hall.write_text("1,3\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=f"{hall}: there is no copy of it, and the one here is another"):
        inputs_of(kept, tmp_path / "another").__enter__()


def test_a_worker_knows_the_treatments_that_a_search_has_chosen_before_it_was_resumed(tmp_path: Path) -> None:
    (tmp_path / "places_of_this_study.py").write_text("PLACES = [0.1, 0.2]", encoding="utf-8")
    (tmp_path / "study.py").write_text(CONFIG, encoding="utf-8")
    journal = tmp_path / "results" / "trial" / "journal.jsonl"
    journal.parent.mkdir(parents=True)
    runs = [BatchRun("r_1", {"Place": "0.1"}), BatchRun("r_2", {"Place": "0.15"})]
    first = Batch(number=1, order=RunOrder(seed=1), repetitions=1, factors={"Place": [0.1, 0.2]}, runs=runs[:1])
    chosen = {"name": "combination 2", "runs": [runs[1].as_mapping()], "factors": {"Place": [0.1, 0.15, 0.2]}}
    with Journal(journal) as opened:
        opened.append(DECIDED, why="", known={}, base=first.as_mapping(), **chosen)
    with own_modules():
        here = prepare_or_refuse(tmp_path / "study.py", {})
        task = RunTask("r_2", 2, 2, 1, here.model.plan()[1].combination, 1, 1, 1)
        described = json.loads(json.dumps(described_task(here, task)))
        snapshot = json.loads(json.dumps(snapshot_of(here)))
    with own_modules():
        there = experiment_of(snapshot, tmp_path / "worker")
    assert task_of(there, described).combination == {"Place": 0.15}


@contextmanager
def own_modules() -> Iterator[None]:
    """Forget the config's neighbour, as the process of a worker has none."""
    try:
        yield
    finally:
        sys.modules.pop("places_of_this_study", None)


PATHS = CONFIG.replace(
    "from places_of_this_study import PLACES", "from pathlib import Path\n\nHERE = Path(__file__).parent"
)


@pytest.mark.parametrize("place", ['HERE / "hall.yaml"', 'f"--map={HERE}/hall.yaml"', '"hall.yaml"'])
def test_a_treatment_that_names_a_file_beside_the_config_names_the_copy_on_the_worker(
    tmp_path: Path, place: str
) -> None:
    (tmp_path / "study.py").write_text(PATHS.replace("PLACES", f"[{place}]"), encoding="utf-8")
    here = prepare_or_refuse(tmp_path / "study.py", {})
    snapshot = json.loads(json.dumps(snapshot_of(here)))
    described = json.loads(
        json.dumps(described_task(here, RunTask("r_1", 1, 1, 1, here.model.plan()[0].combination, 1, 1, 1)))
    )
    there = experiment_of(snapshot, tmp_path / "worker")
    task = task_here(there, described, texts_here(snapshot, there))
    named = eval(place, {"HERE": tmp_path / "worker" / "source"})  # noqa: S307 - as written above
    assert task.combination == {"Place": named}


def test_a_worker_with_other_treatments_says_so_before_it_gets_any_run(tmp_path: Path) -> None:
    (tmp_path / "study.py").write_text(PATHS.replace("PLACES", "[len(str(HERE))]"), encoding="utf-8")
    snapshot = snapshot_of(prepare_or_refuse(tmp_path / "study.py", {}))
    there = experiment_of(snapshot, tmp_path / "worker")
    with pytest.raises(ConfigError, match=f"treatment '{len(str(tmp_path))}' is not there"):
        texts_here(snapshot, there)


FROM_OUTSIDE = CONFIG.replace("from places_of_this_study import PLACES", "import os").replace(
    '"results"', '"results"\n    gain = float(os.environ.get("GAIN_OF_TRIAL", "1"))'
)


def test_a_worker_on_which_the_config_takes_other_values_from_outside_executes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "study.py").write_text(FROM_OUTSIDE.replace("PLACES", "[1]"), encoding="utf-8")
    monkeypatch.setenv("GAIN_OF_TRIAL", "2.5")
    here = prepare_or_refuse(tmp_path / "study.py", {})
    here.folder.root.mkdir(parents=True)
    write_manifest(here.folder.manifest, {"executions": [{"given": given_values(here)}]})
    snapshot = json.loads(json.dumps(snapshot_of(here)))
    assert experiment_of(snapshot, tmp_path / "same").config.gain == 2.5
    monkeypatch.delenv("GAIN_OF_TRIAL")
    with pytest.raises(ConfigError, match=r"gain \(2.5, here 1.0\)"):
        experiment_of(snapshot, tmp_path / "other")
    set_here = {**snapshot, "set": {**snapshot["set"], "gain": "2.5"}}
    assert experiment_of(set_here, tmp_path / "set").config.gain == 2.5
