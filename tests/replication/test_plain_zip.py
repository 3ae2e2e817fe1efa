"""The zip file of a package is the same each time, also in the form for large files, and whole or not there."""

from __future__ import annotations

import os
import signal
import sys
import zipfile

import pytest

from robot_runner.core.errors import PackageError, StorageError
from robot_runner.replication import plain_zip
from robot_runner.replication.packing import pack
from robot_runner.replication.plain_zip import looks_like_a_bomb, written_beside


def test_the_form_for_large_files_reads_as_any(tmp_path, monkeypatch):
    monkeypatch.setattr(plain_zip, "_LARGE", 10)
    with written_beside(tmp_path / "a.zip") as archive:
        stored = archive.add("runs/a.csv", [b"a,b\n", b"1,2\n"], size=11)
        archive.add_folders(["runs/"])
    assert (stored.size, len(stored.sha256)) == (8, 64)
    with zipfile.ZipFile(tmp_path / "a.zip") as opened:
        assert opened.read("runs/a.csv") == b"a,b\n1,2\n"
        assert [entry.filename for entry in opened.infolist()] == ["runs/a.csv", "runs/"]
        assert {entry.date_time for entry in opened.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    extra = (tmp_path / "a.zip").read_bytes()[30 + len("runs/a.csv") :]  # behind the fields of the local header
    assert extra[:2] == b"\x01\x00"  # the field of ZIP64; the version needed was left at 2.0 before Python 3.11.4


def test_a_file_that_shrinks_to_a_hundredth_looks_like_a_bomb_and_no_other_one(tmp_path):
    path = tmp_path / "file"
    for content, looks in [
        (b"the same line\n" * 20_000, True),
        (b"the same line\n" * 1_000, False),  # too small to be one
        ("".join(f"{number}: the same line\n" for number in range(20_000)).encode(), False),
    ]:
        path.write_bytes(content)
        assert looks_like_a_bomb(path, len(content)) is looks


@pytest.mark.parametrize("size", [1 << 14, 1 << 16])
def test_many_files_of_one_line_are_no_bomb_together(size, tmp_path):
    path, count = tmp_path / "samples.csv", 99
    path.write_bytes(b"0.0\n" * (size // 4))
    with written_beside(tmp_path / "a.zip") as archive:
        for run in range(count):
            is_stored = looks_like_a_bomb(path, size)
            archive.add(f"runs/r_{run}/samples.csv", [path.read_bytes()], size=size, is_stored=is_stored)
    # Who receives it takes 200 times for a bomb, of one file and of the package.
    assert count * size < 200 * (tmp_path / "a.zip").stat().st_size


def test_what_breaks_off_leaves_nothing_behind(tmp_path):
    (tmp_path / "a.zip").write_text("before", encoding="utf-8")

    def breaks():
        yield b"a"
        raise OSError(28, "No space left on device")

    with pytest.raises(StorageError), written_beside(tmp_path / "a.zip") as archive:
        archive.add("a", breaks())
    assert [path.name for path in tmp_path.iterdir()] == ["a.zip"]
    assert (tmp_path / "a.zip").read_text(encoding="utf-8") == "before"


def test_a_request_to_stop_leaves_nothing_behind(tmp_path):
    def is_asked_to_stop():
        yield b"a"
        os.kill(os.getpid(), signal.SIGTERM)
        yield b"b"

    with pytest.raises(KeyboardInterrupt), written_beside(tmp_path / "a.zip") as archive:
        archive.add("a", is_asked_to_stop())
    assert list(tmp_path.iterdir()) == []


def test_without_the_extra_it_is_named(experiment, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rocrate", None)
    with pytest.raises(PackageError) as refused:
        pack(experiment, tmp_path / "a.zip")
    assert refused.value.fix == "Install it: pip install 'robot-runner[replication]'"
