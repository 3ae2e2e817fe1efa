"""What comes out of an archive that a host sent: whole files, in their places, and a word about everything else."""

from __future__ import annotations

import errno
import io
import os
import tarfile
import time
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.links.archived_files import unpack

if TYPE_CHECKING:
    from pathlib import Path

_PLENTY = 1_000_000


def archive_of(*members: tuple[str, bytes | tarfile.TarInfo]) -> io.BytesIO:
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w", format=tarfile.GNU_FORMAT) as tar:
        for name, content in members:
            member = tarfile.TarInfo(name)
            data = content if isinstance(content, bytes) else b""
            if isinstance(content, tarfile.TarInfo):
                member.type, member.linkname = content.type, content.linkname
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
    archive.seek(0)
    return archive


def link(kind: bytes, to: str) -> tarfile.TarInfo:
    member = tarfile.TarInfo()
    member.type, member.linkname = kind, to
    return member


def files_in(folder: Path) -> dict[str, bytes]:
    return {str(each.relative_to(folder)): each.read_bytes() for each in folder.rglob("*") if each.is_file()}


def test_a_file_that_cannot_be_written_here_is_told_and_the_next_ones_come(tmp_path: Path) -> None:
    long = "n" * 256
    members = [("in place of a folder/x", b"1"), ("in place of a folder", b"2"), (long, b"3"), ("last", b"4")]
    unpacked = unpack(archive_of(*members), tmp_path, _PLENTY)
    assert files_in(tmp_path) == {"in place of a folder/x": b"1", "last": b"4"}
    assert unpacked.problems == [
        "/in place of a folder cannot be written here: Is a directory",
        f"/{long} cannot be written here: File name too long",
    ]
    assert unpacked.size == 2


@pytest.mark.parametrize(("mtime", "kept"), [("1600000000.5", 1600000000.5), ("nan", None), ("1e300", None)])
def test_a_file_has_the_time_at_which_it_was_written_there_if_that_is_one(
    tmp_path: Path, mtime: str, kept: float | None
) -> None:
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w", format=tarfile.PAX_FORMAT) as tar:
        member = tarfile.TarInfo("log")
        member.pax_headers = {"mtime": mtime}
        tar.addfile(member)
    archive.seek(0)
    (file,) = unpack(archive, tmp_path, _PLENTY).files
    assert file.stat().st_mtime == (kept or pytest.approx(time.time(), abs=60))


@pytest.mark.parametrize("said", [{"GNU.sparse.size": "x"}, {"GNU.sparse.map": "a,b"}])
def test_an_archive_that_says_what_cannot_be_is_told(tmp_path: Path, said: dict[str, str]) -> None:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as tar:
        tar.addfile(tarfile.TarInfo("first"))
        odd = tarfile.TarInfo("odd")
        odd.pax_headers = said
        tar.addfile(odd)
    packed.seek(0)
    unpacked = unpack(packed, tmp_path, 1000)
    assert (unpacked.files, len(unpacked.problems)) == ([tmp_path / "first"], 1)


def test_a_folder_does_not_take_the_place_of_a_file_that_came_before(tmp_path: Path) -> None:
    unpacked = unpack(archive_of(("a", b"1"), ("a/b", b"2")), tmp_path, _PLENTY)
    assert files_in(tmp_path) == {"a": b"1"}
    assert unpacked.problems == ["/a/b cannot be written here: File exists"]


def test_a_link_here_is_replaced_and_not_followed(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "a").symlink_to(tmp_path / "elsewhere")
    unpack(archive_of(("a/b", b"2")), folder, _PLENTY)
    assert files_in(folder) == {"a/b": b"2"}
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_second_names_count_as_much_as_first_ones_and_those_of_links_are_not_followed(tmp_path: Path) -> None:
    members: list[tuple[str, Any]] = [("a", b"12345")]
    members += [("link", link(tarfile.SYMTYPE, "a")), ("link again", link(tarfile.LNKTYPE, "link"))]
    members += [(f"a{number}", link(tarfile.LNKTYPE, "a")) for number in range(3)]
    members += [("of nothing", link(tarfile.LNKTYPE, "nothing"))]
    for name in ("whole", "part"):
        (tmp_path / name).mkdir()
    whole = unpack(archive_of(*members), tmp_path / "whole", _PLENTY)
    assert [each.read_bytes() for each in whole.files] == [b"12345"] * 4
    assert whole.size == 20
    assert whole.problems == [
        "/link is a link to a, which is not followed",
        "/link again is a link to a, which is not followed",
        "/of nothing is not a file",
    ]
    part = unpack(archive_of(*members), tmp_path / "part", 12)
    assert (len(part.files), part.is_too_much) == (2, True)


def test_what_there_is_no_room_for_is_told_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    archive = archive_of(*((f"f{number}", b"1") for number in range(100)))
    monkeypatch.setattr(os, "open", refuse)
    assert unpack(archive, tmp_path, _PLENTY).problems == ["/f0 cannot be written here: No space left on device"]
