"""Runs on the workers of a real Dask cluster: the same values as here, and raw data comes home."""

from __future__ import annotations

import shutil
import signal
import subprocess
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import distributed
import pytest
from tests.cluster.conftest import BIN, PATIENCE, Cluster, Watched, apart_from, journal_of, table_of, until

import robot_runner
from robot_runner.cluster import cluster_places
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution.left_processes import RunMark, RunsElsewhere, runs_elsewhere
from robot_runner.core.execution.standby_lock import LONGEST
from robot_runner.core.storage.claim_locks import HeldClaims
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import describe_host, read_manifest

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

SIMULATED = """
import beside
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins.profilers import Ina219, PsUtil
from robot_runner.plugins.systems import BasicTurtlebot3


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "simulated"
    results_output_path = "results"
    robot = "simulated"
    plugins = [BasicTurtlebot3(sleep_s=0.1, drive_s=0.3, task_s=0.2, rotate_s=2.5), Ina219(), PsUtil()]

    def start_run(self, context):
        print("a run begins")

    def populate_run_data(self, context):
        (context.raw_data_folder / "deep").mkdir()
        (context.raw_data_folder / "deep" / "raw.bin").write_bytes(bytes(range(256)) * 8192)
        return {"Drawn": beside.drawn(context)}

    def create_run_table(self):
        factor = Factor("Task", ["Computation", "Network"])
        return RunTableModel([factor], repetitions=3, data_columns=["Drawn", "Energy", "CPU"], seed=4)
"""
BESIDE = "import random\n\n\ndef drawn(context):\n    return random.Random(context.run_seed).random()\n"
VOLATILE = "_at"
WORKER = {"address": "tcp://one:1", "name": "one", "worker": "1", "host": "one", "threads": 1, "resources": []}
WORKER |= {"machine": {"cores": 2}}


def _values(folder: Path) -> list[dict[str, str]]:
    return [{name: value for name, value in row.items() if not name.endswith(VOLATILE)} for row in table_of(folder)]


def _answer(experiment: subprocess.Popen[str]) -> str:
    out, _ = experiment.communicate(timeout=PATIENCE)
    return out


def _all_files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.long
@pytest.mark.parametrize("is_shared", [False, pytest.param(True, marks=pytest.mark.soak)])
def test_two_workers_yield_the_values_of_this_machine_with_and_without_a_shared_folder(
    cluster: Cluster, tmp_path: Path, is_shared: bool
) -> None:
    config = tmp_path / "config.py"
    config.write_text(SIMULATED, encoding="utf-8")
    (tmp_path / "beside.py").write_text(BESIDE, encoding="utf-8")
    here = tmp_path / "here"
    subprocess.run(
        [str(BIN / "robot-runner"), "run", str(config), "--plain", "--set", f"results_output_path={here}"],
        check=True,
        capture_output=True,
        timeout=PATIENCE,
    )
    (tmp_path / "results").mkdir()
    for name in ("one", "two"):
        cluster.worker(name, before=() if is_shared else apart_from(tmp_path / "results"))
    experiment = cluster.experiment(config)
    answer = _answer(experiment)
    assert experiment.returncode == 0, answer
    there = tmp_path / "results" / "simulated"
    assert _values(there) == _values(here / "simulated")
    assert _all_files(there / "runs").keys() == _all_files(here / "simulated" / "runs").keys()
    for name, content in _all_files(there / "runs").items():
        assert len(content) == len((here / "simulated" / "runs" / name).read_bytes()), name
    assert (there / "runs" / "r_1" / "log.txt").read_text() == "a run begins\n"
    assert {record["place"] for record in journal_of(there, "attempt_started")} == {"one", "two"}
    machines = read_manifest(there / "manifest.json")["machines"]
    assert [each["host"] for each in machines] == [describe_host()], "both workers are on this machine"
    assert sorted(machines[0]["places"]) == ["one", "two"]
    assert sorted(record["place"] for record in journal_of(there, "machine")) == ["one", "two"]
    assert list(there.glob(".probe*")) == []
    for name in ("one", "two"):
        until(lambda name=name: cluster.left_on(name) == [], f"nothing is left on {name}")


