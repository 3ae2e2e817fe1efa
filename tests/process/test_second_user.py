"""Another user of the same machine can neither read an experiment's private raw data, nor block it, nor alter it."""

from __future__ import annotations

import codecs
import fcntl
import json
import os
import shutil
import stat
import subprocess
import tempfile
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.command_line import PROGRAM
from tests.process.conftest import kill_together, named, wait_until

from robot_runner.core.config.preparation import prepare
from robot_runner.core.execution.before_first_run import folder_findings
from robot_runner.core.storage.shared_claims import hold_against_users

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.process.conftest import Experiment

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root can become a second user")

#: `nobody` on Linux: no rights but everybody's.
_STRANGER = 65534
_CONFIG = """\
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "private"
    results_output_path = Path("results")

    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])], data_columns=["Faces"])

    def launch_mission(self, context):
        print("who was seen")
        (context.run_folder / "faces.csv").write_text("time_s,person\\n0.5,Ada\\n")

    def populate_run_data(self, context):
        return {"Faces": 1}
"""


@pytest.fixture
def study() -> Iterator[Path]:
    """Yield a folder that everybody may enter; those of pytest are their owner's alone."""
    folder = Path(tempfile.mkdtemp(prefix="robot-runner-study-"))
    folder.chmod(0o755)
    (folder / "private.py").write_text(_CONFIG, encoding="utf-8")
    yield folder
    shutil.rmtree(folder)


def run(study: Path) -> subprocess.CompletedProcess[str]:
    command = [PROGRAM, "private.py", "--plain", "--no-probe"]
    return subprocess.run(command, cwd=study, capture_output=True, text=True, timeout=100, check=False)


def as_stranger(act: Callable[[], object]) -> object:
    """Return what a process of the second user says, as plain data."""
    with begun_as_stranger(act) as said:
        return said


@contextmanager
def begun_as_stranger(act: Callable[[], object]) -> Iterator[object]:
    """Have the second user do something, and yield what it says; the process stays until the block ends."""
    (answer, say), (wait, end) = os.pipe(), os.pipe()
    pid = os.fork()
    if pid == 0:
        with suppress(BaseException):
            os.close(end)
            os.setgroups([])
            os.setgid(_STRANGER)
            os.setuid(_STRANGER)
            os.write(say, json.dumps(act()).encode())
            os.close(say)
            os.read(wait, 1)
        os._exit(0)
    os.close(say)
    os.close(wait)
    try:
        with os.fdopen(answer, "rb") as told:
            yield json.loads(told.read())
    finally:
        os.close(end)
        os.waitpid(pid, 0)


def succeeded(acts: dict[str, Callable[[], object]]) -> list[str]:
    """Return which of these the system let happen."""
    done = []
    for name, act in acts.items():
        with suppress(OSError):
            act()
            done.append(name)
    return done


@pytest.mark.long
def test_nothing_of_a_new_experiment_can_be_read_or_altered(study: Path) -> None:
    finished = run(study)
    assert finished.returncode == 0, finished.stdout + finished.stderr
    folder = study / "results" / "private"
    paths = [path for path in folder.rglob("*") if path.is_file()]
    names = {path.name for path in paths}
    assert {"journal.jsonl", "manifest.json", "run_table.csv", "log.txt", "faces.csv", ".lock"} <= names
    acts: dict[str, Callable[[], object]] = {
        "list": lambda: list(folder.iterdir()),
        "plant": (folder / "new").touch,
        "move": lambda: folder.rename(study / "results" / "other"),
        "replace": (folder / ".lock").unlink,
    }
    for path in paths:
        acts[f"read {path.name}"] = path.read_bytes
        acts[f"write {path.name}"] = lambda path=path: path.open("r+b")  # type: ignore[misc]
    assert as_stranger(lambda: succeeded(acts)) == []
    # Where the owner lets others into the folder later, what the program wrote before stays private.
    folder.chmod(0o755)
    private = [name for name in acts if name.partition(" ")[2] not in {"", "faces.csv"}]
    assert as_stranger(lambda: succeeded({name: acts[name] for name in private})) == []
    assert stat.S_IMODE((folder / "runs").stat().st_mode) == 0o700


