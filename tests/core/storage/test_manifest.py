from __future__ import annotations

import json
import math
import platform
from pathlib import Path

import pytest

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.manifest import FORMAT, describe_host, describe_software, read_manifest, write_manifest


def test_the_host_is_told_by_what_it_is() -> None:
    host = describe_host()
    assert host["system"] == platform.system()
    assert host["cores"] >= 1
    assert host["memory_bytes"] > 1 << 20


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="only Linux tells its processor so")
def test_the_processor_is_named_and_not_numbered() -> None:
    assert not describe_host()["processor"].isdigit()


def test_every_installed_package_is_told_with_its_version() -> None:
    packages = describe_software()["packages"]
    assert packages["pytest"] == pytest.__version__
    assert list(packages) == sorted(packages, key=str.lower)


def test_a_manifest_comes_back_with_its_format(tmp_path: Path) -> None:
    write_manifest(tmp_path / "manifest.json", {"seed": 7, "path": Path("a/b")})
    assert read_manifest(tmp_path / "manifest.json") == {"format": FORMAT, "seed": 7, "path": "a/b"}


@pytest.mark.parametrize(
    ("text", "problem"),
    [("nonsense", "cannot be read"), ("[]", "not a manifest"), ("{}", "not a manifest"), ('{"format": 99}', "newer")],
)
def test_what_is_no_manifest_of_ours_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(StorageError, match=problem) as refused:
        read_manifest(tmp_path / "manifest.json")
    assert refused.value.fix


@pytest.mark.parametrize("part", ["packages", "system", "system_packages", "editable_code"])
def test_software_of_another_shape_is_told_with_its_place(tmp_path: Path, part: str) -> None:
    (tmp_path / "manifest.json").write_text(json.dumps({"format": 1, "software": {part: 7}}))
    with pytest.raises(StorageError, match=part):
        read_manifest(tmp_path / "manifest.json")


def test_a_folder_without_a_manifest_is_no_experiment(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="no experiment here"):
        read_manifest(tmp_path / "manifest.json")


def test_numbers_that_json_does_not_have_are_written_as_every_reader_of_json_takes_them(tmp_path: Path) -> None:
    def refuse(name: str) -> None:
        raise AssertionError(name)

    write_manifest(tmp_path / "manifest.json", {"clocks": {"pi": {"offset": math.nan}}})
    with Journal(tmp_path / "journal.jsonl") as journal:
        journal.append("shared", owner="config", values={"limits": [math.inf, -math.inf, 0.5]})
    manifest = json.loads((tmp_path / "manifest.json").read_text(), parse_constant=refuse)
    assert manifest["clocks"]["pi"] == {"offset": "nan"}
    (line,) = (tmp_path / "journal.jsonl").read_text().splitlines()
    assert json.loads(line, parse_constant=refuse)["values"] == {"limits": ["inf", "-inf", 0.5]}
