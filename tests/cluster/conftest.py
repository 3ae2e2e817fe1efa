"""A real Dask cluster on loopback: scheduler and workers are processes of their own, and each can be killed."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.forked_program import RUNS, ForkedProgram
from tests.loopback_port import claim_port

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

pytest.importorskip("distributed")

BIN = Path(sys.executable).parent
#: How long something may take before a test gives up, s: a busy machine may need most of it.
PATIENCE = 90.0
#: How long a lease lasts in these tests, s.
LEASE = 3.0
#: What `dask scheduler` and `dask worker` import, and what a worker imports for its first run.
_DASK = (
    *("dask.cli", "distributed.cli.dask_scheduler", "distributed.cli.dask_worker"),
    "robot_runner.cluster.on_worker",
)

# Of all that are started, by whichever process.
os.environ.setdefault("DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED", "False")


class Cluster:
    """A scheduler, its workers, and experiments that are executed there."""

    def __init__(self, folder: Path, *, protocol: str = "tcp", settings: dict[str, str] | None = None) -> None:
        self.folder = folder
        self.environment = {
            **os.environ,
            "DASK_ROBOT_RUNNER__LEASE": f"{LEASE}s",
            **(settings or {}),
        }
        self.protocol = protocol
        self.port = claim_port()
        self.address = f"{protocol}://127.0.0.1:{self.port}"
        self._started: list[subprocess.Popen[Any]] = []
        self.scheduler = self.start_scheduler()

    def start_scheduler(self) -> subprocess.Popen[bytes]:
        words = ["scheduler", "--protocol", self.protocol, "--host", "127.0.0.1", "--port", str(self.port)]
        self.scheduler = self._start("scheduler", [*words, "--dashboard-address", "127.0.0.1:0"])
        return self.scheduler

    def worker(
        self,
        name: str,
        *words: str,
        nanny: bool = False,
        before: Sequence[str] = (),
        local: Path | None = None,
        **environment: str,
    ) -> subprocess.Popen[bytes]:
        """Start a worker, by a command that stands before it where one is given."""
        said = ["worker", self.address, "--name", name, "--nthreads", "1"]
        said += ["--host", "127.0.0.1", "--no-dashboard", "--nanny" if nanny else "--no-nanny"]
        said += ["--local-directory", str(local or self.folder / name), *words]
        return self._start(name, said, before, is_itself=nanny, **environment)

    def experiment(self, config: Path, *words: str, **settings: str) -> subprocess.Popen[str]:
        """Start an experiment."""
        process = ForkedProgram(
            "robot_runner",
            ["run", str(config), "--plain", "--cluster", self.address, *words],
            RUNS,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**self.environment, **settings},
        )
        self._started.append(process)
        return process

    def log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text(encoding="utf-8", errors="replace")

    def left_on(self, name: str) -> list[Path]:
        """Return what of ours is left in the folder of a worker."""
        return list((self.folder / name).rglob("robot-runner-*"))

    def close(self) -> None:
        for process in self._started:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if process.stdout is not None:
                process.stdout.close()

    def _start(
        self, name: str, words: list[str], before: Sequence[str] = (), *, is_itself: bool = False, **environment: str
    ) -> subprocess.Popen[bytes]:
        """Start `dask` with these words; fork it where no command before it and no setting asks for a start."""
        is_forked = not (is_itself or before or environment.keys() - {"XDG_STATE_HOME"} or self.protocol != "tcp")
        with (self.folder / f"{name}.log").open("ab") as log:
            streams = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": log}
            process: subprocess.Popen[bytes] = (
                ForkedProgram("dask", words, _DASK, env={**self.environment, **environment}, **streams)
                if is_forked
                else subprocess.Popen(
                    [*before, str(BIN / "dask"), *words],
                    env={**self.environment, **environment},
                    start_new_session=True,
                    **streams,
                )
            )
        self._started.append(process)
        return process


class Proxy:
    """A TCP connection that can be cut, both ways, without either side being told."""

    def __init__(self, port: int) -> None:
        self.port = claim_port()
        self._to = port
        self._listener = socket.create_server(("127.0.0.1", self.port))
        self._sockets: list[socket.socket] = [self._listener]
        self._flows = threading.Event()
        self._flows.set()
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Hold back everything from now on: nobody is told, as where a cable was pulled."""
        self._flows.clear()

    def mend(self) -> None:
        self._flows.set()

    def reset(self) -> None:
        """Break all connections, as where an address changes: new ones can be made at once."""
        for each in self._sockets[1:]:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._flows.set()
        for each in self._sockets:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                self._sockets.append(near)
                try:
                    far = socket.create_connection(("127.0.0.1", self._to))
                except OSError:  # nobody is there for now
                    near.close()
                    continue
                self._sockets.append(far)
                for source, target in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=(source, target), daemon=True).start()

    def _pass_on(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                self._flows.wait()
                target.sendall(data)
        with suppress(OSError):
            target.shutdown(socket.SHUT_WR)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """Return a scheduler without workers."""
    made = Cluster(_folder(tmp_path))
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def start_cluster(tmp_path: Path) -> Iterator[Callable[..., Cluster]]:
    """Return what starts a scheduler with settings of its own."""
    made: list[Cluster] = []

    def start(**settings: Any) -> Cluster:
        made.append(Cluster(_folder(tmp_path), **settings))
        return made[-1]

    yield start
    for each in made:
        each.close()


def _folder(tmp_path: Path) -> Path:
    folder = tmp_path / "cluster"
    folder.mkdir()
    return folder


def apart_from(folder: Path, *, size: str = "50%") -> list[str]:
    """Return what has a command see an empty disk in the place of a folder; skip the test where that is forbidden."""
    script = f'mount -t tmpfs -o size={size} none "$0" && exec "$@"'
    for kind in ([], ["--user", "--map-root-user"]):
        command = ["unshare", *kind, "--mount", "sh", "-c", script, str(folder)]
        if (
            shutil.which("unshare")
            and subprocess.run([*command, "true"], check=False, capture_output=True).returncode == 0
        ):
            return command
    pytest.skip("this user may have no mounts of their own")


def table_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "run_table.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def journal_of(folder: Path, kind: str) -> list[dict[str, Any]]:
    path = folder / "journal.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []  # not yet
    return [record for line in lines if (record := json.loads(line))["kind"] == kind]


def until(is_so: Callable[[], Any], what: str, seconds: float = PATIENCE) -> Any:
    """Wait until something is so, and return it."""
    deadline = time.monotonic() + seconds
    while not (found := is_so()):
        assert time.monotonic() < deadline, f"not within {seconds:g} s: {what}"
        time.sleep(0.05)
    return found


#: An experiment whose runs wait for a file `go`, and tell by a lock whether one is ever executed twice at a time.
WATCHED = """
import fcntl
import os
import time
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel

TOLD = Path({told!r})


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "watched"
    results_output_path = "results"
    claims = []
    grace_in_s = 1.0

    def launch_mission(self, context):
        self.lock = (TOLD / (context.run_id + ".lock")).open("w")
        try:
            fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            (TOLD / "executed_twice_at_a_time").touch()
        (TOLD / (context.run_id + ".begun")).write_text(str(os.getpid()))
        while not (TOLD / "go").exists():
            time.sleep(0.02)

    def stop_run(self, context):
        (TOLD / (context.run_id + ".closed")).touch()

    def populate_run_data(self, context):
        context.run_path.mkdir(parents=True, exist_ok=True)
        (context.run_path / "raw.txt").write_text(context.run_id)
        (context.run_path / os.fsdecode(b"caf\\xe9")).symlink_to("raw.txt")
        return {{"Twice": 2.0 * context.combination["X"]}}

    def create_run_table(self):
        return RunTableModel([Factor("X", [1, 2, 3])], data_columns=["Twice"])
"""


class Watched:
    """That experiment, and what its runs tell."""

    def __init__(self, folder: Path) -> None:
        self.told = folder / "told"
        self.told.mkdir()
        self.config = folder / "config.py"
        self.config.write_text(WATCHED.format(told=str(self.told)), encoding="utf-8")
        self.folder = folder / "results" / "watched"

    def pid(self, run: str = "r_1") -> int:
        """Wait until a run was begun, and return its process."""
        path = self.told / f"{run}.begun"
        return int(until(lambda: path.exists() and path.read_text(), f"{run} begins"))

    def go(self) -> None:
        (self.told / "go").touch()

    @property
    def was_executed_twice_at_a_time(self) -> bool:
        return (self.told / "executed_twice_at_a_time").exists()


@pytest.fixture
def watched(tmp_path: Path) -> Watched:
    return Watched(tmp_path)