@pytest.mark.long
def test_who_may_not_read_the_files_of_an_experiment_in_a_shared_folder_is_told_so_by_check(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run(study).returncode == 0
    folder = study / "results" / "private"
    folder.chmod(0o777)
    monkeypatch.chdir(study)
    experiment = prepare(Path("private.py")).experiment
    assert experiment is not None

    def told() -> list[str]:
        return [each.problem for each in folder_findings(experiment)]

    assert told() == []
    assert as_stranger(told) == ["the file cannot be read: Permission denied"]


def hold_all(folder: Path) -> list[str]:
    """Lock whatever can be opened, in every way that reading allows, and leave it open."""
    held = []
    for name in (".lock", ".alive", ".standing_by", "journal.jsonl"):
        for kind, lock in (("record", fcntl.lockf), ("file", fcntl.flock)):
            with suppress(OSError):
                lock(os.open(folder / name, os.O_RDONLY), fcntl.LOCK_SH | fcntl.LOCK_NB)
                held.append(f"{kind} {name}")
    return held


@pytest.mark.long
def test_a_stranger_who_locks_the_files_of_an_earlier_version_does_not_block(study: Path) -> None:
    folder = study / "results" / "private"
    folder.mkdir(parents=True)
    for name in (".lock", ".alive", ".standing_by", "journal.jsonl"):
        (folder / name).touch(0o644)
    (folder / ".standing_by").write_text(str(os.getpid()), encoding="ascii")  # whom nobody may kill for that
    with begun_as_stranger(lambda: hold_all(folder)) as held:
        assert isinstance(held, list)
        assert {"record .lock", "file .alive", "file .standing_by"} <= set(held)
        finished = run(study)
        assert finished.returncode == 0, finished.stdout + finished.stderr
        assert "1 run" in finished.stdout or "1 of 1" in finished.stdout
    assert as_stranger(lambda: [name for name in hold_all(folder) if "journal" not in name]) == []


#: A planner that does not end when it is told to.
_PLANNED = """from pathlib import Path

from robot_runner import *
from robot_runner.plugins.systems import Program

HERE = Path(__file__).parent


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = HERE / "results"
    claims = ["room:lab"]
    run_process = RunProcess.{process}
    plugins = [Program(["sh", "-c", "trap '' TERM; echo ready; exec sleep 600"], per="{per}", ready="ready",
                       grace_s=600)]

    def launch_mission(self, context):
        (HERE / "launched").touch()
        context.clock.sleep(600)

    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])])
"""


@pytest.mark.long
@pytest.mark.parametrize(("per", "process"), [("experiment", "FORK"), ("run", "SPAWN")])
def test_another_user_is_kept_out_until_software_under_test_of_a_killed_experiment_has_ended(
    start: Callable[..., Experiment], study: Path, monkeypatch: pytest.MonkeyPatch, per: str, process: str
) -> None:
    place = study / "everybody"
    place.mkdir()
    place.chmod(0o1777)
    monkeypatch.setenv("ROBOT_RUNNER_LOCKS", str(place))
    config = study / "trial.py"
    config.write_text(_PLANNED.format(per=per, process=process))
    experiment = start(config=config)
    experiment.wait_for("launched")
    supervised = named(experiment, b"supervisor.py")
    kept = {*supervised, *children_of(supervised)}
    kill_together(set(experiment.processes()) - kept)
    experiment.end()
    wait_until(lambda: kept.issuperset(experiment.processes()), "all others are gone")

    def holders() -> object:
        with ExitStack() as opened:
            return list(hold_against_users("room:lab", opened))

    codecs.lookup("ascii")  # which another user may not be able to load
    assert as_stranger(holders) == ["an experiment of root"]
    kill_together(supervised)
    wait_until(lambda: as_stranger(holders) == [], "nobody has it any more")


def children_of(parents: list[int]) -> list[int]:
    return [int(path.name) for path in Path("/proc").glob("[0-9]*") if parent_of(path) in parents]


def parent_of(process: Path) -> int | None:
    with suppress(OSError):
        return int((process / "stat").read_text().rpartition(")")[2].split()[1])
    return None
