"""A machine is set up on a faithful copy of its files, and put back, also after real processes were killed."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import pytest
from tests.meters.machine.computer_copy import CPU, ComputerCopy

from robot_runner.cli.main import main
from robot_runner.core.errors import ExecutionError, PluginError
from robot_runner.meters.machine import tuned_machine
from robot_runner.meters.machine.tuned_machine import check_left_behind
from robot_runner.meters.machine.tuning import Machine, Wishes
from robot_runner.meters.machine.tuning_state import state_file
from robot_runner.plugins.systems import Tune
from robot_runner.testing import SystemContract, make_context

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

GOVERNORS = [f"{CPU}/cpufreq/policy{core}/scaling_governor" for core in (0, 1)]
TURBO = f"{CPU}/intel_pstate/no_turbo"
NOBODY = 2**22 + 1  # above any pid of Linux

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="Linux's /proc is not there")


@pytest.fixture
def copy(tmp_path: Path) -> ComputerCopy:
    made = ComputerCopy(tmp_path / "computer")
    made.write("proc/sys/vm/drop_caches", 0)
    made.write("proc/sys/kernel/random/boot_id", "0c5f-first")
    return made


@pytest.fixture
def machine(copy: ComputerCopy, tmp_path: Path) -> Machine:
    return Machine(copy.root, tmp_path / "state" / "tuned.json")


def setting(copy: ComputerCopy) -> tuple[str, ...]:
    return tuple(copy.read(path) for path in (*GOVERNORS, TURBO) if (copy.root / path).exists())


AS_BEFORE = ("powersave", "powersave", "0")
AS_ASKED = ("performance", "performance", "1")
WISHES = Wishes("performance", turbo=False)


class TestTune(SystemContract):
    @pytest.fixture(autouse=True)
    def _copy(self, tmp_path_factory: pytest.TempPathFactory) -> None:
        self.root = tmp_path_factory.mktemp("computer")
        ComputerCopy(self.root)

    def make_plugin(self) -> Tune:
        return Tune(governor="performance", scope="run", root=self.root)


def test_a_machine_is_set_up_and_put_back(copy: ComputerCopy, machine: Machine) -> None:
    machine.apply(WISHES, owner=os.getpid())
    assert setting(copy) == AS_ASKED
    assert machine.restore() == []
    assert setting(copy) == AS_BEFORE
    assert not machine.state.exists()


def test_governors_that_differ_get_back_each_its_own(copy: ComputerCopy, machine: Machine) -> None:
    copy.write(GOVERNORS[1], "performance")
    machine.apply(Wishes("powersave"), owner=None)
    machine.restore()
    assert setting(copy)[:2] == ("powersave", "performance")


def test_boost_of_other_processors_is_switched_the_other_way_round(copy: ComputerCopy, machine: Machine) -> None:
    (copy.root / TURBO).unlink()
    copy.write(f"{CPU}/cpufreq/boost", 1)
    machine.apply(Wishes(turbo=False), owner=None)
    assert copy.read(f"{CPU}/cpufreq/boost") == "0"
    machine.restore()
    assert copy.read(f"{CPU}/cpufreq/boost") == "1"


def test_everything_that_stands_in_the_way_is_said_at_once(copy: ComputerCopy, machine: Machine) -> None:
    (copy.root / TURBO).unlink()
    found = machine.findings("plugin Tune", Wishes("perfomance", turbo=False, cores=(4096,)))
    assert [finding.is_error for finding in found] == [True, True, True]
    assert "'performance'" in found[0].fix
    assert "4096" in found[2].problem
    assert setting(copy)[:2] == AS_BEFORE[:2]


def test_a_virtual_machine_without_a_governor_says_so(tmp_path: Path) -> None:
    found = Machine(tmp_path, tmp_path / "state.json").findings("plugin Tune", WISHES)
    assert ["governor" in found[0].problem, "turbo" in found[1].problem] == [True, True]


def test_a_setting_that_the_kernel_does_not_take_leaves_all_as_it_was(copy: ComputerCopy, machine: Machine) -> None:
    path = copy.root / GOVERNORS[1]
    path.unlink()
    path.symlink_to("/dev/null")  # takes everything and keeps nothing
    with pytest.raises(PluginError, match="was set to"):
        machine.apply(WISHES, owner=os.getpid())
    assert (copy.read(GOVERNORS[0]), copy.read(TURBO)) == ("powersave", "0")
    assert not machine.state.exists()


def test_a_command_that_is_interrupted_between_two_settings_leaves_all_as_it_was_and_can_be_repeated(
    copy: ComputerCopy, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["tune", "--root", str(copy.root), "--governor", "performance", "--turbo", "off"]
    set_one = Machine._set

    def set_and_interrupt(machine: Machine, *change: Any, **more: Any) -> None:
        set_one(machine, *change, **more)
        raise KeyboardInterrupt

    with monkeypatch.context() as ctrl_c:
        ctrl_c.setattr(Machine, "_set", set_and_interrupt)
        assert main(words) == 130
    assert setting(copy) == AS_BEFORE
    assert main(words) == 0
    assert setting(copy) == AS_ASKED


def test_what_somebody_else_has_set_since_is_left(copy: ComputerCopy, machine: Machine) -> None:
    copy.write(f"{CPU}/cpufreq/policy0/scaling_available_governors", "performance powersave schedutil")
    machine.apply(WISHES, owner=None)
    copy.write(GOVERNORS[0], "schedutil")
    (problem,) = machine.restore()
    assert "'schedutil'" in problem
    assert setting(copy) == ("schedutil", *AS_BEFORE[1:])


def test_what_cannot_be_put_back_stays_written_down(
    copy: ComputerCopy, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine.apply(WISHES, owner=NOBODY)

    def refuse(path: Path, text: str, **_: str) -> int:
        raise PermissionError(errno.EACCES, "Permission denied", str(path), None, text)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", refuse)
        assert len(machine.restore()) == 3
        with pytest.raises(PluginError, match="cannot be put back to '0': Permission denied"):
            machine.apply(Wishes(turbo=True), owner=os.getpid())
    assert machine.restore() == []
    assert setting(copy) == AS_BEFORE
    assert not machine.state.exists()


def test_a_setting_that_cannot_be_read_is_neither_changed_nor_forgotten(
    copy: ComputerCopy, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, unread = Path.read_text, copy.root / GOVERNORS[1]

    def refuse(path: Path, **options: str) -> str:
        if path == unread:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE), str(path))
        return read(path, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_text", refuse)
        with pytest.raises(PluginError, match="cannot be read: Too many open files"):
            machine.apply(WISHES, owner=NOBODY)
    assert setting(copy) == AS_BEFORE
    machine.apply(WISHES, owner=NOBODY)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_text", refuse)
        (problem,) = machine.restore()
    assert "cannot be put back to 'powersave': Too many open files" in problem
    assert machine.restore() == []
    assert setting(copy) == AS_BEFORE


def test_what_a_dead_process_left_is_put_back_before_the_next_setting(copy: ComputerCopy, machine: Machine) -> None:
    machine.apply(WISHES, owner=NOBODY)
    assert "was killed" in machine.left_behind("here")[0].problem
    machine.apply(Wishes(turbo=True), owner=os.getpid())
    assert setting(copy) == AS_BEFORE  # the governor as before, and turbo as asked
    machine.restore()
    assert setting(copy) == AS_BEFORE


def test_after_a_new_start_of_the_machine_there_is_nothing_to_put_back(copy: ComputerCopy, machine: Machine) -> None:
    machine.apply(WISHES, owner=NOBODY)
    copy.write("proc/sys/kernel/random/boot_id", "7d1e-second")
    copy.write(TURBO, 1)
    assert machine.left_behind("here") == []
    assert machine.restore() == []
    assert copy.read(TURBO) == "1"


def test_two_experiments_do_not_set_up_one_machine(copy: ComputerCopy, machine: Machine) -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as other:
        machine.apply(WISHES, owner=other.pid)
        with pytest.raises(PluginError, match=f"set up by process {other.pid}, which goes on"):
            machine.apply(Wishes("powersave"), owner=os.getpid())
        assert setting(copy) == AS_ASKED
        other.communicate(b"\n")
    assert machine.restore() == []


def test_a_run_in_a_fresh_interpreter_is_not_refused_by_its_own_orchestrator(machine: Machine) -> None:
    machine.apply(WISHES, owner=os.getppid())
    assert machine.left_behind("here", blocks=True) == []
    machine.restore()


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"boot": 1}', '{"boot": "x", "owner": 3, "changes": [], "threads": {}}']
)
def test_a_damaged_file_of_state_is_an_error_of_ours(machine: Machine, text: str) -> None:
    machine.state.parent.mkdir(parents=True)
    machine.state.write_text(text, encoding="utf-8")
    with pytest.raises(PluginError, match="cannot be read"):
        machine.restore()
    assert machine.left_behind("here")[0].is_error


def test_caches_are_dropped_before_each_run(copy: ComputerCopy, tmp_path: Path) -> None:
    tune = Tune(drop_caches=True, root=copy.root, state=tmp_path / "tuned.json")
    tune.start_run(make_context(tmp_path, tune))
    assert copy.read("proc/sys/vm/drop_caches") == "3"


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        ({}, "nothing is to be set"),
        ({"turbo": False, "scope": "runs"}, "scope is 'runs'"),
        ({"cores": [-1]}, "no core -1"),
    ],
)
def test_parameters_that_cannot_be_are_refused(wrong: dict[str, object], problem: str) -> None:
    with pytest.raises(PluginError, match=problem):
        Tune(**wrong)  # type: ignore[arg-type]


CONFIG = """\
import os, time
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins.systems import Tune


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "tuned"
    results_output_path = Path(__file__).parent
    plugins = [Tune(governor="performance", turbo=False, root={root!r}, state={state!r}, scope={scope!r})]

    def create_run_table(self):
        return RunTableModel([Factor("Way", ["a", "b"])])

    def launch_mission(self, context):
        Path({mark!r}).write_text(Path({governor!r}).read_text())
        time.sleep({seconds})
