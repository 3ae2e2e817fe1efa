from __future__ import annotations

import os
import resource
import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import StorageError
from robot_runner.core.events.measure import as_measure_value
from robot_runner.core.storage import guarded_files
from robot_runner.core.storage import journal as journal_file
from robot_runner.core.storage.journal import Journal, read_journal, utc_now
from robot_runner.core.storage.manifest import read_manifest, write_manifest


def test_what_is_appended_is_read_back_in_order(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    with Journal(path) as journal:
        journal.append("first", text="line\nbreak, ünïcode")
        journal.append("second", flush=True, number=1.5)
    records = list(read_journal(path))
    assert [record["kind"] for record in records] == ["first", "second"]
    assert records[0]["text"] == "line\nbreak, ünïcode"
    assert records[1]["number"] == 1.5


def test_a_journal_that_is_opened_again_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    for number in range(3):
        with Journal(path) as journal:
            journal.append("opened", number=number)
    assert [record["number"] for record in read_journal(path)] == [0, 1, 2]


@given(st.binary(max_size=200).filter(lambda torn: b"\n" not in torn))
def test_a_torn_last_line_is_passed_over_and_cut_off(tmp_path_factory: pytest.TempPathFactory, torn: bytes) -> None:
    path = tmp_path_factory.mktemp("torn") / "journal.jsonl"
    with Journal(path) as journal:
        journal.append("whole")
    with path.open("ab") as file:
        file.write(torn)
    assert [record["kind"] for record in read_journal(path)] == ["whole"]
    with Journal(path) as journal:
        journal.append("after")
    assert [record["kind"] for record in read_journal(path)] == ["whole", "after"]


def test_a_torn_line_longer_than_a_block_is_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b'{"kind":"whole"}\n' + b"x" * 200_000)
    with Journal(path):
        pass
    assert path.read_bytes() == b'{"kind":"whole"}\n'


def test_a_file_without_ends_of_lines_is_no_journal_and_stays_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_file, "LINE_LIMIT", 100_000)
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b"x" * 300_000)
    with pytest.raises(StorageError, match="this is not a journal: its last 131,072 bytes have no end of a line"):
        Journal(path)
    assert path.stat().st_size == 300_000
    held = [os.path.realpath(each) for each in Path("/proc/self/fd").iterdir()]
    assert str(path) not in held


def test_only_the_kinds_asked_for_are_read(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    with Journal(path) as journal:
        for kind in ("event", "finding", "event", "eventual"):
            journal.append(kind, event="start_run", owner="PsUtil", problem="a gap", fix="")
    assert [record["kind"] for record in read_journal(path, kinds={"event"})] == ["event", "event"]


def test_a_line_that_is_no_record_is_refused_with_its_number(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_text('{"kind":"a","at":"2026-01-31T12:00:00Z"}\nnonsense\n{"kind":"b"}\n')
    with pytest.raises(StorageError) as refused:
        list(read_journal(path))
    assert refused.value.where == f"{path}:2"


@pytest.mark.parametrize("value", [-(2**1023), 10**30, 2**63], ids=["the least", "a UUID", "beyond 64 bits"])
def test_a_whole_number_that_a_measure_may_have_is_read_back(tmp_path: Path, value: int) -> None:
    path = tmp_path / "journal.jsonl"
    assert as_measure_value("Serial", value, where="config") == value
    measures = {"Serial": {"value": value, "owner": "config", "origin": "measured"}}
    rest = {"run": "r_1", "attempt": 1, "status": "done", "seconds": 1.0, "failure": None, "stamps": {}}
    with Journal(path) as journal:
        journal.append("attempt_finished", measures=measures, **rest)
    assert [record["measures"] for record in read_journal(path)] == [measures]


def test_seeds_and_treatments_of_any_size_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    seed, parameters = 2**128 - 1, {"serial": {"factor": "Serial", "value": 10**20}}
    with Journal(path) as journal:
        journal.append("experiment_started", seed=seed)
        journal.append("bound", run="r_1", attempt=1, owner="Meter", parameters=parameters)
    assert [record.get("seed") for record in read_journal(path)] == [seed, None]
    write_manifest(tmp_path / "manifest.json", {"seed": seed, "design": {"batches": [{"batch": 1, "seed": seed}]}})
    assert read_manifest(tmp_path / "manifest.json")["seed"] == seed


def test_a_journal_that_is_not_there_has_no_records(tmp_path: Path) -> None:
    assert list(read_journal(tmp_path / "journal.jsonl")) == []


def test_a_journal_that_cannot_be_opened_is_an_error_with_a_fix(tmp_path: Path) -> None:
    with pytest.raises(StorageError) as refused:
        Journal(tmp_path / "missing" / "journal.jsonl")
    assert refused.value.fix


def test_moments_are_utc_with_milliseconds() -> None:
    assert len(utc_now()) == len("2026-01-31T12:00:00.250Z")
    assert utc_now().endswith("Z")


@pytest.mark.parametrize("block", [7, 64, 1_000_000])
def test_a_journal_is_read_alike_in_blocks_of_any_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int
) -> None:
    """Lines that a block cuts, kinds that are the beginning of another, and text that looks like a record."""
    monkeypatch.setattr(guarded_files, "_BLOCK", block)
    path = tmp_path / "journal.jsonl"
    kinds = ["said", "said_late", "other", "said", "third"]
    with Journal(path) as journal:
        for number, kind in enumerate(kinds * 20):
            journal.append(kind, number=number, event="start_run", text='\n{"kind":"event"}\n' * (number % 3))
    assert [record["number"] for record in read_journal(path)] == list(range(100))
    chosen = [record["number"] for record in read_journal(path, kinds={"third", "said"})]
    assert chosen == [number for number in range(100) if number % 5 in {0, 3, 4}]


_LINE = b'{"kind":"other","at":"2026-01-31T12:00:00.250Z"}\n'


@pytest.mark.parametrize("kinds", [None, {"other"}])
@pytest.mark.parametrize(
    "damage",
    [
        b'{"kind":"even\n',
        b"lost\n",
        b'{"kind":"event","a":1}\r\n',
        b'{"kind":"event"}{"kind":"event"\n',
        b'{"kind":"event"}{"kind":"finding"}\n',
        b'{"kind":"event","at":"2026-01-{"kind":"attempt_finished","at":"2026-01-31T12:00:00Z","run":"r_1"}\n',
    ],
)
def test_a_damaged_line_is_refused_after_those_before_it_whatever_kind_is_asked_for(
    tmp_path: Path, damage: bytes, kinds: set[str] | None
) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_bytes(_LINE * 3 + damage + _LINE)
    read = read_journal(path, kinds=kinds)
    assert [next(read)["kind"] for _ in range(3)] == ["other"] * 3
    with pytest.raises(StorageError) as refused:
        next(read)
    assert refused.value.findings[0].where == f"{path}:4"


@pytest.mark.parametrize("room", [0, 1, 40])
def test_a_record_for_which_the_disk_has_no_room_is_refused_and_leaves_nothing(tmp_path: Path, room: int) -> None:
    path = tmp_path / "journal.jsonl"
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    with Journal(path) as journal:
        journal.append("first")
        whole = path.read_bytes()
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(whole) + room, unlimited[1]))
        try:
            with pytest.raises(StorageError, match="cannot be written"):
                journal.append("lost", text="x" * 100)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
        assert path.read_bytes() == whole
        journal.append("second")
    assert [record["kind"] for record in read_journal(path)] == ["first", "second"]


