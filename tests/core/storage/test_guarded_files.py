"""Files of an experiment folder are opened without following links, waiting for pipes, or reading without end."""

from __future__ import annotations

import json
import os
import socket
import stat
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.guarded_files import (
    MissingFileError,
    make_experiment_folder,
    make_folder,
    open_descriptor,
    open_to_append,
    open_to_read,
    open_to_write,
    read_blocks,
    read_bytes,
    read_json,
    read_text,
    remove,
    replace,
)

Opener = Callable[[Path, Path], object]


def _append(path: Path, root: Path) -> None:
    with open_to_append(path, root) as file:
        file.write(b"more")


def _replace(path: Path, root: Path) -> None:
    replace(path, "new", root)


def _lock(path: Path, root: Path) -> None:
    os.close(open_descriptor(path, root))


READERS: list[Opener] = [
    open_to_read,
    read_bytes,
    read_text,
    read_json,
    lambda path, root: list(read_blocks(path, root)),
]
WRITERS: list[Opener] = [_append, _replace, _lock]


def refusal(opener: Opener, path: Path, root: Path) -> StorageError:
    began = time.monotonic()
    with pytest.raises(StorageError) as caught:
        opener(path, root)
    assert time.monotonic() - began < 5
    assert caught.value.where == str(path)
    assert caught.value.fix
    return caught.value


def odd_ones(root: Path) -> dict[str, Path]:
    """Return what could stand in place of a file, by the words that name it."""
    outside = root.parent / "outside.txt"
    outside.write_text("secret", encoding="utf-8")
    made = {
        "symbolic link": root / "link",
        "a symbolic link": root / "dangling",
        "link": root / "zero",
        "named pipe": root / "pipe",
        "socket": root / "socket",
        "folder": root / "folder",
    }
    made["symbolic link"].symlink_to(outside)
    made["a symbolic link"].symlink_to(root.parent / "nowhere.txt")
    made["link"].symlink_to("/dev/zero")
    os.mkfifo(made["named pipe"])
    made["folder"].mkdir()
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(made["socket"]))
    return made