"""


@pytest.fixture
def config(copy: ComputerCopy, machine: Machine, tmp_path: Path) -> Callable[..., Path]:
    def write(*, scope: str = "experiment", seconds: float = 0.0) -> Path:
        path = tmp_path / "study.py"
        facts = {"root": str(copy.root), "state": str(machine.state), "mark": str(tmp_path / "mark")}
        governor = str(copy.root / GOVERNORS[0])
        path.write_text(CONFIG.format(**facts, governor=governor, scope=scope, seconds=seconds), encoding="utf-8")
        return path

    return write


def until(condition: Callable[[], bool], *, seconds: float = 30.0) -> bool:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    return condition()


@pytest.mark.parametrize("scope", ["experiment", "run"])
def test_an_experiment_is_executed_on_the_machine_that_was_asked_for(
    copy: ComputerCopy, config: Callable[..., Path], tmp_path: Path, scope: str
) -> None:
    assert main(["run", str(config(scope=scope))]) == 0
    assert (tmp_path / "mark").read_text().strip() == "performance"
    assert setting(copy) == AS_BEFORE


def test_where_there_is_no_process_for_a_guardian_nothing_is_set_and_that_is_told_with_what_to_do(
    copy: ComputerCopy, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    refusal = BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    monkeypatch.setattr(subprocess, "Popen", Mock(side_effect=refusal))
    with pytest.raises(
        ExecutionError, match="no process can be started for restoring the machine afterwards: "
    ) as caught:
        Tune(governor="performance", root=copy.root, state=machine.state).before_experiment()
    assert "ulimit -u" in caught.value.fix
    assert setting(copy) == AS_BEFORE


@pytest.mark.long
@pytest.mark.parametrize("scope", ["experiment", "run"])
def test_the_guardian_puts_the_machine_back_when_the_experiment_is_killed(
    copy: ComputerCopy, machine: Machine, config: Callable[..., Path], tmp_path: Path, scope: str
) -> None:
    with executed(config(scope=scope, seconds=60.0)) as process:
        assert until((tmp_path / "mark").exists)
        assert setting(copy) == AS_ASKED
        process.kill()
        assert until(lambda: not machine.state.exists())
    assert setting(copy) == AS_BEFORE


def test_a_late_guardian_leaves_the_machine_to_the_experiment_that_has_set_it_up_since(
    copy: ComputerCopy, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tuned_machine, "_PATIENCE", 0.1)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO()))
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE) as other:  # which ends with this block, whatever fails
        machine.apply(WISHES, owner=other.pid)
        tuned_machine._guard(copy.root, machine.state)
        assert setting(copy) == AS_ASKED
        other.kill()
        os.waitid(os.P_PID, other.pid, os.WEXITED | os.WNOWAIT)  # it is dead, and was not reaped yet
        tuned_machine._guard(copy.root, machine.state)
        assert setting(copy) == AS_BEFORE


@pytest.mark.long
def test_where_the_guardian_is_killed_too_the_next_command_puts_the_machine_back(
    copy: ComputerCopy,
    machine: Machine,
    config: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with executed(config(seconds=60.0)) as process:
        assert until((tmp_path / "mark").exists)
        for pid in guardians(copy.root):
            os.kill(pid, signal.SIGKILL)
        process.kill()
        process.wait()
    assert setting(copy) == AS_ASKED
    machine.state.rename(copy.root / "tuned.json")  # where the command looks
    assert main(["tune", "--root", str(copy.root), "--restore"]) == 0
    assert setting(copy) == AS_BEFORE
    assert "governor: powersave" in capsys.readouterr().out


class executed:  # noqa: N801 - reads as a function
    """An experiment in a process of its own, which has ended with all that it started when the block is left."""

    def __init__(self, config: Path) -> None:
        self._config = config

    def __enter__(self) -> subprocess.Popen[bytes]:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "robot_runner", "run", str(self._config)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        return self._process

    def __exit__(self, *raised: object) -> None:
        self._process.kill()
        self._process.wait()


def guardians(root: Path) -> Iterator[int]:
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().split(b"\0")
        except OSError:
            continue
        if b"robot_runner.meters.machine.tuned_machine" in words and str(root).encode() in words:
            yield int(path.parent.name)


PINNED = """\
import os, sys, threading
threading.Thread(target=threading.Event().wait, daemon=True).start()
print(flush=True)
for line in sys.stdin:
    print(*sorted(set().union(*(os.sched_getaffinity(int(t)) for t in os.listdir("/proc/self/task")))), flush=True)
