"""`robot-runner verify` says whether a package is intact, and executes nothing of it."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import pytest
from tests.analysis.importing.foreign_folder import make_earlier_folder

from robot_runner.analysis.importing.adoption import adopt
from robot_runner.analysis.importing.description import ImportDescription
from robot_runner.analysis.importing.understanding import understand


@pytest.fixture
def package(packed, tmp_path):
    return Path(shutil.copy(packed.path, tmp_path / "small.zip"))


def test_an_intact_package_is_called_so(robot_runner, package, packed, tmp_path):
    answer = robot_runner("verify", "small.zip", "--sha256", packed.sha256.upper())
    assert answer.code == 0
    assert answer.out.startswith("small  intact")
    assert packed.sha256 in answer.out
    assert [path.name for path in tmp_path.iterdir()] == ["small.zip"]


@pytest.mark.long
def test_of_imported_results_it_is_not_proposed_to_execute_them_again(robot_runner, tmp_path):
    earlier = make_earlier_folder(tmp_path / "earlier")
    adopt(understand(earlier, ImportDescription()), tmp_path / "ours")
    assert robot_runner("pack", "ours").code == 0
    answer = robot_runner("verify", "ours.zip")
    assert answer.code == 0, answer.err
    assert "replicate" not in answer.out
    assert "no config" in answer.out


@pytest.mark.parametrize("place", [10, 100], ids=["header", "data"])
def test_a_damaged_package_is_refused(robot_runner, package, place):
    with zipfile.ZipFile(package) as archive:
        place += archive.getinfo("run_table.csv").header_offset
    content = bytearray(package.read_bytes())
    content[place] ^= 255
    package.write_bytes(content)
    answer = robot_runner("verify", "small.zip")
    assert answer.code == 2
    assert "damaged" in answer.err
    facts = robot_runner("verify", "small.zip", "--json").json
    assert facts["is_intact"] is False
    assert facts["findings"][0]["severity"] == "error"


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["small.zip", "--sha256", "0" * 64], "the package's SHA-256 is"),
        (["small.zip", "--sha256", "12"], "not a SHA-256"),
        (["small.zip", "--sha256", "sha256:" + "g" * 64], "not a SHA-256"),
        (["small.zip", "--sha256", ""], "not a SHA-256"),
        (["smal.zip"], "no such file"),
    ],
)
def test_what_cannot_be_is_refused(robot_runner, words, problem):
    answer = robot_runner("verify", *words)
    assert answer.code == 2
    assert problem in answer.err
