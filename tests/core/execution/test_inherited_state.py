"""What callbacks wrote to files that they leave open is there, though a forked run ends without Python's own end.

And each run draws random numbers of its own.
"""

from __future__ import annotations

import csv
import gc
import gzip
import io
import random
import socket
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution import inherited_state
from robot_runner.core.execution.inherited_state import seed_random_numbers
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment

LEAVING = """
import csv, gzip, os, zipfile
from robot_runner import ExperimentConfig, Factor, RunTableModel

class FullDisk(open(os.devnull).__class__):
    def flush(self):
        raise OSError(28, "No space left on device")

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "leaving"
    workers = 1

    def before_experiment(self, context):
        self.all = open(context.experiment_folder / "all.csv", "w")
        self.all.write("head\\n")
        self.closed = open(context.experiment_folder / "closed.csv", "w")
        self.closed.close()

    def before_run(self, context):
        self.all.write(f"before {context.run_id}\\n")
        self.of_run = open(context.experiment_folder / f"{context.run_id}.csv", "w")
        self.of_run.write("before\\n")

    def start_run(self, context):
        self.text = open(context.run_folder / "own.csv", "w")
        self.bytes = open(context.run_folder / "own.bin", "wb")
        self.packed = gzip.open(context.run_folder / "own.gz", "wt")
        self.archive = zipfile.ZipFile(context.run_folder / "own.zip", "w")
        self.random = open(context.run_folder / "own.dat", "w+b")
        if context.combination["Disk"] == "full":
            self.full = FullDisk(open(context.run_folder / "full.csv", "wb"))

    def launch_mission(self, context):
        csv.writer(self.text).writerow([1, 2])
        self.of_run.write("in the run\\n")
        for each in (self.bytes, self.random):
            each.write(b"abc")
        self.packed.write("packed")
        self.archive.writestr("name", "text")
        if context.combination["Disk"] == "killed":
            raise SystemExit(3)

    def populate_run_data(self, context):
        self.all.write(f"run {context.run_id}\\n")

    def after_experiment(self, context):
        self.all.write("end\\n")
        self.all.flush()

    def create_run_table(self):
        return RunTableModel([Factor("Disk", ["fine", "killed", "full"])])
"""


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_what_callbacks_have_written_is_in_files_that_they_leave_open(tmp_path: Path) -> None:
    config = tmp_path / "leaving.py"
    config.write_text(LEAVING, encoding="utf-8")
    finished = execute_experiment(prepare_or_refuse(config), SilentObserver())
    folder = tmp_path / "experiments" / "leaving"
    lines = ["head", "before r_1", "run r_1", "before r_2", "before r_3", "run r_3", "end"]
    assert (folder / "all.csv").read_text(encoding="utf-8").splitlines() == lines
    for run in ("r_1", "r_2", "r_3"):
        own = folder / "runs" / run
        assert (folder / f"{run}.csv").read_text(encoding="utf-8") == "before\nin the run\n"
        assert (own / "own.csv").read_bytes() == b"1,2\r\n"
        assert (own / "own.bin").read_bytes() == (own / "own.dat").read_bytes() == b"abc"
        assert gzip.decompress((own / "own.gz").read_bytes()) == b"packed"
        assert b"text" in (own / "own.zip").read_bytes()
        assert (own / "own.zip").read_bytes()[-22:-18] == b"PK\x05\x06"  # the end of an archive
    assert (finished.done_count, finished.failed_count) == (1, 2)
    full = folder / "runs" / "r_3" / "full.csv"
    problem = f"{full} lacks part of what was written to it: No space left on device"
    assert any(problem in failure for failure in finished.failures), finished.failures


class AsksForItsClass:
    @property
    def __class__(self) -> type:
        raise AssertionError("it was asked")


def test_what_is_no_file_on_a_disk_is_left_alone(tmp_path: Path) -> None:
    strange = AsksForItsClass()
    one, other = socket.socketpair()
    with one, other, one.makefile("w") as line, io.TextIOWrapper(io.BytesIO()) as memory:
        line.write("waits")
        memory.write("waits")
        assert inherited_state.write_open_files() == []
        other.setblocking(False)
        with pytest.raises(BlockingIOError):
            other.recv(10)
        assert memory.buffer.getvalue() == b""
    del strange


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_files_are_not_kept_open_by_being_known(tmp_path: Path) -> None:
    file = (tmp_path / "file").open("w")
    file.write("text")
    inherited_state.note_open_files()
    del file
    gc.collect()
    assert (tmp_path / "file").read_text() == "text"
    inherited_state.write_inherited()


DRAWING = """
import random
import numpy as np
from robot_runner import ExperimentConfig, Factor, RunTableModel

np.random.seed(1)
random.seed(1)

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "drawing"

    def before_run(self, context):
        context.share(drawn=random.random() + np.random.normal())

    def populate_run_data(self, context):
        before = context.plugin_data["config"]["drawn"]
        return {"Python": random.random(), "NumPy": np.random.normal(), "Before": before}

    def create_run_table(self):
        return RunTableModel([Factor("A", [1, 2])], repetitions=2, seed=5, data_columns=["Python", "NumPy", "Before"])
"""


def drawn(folder: Path, **settings: str) -> list[tuple[str, ...]]:
    config = folder / "drawing.py"
    folder.mkdir()
    config.write_text(DRAWING, encoding="utf-8")
    finished = execute_experiment(prepare_or_refuse(config, settings), SilentObserver())
    assert finished.done_count == 4, finished.failures
    with (folder / "experiments" / "drawing" / "run_table.csv").open(encoding="utf-8", newline="") as file:
        return [(row["Python"], row["NumPy"], row["Before"]) for row in csv.DictReader(file)]


@pytest.mark.long
def test_each_run_draws_numbers_of_its_own_and_the_same_in_each_kind_of_process(tmp_path: Path) -> None:
    state, of_numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - which the config seeds
    try:
        forked = drawn(tmp_path / "forked")
        assert len(set(forked)) == 4
        for number in range(3):
            assert len({each[number] for each in forked}) == 4
        assert all(float(python) + float(numpy) != float(before) for python, numpy, before in forked)
        assert drawn(tmp_path / "together", workers="2") == forked
        assert drawn(tmp_path / "anew", run_process="spawn") == forked
        assert drawn(tmp_path / "here", run_process="in_process") == forked
    finally:
        random.setstate(state)
        np.random.set_state(of_numpy)  # noqa: NPY002


def test_what_was_not_imported_is_not_seeded_and_what_was_is(monkeypatch: pytest.MonkeyPatch) -> None:
    state, seeds = random.getstate(), []
    try:
        monkeypatch.setitem(sys.modules, "numpy.random", SimpleNamespace(seed=seeds.append))
        monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(manual_seed=seeds.append))
        seed_random_numbers(2**32 - 1)
        monkeypatch.delitem(sys.modules, "numpy.random")
        monkeypatch.delitem(sys.modules, "torch")
        seed_random_numbers(7)
    finally:
        random.setstate(state)
    assert seeds == [2**32 - 1] * 2