"""


@pytest.mark.skipif(len(getattr(os, "sched_getaffinity", lambda _: "")(0)) < 2, reason="needs two cores")
def test_other_processes_are_kept_off_the_cores_of_the_experiment_and_get_them_back(
    copy: ComputerCopy, machine: Machine
) -> None:
    everything = sorted(os.sched_getaffinity(0))
    ours, rest = everything[-1:], everything[:-1]
    # In the copy there are these two processes alone: nobody else on this machine is moved.
    script = textwrap.dedent(
        f"""
        import os, sys
        from pathlib import Path
        from robot_runner.meters.machine.tuning import Machine, Wishes
        Path({str(copy.root / "proc")!r}, str(os.getpid())).symlink_to(f"/proc/{{os.getpid()}}")
        machine = Machine(Path({str(copy.root)!r}), Path({str(machine.state)!r}))
        machine.apply(Wishes(cores={tuple(ours)!r}), owner=os.getpid())
        print(*sorted(os.sched_getaffinity(0)), flush=True)
        sys.stdin.readline()
        machine.restore()
        print(*sorted(os.sched_getaffinity(0)), flush=True)
        """
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", PINNED], **pipes) as other:  # type: ignore[call-overload]
        other.stdout.readline()
        (copy.root / "proc" / str(other.pid)).symlink_to(f"/proc/{other.pid}")
        with subprocess.Popen([sys.executable, "-c", script], **pipes) as experiment:  # type: ignore[call-overload]
            assert cores_of(experiment.stdout.readline()) == ours
            assert asked(other) == rest
            experiment.stdin.write("\n")
            experiment.stdin.flush()
            assert cores_of(experiment.stdout.readline()) == everything
        assert asked(other) == everything
        other.kill()


def asked(process: subprocess.Popen[str]) -> list[int]:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    return cores_of(process.stdout.readline())


def cores_of(line: str) -> list[int]:
    return list(map(int, line.split()))


def test_the_command_sets_and_restores(copy: ComputerCopy, capsys: pytest.CaptureFixture[str]) -> None:
    root = ["--root", str(copy.root)]
    assert main(["tune", *root, "--governor", "performance", "--turbo", "off"]) == 0
    assert setting(copy) == AS_ASKED
    assert "set up by robot-runner: by hand" in capsys.readouterr().out
    assert main(["tune", *root, "--turbo", "on"]) == 2
    assert main(["tune", *root, "--restore"]) == 0
    assert setting(copy) == AS_BEFORE
    assert main(["tune", *root, "--restore", "--turbo", "on"]) == 2


def test_the_command_does_not_put_back_what_an_experiment_uses(copy: ComputerCopy) -> None:
    Machine(copy.root).apply(WISHES, owner=os.getpid())
    assert main(["tune", "--root", str(copy.root), "--restore"]) != 0
    assert setting(copy) == AS_ASKED


@pytest.mark.parametrize("home", ["/etc/passwd", "/proc/self/exe/nowhere"])
def test_where_there_is_no_folder_of_state_nothing_was_left_and_no_experiment_is_refused(
    monkeypatch: pytest.MonkeyPatch, home: str
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", home)
    assert check_left_behind("study.py", None, []) == []  # type: ignore[arg-type]

    def refuse(_: Path) -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "expanduser", refuse)
    assert check_left_behind("study.py", None, []) == []  # type: ignore[arg-type]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody who may not enter")
def test_a_folder_of_state_that_may_not_be_entered_refuses_no_experiment(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    path = state_file()
    path.parent.mkdir(mode=0o700)
    os.seteuid(NOBODY)
    try:
        assert check_left_behind("study.py", None, []) == []  # type: ignore[arg-type]
    finally:
        os.seteuid(0)


def test_an_experiment_without_tune_is_told_of_a_machine_that_was_left_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert check_left_behind("study.py", None, []) == []  # type: ignore[arg-type]
    path = state_file()
    path.parent.mkdir()
    boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    facts = {"boot": boot, "owner": [NOBODY, "1"], "changes": [], "threads": {}, "others": [], "everything": []}
    path.write_text(json.dumps(facts))
    (finding,) = check_left_behind("study.py", None, [])  # type: ignore[arg-type]
    assert not finding.is_error
    assert "tune --restore" in finding.fix
