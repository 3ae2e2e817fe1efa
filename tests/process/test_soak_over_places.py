"""One experiment, executed over places of every kind and killed at random: its table is that of one worker."""

from __future__ import annotations

import csv
import os
import random
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.forked_program import MARK, RUNS, ForkedProgram
from tests.process.graph_simulation import simulated_robot
from tests.ros.dds_domain import LOOPBACK, claim_domain

from robot_runner.core.storage.outliving import has_in_environment, processes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from tests.cluster.conftest import Cluster

CONFIG = """
import random
from robot_runner import ExperimentConfig, Factor, Robots, RunTableModel
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "soaked"
    results_output_path = {results!r}
    robot = {robot}
    attempts = 20
    attempts_if_lost = 20
    grace_in_s = 2
    probe = False
    claims = []
    plugins = [BasicTurtlebot3(sleep_s=0.1, drive_s=0.2, task_s=0.1, rotate_s=1.8{odometry}), *{meters}]

    def populate_run_data(self, context):
        (context.raw_data_folder / "drawn.txt").write_text(str(context.run_seed))
        return {{"Drawn": random.Random(context.run_seed).random()}}

    def create_run_table(self):
        tasks = Factor("Task", ["Computation", "Network", "Video"])
        return RunTableModel([tasks], repetitions={repetitions}, shuffle=True, seed=4, data_columns={columns})
"""
SIMULATED = {"robot": "'simulated'", "meters": "[Ina219()]", "columns": '["Drawn", "Energy"]', "odometry": ""}
#: One execution of the soak may take so long, s: 300 runs, on a machine that does other things as well.
PATIENCE = 3600.0


class Soaked:
    """An experiment that is started again and again, and the processes of its executions."""

    def __init__(self, config: Path, folder: Path, wrapper: Sequence[str] = (), **environment: str) -> None:
        self.config = config
        self.folder = folder
        self.faults: Counter[str] = Counter()
        self._wrapper = wrapper
        self._mark = uuid.uuid4().hex
        self._environment = {**os.environ, **environment, MARK: self._mark}

    def start(self, *words: str) -> subprocess.Popen[bytes]:
        words = ("run", str(self.config), "--plain", *words)
        log = (self.config.parent / "log.txt").open("ab")
        with log:
            streams = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": log, "env": self._environment}
            if not self._wrapper:
                return ForkedProgram("robot_runner", words, RUNS, **streams)
            command = [*self._wrapper, sys.executable, "-m", "robot_runner", *words]
            return subprocess.Popen(command, start_new_session=True, **streams)

    @property
    def log(self) -> str:
        return (self.config.parent / "log.txt").read_text()[-4000:]

    def processes(self) -> list[int]:
        mark = f"{MARK}={self._mark}".encode()
        return [pid for pid in processes() if has_in_environment(pid, mark)]

    @property
    def done(self) -> int:
        with suppress(OSError):
            return sum(row["status"] == "Done" for row in table_of(self.folder))
        return 0

    def kill(self, whom: str, pids: Sequence[int]) -> None:
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
                self.faults[whom] += 1

    def end(self) -> None:
        self.kill("", self.processes())


def table_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "run_table.csv").open(encoding="utf-8", newline="") as file:
        return [{name: cell for name, cell in row.items() if not name.endswith("_at")} for row in csv.DictReader(file)]


def tortured(
    soaked: Soaked, kills: int, chance: random.Random, pauses: float, victims: Callable[[], list[int]]
) -> None:
    """Execute the experiment to its end, and meanwhile kill its orchestrator, others of its processes, or all.

    Args:
        soaked: the experiment.
        kills: how often.
        chance: chooses moments and victims.
        pauses: the longest time between two kills, s.
        victims: returns processes beside its own, of which one is killed now and then: of a cluster.
    """
    deadline = time.monotonic() + PATIENCE
    words = [[]] if victims() else [["--workers", str(count)] for count in (1, 2, 4)]
    process = soaked.start(*chance.choice(words))
    while process.poll() is None or process.returncode != 0:
        assert time.monotonic() < deadline, soaked.log
        if process.poll() is not None:
            gateway = "the process that speaks to the cluster has ended" in soaked.log
            # 1: an attempt too many was killed, or the experiment could not go on; 2: the same before its first run.
            assert process.returncode in {-signal.SIGKILL, 1, *([2] if gateway else [])}, soaked.log
            process = soaked.start(*chance.choice(words))
        if kills <= 0:
            process.wait(PATIENCE)
            continue
        time.sleep(chance.uniform(0.2, 1.0) * pauses)
        kills -= 1
        own, others = soaked.processes(), victims()
        whom = chance.choice(["orchestrator", "anybody", "anybody", "everybody", *(["cluster"] if others else [])])
        chosen = {
            "orchestrator": [process.pid],
            "anybody": [chance.choice(own)] if own else [],
            "everybody": own,
            "cluster": others[:1],
        }
        soaked.kill(whom, chosen[whom])
        time.sleep(0.05)


def written(folder: Path, name: str, results: str, repetitions: int, **facts: str) -> Path:
    (folder / name).mkdir()
    path = folder / name / "config.py"
    path.write_text(CONFIG.format(results=results, repetitions=repetitions, **{**SIMULATED, **facts}))
    return path


def untouched(folder: Path, repetitions: int) -> list[dict[str, str]]:
    """Return the table of one worker whom nobody kills."""
    config = written(folder, "alone", "results", repetitions)
    alone = Soaked(config, config.parent / "results" / "soaked")
    assert alone.start().wait(PATIENCE) == 0, alone.log
    return table_of(alone.folder)


