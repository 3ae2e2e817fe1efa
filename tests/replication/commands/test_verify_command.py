"""`robot-runner verify` says whether a package is intact, and executes nothing of it."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import pytest


@pytest.fixture
def package(packed, tmp_path):
    return Path(shutil.copy(packed.path, tmp_path / "small.zip"))


def test_an_intact_package_is_called_so(robot_runner, package, packed, tmp_path):
    answer = robot_runner("verify", "small.zip", "--sha256", packed.sha256.upper())
    assert answer.code == 0
    assert answer.out.startswith("small  intact")
    assert packed.sha256 in answer.out
    assert [path.name for path in tmp_path.iterdir()] == ["small.zip"]


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
        (["small.zip", "--sha256", "12"], "no SHA-256"),
        (["small.zip", "--sha256", "sha256:" + "g" * 64], "no SHA-256"),
        (["small.zip", "--sha256", ""], "no SHA-256"),
        (["smal.zip"], "no such file"),
    ],
)
def test_what_cannot_be_is_refused(robot_runner, words, problem):
    answer = robot_runner("verify", *words)
    assert answer.code == 2
    assert problem in answer.err
