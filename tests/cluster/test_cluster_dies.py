"""What of a cluster can die or fall silent, really killed: no run is lost, and none is executed twice at a time."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.cluster.conftest import (
    BIN,
    LEASE,
    PATIENCE,
    Cluster,
    Proxy,
    Watched,
    apart_from,
    journal_of,
    table_of,
    until,
)
from tests.process.conftest import kill_together

from robot_runner.cluster.cluster_places import resource_of
from robot_runner.core.execution.going_on import goes_on
from robot_runner.testing.rosbridge_server import RosbridgeServer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@pytest.fixture
def proxy(cluster: Cluster) -> Iterator[Proxy]:
    """Return a connection between the orchestrator and the scheduler that can be cut."""
    made = Proxy(cluster.port)
    yield made
    made.close()


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _lost(watched: Watched) -> list[str]:
    """Return why attempts were lost."""
    return [record["failure"] for record in journal_of(watched.folder, "attempt_finished") if record.get("is_lost")]


def _ends_well(experiment: subprocess.Popen[str], watched: Watched) -> str:
    watched.go()
    answer, _ = experiment.communicate(timeout=PATIENCE)
    assert experiment.returncode == 0, answer
    assert [row["Twice"] for row in table_of(watched.folder)] == ["2.0", "4.0", "6.0"]
    assert not watched.was_executed_twice_at_a_time
    return answer


def test_the_run_of_a_worker_that_is_killed_is_lost_with_its_reason_and_executed_elsewhere(
    cluster: Cluster, watched: Watched
) -> None:
    worker = cluster.worker("killed")
    experiment = cluster.experiment(watched.config)
    run = watched.pid()
    os.killpg(worker.pid, signal.SIGKILL)
    until(lambda: not _is_alive(run), "the run ends with its worker")
    assert (watched.told / "r_1.closed").exists(), "it has closed what it opened"
    cluster.worker("other")
    until(lambda: _lost(watched), "the attempt is lost")
    answer = _ends_well(experiment, watched)
    (lost,) = _lost(watched)
    assert "the attempt was lost" in lost, answer
    assert "worker killed" in lost
    assert [record["place"] for record in journal_of(watched.folder, "attempt_started")][:2] == ["killed", "other"]
    assert cluster.left_on("other") == []


@pytest.mark.long
@pytest.mark.parametrize(
    "is_real", [pytest.param(True, id="a real robot"), pytest.param(False, id="no robot", marks=pytest.mark.soak)]
)
def test_of_the_robot_of_a_worker_whose_machine_failed_it_is_told_that_nobody_knows_whether_it_stands_still(
    cluster: Cluster, watched: Watched, is_real: bool
) -> None:
    with closing(RosbridgeServer()) as server:
        if is_real:
            robot = f"    robot = {server.url!r}\n    grace_in_s"
            watched.config.write_text(watched.config.read_text().replace("    grace_in_s", robot))
        offered = ["--resources", f"{resource_of(f'robot:{server.url}')}=1"]
        worker = cluster.worker("failed", *offered, MARKED="failed")
        experiment = cluster.experiment(watched.config)
        watched.pid()
        left = [int(each.name) for each in Path("/proc").glob("[0-9]*") if _is_marked(each, b"MARKED=failed")]
        assert worker.pid in left
        kill_together(left)
        cluster.worker("other", *offered)
        answer = " ".join(_ends_well(experiment, watched).split())
        assert ("whether its robot stands still is not known" in answer) == is_real


def _is_marked(process: Path, assignment: bytes) -> bool:
    try:
        return assignment in (process / "environ").read_bytes().split(b"\0")
    except OSError:
        return False


@pytest.mark.soak
def test_runs_end_where_their_orchestrator_was_killed_with_its_gateway(cluster: Cluster, watched: Watched) -> None:
    cluster.worker("one")
    experiment = cluster.experiment(watched.config)
    run = watched.pid()
    (mark,) = (path for path in watched.folder.glob(".probe-*") if path.name.count("-") == 1)
    os.utime(mark, (0.0, 0.0))
    until(lambda: mark.stat().st_mtime > 0.0, "the lease is renewed")
    for pid in _children(experiment.pid):  # the gateway has a session of its own
        os.kill(pid, signal.SIGKILL)
    os.killpg(experiment.pid, signal.SIGKILL)
    killed = time.monotonic()
    experiment.wait(PATIENCE)
    assert _is_alive(run)
    assert goes_on(watched.folder), "who claims the same robot waits"
    until(lambda: not _is_alive(run), "the run ends with its lease")
    assert time.monotonic() - killed < LEASE + 10
    assert (watched.told / "r_1.closed").exists()
    _ends_well(cluster.experiment(watched.config), watched)


def _children(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return [int(each) for task in tasks for each in (task / "children").read_text().split()]


@pytest.mark.long
def test_an_attempt_that_ended_with_its_lease_leaves_nothing_to_the_next_one_on_its_worker(
    cluster: Cluster, watched: Watched
) -> None:
    """The machine of the orchestrator slept for a while: the worker, and its process for runs, are the same then."""
    begins = """\
        context.run_path.mkdir(parents=True, exist_ok=True)
        with (context.run_path / "early.txt").open("a") as file:
            file.write(context.run_id)
        print(context.run_id)
        while not"""
    watched.config.write_text(watched.config.read_text().replace("        while not", begins))
    cluster.worker("one")
    experiment = cluster.experiment(watched.config)
    run = watched.pid()
    (gateway,) = (pid for pid in _children(experiment.pid) if b"gateway" in Path(f"/proc/{pid}/cmdline").read_bytes())
    os.kill(gateway, signal.SIGSTOP)
    until(lambda: not _is_alive(run), "the run ends with its lease")
    os.kill(gateway, signal.SIGCONT)
    until(lambda: _lost(watched), "the attempt is lost")
    _ends_well(experiment, watched)
    for name in ("r_1", "r_2", "r_3"):
        folder = watched.folder / "runs" / name
        assert (folder / "early.txt").read_text() == name
        assert (folder / "log.txt").read_text() == f"{name}\n"


@pytest.mark.long
def test_a_connection_that_breaks_and_is_made_anew_has_no_run_executed_twice_at_a_time(
    cluster: Cluster, watched: Watched, proxy: Proxy
) -> None:
    cluster.worker("one")
    cluster.worker("two")
    cluster.address = f"tcp://127.0.0.1:{proxy.port}"
    experiment = cluster.experiment(watched.config)
    watched.pid("r_1")
    watched.pid("r_2")
    proxy.reset()
    until(lambda: len(_lost(watched)) >= 2, "both attempts are lost")
    until(lambda: len(journal_of(watched.folder, "attempt_started")) >= 4, "they are begun again")
    time.sleep(2 * LEASE)
    _ends_well(experiment, watched)


@pytest.mark.soak
def test_a_run_is_told_at_once_to_stop_where_its_orchestrator_alone_was_killed(
    start_cluster: Callable[..., Cluster], watched: Watched
) -> None:
    cluster = start_cluster(settings={"DASK_ROBOT_RUNNER__LEASE": "1h"})
    cluster.worker("one")
    experiment = cluster.experiment(watched.config)
    run = watched.pid()
    experiment.kill()
    until(lambda: not _is_alive(run), "the gateway has the run stopped")
    assert (watched.told / "r_1.closed").exists()


@pytest.mark.soak
def test_a_nanny_starts_the_worker_again_that_was_killed(cluster: Cluster, watched: Watched) -> None:
    nanny = cluster.worker("one", nanny=True)
    experiment = cluster.experiment(watched.config)
    run = watched.pid()
    worker = next(pid for pid in _children(nanny.pid) if "spawn_main" in Path(f"/proc/{pid}/cmdline").read_text())
    os.kill(worker, signal.SIGKILL)
    until(lambda: not _is_alive(run), "the run ends with its worker")
    until(lambda: _lost(watched), "the attempt is lost")
    _ends_well(experiment, watched)
    assert {record["place"] for record in journal_of(watched.folder, "attempt_started")} == {"one"}


@pytest.mark.soak
def test_where_a_nanny_dies_its_worker_is_lost(cluster: Cluster, watched: Watched) -> None:
    nanny = cluster.worker("one", nanny=True)
    experiment = cluster.experiment(watched.config)
    run = watched.pid()
    nanny.kill()
    until(lambda: not _is_alive(run), "the run ends with the worker, which ends with its nanny")
    cluster.worker("other")
    _ends_well(experiment, watched)


@pytest.mark.soak
def test_a_scheduler_that_is_killed_and_started_again_costs_an_attempt(cluster: Cluster, watched: Watched) -> None:
    cluster.worker("one")
    experiment = cluster.experiment(watched.config)
    run = watched.pid()
    cluster.scheduler.kill()
    cluster.scheduler.wait()
    until(lambda: not _is_alive(run), "the run ends, as nobody renews its lease")
    cluster.start_scheduler()
    cluster.worker("two")
    answer = _ends_well(experiment, watched)
    assert len(_lost(watched)) == 1, answer


@pytest.mark.soak
def test_an_experiment_without_workers_ends_when_its_patience_does_and_resumes(
    cluster: Cluster, watched: Watched
) -> None:
    experiment = cluster.experiment(watched.config, DASK_ROBOT_RUNNER__PATIENCE="2s")
    answer, _ = experiment.communicate(timeout=PATIENCE)
    assert experiment.returncode == 2, answer
    assert "no worker has been there for 2 s" in answer
    assert "Traceback" not in answer
    cluster.worker("one")
    _ends_well(cluster.experiment(watched.config), watched)


@pytest.mark.soak
def test_a_cut_between_orchestrator_and_cluster_never_has_a_run_executed_twice_at_a_time(
    cluster: Cluster, watched: Watched, proxy: Proxy
) -> None:
    """Nobody is told of the cut: the run is stopped by its lease, and begun again some time after that."""
    cluster.worker("one")
    cluster.address = f"tcp://127.0.0.1:{proxy.port}"
    experiment = cluster.experiment(watched.config)
    run = watched.pid()
    proxy.cut()
    cut = time.monotonic()
    until(lambda: not _is_alive(run), "the run ends with its lease")
    assert time.monotonic() - cut < LEASE + 10
    assert (watched.told / "r_1.closed").exists()
    proxy.mend()
    _ends_well(experiment, watched)
    assert len(_lost(watched)) == 1


@pytest.mark.soak
def test_a_worker_that_is_cut_off_is_lost_and_used_again_when_it_is_back(cluster: Cluster, watched: Watched) -> None:
    """A stopped process answers nobody, as one does behind a cable that was pulled; its run goes on without it."""
    worker = cluster.worker("one")
    experiment = cluster.experiment(watched.config)
    run = watched.pid()
    worker.send_signal(signal.SIGSTOP)
    until(lambda: not _is_alive(run), "the run ends with its lease, though its worker is stopped")
    assert (watched.told / "r_1.closed").exists()
    until(lambda: _lost(watched), "the attempt is lost")
    worker.send_signal(signal.SIGCONT)
    _ends_well(experiment, watched)


@pytest.mark.soak
def test_a_worker_that_is_slow_to_answer_loses_nothing(cluster: Cluster, watched: Watched) -> None:
    worker = cluster.worker("one")
    experiment = cluster.experiment(watched.config)
    watched.pid()
    worker.send_signal(signal.SIGSTOP)
    time.sleep(LEASE / 3)
    worker.send_signal(signal.SIGCONT)
    _ends_well(experiment, watched)
    assert _lost(watched) == []


@pytest.mark.soak
def test_a_worker_whose_disk_is_full_executes_nothing_and_the_runs_go_elsewhere(
    cluster: Cluster, watched: Watched, tmp_path: Path
) -> None:
    """One that is full at first costs no attempt, one that fills up costs the one that finds that."""
    fills = """\
        if filler := os.environ.get("FILLER"):
            Path(filler).write_bytes(bytes(40_000_000))
        while not"""
    watched.config.write_text(watched.config.read_text().replace("        while not", fills))
    for name, size in (("full", "8m"), ("filled", "90m")):
        local = tmp_path / name
        local.mkdir()
        cluster.worker(name, before=apart_from(local, size=size), local=local, FILLER=str(local / "filler"))
    experiment = cluster.experiment(watched.config)
    until(
        lambda: "worker full: executes no runs: the worker's disk is full" in str(journal_of(watched.folder, "place")),
        "the first one is refused",
    )
    watched.go()
    until(lambda: _lost(watched), "an attempt is lost")
    cluster.worker("other")
    _ends_well(experiment, watched)
    assert "the worker's disk is full" in "".join(_lost(watched))
    assert len(_lost(watched)) == 1
    done = [each["run"] for each in journal_of(watched.folder, "attempt_finished") if each["status"] == "done"]
    assert sorted(done) == ["r_1", "r_2", "r_3"]


@pytest.mark.long
def test_a_scheduler_that_takes_connections_and_says_nothing_is_told_and_waited_for_as_long_as_was_set(
    cluster: Cluster, watched: Watched
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        cluster.address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        settings = {"DASK_ROBOT_RUNNER__LEASE": "1s", "DASK_ROBOT_RUNNER__PATIENCE": "6s"}
        experiment = cluster.experiment(watched.config, **settings)
        answer, _ = experiment.communicate(timeout=PATIENCE)
    assert experiment.returncode == 2, answer
    assert "no worker has been there for 6 s" in answer
    assert "the scheduler cannot be reached: it has not answered for 2 s" in answer


@pytest.mark.long
def test_a_worker_that_cannot_join_is_told_with_its_reason(cluster: Cluster, watched: Watched, tmp_path: Path) -> None:
    """Its disk is so full that it cannot even take down what is to be executed."""
    local = tmp_path / "full"
    local.mkdir()
    cluster.worker("full", before=apart_from(local, size="4k"), local=local)  # a page: Dask's own files are empty
    until(lambda: "Registered to" in cluster.log("full"), "the worker is there")  # a busy machine takes its time
    watched.config.write_text(watched.config.read_text() + f"# {'long' * 2000}\n")
    experiment = cluster.experiment(watched.config, DASK_ROBOT_RUNNER__PATIENCE="4s")
    answer, _ = experiment.communicate(timeout=PATIENCE)
    assert experiment.returncode == 2, answer
    assert "worker full: cannot join: OSError: [Errno 28] No space left on device" in answer


@pytest.mark.soak
def test_attempts_that_are_lost_count_where_the_config_says_so(cluster: Cluster, watched: Watched) -> None:
    worker = cluster.worker("killed")
    experiment = cluster.experiment(watched.config, "--set", "attempts_if_lost=0")
    watched.pid()
    os.killpg(worker.pid, signal.SIGKILL)
    until(lambda: _lost(watched), "the attempt is lost")
    cluster.worker("other")
    watched.go()
    answer, _ = experiment.communicate(timeout=PATIENCE)
    assert experiment.returncode == 1, answer
    assert [row["status"] for row in table_of(watched.folder)] == ["Failed", "Done", "Done"]


DRAWN = """
import random
import time