READING = """
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins import InputFile, input_file
from robot_runner.plugins.systems import Program

HERE, HALL = Path(__file__).parent, Path({hall!r})


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "reading"
    results_output_path = {results!r}
    claims = []
    plugins = [Program(["sh", "tell.sh"], name="Teller", folder=HERE / "nav", reads=["map.txt"], ready="5")]

    def input_files(self):
        return [InputFile(HALL), InputFile(HERE / "rooms.txt")]

    def populate_run_data(self, context):
        return {{"Hall": int(input_file(HALL).read_text()), "Rooms": int((HERE / "rooms.txt").read_text())}}

    def create_run_table(self):
        return RunTableModel([Factor("X", [1, 2])], data_columns=["Hall", "Rooms"])
"""


@pytest.mark.long
@pytest.mark.parametrize("is_shared", [False, pytest.param(True, marks=pytest.mark.soak)])
def test_a_worker_reads_the_files_that_the_experiment_names_and_not_its_own(
    cluster: Cluster, tmp_path: Path, is_shared: bool
) -> None:
    """It has another file under the same path, and none of those beside the config."""
    study, data, results = (tmp_path / name for name in ("study", "data", "results"))
    written = {"data/hall.txt": "1", "study/rooms.txt": "3", "study/nav/map.txt": "5"}
    written |= {"study/nav/tell.sh": "cat map.txt; sleep 100", "theirs/hall.txt": "2"}
    for name, text in written.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"{text}\n")
    results.mkdir()
    (study / "config.py").write_text(READING.format(hall=str(data / "hall.txt"), results=str(results)))
    others = 'mount --bind "$0/theirs" "$0/data" && exec "$@"'
    before = [*apart_from(study), "sh", "-c", others, str(tmp_path)]
    cluster.worker("one", before=[*before, *([] if is_shared else apart_from(results))])
    experiment = cluster.experiment(study / "config.py", DASK_ROBOT_RUNNER__PATIENCE="10s")
    answer = _answer(experiment)
    assert experiment.returncode == 0, answer
    assert [(row["Hall"], row["Rooms"]) for row in table_of(results / "reading")] == [("1", "3")] * 2
    until(lambda: cluster.left_on("one") == [], "nothing is left")


@pytest.mark.long
def test_a_shared_folder_is_written_in_place_and_ctrl_c_ends_the_runs(cluster: Cluster, watched: Watched) -> None:
    cluster.worker("one")
    experiment = cluster.experiment(watched.config)
    watched.pid()
    experiment.send_signal(signal.SIGINT)
    answer = _answer(experiment)
    assert experiment.returncode == 130, answer
    assert (watched.told / "r_1.closed").exists()
    watched.go()
    experiment = cluster.experiment(watched.config)
    answer = _answer(experiment)
    assert experiment.returncode == 0, answer
    assert [row["Twice"] for row in table_of(watched.folder)] == ["2.0", "4.0", "6.0"]
    assert (watched.folder / "runs" / "r_2" / "raw.txt").read_text() == "r_2"
    assert r"'caf\udce9' is not a regular file" in answer, "a link is named, in whatever encoding its name is"
    assert not watched.was_executed_twice_at_a_time