@pytest.mark.parametrize("opener", [*READERS, *WRITERS])
def test_what_is_no_regular_file_is_refused_with_its_kind_and_left_alone(tmp_path: Path, opener: Opener) -> None:
    (root := tmp_path / "experiment").mkdir()
    for words, path in odd_ones(root).items():
        assert words in refusal(opener, path, root).problem
    assert (tmp_path / "outside.txt").read_text(encoding="utf-8") == "secret"
    assert not (tmp_path / "nowhere.txt").exists()
    assert sorted(path.name for path in root.iterdir()) == ["dangling", "folder", "link", "pipe", "socket", "zero"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make a device")
def test_a_device_is_refused(tmp_path: Path) -> None:
    try:
        os.mknod(tmp_path / "zero", stat.S_IFCHR | 0o666, os.makedev(1, 5))
    except PermissionError:
        pytest.skip("this container makes no devices")
    for opener in [*READERS, *WRITERS]:
        assert "device" in refusal(opener, tmp_path / "zero", tmp_path).problem


@pytest.mark.parametrize("opener", [*READERS, *WRITERS])
def test_a_folder_on_the_way_that_is_a_link_is_refused_and_named(tmp_path: Path, opener: Opener) -> None:
    (root := tmp_path / "experiment").mkdir()
    (tmp_path / "elsewhere" / "r_1").mkdir(parents=True)
    (tmp_path / "elsewhere" / "r_1" / "log.txt").write_text("{}", encoding="utf-8")
    (root / "runs").symlink_to(tmp_path / "elsewhere")
    assert "'runs' is a symbolic link" in refusal(opener, root / "runs" / "r_1" / "log.txt", root).problem
    assert (tmp_path / "elsewhere" / "r_1" / "log.txt").read_text(encoding="utf-8") == "{}"


@pytest.mark.parametrize("opener", [*READERS, *WRITERS])
def test_a_path_that_leads_outside_is_refused(tmp_path: Path, opener: Opener) -> None:
    (root := tmp_path / "experiment").mkdir()
    (root / "runs").mkdir()
    (tmp_path / "outside.txt").write_text("{}", encoding="utf-8")
    for path in (root / ".." / "outside.txt", root / "runs" / ".." / ".." / "outside.txt", tmp_path / "outside.txt"):
        assert "out of the experiment's folder" in refusal(opener, path, root).problem


def test_the_experiment_itself_may_be_reached_over_a_link(tmp_path: Path) -> None:
    (disk := tmp_path / "disk").mkdir()
    (root := tmp_path / "experiment").symlink_to(disk)
    replace(root / "manifest.json", "{}", root)
    assert read_json(root / "manifest.json", root) == {}
    assert (disk / "manifest.json").read_text(encoding="utf-8") == "{}"


def test_a_relative_experiment_folder_is_as_good_as_an_absolute_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    replace(Path("note.txt"), "here", Path())
    assert read_text(Path("note.txt"), Path()) == read_text(Path("note.txt")) == "here"


@pytest.mark.parametrize("opener", READERS)
def test_a_file_that_is_missing_has_an_error_of_its_own(tmp_path: Path, opener: Opener) -> None:
    with pytest.raises(MissingFileError):
        opener(tmp_path / "nothing", tmp_path)
    with pytest.raises(MissingFileError):
        opener(tmp_path / "no" / "folder", tmp_path)


def test_a_file_beyond_the_limit_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "manifest.json"
    with path.open("wb") as file:
        file.truncate(200_000_000_000)  # sparse: it takes no room on the disk
    for opener in (read_bytes, read_text, read_json):
        found = refusal(opener, path, tmp_path)
        assert "200.0 GB" in found.problem
    assert "1.0 kB" in refusal(lambda path, root: open_to_read(path, root, limit=1000), path, tmp_path).problem
    assert "a line of more than" in refusal(READERS[-1], path, tmp_path).problem


def test_lines_come_as_they_stand_and_long_ones_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b"one\ntwo\r\nthree")
    assert list(read_blocks(path, tmp_path)) == [b"one\ntwo\r\n", b"three"]
    assert list(read_blocks(path, tmp_path, longest=5)) == [b"one\n", b"two\r\n", b"three"]
    with pytest.raises(StorageError, match="line of more than 4 B"):
        list(read_blocks(path, tmp_path, longest=4))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"[" * 100_000 + b"]" * 100_000, "nested"),
        (b"[" * 65 + b"]" * 65, "nested deeper than 64 levels"),
        (b'{"a":' * 65 + b"1" + b"}" * 65, "nested deeper than 64 levels"),
        (b"", "not valid JSON"),
        (b"{", "not valid JSON"),
        (b"\xff\xfe{\x00}\x00", "not valid JSON"),
        (b"9" * 5000, "not valid JSON"),
    ],
)
def test_json_that_cannot_be_taken_is_refused_with_the_reason(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "schema.json"
    path.write_bytes(content)
    assert words in refusal(read_json, path, tmp_path).problem


def test_json_up_to_the_bound_is_read(tmp_path: Path) -> None:
    path = tmp_path / "schema.json"
    path.write_text("\ufeff" + "[" * 64 + "]" * 64, encoding="utf-8")
    assert json.dumps(read_json(path, tmp_path)) == "[" * 64 + "]" * 64


def test_replacing_is_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    replace(path, b"old", tmp_path)

    def write_half() -> None:
        with open_to_write(path, tmp_path) as file:
            file.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert path.read_bytes() == b"old"
    with open_to_write(path, tmp_path) as file:
        file.write(b"new")
    assert path.read_bytes() == b"new"
    assert [each.name for each in tmp_path.iterdir()] == ["table.csv"]


def test_a_link_planted_where_a_file_is_written_beside_is_not_followed(tmp_path: Path) -> None:
    (root := tmp_path / "experiment").mkdir()
    (root / f".table.csv.{threading.get_native_id()}.tmp").symlink_to(tmp_path / "victim")
    replace(root / "table.csv", "new", root)
    assert not (tmp_path / "victim").exists()
    assert [each.name for each in root.iterdir()] == ["table.csv"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to another user")
def test_a_hard_link_to_another_users_file_is_not_written(tmp_path: Path) -> None:
    (root := tmp_path / "experiment").mkdir()
    (theirs := tmp_path / "theirs").write_bytes(b"theirs")
    os.chown(theirs, 65534, 65534)
    (root / "journal.jsonl").hardlink_to(theirs)
    for opener in (_append, _lock):
        assert "hard link" in refusal(opener, root / "journal.jsonl", root).problem
    replace(root / "journal.jsonl", "ours", root)  # the name is given to another file
    assert theirs.read_bytes() == b"theirs"


@pytest.mark.parametrize(
    ("of_folder", "umask", "of_file"),
    [
        (0o700, 0o022, 0o600),
        (0o700, 0o002, 0o600),
        (0o755, 0o022, 0o644),
        (0o2775, 0o002, 0o664),
        (0o755, 0o077, 0o600),
    ],
)
def test_files_and_folders_may_be_read_by_those_who_may_read_the_experiment(
    tmp_path: Path, of_folder: int, umask: int, of_file: int
) -> None:
    (root := tmp_path / "experiment").mkdir()
    root.chmod(of_folder)
    before = os.umask(umask)
    try:
        make_folder(root / "runs" / "r_1", root)
        replace(root / "manifest.json", "{}", root)
        _append(root / "runs" / "r_1" / "log.txt", root)
    finally:
        os.umask(before)
    for path in (root / "manifest.json", root / "runs" / "r_1" / "log.txt"):
        assert stat.S_IMODE(path.stat().st_mode) == of_file
    assert (root / "runs" / "r_1").stat().st_mode & 0o666 == of_file


@pytest.mark.parametrize(
    ("of_parent", "umask", "of_folder"),
    [(0o755, 0o022, 0o700), (0o777, 0o000, 0o700), (0o2775, 0o002, 0o2770), (0o2755, 0o022, 0o2750)],
)
def test_a_new_experiment_is_its_owners_or_the_groups_that_shares_its_folder(
    tmp_path: Path, of_parent: int, umask: int, of_folder: int
) -> None:
    (results := tmp_path / "results").mkdir()
    results.chmod(of_parent)
    before = os.umask(umask)
    try:
        make_experiment_folder(results / "experiment")
        make_experiment_folder(results / "experiment")
    finally:
        os.umask(before)
    assert stat.S_IMODE((results / "experiment").stat().st_mode) == of_folder


def test_the_rights_of_an_experiment_that_is_there_are_the_users_business(tmp_path: Path) -> None:
    (root := tmp_path / "experiment").mkdir()
    root.chmod(0o755)
    make_experiment_folder(root)
    assert stat.S_IMODE(root.stat().st_mode) == 0o755


def test_folders_are_made_beside_no_link(tmp_path: Path) -> None:
    (root := tmp_path / "experiment").mkdir()
    (root / "runs").symlink_to(tmp_path / "elsewhere")
    (root / "report").symlink_to(tmp_path)
    for path in (root / "runs", root / "runs" / "r_1", root / "report", root / "report" / "figures"):
        assert "symbolic link" in refusal(make_folder, path, root).problem
    (root / "log").write_text("", encoding="utf-8")
    assert "regular file" in refusal(make_folder, root / "log", root).problem
    assert [path.name for path in tmp_path.iterdir()] == ["experiment"]


def test_removing_takes_the_name_and_not_what_it_points_to(tmp_path: Path) -> None:
    (root := tmp_path / "experiment").mkdir()
    (outside := tmp_path / "outside").write_text("x", encoding="utf-8")
    (root / ".control").symlink_to(outside)
    remove(root / ".control", root)
    remove(root / ".control", root)
    assert list(root.iterdir()) == []
    (root / "runs").symlink_to(tmp_path)
    assert "symbolic link" in refusal(remove, root / "runs" / "outside", root).problem
    assert outside.exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_what_the_system_refuses_is_said_with_a_fix(tmp_path: Path) -> None:
    (path := tmp_path / "manifest.json").write_text("{}", encoding="utf-8")
    path.chmod(0)
    assert "Permission denied" in refusal(read_json, path, tmp_path).problem


def test_threads_that_replace_one_file_at_once_do_not_disturb_each_other(tmp_path: Path) -> None:
    path = tmp_path / ".control"
    together = threading.Barrier(4)

    def write(letter: str) -> None:
        together.wait()
        for _ in range(50):
            replace(path, letter * 1000)
            assert path.read_text() in {each * 1000 for each in "abcd"}

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(write, "abcd"))
    assert [each.name for each in tmp_path.iterdir()] == [".control"]