from robot_runner import ExperimentConfig, Factor, RunTableModel


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "drawn"
    results_output_path = "results"
    claims = []
    grace_in_s = 1.0
    attempts_if_lost = 100

    def launch_mission(self, context):
        time.sleep(0.2)

    def populate_run_data(self, context):
        return {"Drawn": random.Random(context.run_seed).random()}

    def create_run_table(self):
        return RunTableModel([Factor("X", [1, 2])], repetitions=30, data_columns=["Drawn"], seed=8)
"""


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_whoever_is_killed_at_random_the_table_is_in_the_end_the_one_of_this_machine(
    cluster: Cluster, tmp_path: Path
) -> None:
    config = tmp_path / "config.py"
    config.write_text(DRAWN, encoding="utf-8")
    choose = random.Random(16)  # noqa: S311 - whom to kill
    workers = {name: cluster.worker(name) for name in ("one", "two")}
    experiment = cluster.experiment(config, "--accept-changes")
    for number in range(4):
        time.sleep(choose.uniform(4, 10))
        if number % 2:
            experiment.kill()
            experiment.wait()
            experiment = cluster.experiment(config, "--accept-changes")
        else:
            os.killpg(workers.pop(choose.choice(sorted(workers))).pid, signal.SIGKILL)
            workers[f"another {number}"] = cluster.worker(f"another {number}")
    answer, _ = experiment.communicate(timeout=300)
    assert experiment.returncode == 0, answer
    here = tmp_path / "here"
    words = ["run", str(config), "--plain", "--set", f"results_output_path={here}", "--workers", "2"]
    subprocess.run([str(BIN / "robot-runner"), *words], check=True, capture_output=True)
    there = table_of(tmp_path / "results" / "drawn")
    assert [(row["run_id"], row["Drawn"]) for row in there] == [
        (row["run_id"], row["Drawn"]) for row in table_of(here / "drawn")
    ]
