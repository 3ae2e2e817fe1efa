"""A file is replaced whole or not at all, and what the system refuses is said with a fix."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from types import SimpleNamespace
from typing import TextIO

import pytest

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.guarded_files import replace
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.safe_write import write_beside_and_rename
from robot_runner.core.storage.system_refusals import fsync_folder, storage_error


def names_in(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


def test_a_file_is_made_and_replaced_as_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    write_beside_and_rename(path, lambda file: file.write("first\n"))
    write_beside_and_rename(path, lambda file: file.write("é\r\nlast\n"))
    assert path.read_bytes() == "é\r\nlast\n".encode()
    assert names_in(tmp_path) == ["table.csv"]


def test_it_is_written_in_the_folder_itself_and_never_elsewhere(tmp_path: Path) -> None:
    seen: list[Path] = []

    def write(file: TextIO) -> None:
        seen.append(Path(file.name))

    write_beside_and_rename(tmp_path / "table.csv", write)
    assert [path.parent for path in seen] == [tmp_path]


def test_the_file_and_then_its_folder_are_flushed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flushed: list[str] = []
    fsync = os.fsync

    def watch(descriptor: int) -> None:
        flushed.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", watch)
    write_beside_and_rename(tmp_path / "table.csv", lambda file: file.write("x"))
    assert flushed == ["file", "folder"]
    replace(tmp_path / "figure.svg", "x", is_lasting=False)  # one of many that can be made again
    assert flushed == ["file", "folder"]
    assert (tmp_path / "figure.svg").read_text() == "x"


def test_a_new_file_has_the_permissions_that_the_user_asks_for(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_beside_and_rename(tmp_path / "table.csv", lambda file: file.write("x"))
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "table.csv").stat().st_mode) == 0o640


def test_the_name_of_a_file_that_is_no_text_can_be_written(tmp_path: Path) -> None:
    path, name = tmp_path / "verdict.json", os.fsdecode(b"B\xfcro")
    write_beside_and_rename(path, lambda file: file.write(f'"{name}"'))
    assert path.read_text(encoding="utf-8") == '"B\\udcfcro"'  # as JSON has it, too


def test_a_symbolic_link_stays_and_its_target_is_replaced(tmp_path: Path) -> None:
    target = tmp_path / "elsewhere" / "table.csv"
    target.parent.mkdir()
    link = tmp_path / "table.csv"
    link.symlink_to(target)
    write_beside_and_rename(link, lambda file: file.write("new"))
    assert link.is_symlink()
    assert target.read_text(encoding="utf-8") == "new"


@pytest.mark.parametrize(
    ("number", "fix"),
    [
        (errno.ENOSPC, "Make room on the disk, then try again."),
        (errno.EACCES, "Correct the permissions of the file and its folder."),
        (errno.EROFS, "Choose a folder on a file system that can be written."),
        (errno.EFBIG, "Raise the limit of a file's size (ulimit -f), or choose a file system for larger files."),
        (errno.EMFILE, "Raise the limit of open files (ulimit -n)."),
        (errno.ENOTCONN, "See that its disk or network folder is there again, and sound; then try again."),
        (errno.ENOSPC + 1000, "Correct what the system names, then try again."),
    ],
)
def test_where_the_system_refuses_the_old_file_is_intact(tmp_path: Path, number: int, fix: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text("old", encoding="utf-8")

    def refuse(file: TextIO) -> None:
        file.write("half of it")
        raise OSError(number, os.strerror(number))

    with pytest.raises(StorageError) as caught:
        write_beside_and_rename(path, refuse)
    assert str(caught.value) == f"{path}: the file cannot be written: {os.strerror(number)} → {fix}"
    assert path.read_text(encoding="utf-8") == "old"
    assert names_in(tmp_path) == ["table.csv"]


def test_a_disk_that_fills_up_while_flushing_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "table.csv"
    path.write_text("old", encoding="utf-8")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="No space left on device"):
        write_beside_and_rename(path, lambda file: file.write("new"))
    assert path.read_text(encoding="utf-8") == "old"
    assert names_in(tmp_path) == ["table.csv"]


def test_an_error_of_the_writer_goes_through_and_leaves_nothing_behind(tmp_path: Path) -> None:
    def interrupt(_: TextIO) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_beside_and_rename(tmp_path / "table.csv", interrupt)
    assert names_in(tmp_path) == []


def test_a_folder_that_is_missing_or_a_file_is_named_with_a_fix(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="Correct the path, or make the folder first"):
        write_beside_and_rename(tmp_path / "nowhere" / "table.csv", lambda file: file.write("x"))
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(StorageError, match="a part of it is a file"):
        write_beside_and_rename(tmp_path / "file" / "table.csv", lambda file: file.write("x"))


def test_a_file_system_that_flushes_neither_folders_nor_files_is_no_reason_to_fail(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(number: int) -> None:
        raise OSError(number, "refused")

    monkeypatch.setattr(os, "fsync", lambda _: refuse(errno.EINVAL))
    fsync_folder(tmp_path)
    write_beside_and_rename(tmp_path / "table.csv", lambda file: file.write("whole"))
    assert (tmp_path / "table.csv").read_text(encoding="utf-8") == "whole"
    with Journal(tmp_path / "journal.jsonl") as journal:
        journal.append("table_written")
    monkeypatch.setattr(os, "fsync", lambda _: refuse(errno.EIO))
    with pytest.raises(OSError, match="refused"):
        fsync_folder(tmp_path)


def test_a_disk_with_room_and_without_inodes_is_told_as_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = OSError(errno.ENOSPC, "No space left on device")
    for free, expected in ((0, "df -i"), (5, "Make room on the disk")):
        found = SimpleNamespace(f_files=100, f_favail=free, f_bavail=1000)
        monkeypatch.setattr(os, "statvfs", lambda _, found=found: found)
        assert expected in storage_error(tmp_path / "table.csv", "written", full).fix


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
def test_what_another_user_keeps_from_us_is_told_with_the_user(tmp_path: Path) -> None:
    path = tmp_path / "manifest.json"
    path.touch()
    os.chown(path, 54321, 54321)
    error = storage_error(path, "read", PermissionError(errno.EACCES, "Permission denied"))
    assert error.fix == "It is user 54321's: have it given to you (sudo chown), or shared with you (chmod)."
    made = storage_error(path / "in it", "made", PermissionError(errno.EACCES, "Permission denied"))
    assert "user 54321" in made.fix  # of what is not there, the folder tells
    below = storage_error(path / "report" / "figures", "made", PermissionError(errno.EACCES, "Permission denied"))
    assert "user 54321" in below.fix  # of that neither, the next folder above does
    os.chown(path, os.geteuid(), -1)
    assert storage_error(path, "read", PermissionError(errno.EACCES, "Permission denied")).fix.startswith("Correct")


def test_an_error_without_a_number_is_said_as_it_is() -> None:
    error = storage_error(Path("table.csv"), "read", OSError("odd"))
    assert str(error) == "table.csv: the file cannot be read: odd → Correct what the system names, then try again."


def test_a_name_that_is_too_long_is_told_as_what_it_is(tmp_path: Path) -> None:
    name = tmp_path / ("long" * 100)
    with pytest.raises(OSError, match="too long") as refused:
        name.read_text()
    assert "the file cannot be read: File name too long" in str(storage_error(name, "read", refused.value))


def test_a_loop_of_links_in_the_place_of_a_file_is_an_error_with_a_fix(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(StorageError, match="symbolic link") as refused:
        write_beside_and_rename(tmp_path / "loop", lambda file: file.write("x"))
    assert refused.value.fix
