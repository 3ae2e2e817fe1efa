"""The disk is full, read-only, or gone: a clear error, the journal intact, and the experiment resumes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

Start = Callable[..., Any]
Write = Callable[..., Path]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a file system of 256 KiB where the results go."""
    folder = tmp_path / "results"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", folder], check=False, capture_output=True, text=True
    )
    if mounted.returncode:
        pytest.skip(f"only root may mount a small file system here: {mounted.stderr.strip()}")
    yield folder
    subprocess.run(["umount", "--lazy", folder], check=True)


FILLING = """
def launch_mission(self, context):
    if context.run_id == "r_3" and not (Path(__file__).parent / "room").exists():
        with (Path(__file__).parent / "results" / "ballast").open("wb", buffering=0) as file:
            try:
                while True: file.write(b"x" * 512)
            except OSError: pass
def stop_run(self, context):
    with (Path(__file__).parent / "closed.txt").open("a") as file: print(context.run_id, file=file)
def populate_run_data(self, context): return {"Energy": 1.5}
"""


def test_a_full_disk_is_said_and_the_experiment_resumes_once_there_is_room(start: Start, small_disk: Path) -> None:
    experiment = start(FILLING)
    assert experiment.end() == 1, experiment.output
    assert "No space left on device" in experiment.output
    assert "Make room" in experiment.output
    assert "Traceback" not in experiment.output
    assert (experiment.config.parent / "closed.txt").read_text().split()[:2] == ["r_1", "r_2"]
    assert experiment.nobody_is_left()
    (small_disk / "ballast").unlink()
    (experiment.config.parent / "room").write_text("")
    again = start(config=experiment.config)
    assert again.end() == 0, again.output
    assert again.statuses == ["Done"] * 4
    attempts = (again.folder / "journal.jsonl").read_text().count('"kind":"attempt_started"')
    assert attempts <= 6, "runs that were done before the disk was full are not executed again"


@pytest.mark.long
def test_a_disk_that_fails_while_the_robot_moves_stops_the_robot(start: Start, small_disk: Path) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            import time
            with (Path(__file__).parent / "results" / "ballast").open("wb", buffering=0) as file:
                try:
                    while True: file.write(b"x" * 512)
                except OSError: pass
            for number in range(1000):
                context.share(number="x" * 100)
                time.sleep(0.01)
        def stop_run(self, context): (Path(__file__).parent / "stopped").write_text(context.run_id)
        """
    )
    assert experiment.end() == 1, experiment.output
    assert (experiment.config.parent / "stopped").read_text() == "r_1"
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_a_folder_that_is_deleted_under_the_experiment_is_an_error_that_names_it(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            import shutil
            if context.run_id == "r_2": shutil.rmtree(context.experiment_folder)
        """
    )
    assert experiment.end() == 1
    assert str(experiment.folder) in experiment.output
    assert "Traceback" not in experiment.output
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_after_experiment_comes_also_where_nothing_can_be_taken_down_any_more(start: Start) -> None:
    experiment = start(
        """
        def before_run(self, context):
            import resource
            if context.run_id == "r_2":
                size = (context.experiment_folder / "journal.jsonl").stat().st_size
                resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
        def after_experiment(self, context):
            (Path(__file__).parent / "closed").write_text(context.ended.failure)
        """
    )
    assert experiment.end() == 1
    assert "journal.jsonl: the file cannot be written" in experiment.output
    assert "journal.jsonl: the file cannot be written" in (experiment.config.parent / "closed").read_text()
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_a_folder_that_is_moved_under_the_experiment_ends_it_and_nothing_is_lost(start: Start) -> None:
    first = start(
        """
        def launch_mission(self, context):
            print("on the way in", context.run_id)
            there = Path(__file__).parent / "moved"
            if context.run_id == "r_2" and not (Path(__file__).parent / "was_moved").exists():
                (Path(__file__).parent / "was_moved").touch()
                context.experiment_folder.rename(there)
            context.run_folder.mkdir(parents=True, exist_ok=True)
            (context.run_folder / "own.csv").write_text(context.run_id)
        def populate_run_data(self, context): return {"Energy": 1.5}
        """
    )
    assert first.end() == 1
    moved = first.config.parent / "moved"
    assert "the experiment was moved or renamed while it was executed" in first.output
    assert f"its journal is {moved / 'journal.jsonl'}" in first.output
    shutil.copytree(first.folder, moved, dirs_exist_ok=True)  # what has come to lie there since
    shutil.rmtree(first.folder)
    moved.rename(first.folder)
    again = start(config=first.config)
    assert again.end() == 0, again.output
    assert again.statuses == ["Done"] * 4
    kept = again.folder / "earlier_attempts" / "r_2" / "1"
    for folder, run in ((again.folder / "runs" / "r_1", "r_1"), (kept, "r_2"), (again.folder / "runs" / "r_2", "r_2")):
        assert (folder / "own.csv").read_text() == run
        assert (folder / "log.txt").read_text() == f"on the way in {run}\n"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody who may not write")
