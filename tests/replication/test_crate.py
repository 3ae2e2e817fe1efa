"""What describes a package is accepted by the validators of those who made the formats. No network is asked."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import pytest
import rocrate
from frictionless import Resource, system

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from rocrate_validator import models, services
    from rocrate_validator.utils.http import HttpRequester

CONTEXT = json.loads((Path(rocrate.__file__).parent / "data" / "ro-crate.jsonld").read_text(encoding="utf-8"))


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


@pytest.mark.parametrize("profile", ["ro-crate-1.1", "process-run-crate"])
def test_the_crate_has_all_that_is_required_and_recommended(packed, issues, profile):
    assert issues(packed.path, profile) == []


def test_the_validator_would_notice(unpacked, issues):
    path = unpacked / "ro-crate-metadata.json"
    crate = json.loads(path.read_text(encoding="utf-8"))
    root = next(entity for entity in crate["@graph"] if entity["@id"] == "./")
    del root["license"], root["author"]
    path.write_text(json.dumps(crate), encoding="utf-8")
    found = " ".join(issues(unpacked, "process-run-crate"))
    assert "license" in found
    assert "author" in found


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


def test_the_experiment_is_one_action_with_its_robot_runner_and_plugins(unpacked):
    graph = json.loads((unpacked / "ro-crate-metadata.json").read_text(encoding="utf-8"))["@graph"]
    entities = {entity["@id"]: entity for entity in graph}
    action = next(entity for entity in graph if entity["@type"] == "CreateAction")
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