@pytest.mark.long
def test_a_worker_of_another_version_executes_nothing_and_the_difference_is_told(
    cluster: Cluster, watched: Watched, tmp_path: Path
) -> None:
    """Nor does one that does not offer what the runs claim."""
    watched.config.write_text(watched.config.read_text().replace("claims = []", 'claims = ["robot:alice"]'))
    other = tmp_path / "other"
    shutil.copytree(Path(robot_runner.__file__).parent, other / "robot_runner")
    changed = other / "robot_runner" / "core" / "words.py"
    changed.write_text(changed.read_text() + "# another checkout\n")
    cluster.worker("other", "--resources", "robot:alice=1", PYTHONPATH=str(other))
    cluster.worker("without")
    watched.go()
    experiment = cluster.experiment(watched.config)
    refused = "worker other: the worker has the same version of Robot Runner with another source"
    until(lambda: refused in str(journal_of(watched.folder, "place")), "the worker is refused")
    until(lambda: "robot:alice=1" in str(journal_of(watched.folder, "place")), "it is told what no worker offers")
    cluster.worker("with", "--resources", "robot:alice=1")
    answer = _answer(experiment)
    assert experiment.returncode == 0, answer
    assert refused in answer
    assert {record["place"] for record in journal_of(watched.folder, "attempt_started")} == {"with"}