def test_a_record_that_holds_a_mapping_with_a_kind_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    with Journal(path) as journal:
        journal.append("waiting", questions=[{"kind": "choice", "name": "battery"}])
        journal.append("other", known={"kind": "race"})
    assert [record["kind"] for record in read_journal(path)] == ["waiting", "other"]
    assert [record["kind"] for record in read_journal(path, kinds={"other"})] == ["other"]


@pytest.mark.parametrize("somebody_wrote", [None, "theirs"])
def test_a_journal_that_is_removed_or_replaced_while_it_is_open_is_put_back_whole(
    tmp_path: Path, somebody_wrote: str | None
) -> None:
    path = tmp_path / "journal.jsonl"

    def remove() -> None:
        path.unlink()
        if somebody_wrote:
            path.write_text(somebody_wrote)

    with Journal(path) as journal:
        journal.append("first")
        remove()
        journal.append("second", flush=True)
        assert [record["kind"] for record in read_journal(path)] == ["first", "second"]
        journal.append("third", flush=True)
        remove()
    assert [record["kind"] for record in read_journal(path)] == ["first", "second", "third"]
    kept = [each.read_text() for each in tmp_path.iterdir() if each != path]
    assert kept == ([somebody_wrote] if somebody_wrote else [])


def test_a_journal_that_was_removed_does_not_take_the_place_of_one_that_another_process_writes(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    first = Journal(path, successor=lambda: "another process has executed the experiment again since")
    first.append("first")
    path.unlink()
    with Journal(path) as other:
        other.append("other")
        with pytest.raises(StorageError, match="another process has executed the experiment again") as refused:
            first.append("second", flush=True)
        other.append("another")
    (kept,) = tmp_path.glob("journal.jsonl.removed-*")
    assert kept.name in refused.value.fix
    assert [record["kind"] for record in read_journal(kept)] == ["first", "second"]
    assert [record["kind"] for record in read_journal(path)] == ["other", "another"]


def test_a_journal_whose_folder_is_removed_while_it_is_open_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "experiment" / "journal.jsonl"
    path.parent.mkdir()
    journal = Journal(path)
    shutil.rmtree(path.parent)
    with pytest.raises(StorageError, match="the experiment's folder was removed while it was executed"):
        journal.close()
    journal.close()


def test_what_is_written_beside_a_journal_has_it_put_back_and_is_refused_where_it_was_moved(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    with Journal(path) as journal:
        journal.stay_in_place()
        journal.append("first")
        path.unlink()
        journal.stay_in_place()
        assert [record["kind"] for record in read_journal(path)] == ["first"]
        path.rename(tmp_path / "moved.jsonl")
        with pytest.raises(StorageError, match="the journal was moved while it was written"):
            journal.stay_in_place()
        path.write_text("another's")
        with pytest.raises(StorageError, match="the journal was moved while it was written"):
            journal.stay_in_place()


def test_a_journal_that_is_moved_while_it_is_open_goes_on_where_it_is(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    with Journal(path) as journal:
        moved = path.rename(tmp_path / "moved.jsonl")
        journal.append("first", flush=True)
    assert [record["kind"] for record in read_journal(moved)] == ["first"]
    assert not path.exists()


def test_what_is_too_long_to_be_read_again_is_shortened_and_a_plan_that_is_too_long_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_file, "LINE_LIMIT", 50_000)
    path = tmp_path / "journal.jsonl"
    with Journal(path) as journal:
        journal.append("finding", owner="config", problem="x" * 50_000, fix="")
        whole = path.read_bytes()
        with pytest.raises(StorageError, match=r"a record 'extended' of 60,.* bytes could not be read again"):
            journal.append("extended", runs=["r"] * 15_000)
        assert path.read_bytes() == whole
        journal.append("finding", owner="config", problem="y" * 40_000, fix="")
    long, short = (record["problem"] for record in read_journal(path))
    assert long == "x" * 10_000 + "… (40,000 more characters)"
    assert short == "y" * 40_000