def test_a_folder_that_may_not_be_written_is_refused_before_anything_is_executed(write_config: Write) -> None:
    config = write_config("results_output_path = Path('/proc/nowhere')")
    refused = subprocess.run(
        [sys.executable, "-m", "robot_runner", "run", str(config)],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert refused.returncode == 2
    assert "/proc" in refused.stderr
    assert "fix: " in refused.stderr


@pytest.mark.long
def test_a_results_folder_that_became_read_only_is_refused_and_left_alone(start: Start, tmp_path: Path) -> None:
    first = start("def populate_run_data(self, context): return {'Energy': 1}", "--only", "r_1")
    assert first.end() == 0, first.output
    before = {path: path.read_bytes() for path in first.folder.rglob("*") if path.is_file()}
    mounted = subprocess.run(
        ["mount", "--bind", "-o", "ro", first.folder, first.folder], check=False, capture_output=True
    )
    if mounted.returncode:
        pytest.skip("only root may mount a folder read-only here")
    try:
        subprocess.run(["mount", "-o", "remount,ro,bind", first.folder], check=True, capture_output=True)
        second = start(config=first.config)
        assert second.end() == 2
        assert "cannot be written" in second.output
        assert "fix: " in second.output
    finally:
        subprocess.run(["umount", first.folder], check=True)
    assert {path: path.read_bytes() for path in first.folder.rglob("*") if path.is_file()} == before


@pytest.mark.long
def test_a_torn_journal_and_a_missing_table_are_made_whole(start: Start) -> None:
    experiment = start("def populate_run_data(self, context): return {'Energy': 1.5}")
    assert experiment.end() == 0
    table = experiment.table
    with (experiment.folder / "journal.jsonl").open("ab") as file:
        file.write(b'{"kind":"attempt_star')
    again = start(config=experiment.config)
    assert again.end() == 0
    assert again.table == table


@pytest.mark.long
def test_a_corrupt_journal_is_refused_with_the_line(start: Start) -> None:
    experiment = start()
    assert experiment.end() == 0
    journal = experiment.folder / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    lines[1] = b'{"kind":"table_written" nonsense\n'
    journal.write_bytes(b"".join(lines))
    again = start(config=experiment.config)
    assert again.end() == 2
    assert "journal.jsonl:2" in again.output
    shutil.rmtree(experiment.folder)


@pytest.mark.long
def test_a_disk_that_fails_while_a_keeper_does_not_answer_ends_the_experiment_and_its_run(start: Start) -> None:
    experiment = start(
        """
        from robot_runner.core.execution import keeper
        from robot_runner.core.storage.journal import Journal
        keeper._MARGIN = 0.5
        grace_in_s = 0.5
        def refuse(self, kind, append=Journal.append, **fields):
            if kind == "shared":
                from robot_runner.core.errors import StorageError
                raise StorageError("the file cannot be written", where="journal.jsonl", fix="Make room.")
            append(self, kind, **fields)
        Journal.append = refuse
        def launch_mission(self, context):
            import os, signal, time
            os.kill(os.getppid(), signal.SIGSTOP)
            context.share(position=1)
            time.sleep(600)
        """
    )
    assert experiment.end() == 1
    assert "journal.jsonl: the file cannot be written" in experiment.output
    assert experiment.nobody_is_left()
