"""Each reader of a file that we write returns a value or one of our errors, whatever bytes the file holds."""

from __future__ import annotations

import random
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.hostile.damaged_bytes import EXAMPLES, damaged, read_or_refused

from robot_runner.analysis.sample_files import headings_of, split_unit
from robot_runner.core.execution.durations import Durations
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.storage.executed_runs import ExcludedRuns, done_runs, executed_order
from robot_runner.core.storage.journal import Journal, last_records, read_journal
from robot_runner.core.storage.lock import holder_of, take_request
from robot_runner.core.storage.manifest import is_damaged, read_manifest
from robot_runner.core.storage.outliving import outliving
from robot_runner.core.storage.registration import read_registration
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.legacy.recognition import recognise
from robot_runner.replication.opening import open_package
from robot_runner.replication.run_history import RunHistory
from robot_runner.replication.verification import verify_package

if TYPE_CHECKING:
    from tests.hostile.hostile_original import Original

Reader = Callable[[Path], Any]


def _journal(path: Path) -> None:
    """Read it as each of those does that has a reader of its own."""
    for read in (
        lambda: list(read_journal(path)),
        lambda: list(last_records(path, kinds=["attempt_started", "attempt_finished"])),
        lambda: ExcludedRuns.read(path),
        lambda: (done_runs(path), executed_order(path)),
        lambda: Durations().learn_from(path),
        lambda: RunHistory.read(path, "r_1"),
        lambda: Journal(path).close(),
    ):
        read_or_refused(read)


def _manifest(path: Path) -> None:
    read_or_refused(lambda: read_manifest(path))
    is_damaged(path)
    read_or_refused(lambda: read_status(path.parent))


def _table(path: Path) -> None:
    schema = read_schema(path.with_name("run_table.schema.json"))
    read_or_refused(lambda: read_run_table(path, TableLayout.of_schema(schema)))
    read_or_refused(lambda: read_run_table(path, TableLayout((), stamps=())))


def _package(path: Path) -> None:
    def verify() -> None:
        with open_package(path) as package:
            verify_package(package)

    read_or_refused(verify)


def _samples(path: Path) -> None:
    read_or_refused(lambda: [split_unit(heading) for heading in headings_of(path)])


def _control(path: Path) -> None:
    take_request(path)


#: The file, and how it is read.
READERS: dict[str, tuple[str, Reader]] = {
    "journal": ("journal.jsonl", _journal),
    "manifest": ("manifest.json", _manifest),
    "schema": ("run_table.schema.json", lambda path: read_or_refused(lambda: read_schema(path))),
    "table": ("run_table.csv", _table),
    "registration": ("registration.json", lambda path: read_or_refused(lambda: read_registration(path))),
    "samples": ("runs/r_1/Ina219/samples.csv", _samples),
    "control file": (".control", _control),
    "lock": (".lock", holder_of),
    "list of processes": (".outliving", outliving),
    "config": ("config/small.py", lambda path: read_or_refused(lambda: recognise(path))),
    "package": ("small.zip", _package),
}


@pytest.mark.long
@pytest.mark.parametrize("name", READERS)
@settings(suppress_health_check=list(HealthCheck), max_examples=EXAMPLES)
@given(seed=st.integers(0, 2**32))
def test_whatever_a_file_holds_it_is_read_or_refused(
    original: Original, tmp_path_factory: pytest.TempPathFactory, name: str, seed: int
) -> None:
    relative, read = READERS[name]
    folder = _copy_of(original, tmp_path_factory)
    path = folder / relative
    whole = _whole(original, relative)
    try:
        path.write_bytes(damaged(whole, random.Random(seed)))  # noqa: S311 - chance, and no secret
        read(path)
    finally:
        path.write_bytes(whole)


@pytest.mark.long
def test_the_files_are_in_order_before_they_are_damaged(
    original: Original, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Else each would be refused at once, and nothing behind it were searched."""
    folder = _copy_of(original, tmp_path_factory)
    assert read_status(folder).done == 4
    assert len(read_schema(folder / "run_table.schema.json")) > 10
    assert read_registration(folder / "registration.json").is_intact
    assert zipfile.is_zipfile(folder / "small.zip")
    with open_package(folder / "small.zip") as package:
        assert verify_package(package).is_intact


_REQUEST = b'{"command": "continue", "answers": {"Temperature": "21.5"}}'
_SPARED = b'[1, "12"]\n[4000000, "7"]\n'
_HOLDER = b'{"pid": 7, "host": "lab", "since": "2026-01-31T12:00:00.000Z"}'
_copies: dict[Path, Path] = {}


def _whole(original: Original, relative: str) -> bytes:
    if relative == "small.zip":
        return original.package.read_bytes()
    made = {".control": _REQUEST, ".outliving": _SPARED, ".lock": _HOLDER}
    return made[relative] if relative in made else (original.study / original.folder / relative).read_bytes()


def _copy_of(original: Original, factory: pytest.TempPathFactory) -> Path:
    if original.study not in _copies:
        folder = factory.mktemp("fuzzed") / "small"
        import shutil

        shutil.copytree(original.study / original.folder, folder)
        shutil.copy(original.package, folder / "small.zip")
        _copies[original.study] = folder
    return _copies[original.study]
