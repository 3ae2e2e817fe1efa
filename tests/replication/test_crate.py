"""What describes a package is accepted by the validators of those who made the formats. No network is asked."""

from __future__ import annotations

import csv
import json
import warnings
import zipfile
from pathlib import Path
from typing import Any

import pytest
import rocrate
from frictionless import Resource, system
from tests.replication.small_experiment import changed_between_its_runs, own_modules, write_config

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from rocrate_validator import models, services
    from rocrate_validator.utils.http import HttpRequester

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole
from robot_runner.replication.about import About
from robot_runner.replication.contents import media_type_of
from robot_runner.replication.crate import crate_text
from robot_runner.replication.crate_actions import ExecutedRun
from robot_runner.replication.packing import pack
from robot_runner.replication.sealing import Packing, crate_faults

CONTEXT = json.loads((Path(rocrate.__file__).parent / "data" / "ro-crate.jsonld").read_text(encoding="utf-8"))
# The library brings the context of RO-Crate 1.3; that of 1.1 has these terms of workflows elsewhere.
_BIOSCHEMAS = "https://bioschemas.org"
CONTEXT["@context"] |= {
    "ComputationalWorkflow": f"{_BIOSCHEMAS}/ComputationalWorkflow",
    "FormalParameter": f"{_BIOSCHEMAS}/FormalParameter",
    "input": f"{_BIOSCHEMAS}/ComputationalWorkflow#input",
    "output": f"{_BIOSCHEMAS}/ComputationalWorkflow#output",
}
# Process Run Crate 0.5 says of a workflow's identifier: "SHOULD be an absolute URI, but MAY be a relative URI to a data
# entity in the crate". The validator knows the first half only (its issue 51), while it demands of a Workflow RO-Crate
# that the file of the workflow is in the crate: no crate can satisfy both.
CONTRADICTION = "process-run-crate-0.5_5.1: The SoftwareApplication id SHOULD be an absolute URI"


class _Answer:
    status_code = 200
    ok = True
    text = json.dumps(CONTEXT)
    headers = {"Content-Type": "application/ld+json"}  # noqa: RUF012 - as requests has it

    def json(self) -> Any:
        return CONTEXT

    def raise_for_status(self) -> None:
        """All is well."""


