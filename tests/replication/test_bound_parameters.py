"""Which value each bound parameter had, and who read a factor: told from the folder and from its package alone."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.threats_section import threats_of
from robot_runner.analysis.results import load_results
from robot_runner.analysis.statistics.experiment_statistics import analyse
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.replication.explanation import explain_run
from robot_runner.replication.opening import open_package, unpack
from robot_runner.replication.packing import pack

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.analysis.report.blocks import Remark

CONFIG = """\
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import Measure, Profiler


class Meter(Profiler):
    measures = (Measure("Used", "Hz", "The rate that it was built with."),)

    def __init__(self, rate):
        super().__init__()
        self.rate = rate

    def populate_run_data(self, context):
        context.publish("Used", self.rate)


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "bound"
    results_output_path = Path("results")
    plugins = [Meter(treatment("Rate"))]

    def create_run_table(self):
        factors = {"Rate": [1.0, 2.0], "Floor": ["wood", "carpet"], "Load": ["a", "b"]}
        return RunTableModel([Factor(name, treatments) for name, treatments in factors.items()])

    def before_run(self, context):
        self.load = context.combination["Load"]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = tmp_path_factory.mktemp("bound") / "config.py"
    config.write_text(CONFIG, encoding="utf-8")
    return execute_experiment(prepare_or_refuse(config), SilentObserver()).folder


@pytest.fixture(scope="module")
def unpacked(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("packed")
    pack(folder, where / "bound.zip")
    with open_package(where / "bound.zip") as package:
        unpack(package, where / "unpacked")
    return where / "unpacked"


@pytest.fixture(params=["folder", "unpacked"])
def either(request: pytest.FixtureRequest) -> Path:
    return request.getfixturevalue(request.param)


def threats(folder: Path) -> tuple[Remark, ...]:
    results = load_results(folder)
    return threats_of(Material(results, analyse(results)))


def facts_of(folder: Path, run: str, name: str) -> dict[str, str]:
    return dict(explain_run(folder, run, [name]).values[0].facts)


@pytest.mark.long
@pytest.mark.parametrize(("run", "rate"), [("r_1", "1.0"), ("r_8", "2.0")])
def test_a_run_tells_the_value_of_each_bound_parameter(either: Path, run: str, rate: str) -> None:
    assert dict(explain_run(either, run).facts)["Parameter"] == f"rate of Meter = {rate}, bound to the factor Rate"
    assert facts_of(either, run, "Used")["Parameter"] == f"rate = {rate}, bound to the factor Rate"


def test_a_factor_tells_what_is_bound_to_it_and_who_read_it(either: Path) -> None:
    bound = facts_of(either, "r_1", "Rate")
    assert (bound["Bound to"], bound["Read by"]) == ("rate of Meter", "Meter")
    read = facts_of(either, "r_1", "Load")
    assert read["Read by"] == "config"
    assert "Bound to" not in read
    assert facts_of(either, "r_1", "Floor")["Read by"] == "no callback and no plugin looked at it"


def test_a_factor_that_nobody_read_is_a_threat_to_validity(either: Path) -> None:
    assert load_results(either).readers == {"Rate": ("Meter",), "Load": ("config",)}
    found = {threat.title: threat for threat in threats(either)}
    assert [title for title in found if "never have been applied" in title] == ["Floor may never have been applied"]
    assert found["Floor may never have been applied"].kind == "Construct validity"


@pytest.mark.long
def test_units_and_periods_that_nobody_reads_are_no_threat(tmp_path: Path) -> None:
    config = tmp_path / "config.py"
    crossed = CONFIG.replace(
        "return RunTableModel([Factor(name, treatments) for name, treatments in factors.items()])",
        "units = {'Robot': [1, 2], 'Period': [1, 2], 'Rate': [1.0, 2.0]}\n"
        "        factors = [Factor(name, treatments) for name, treatments in units.items()]\n"
        "        return RunTableModel(factors, design=Crossover(unit='Robot', period='Period'))",
    )
    crossed = crossed.replace('self.load = context.combination["Load"]', "pass")
    config.write_text(f"from robot_runner.designs import Crossover\n{crossed}", encoding="utf-8")
    executed = execute_experiment(prepare_or_refuse(config), SilentObserver()).folder
    assert load_results(executed).readers == {"Rate": ("Meter",)}
    assert not [each.title for each in threats(executed) if "never have been applied" in each.title]


def test_results_of_versions_that_did_not_look_are_not_blamed(folder: Path, tmp_path: Path) -> None:
    older = tmp_path / "older"
    shutil.copytree(folder, older)
    journal = older / "journal.jsonl"
    text = journal.read_text(encoding="utf-8")
    assert '"readers":' in text
    journal.write_text(text.replace('"readers":', '"other":'), encoding="utf-8")
    assert load_results(older).readers is None
    assert not [each for each in threats(older) if "never have been applied" in each.title]
    assert "Read by" not in facts_of(older, "r_1", "Floor")