@pytest.fixture
def measuring(cluster: Cluster, watched: Watched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Watched:
    """An experiment that has a worker, whose machine, and a robot that is reached from there, it claims for itself."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    claims = 'claims = ["host:localhost", "robot:domain 7/bob"]'
    watched.config.write_text(watched.config.read_text().replace("claims = []", claims))
    watched.go()
    cluster.worker("one", "--resources", "robot:domain_7/bob=1", XDG_STATE_HOME=str(tmp_path / "state"))
    return watched


@pytest.mark.long
def test_a_run_waits_until_no_other_experiment_has_what_it_claims_of_the_worker_s_machine(
    cluster: Cluster, measuring: Watched, tmp_path: Path
) -> None:
    """As on this machine, where two experiments that measure the computer would measure each other."""
    with HeldClaims(["robot:domain 7"], "neighbour", tmp_path / "neighbour"):
        experiment = cluster.experiment(measuring.config)
        until(lambda: "the experiment 'neighbour'" in str(journal_of(measuring.folder, "finding")), "it is told")
        assert not list(measuring.told.glob("*.begun"))
    answer = _answer(experiment)
    assert experiment.returncode == 0, answer
    assert len(list(measuring.told.glob("*.begun"))) == 3
    with HeldClaims(["host:localhost"], "neighbour", tmp_path / "neighbour"):
        experiment = cluster.experiment(measuring.config, "--redo", "r_1")
        until(lambda: len(journal_of(measuring.folder, "attempt_started")) == 4, "it is ordered")
        experiment.send_signal(signal.SIGINT)
        assert "Interrupted" in _answer(experiment)


@pytest.mark.soak
def test_a_run_waits_until_the_run_of_a_process_that_was_killed_has_let_go_of_the_worker_s_machine(
    cluster: Cluster, measuring: Watched, tmp_path: Path
) -> None:
    killed = ExperimentFolder(tmp_path / "killed")
    killed.root.mkdir()
    with HeldClaims(["host:localhost"], "killed", killed.root):
        """Its lock is gone with it."""
    with closing(RunMark(killed)):
        experiment = cluster.experiment(measuring.config)
        until(
            lambda: "remaining processes of the experiment 'killed'" in str(journal_of(measuring.folder, "finding")),
            "told",
        )
        assert not list(measuring.told.glob("*.begun"))
    assert experiment.wait(60) == 0, _answer(experiment)


def test_an_experiment_that_cannot_travel_leaves_no_probe_and_no_process(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    def started(module: str) -> None:
        raise AssertionError(f"{module} was started")

    monkeypatch.setattr(cluster_places, "PipedProcess", started)
    experiment = replace(prepare_or_refuse(watched.config, {}), kept="nothing")
    experiment.folder.root.mkdir(parents=True)
    with pytest.raises(ExecutionError, match="stands in no file"):
        cluster_places.ClusterPlaces(experiment, "tcp://scheduler:8786")
    assert list(experiment.folder.root.iterdir()) == []


def test_runs_of_an_orchestrator_that_was_killed_are_waited_for_before_any_is_begun(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They go on until their leases end: a run that was begun again at once would be executed twice at a time."""
    now = 1000.0
    gateway = Mock(replies=lambda: ([("settings", {"lease": 30.0, "patience": 10.0}), ("joined", WORKER)], True))
    monkeypatch.setattr(cluster_places, "PipedProcess", lambda module: gateway)
    monkeypatch.setattr(cluster_places, "time", Mock(monotonic=lambda: now))
    experiment = prepare_or_refuse(watched.config, {})
    experiment.folder.root.mkdir(parents=True)
    killed = cluster_places.ClusterPlaces(experiment, "tcp://scheduler:8786")
    assert killed.advance() == []
    assert len(killed.all) == 1, "nobody was killed before"
    (probe,) = experiment.folder.root.iterdir()
    assert runs_elsewhere(experiment.folder) == [RunsElsewhere("cluster tcp://scheduler:8786", 33.0)], "also told here"
    probe.with_name(f"{probe.name}-answered").touch()
    for _ in range(2):  # whoever interrupts the wait has the next one wait as well
        places = cluster_places.ClusterPlaces(experiment, "tcp://scheduler:8786")
        assert "an earlier execution was killed; its runs may go on for 33 s" in places.advance()[0]
        assert (len(places.all), places.due) == (0, now + 33)
        places.close()
        (probe,) = experiment.folder.root.iterdir()
        assert probe.name == f".probe-{places._session}", "what the one before left is removed"
    probe.with_name(f"{probe.name}-answered-too-late").touch()
    now += 33
    assert len(places.all) == 1
    places.close()
    assert list(experiment.folder.root.iterdir()) == []


@pytest.mark.parametrize(("robot", "stopping"), [("'dds:domain=7'", LONGEST), ("'simulated'", 0.0), ("None", 0.0)])
def test_another_run_of_a_lost_worker_s_robot_waits_until_that_can_have_been_stopped(
    watched: Watched, monkeypatch: pytest.MonkeyPatch, robot: str, stopping: float
) -> None:
    # A config that commands the robot by itself is enough: a standby stops it without a `make_safe` of any system.
    monkeypatch.setattr(cluster_places, "PipedProcess", Mock())
    text = watched.config.read_text().replace("    grace_in_s", f"    robot = {robot}\n    grace_in_s")
    watched.config.write_text(text)
    experiment = prepare_or_refuse(watched.config, {}, looks_at_graph=False)
    experiment.folder.root.mkdir(parents=True)
    places = cluster_places.ClusterPlaces(experiment, "tcp://scheduler:8786")
    grace = experiment.parameters.grace_in_s
    assert places.longest_end == cluster_places._LEASE + grace + cluster_places._KILLING + stopping


def test_where_the_process_that_speaks_to_the_cluster_ends_the_experiment_says_so(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    gateway = Mock(replies=lambda: ([], False), wait=lambda seconds: -9)
    monkeypatch.setattr(cluster_places, "PipedProcess", lambda module: gateway)
    experiment = prepare_or_refuse(watched.config, {})
    experiment.folder.root.mkdir(parents=True)
    places = cluster_places.ClusterPlaces(experiment, "tcp://scheduler:8786")
    places.take_replies()
    assert places.due == 0.0, "nobody waits for workers any more"
    with pytest.raises(ExecutionError, match="the process that speaks to the cluster has ended with code -9"):
        places.advance()
    places.close()


def test_nobody_loses_patience_while_a_worker_loads_the_experiment(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1000.0
    told = [("settings", {"lease": 30.0, "patience": 10.0}), ("joining", {"address": "tcp://one:1"})]
    gateway = Mock(replies=lambda: (told, True))
    monkeypatch.setattr(cluster_places, "PipedProcess", lambda module: gateway)
    monkeypatch.setattr(cluster_places, "time", Mock(monotonic=lambda: now))
    experiment = prepare_or_refuse(watched.config, {})
    experiment.folder.root.mkdir(parents=True)
    places = cluster_places.ClusterPlaces(experiment, "tcp://scheduler:8786")
    assert places.advance() == []
    told, now = [], now + 60
    assert places.advance() == []
    finding = {"where": "worker one", "problem": "executes no runs: the worker's disk is full", "fix": ""}
    told = [("refused", {"address": "tcp://one:1", "findings": [finding]})]
    with pytest.raises(ExecutionError, match=r"no worker has been there for 10 s .*the worker's disk is full"):
        places.advance()
    places.close()


def test_that_there_is_no_worker_is_said_once_they_have_had_their_time_to_join(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Lacking()
    clock.told.pop()  # the one that has joined
    with _places(clock, watched, monkeypatch) as places:
        assert clock.after(9) == []
        assert clock.after(20) == [], "the scheduler is not reached: no worker could be there"
        assert clock.after(1, ("connected", {})) == []
        assert places.due == clock.now + 10
        assert clock.after(10, ("joining", {"address": "tcp://one:1"})) == [], "it loads the experiment"
        [said] = clock.after(1, ("refused", {"address": "tcp://one:1", "findings": []}))
        assert "cluster tcp://scheduler:8786: no worker is there" in said
        assert "dask worker tcp://scheduler:8786 --nthreads 1" in said
        assert clock.after(10) == [], "said once"
        assert clock.after(0, ("joined", WORKER)) == []
        [gone] = clock.after(0, ("gone", {"worker": WORKER["worker"], "because": "it has left"}))
        assert "it has left" in gone
        assert any("no worker is there" in each for each in clock.after(10, is_idle=False))
        with pytest.raises(ExecutionError, match="no worker has been there for 60 s") as ended:
            clock.after(50, is_idle=False)
        assert "no worker is there" not in ended.value.problem, "said once is enough"


@pytest.fixture
def lacking(watched: Watched, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lacking]:
    """Places of one worker, where a run claims a robot that it does not offer; the clock is moved by hand."""
    clock = Lacking()
    with _places(clock, watched, monkeypatch):
        yield clock


@contextmanager
def _places(
    clock: Lacking, watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> Iterator[cluster_places.ClusterPlaces]:
    monkeypatch.setattr(cluster_places, "PipedProcess", lambda module: Mock(replies=clock.replies))
    monkeypatch.setattr(cluster_places, "time", Mock(monotonic=lambda: clock.now))
    experiment = prepare_or_refuse(watched.config, {})
    experiment.folder.root.mkdir(parents=True)
    clock.places = cluster_places.ClusterPlaces(experiment, "tcp://scheduler:8786")
    yield clock.places
    clock.places.close()


class Lacking:
    """What the gateway tells, and when it is."""

    places: cluster_places.ClusterPlaces

    def __init__(self) -> None:
        self.now = 1000.0
        self.told: list[Any] = [("settings", {"lease": 30.0, "patience": 60.0}), ("joined", WORKER)]

    def replies(self) -> tuple[list[Any], bool]:
        told, self.told = self.told, []
        return told, True

    def after(self, seconds: float, *told: tuple[str, Any], is_idle: bool = True) -> Sequence[str]:
        """Let time pass and the gateway tell something, then try to begin a run that claims the robot."""
        self.now += seconds
        self.told = [*self.told, *told]
        said = self.places.advance(is_idle=is_idle)
        assert all(each.claimed(["robot:alice"], {}) is None for each in self.places.all)
        return said


def joining(number: int) -> list[tuple[str, Any]]:
    address = f"tcp://worker:{number}"
    return [("joining", {"address": address}), ("joined", WORKER | {"address": address, "worker": str(number)})]


def test_that_no_worker_offers_a_claim_is_said_once_workers_have_had_their_time_to_join(lacking: Lacking) -> None:
    assert lacking.after(0) == []
    assert lacking.after(8, *joining(2)) == [], "another one has just come, and further ones may"
    assert lacking.after(8, joining(3)[0]) == []
    assert lacking.after(60, is_idle=False) == [], "one loads the experiment"
    assert lacking.after(1, joining(3)[1]) == []
    assert lacking.places.due == lacking.now + 10
    [said] = lacking.after(10)
    assert "claim robot:alice: no worker offers it as a resource" in said
    assert lacking.after(10) == [], "said once"


def test_an_experiment_ends_whose_runs_claim_what_no_worker_offers_within_its_patience(lacking: Lacking) -> None:
    lacking.after(0)
    lacking.after(50)
    lacking.after(50, is_idle=False)  # a run that claims nothing is prepared, or executed
    lacking.after(1)
    lacking.after(59)
    with pytest.raises(ExecutionError, match="no worker that offers robot:alice has been there for 60 s") as ended:
        lacking.after(1)
    assert "--resources robot:alice=1" in ended.value.fix
    assert "as a resource" not in ended.value.problem, "said once is enough"


@pytest.mark.long
def test_a_real_robot_is_offered_by_the_command_that_is_told(lacking: Lacking, cluster: Cluster) -> None:
    lacking.after(0)
    [place] = lacking.places.all
    assert place.claimed(["robot:dds:domain=7,namespace=a b"], {}) is None
    command = next(each for each in lacking.after(10) if "domain=7" in each).partition("--resources ")[2]
    cluster.worker("one", "--resources", command.split()[0])
    with distributed.Client(cluster.address) as client:
        client.wait_for_workers(1, timeout=PATIENCE)
        [worker] = client.scheduler_info()["workers"].values()
    place.worker |= {"resources": sorted(worker["resources"])}
    assert place.claimed(["robot:dds:domain=7,namespace=a b"], {}) == frozenset({"robot:dds:domain=7,namespace=a b"})


def test_claims_of_one_run_that_no_worker_offers_together_are_told_with_one_command(lacking: Lacking) -> None:
    lacking.told.append(("joined", WORKER | {"address": "tcp://two:1", "worker": "2", "resources": ["serial:b"]}))
    lacking.places.advance()
    lacking.told = [("joined", WORKER | {"address": "tcp://three:1", "worker": "3", "resources": ["serial:a"]})]

    def after(seconds: float) -> Sequence[str]:
        lacking.now += seconds
        said = lacking.places.advance(is_idle=True)
        assert all(each.claimed(["serial:b", "serial:a"], {}) is None for each in lacking.places.all)
        return said

    assert after(0) == []
    [said] = after(10)
    assert "claims serial:a, serial:b: no worker offers them together as resources" in said
    assert "--resources serial:a=1,serial:b=1" in said
    assert after(10) == [], "said once"
    with pytest.raises(ExecutionError, match="no worker that offers serial:a with serial:b has been there") as ended:
        after(60)
    assert "--resources serial:a=1,serial:b=1" in ended.value.fix
    assert "together" not in ended.value.problem, "said once is enough"
    offering = WORKER | {"address": "tcp://four:1", "worker": "4", "resources": ["serial:a", "serial:b"]}
    lacking.told = [("joined", offering)]
    lacking.places.advance()
    assert lacking.places.all[-1].claimed(["serial:b", "serial:a"], {}) == frozenset({"serial:a", "serial:b"})


def test_an_experiment_goes_on_where_a_worker_offers_what_was_claimed(lacking: Lacking) -> None:
    lacking.after(0)
    lacking.after(59)
    offering = WORKER | {"address": "tcp://two:1", "worker": "2", "resources": ["robot:alice"]}
    lacking.told = [("joined", offering)]
    lacking.places.advance()
    one, two = lacking.places.all
    assert (one.claimed(["robot:alice"], {}), two.claimed(["robot:alice"], {})) == (None, frozenset({"robot:alice"}))
    lacking.now += 600
    assert lacking.places.advance(is_idle=True) == []
