"""Raw data on its way home: whatever a worker says of its files, nothing is written outside of the run's folder."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import json
import os
import stat
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from robot_runner.cluster.raw_data_transfer import PIECE, TransferError, bring_home, listed_files, open_up
from robot_runner.core.errors import StorageError

#: The number of a user that may read nothing of root's.
_NOBODY = 65534


class Worker:
    """What a worker hands over: its files, and what it announces of them."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self.files = files
        listed = [[name, len(content), hashlib.sha256(content).hexdigest()] for name, content in files.items()]
        self.list = "".join(json.dumps(each) + "\n" for each in listed).encode()
        self.asked = 0

    @property
    def ended(self) -> dict[str, Any]:
        return {"files": len(self.files), "bytes": sum(map(len, self.files.values())), "list": len(self.list)}

    async def read(self, name: str, offset: int, size: int) -> tuple[bytes, str]:
        self.asked += 1
        piece = (self.files[name] if name else self.list)[offset : offset + size]
        return piece, hashlib.sha256(piece).hexdigest()


def _brought(worker: Worker, root: Path) -> Path:
    run = root / "runs" / "r_1"
    run.parent.mkdir(exist_ok=True)
    asyncio.run(bring_home(worker.read, worker.ended, run, root))
    return run


def test_files_come_home_in_pieces_with_their_folders(tmp_path: Path) -> None:
    content = bytes(range(256)) * (PIECE // 128 + 7)
    worker = Worker({"log.txt": b"said", "Ina219/deep/raw.bin": content, "empty": b"", "Odd näme\n.txt": b"x"})
    run = _brought(worker, tmp_path)
    found = {path.relative_to(run).as_posix(): path.read_bytes() for path in run.rglob("*") if path.is_file()}
    assert found == worker.files
    assert worker.asked == 1 + 1 + 3 + 0 + 1


def test_memory_is_bounded_by_the_size_of_a_piece(tmp_path: Path) -> None:
    worker = Worker({"raw.bin": bytes(20 * PIECE)})
    tracemalloc.start()
    try:
        _brought(worker, tmp_path)
        assert tracemalloc.get_traced_memory()[1] < 4 * PIECE
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "name", ["../r_2/raw", "/etc/passwd", "a/../../b", "", ".", "a//b", "a/./b", "x\0y", "d/" * 99 + "f"]
)
def test_a_name_that_leads_elsewhere_is_refused_and_nothing_is_written(name: str, tmp_path: Path) -> None:
    worker = Worker({name: b"planted"})
    with pytest.raises(TransferError, match="does not lead into the run's folder"):
        _brought(worker, tmp_path)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_no_link_is_followed(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    root = tmp_path / "experiment"
    for folder in (outside, root / "runs" / "r_1"):
        folder.mkdir(parents=True)
    (root / "runs" / "r_1" / "Ina219").symlink_to(outside)
    with pytest.raises(StorageError, match="symbolic link"):
        _brought(Worker({"Ina219/raw": b"planted"}), root)
    assert list(outside.iterdir()) == []


def test_a_file_is_written_once(tmp_path: Path) -> None:
    worker = Worker({"raw": b"first"})
    worker.list *= 2
    doubled = {**worker.ended, "files": 2, "bytes": 10, "list": len(worker.list)}
    run = tmp_path / "runs" / "r_1"
    run.parent.mkdir()
    with pytest.raises(StorageError):
        asyncio.run(bring_home(worker.read, doubled, run, tmp_path))
    assert (run / "raw").read_bytes() == b"first"


def test_a_piece_that_was_changed_on_its_way_is_asked_for_again(tmp_path: Path) -> None:
    class Noisy(Worker):
        async def read(self, name: str, offset: int, size: int) -> tuple[bytes, str]:
            piece, digest = await super().read(name, offset, size)
            return (b"!" + piece[1:] if name and self.asked == 2 else piece), digest

    worker = Noisy({"raw": b"as it was"})
    assert (_brought(worker, tmp_path) / "raw").read_bytes() == b"as it was"
    assert worker.asked == 3


@pytest.mark.parametrize("error", [TimeoutError, ConnectionError])
def test_a_worker_that_falls_silent_in_the_midst_of_a_file_is_no_lack_of_room(
    error: type[OSError], tmp_path: Path
) -> None:
    """The attempt is lost then, and made again elsewhere; it has not failed."""

    class Leaving(Worker):
        async def read(self, name: str, offset: int, size: int) -> tuple[bytes, str]:
            if name:
                raise error
            return await super().read(name, offset, size)

    with pytest.raises(error):
        _brought(Leaving({"raw.bin": b"raw"}), tmp_path)


def test_a_file_that_cannot_be_written_here_is_told_with_its_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(StorageError, match=r"raw\.bin: .*No space left"):
        _brought(Worker({"raw.bin": b"raw"}), tmp_path)


def test_a_file_that_is_not_what_was_announced_is_an_error(tmp_path: Path) -> None:
    worker = Worker({"raw": b"as it was"})
    worker.files = {"raw": b"as it is!"}
    with pytest.raises(TransferError, match="another SHA-256"):
        _brought(worker, tmp_path)


@pytest.mark.parametrize("line", ['["raw", -1, ""]', '["raw", true, ""]', '["raw", 1]', "7", "{}", "no JSON"])
def test_an_odd_list_is_an_error(line: str, tmp_path: Path) -> None:
    worker = Worker({"raw": b"1"})
    worker.list = line.encode()
    with pytest.raises(TransferError):
        _brought(worker, tmp_path)


def test_more_than_fits_is_refused_before_anything_is_asked_for(tmp_path: Path) -> None:
    worker = Worker({})
    with pytest.raises(StorageError, match="are free here"):
        asyncio.run(bring_home(worker.read, {"files": 1, "bytes": 10**18, "list": 9}, tmp_path / "run", tmp_path))
    assert worker.asked == 0


def test_what_a_run_has_shut_is_opened_up_and_links_lead_nowhere(tmp_path: Path) -> None:
    outside, left = tmp_path / "outside", tmp_path / "left"
    outside.mkdir(mode=0o500)
    (left / "cache").mkdir(parents=True)
    (left / "link").symlink_to(outside)
    (left / "cache" / "bag.db3").write_bytes(b"scans")
    (left / "cache" / "bag.db3").chmod(0)
    (left / "cache").chmod(0o500)
    open_up(left)
    modes = [stat.S_IMODE(each.stat().st_mode) for each in (left / "cache", left / "cache" / "bag.db3", outside)]
    assert modes == [0o700, 0o400, 0o500]
    assert listed_files(left) == ([("cache/bag.db3", 5, hashlib.sha256(b"scans").hexdigest())], ["link"], [])


def test_what_may_not_be_read_is_listed_apart_from_all_that_may(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tmp_path.chmod(0o755)
    monkeypatch.chdir(tmp_path)  # somebody else may not enter the folders above it
    left = Path("left")
    for each in ("of_root", "unlisted", "unentered"):
        (left / each).mkdir(parents=True)
        (left / each / "bag.db3").write_bytes(b"scans")
    (left / "energy.csv").write_bytes(b"1")
    (left / "of_root" / "bag.db3").chmod(0)
    (left / "unlisted").chmod(0o300)
    (left / "unentered").chmod(0o444)
    is_root = os.geteuid() == 0
    if is_root:  # who may read everything
        os.seteuid(_NOBODY)
    try:
        files, others, unread = listed_files(left)
    finally:
        if is_root:
            os.seteuid(0)
        for kept in left.iterdir():
            kept.chmod(0o700)
    assert (files, others) == ([("energy.csv", 1, hashlib.sha256(b"1").hexdigest())], [])
    assert unread == ["of_root/bag.db3", "unentered/bag.db3", "unlisted"]
