"""A package that other tools have copied or zipped again is recognised, or is refused by what they did to it."""

from __future__ import annotations

import re
import shutil
import unicodedata
import zipfile
from functools import partial
from hashlib import sha256

import pytest
from tests.replication.verified_packages import refusal_of, verified

from robot_runner.replication.opening import open_package, unpack


def _zipped_again(packed, target, renamed=lambda name: name, added=()):
    with zipfile.ZipFile(packed.path) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        for entry in old.infolist():
            new.writestr(renamed(entry.filename), old.read(entry))
        for name in added:
            new.writestr(name, b"\0\5\x16\7")
    return target


def test_a_zip_file_of_the_folder_that_it_was_unpacked_to_is_the_package(packed, tmp_path):
    added = ["__MACOSX/small/._run_table.csv", "small/.DS_Store", "small/runs/Thumbs.db"]
    path = _zipped_again(packed, tmp_path / "again.zip", lambda name: f"small-main/{name}", added[:1])
    assert verified(path).file_count == packed.file_count
    with open_package(path) as package:
        unpack(package, tmp_path / "there")
    assert verified(tmp_path / "there").file_count == packed.file_count
    assert not (tmp_path / "there" / "__MACOSX").exists()
    path = _zipped_again(packed, tmp_path / "finder.zip", lambda name: f"small/{name}", added)
    assert verified(path).file_count == packed.file_count


def test_a_package_inside_of_what_is_named_is_pointed_at(packed, unpacked, tmp_path):
    (tmp_path / "downloads" / "small").mkdir(parents=True)
    shutil.copytree(unpacked, tmp_path / "downloads" / "small" / "small")
    error = refusal_of(tmp_path / "downloads")
    assert "no package.json" in error.problem
    assert str(tmp_path / "downloads" / "small" / "small") in error.fix
    with zipfile.ZipFile(tmp_path / "files.zip", "w") as archive:
        archive.write(packed.path, "files/small.zip")
        archive.writestr("files/paper.pdf", b"%PDF")
    error = refusal_of(tmp_path / "files.zip")
    assert "no package.json" in error.problem
    assert "Unpack" in error.fix
    assert "files/small.zip" in error.fix
    with zipfile.ZipFile(tmp_path / "hostile.zip", "w") as archive:
        archive.writestr("../files/SHA256SUMS", "")
    assert refusal_of(tmp_path / "hostile.zip").fix.startswith("Name a package")  # it leaves the folder that it is in


def test_a_folder_that_does_not_belong_to_it_is_one_fault(unpacked):
    for name in ("HEAD", "config", "objects/ab/cd"):
        (unpacked / ".git" / name).parent.mkdir(parents=True, exist_ok=True)
        (unpacked / ".git" / name).write_text("git's")
    (unpacked / "runs" / "r_9" / "a").mkdir(parents=True)
    (unpacked / "runs" / "r_9" / "a" / "more.csv").write_text("1")
    first, second = refusal_of(unpacked).findings
    assert (first.where, first.problem) == (f"{unpacked}, .git", "the folder, of 3 files, is not part of the package")
    assert second.where == f"{unpacked}, runs/r_9/a/more.csv"


@pytest.mark.parametrize(("before", "after"), [(b"\n", b"\r\n"), (b"\r\n", b"\n")], ids=["autocrlf", "normalised"])
def test_line_endings_that_git_has_changed_are_one_fault_that_names_git(packed, tmp_path, before, after):
    path = tmp_path / "there"
    with zipfile.ZipFile(packed.path) as archive:
        archive.extractall(path)
    texts = [path / name for name in ("run_table.csv", "README.md", "journal.jsonl")]
    sums = (path / "SHA256SUMS").read_text()
    for each in texts:
        content = each.read_bytes().replace(b"\r\n", b"\n").replace(b"\n", before)
        sums = re.sub(rf"\w+  {each.name}\n", f"{sha256(content).hexdigest()}  {each.name}\n", sums)
        each.write_bytes(content.replace(before, after))
    (path / "SHA256SUMS").write_text(sums, newline="\r\n")
    (path / "run_table.schema.json").write_text("{}")
    altered, ends = refusal_of(path).findings
    assert altered.problem == "the file was altered: its SHA-256 differs"
    assert ends.where == f"{path}, README.md, journal.jsonl, run_table.csv"
    assert "line ends" in ends.problem
    assert "core.autocrlf" in ends.fix


@pytest.mark.parametrize(
    "spelled",
    [partial(unicodedata.normalize, "NFD"), lambda name: name.encode().decode("cp437")],
    ids=["in parts, by macOS", "in the characters of MS-DOS"],
)
def test_a_name_that_another_tool_has_spelled_otherwise_is_one_fault_that_says_so(unpacked, spelled):
    content, name = b"x,y\n", "\xfcbersicht/w\xf6lkchen.csv"
    with (unpacked / "SHA256SUMS").open("a", encoding="utf-8") as sums:
        sums.write(f"{sha256(content).hexdigest()}  {name}\n")
    (unpacked / spelled(name)).parent.mkdir()
    (unpacked / spelled(name)).write_bytes(content)
    (fault,) = refusal_of(unpacked).findings
    assert fault.where == f"{unpacked}, {name}"
    assert "written otherwise" in fault.problem
    assert "unzip" in fault.fix


@pytest.mark.parametrize("place", [16, 19], ids=["too small", "too large"])
def test_a_wrong_number_in_the_end_of_a_zip_file_is_damage_and_no_refusal_of_the_system(packed, tmp_path, place):
    content = bytearray(packed.path.read_bytes())
    content[len(content) - 22 + place] ^= 255
    (tmp_path / "small.zip").write_bytes(content)
    assert "Get it again" in refusal_of(tmp_path / "small.zip").fix


def test_the_readme_tells_who_has_the_package_alone_how_to_install_robot_runner(unpacked):
    (words,) = re.findall(
        r'^\$ "\$HOME/robot-runner/bin/pip" install (\S+)$', (unpacked / "README.md").read_text(), re.MULTILINE
    )
    assert (unpacked / words).is_file()