def in_the_end_equal(soaked: Soaked, expected: Sequence[dict[str, str]], columns: Sequence[str]) -> None:
    rows = table_of(soaked.folder)
    assert [[row[name] for name in columns] for row in rows] == [[row[name] for name in columns] for row in expected]
    assert all(row["status"] == "Done" for row in rows)
    for row in rows:
        assert (soaked.folder / "runs" / row["run_id"] / "config" / "drawn.txt").exists()
    deadline = time.monotonic() + 60
    while soaked.processes():
        assert time.monotonic() < deadline, "somebody is left"
        time.sleep(0.1)


class Workers:
    """Two workers of a cluster without a shared folder; what is killed is started again, the scheduler too."""

    def __init__(self, cluster: Cluster, apart: list[str], chance: random.Random) -> None:
        self._cluster = cluster
        self._apart = apart
        self._chance = chance
        self._count = 0
        self._workers = [self._started() for _ in range(2)]

    def victims(self) -> list[int]:
        """Start again what was killed, and return all that can be, one at random first."""
        if self._cluster.scheduler.poll() is not None:
            self._cluster.start_scheduler()
        self._workers = [each if each.poll() is None else self._started() for each in self._workers]
        pids = [*(each.pid for each in self._workers), self._cluster.scheduler.pid]
        self._chance.shuffle(pids)
        return pids

    def _started(self) -> subprocess.Popen[bytes]:
        self._count += 1
        return self._cluster.worker(f"worker-{self._count}", before=self._apart)


@pytest.fixture
def torture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Counter[str]]]:
    """Return what executes the experiment over a kind of places, kills at random, and compares the tables."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with ExitStack() as opened:

        def begun(config: Path, **environment: str) -> Soaked:
            folder = config.parent / "results" / "soaked"
            soaked = Soaked(config, folder, **environment)
            opened.callback(soaked.end)
            return soaked

        def over_workers(repetitions: int, kills: int, chance: random.Random, pauses: float) -> Counter[str]:
            expected = untouched(tmp_path, repetitions)
            soaked = begun(written(tmp_path, "workers", "results", repetitions))
            tortured(soaked, kills, chance, pauses, list)
            in_the_end_equal(soaked, expected, list(expected[0]))
            return soaked.faults

        def over_cluster(repetitions: int, kills: int, chance: random.Random, pauses: float) -> Counter[str]:
            # Imported here: each process that other tests of this room fork would copy dask.
            from tests.cluster.conftest import Cluster, apart_from

            expected = untouched(tmp_path, repetitions)
            (tmp_path / "dask").mkdir()
            cluster = opened.enter_context(closing(Cluster(tmp_path / "dask")))
            results = tmp_path / "clustered" / "results"
            config = written(tmp_path, "clustered", "results", repetitions)
            results.mkdir()
            workers = Workers(cluster, apart_from(results), chance)
            text = config.read_text().replace("    claims = []", f"    claims = []\n    cluster = {cluster.address!r}")
            config.write_text(text)
            soaked = begun(config, DASK_ROBOT_RUNNER__LEASE="3s")
            tortured(soaked, kills, chance, pauses, workers.victims)
            in_the_end_equal(soaked, expected, list(expected[0]))
            return soaked.faults

        def over_robots(repetitions: int, kills: int, chance: random.Random, pauses: float) -> Counter[str]:
            expected = untouched(tmp_path, repetitions)
            monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
            domain = claim_domain()
            names = ("alice", "bob")
            for name in names:
                opened.enter_context(simulated_robot(f"dds:domain={domain}", "--namespace", f"/{name}"))
            links = ", ".join(f'"dds:domain={domain},namespace=/{name}"' for name in names)
            odometry = ", odometry_timeout_s=30"
            facts = {"robot": f"Robots({links})", "meters": "[]", "columns": '["Drawn"]', "odometry": odometry}
            soaked = begun(written(tmp_path, "robots", "results", repetitions, **facts))
            tortured(soaked, kills, chance, pauses, list)
            in_the_end_equal(soaked, expected, ["run_id", "status", "Task", "Repetition", "Drawn"])
            shares = Counter((row["Task"], row["Robot"]) for row in table_of(soaked.folder))
            assert len(shares) == 6
            assert max(shares.values()) - min(shares.values()) <= repetitions % 2
            return soaked.faults

        yield lambda kind, *asked: {"workers": over_workers, "cluster": over_cluster, "robots": over_robots}[kind](
            *asked
        )


@pytest.mark.long
def test_twenty_runs_over_workers_that_come_and_go_yield_the_table_of_one_worker(
    torture: Callable[..., Counter[str]], request: pytest.FixtureRequest
) -> None:
    faults = torture("workers", 7, 4, random.Random(2), 2.0)  # noqa: S311 - kills need no cryptography
    request.node.user_properties.append(("faults", faults.total()))


@pytest.mark.soak
@pytest.mark.timeout(2 * PATIENCE)
@pytest.mark.parametrize("kind", ["workers", "cluster", "robots"])
def test_three_hundred_runs_over_places_of_each_kind_yield_the_table_of_one_worker(
    torture: Callable[..., Counter[str]], request: pytest.FixtureRequest, kind: str
) -> None:
    faults = torture(kind, 100, 30, random.Random(3), 8.0)  # noqa: S311 - as above
    request.node.user_properties.append(("faults", faults.total()))
    request.node.user_properties += [(f"faults to {whom}", count) for whom, count in faults.items()]