@pytest.fixture
def issues(monkeypatch):
    """Return what validates a crate with the context that the library `rocrate` brings."""

    def get(self, url, **_):
        assert url.startswith("https://w3id.org/ro/crate/"), f"it asked the network for {url}"
        return _Answer()

    monkeypatch.setattr(HttpRequester, "get", get, raising=False)

    def validate(crate, profile):
        settings = services.ValidationSettings(
            rocrate_uri=str(crate),
            profile_identifier=profile,
            requirement_severity=models.Severity.RECOMMENDED,
            skip_availability_check=True,
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the validator's own libraries
            return [f"{each.check.identifier}: {each.message}" for each in services.validate(settings).get_issues()]

    return validate


@pytest.mark.soak
def test_the_crate_has_all_that_is_required_and_recommended(packed, issues):
    # Workflow Run Crate includes Process Run Crate, Workflow RO-Crate and RO-Crate: issues of all of them are reported.
    assert set(issues(packed.path, "workflow-run-crate")) == {CONTRADICTION}


@pytest.mark.long
def test_the_package_of_the_demo_is_valid_and_nobody_has_to_be_asked_for_more(executed_demo, issues, tmp_path):
    folder = next((executed_demo / "robot-runner-demo").glob("*/manifest.json")).parent
    packed = pack(folder, tmp_path / "demo.zip")
    assert set(issues(packed.path, "workflow-run-crate")) == {CONTRADICTION}
    assert not [each for each in packed.findings if each.where in {"authors", "licence", "citation"}]
    graph = json.loads(zipfile.ZipFile(packed.path).read("ro-crate-metadata.json"))["@graph"]
    assert sum(each["@id"].startswith("#run-") for each in graph) == 15


def test_each_run_is_an_action_that_executed_the_config_with_its_treatments(unpacked):
    graph = json.loads((unpacked / "ro-crate-metadata.json").read_text(encoding="utf-8"))["@graph"]
    entities = {entity["@id"]: entity for entity in graph}
    assert entities["./"]["mainEntity"] == {"@id": "config/small.py"}
    actions = [each for each in graph if each["@id"].startswith("#run-")]
    assert [each["@id"] for each in actions] == ["#run-r_1", "#run-r_2", "#run-r_3", "#run-r_4"]
    with (unpacked / "run_table.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["run_id"]: row for row in csv.DictReader(file)}
    for action in actions:
        row = rows[action["@id"].removeprefix("#run-")]
        treatment = entities[action["object"]["@id"]]
        assert (treatment["name"], treatment["value"]) == ("Task", row["Task"])
        assert entities[treatment["exampleOfWork"]["@id"]]["@type"] == "FormalParameter"
        assert action["instrument"] == {"@id": "config/small.py"}
        assert {"@id": f"runs/{row['run_id']}/"} in action["result"]
        assert action["startTime"] < action["endTime"]
    assert {"@id": "#run-r_1"} in entities["./"]["mentions"]


@pytest.mark.long
def test_a_run_was_executed_by_the_version_of_the_config_that_executed_it(tmp_path, issues):
    packed = pack(changed_between_its_runs(tmp_path), tmp_path / "changing.zip", Packing(with_wheels=False))
    graph = json.loads(zipfile.ZipFile(packed.path).read("ro-crate-metadata.json"))["@graph"]
    instruments = {each["@id"]: each["instrument"]["@id"] for each in graph if each["@id"].startswith("#run-")}
    assert instruments == {"#run-r_1": "earlier_configs/1/changing.py", "#run-r_2": "config/changing.py"}
    assert not [each for each in issues(packed.path, "workflow-run-crate") if "instrument" in each]


@pytest.mark.long
def test_an_experiment_that_ended_before_its_first_run_is_packed_without_an_action_of_a_workflow(tmp_path, issues):
    config = write_config(tmp_path / "study")
    raises = "    def before_experiment(self):\n        raise OSError('no power')\n\n    def create_run_table(self):"
    config.write_text(config.read_text("utf-8").replace("    def create_run_table(self):", raises), "utf-8")
    with own_modules(), pytest.raises(ExecutionError, match="no power"):
        execute_experiment(prepare_or_refuse(config, {}), SilentObserver())
    package = pack(tmp_path / "study" / "results" / "small", tmp_path / "begun.zip", Packing(with_wheels=False)).path
    # Nobody knows when it ended.
    assert {each.partition(":")[0] for each in issues(package, "process-run-crate-0.5")} <= {
        "process-run-crate-0.5_8.4"
    }
    graph = json.loads(zipfile.ZipFile(package).read("ro-crate-metadata.json"))["@graph"]
    assert not [each["@id"] for each in graph if each["@id"].startswith("#run-")]
    assert "config/small.py" in {each["@id"] for each in graph}


@pytest.mark.parametrize(
    ("name", "media_type"),
    [
        ("report/tables/means.tex", "application/x-tex"),
        ("export/spreadsheets/run_table.xlsx", "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet"),
        ("runs/r_1/LabCamera/still-1.jpg", "image/jpeg"),
    ],
)
def test_what_experiments_reports_and_exports_hold_is_not_called_binary_data(name, media_type):
    assert media_type_of(name).name == media_type


@pytest.mark.soak
def test_the_validator_would_notice(unpacked, issues):
    path = unpacked / "ro-crate-metadata.json"
    crate = json.loads(path.read_text(encoding="utf-8"))
    root = next(entity for entity in crate["@graph"] if entity["@id"] == "./")
    del root["license"], root["author"]
    path.write_text(json.dumps(crate), encoding="utf-8")
    found = issues(unpacked, "workflow-run-crate")
    for missing in ("license", "author"):
        assert [each for each in found if each.startswith("ro-crate-1.1_") and missing in each]


def test_the_run_table_is_as_its_schema_says(unpacked):
    described = json.loads((unpacked / "datapackage.json").read_text(encoding="utf-8"))["resources"][0]
    assert described["path"] == "run_table.csv"
    with system.use_context(trusted=True):
        report = Resource.from_descriptor(
            {key: described[key] for key in ("name", "path", "schema", "bytes", "hash")}, basepath=str(unpacked)
        ).validate()
    assert report.valid, report.flatten(["title", "message"])


def test_each_file_is_described_with_its_hash(unpacked):
    graph = json.loads((unpacked / "ro-crate-metadata.json").read_text(encoding="utf-8"))["@graph"]
    hashes = {entity["@id"]: entity["sha256"] for entity in graph if "sha256" in entity}
    sums = dict(reversed(line.split("  ")) for line in (unpacked / "SHA256SUMS").read_text("utf-8").splitlines())
    assert hashes == {name: digest for name, digest in sums.items() if name != "ro-crate-metadata.json"}


def test_a_crate_that_is_not_valid_is_refused_with_every_fault(packed):
    with zipfile.ZipFile(packed.path) as archive:
        names, text = archive.namelist(), archive.read("ro-crate-metadata.json").decode()
    assert list(crate_faults(text, names)) == []
    crate = json.loads(text)
    entities = {entity["@id"]: entity for entity in crate["@graph"]}
    del entities["./"]["license"], entities["#run-r_1"]["instrument"]
    entities["./"]["datePublished"] = "yesterday"
    entities["#experiment"]["object"] = {"@id": "config/other.py"}
    problems = " ".join(each.problem for each in crate_faults(json.dumps(crate), [*names, "stray.txt"]))
    for fault in (
        "no license",
        "an action has no instrument",
        "'yesterday'",
        "names config/other.py",
        "stray.txt is in",
    ):
        assert fault in problems


def test_the_experiment_is_one_action_with_its_robot_runner_and_plugins(unpacked):
    graph = json.loads((unpacked / "ro-crate-metadata.json").read_text(encoding="utf-8"))["@graph"]
    entities = {entity["@id"]: entity for entity in graph}
    action = entities["#experiment"]
    tool = entities[action["instrument"]["@id"]]
    assert tool["softwareVersion"]
    assert {entities[each["@id"]]["name"] for each in tool["softwareRequirements"]} == {
        "BasicTurtlebot3",
        "Ina219",
        "PsUtil",
    }
    assert action["agent"]["@id"] == "https://orcid.org/0000-0002-1825-0097"
    assert {"@id": "run_table.csv"} in action["result"]
    assert action["actionStatus"].endswith("CompletedActionStatus")


def test_what_has_no_ascii_name_keeps_an_identity_of_its_own():
    authors = ({"name": "Ada", "affiliation": "東京大学"}, {"name": "Bob", "affiliation": "京都大学"})
    columns = [
        ColumnDescription(name=name, role=ColumnRole.MEASURE) for name in ("エネルギー", "時間", "CPU %", "CPU_")
    ]
    about = About("small", authors, None, None, "2026-01-31T12:00:00Z")
    entities = json.loads(crate_text(about, {}, [], columns=columns, runs=[], run_folders={}))["@graph"]
    names = {each["@id"]: each["name"] for each in entities if "name" in each}
    people = [each for each in entities if each["@type"] == "Person"]
    assert {each["name"]: names[each["affiliation"]["@id"]] for each in people} == {
        each["name"]: each["affiliation"] for each in authors
    }
    root = next(each for each in entities if each["@id"] == "./")
    assert [names[each["@id"]] for each in root["variableMeasured"]] == [each.name for each in columns]


def test_an_experiment_that_was_killed_ended_with_its_last_run_and_not_when_it_began():
    about = About("small", (), None, None, "2026-01-31T12:00:00Z")
    manifest = {"executions": [{"started_at": "2026-01-31T12:00:00Z"}]}
    run = ExecutedRun("r_1", True, "2026-01-31T12:01:00Z", "2026-01-31T12:03:00Z")
    text = crate_text(about, manifest, [], columns=[], runs=[run], run_folders={})
    (action,) = [each for each in json.loads(text)["@graph"] if each["@id"] == "#experiment"]
    assert (action["endTime"], action["error"]) == ("2026-01-31T12:03:00+00:00", "1 run failed.")
