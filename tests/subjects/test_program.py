"""Programs under test: real processes, from the config that names them to the last of their children."""

from __future__ import annotations

import ast
import errno
import fcntl
import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from threading import Thread, Timer
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import pytest
from tests.command_line import PROGRAM
from tests.conftest import HEAD, written_config
from tests.core.execution.conftest import Executed, execute_in
from tests.long_cases import soak_but
from tests.loopback_port import claim_port
from tests.subjects.conftest import alive, gone
from tests.waiting import wait_until

from robot_runner.core.config.preparation import prepare
from robot_runner.core.config.treatment_makers import Workshop
from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import PluginError, RobotRunnerError, StorageError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.plugin import Circumstances
from robot_runner.plugins.systems import Program
from robot_runner.subjects import supervisor
from robot_runner.subjects.revisions import REVISIONS
from robot_runner.subjects.supervised_program import Start, SupervisedProgram, Task
from robot_runner.subjects.work_tree import WorkTree
from robot_runner.testing import SystemContract, make_context, rehearse

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.events.context import RobotRunnerContext

OURS = HEAD.replace("import *\n", "import *\nfrom robot_runner.plugins.systems import Program\n", 1)
ONE_RUN = '    def create_run_table(self):\n        return RunTableModel([Factor("Task", ["Video"])], seed=1)'
TWO_RUNS = (
    '    def create_run_table(self):\n        return RunTableModel([Factor("Task", ["a", "b"])], seed=1, shuffle=False)'
)
#: Two factors, bound to a word, to a part of a word, and to a variable.
BOUND = """
SCRIPT = 'echo "$0 $1 $SPEED"; echo ready; exec sleep 100'
plugins = [
    Program(
        ["sh", "-c", SCRIPT, treatment("Algorithm"), ["--speed=", treatment("Speed")]],
        name="Planner", environment={"SPEED": treatment("Speed")}, ready="ready",
    )
]
"""
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Algorithm", ["dwa", "teb"]), Factor("Speed", [0.1, 0.2])], seed=1, shuffle=False)
"""


@pytest.fixture
def execute(tmp_path: Path) -> Callable[..., Executed]:
    return partial(execute_in, tmp_path, head=OURS, table=ONE_RUN)


def findings(folder: Path, body: str, **parts: str) -> list[str]:
    prepared = prepare(written_config(folder, body, **{"head": OURS, "table": TABLE, **parts}))
    return [str(finding) for finding in prepared.findings]


class TestProgram(SystemContract):
    """What holds for every system."""

    is_repeatable = False  # real time
    goes_on_without_its_process = False  # who outlives a run ends its processes: tests/process

    #: Others that execute these tests on this machine have programs of their own.
    seconds = f"1000.{os.getpid()}"

    def make_plugin(self) -> Program:
        return Program(["sleep", self.seconds])

    def robot_stands_still(self, context: RobotRunnerContext) -> bool:
        del context
        return not alive(f"sleep\0{self.seconds}\0")


@pytest.mark.long
def test_the_treatments_of_a_run_reach_the_program(execute: Callable[..., Executed]) -> None:
    done = execute(BOUND, table=TABLE)
    combinations = [("dwa", "0.1"), ("dwa", "0.2"), ("teb", "0.1"), ("teb", "0.2")]
    assert done.finished.done_count == 4
    for number, (algorithm, speed) in enumerate(combinations, start=1):
        folder = done.folder / "runs" / f"r_{number}" / "Planner"
        assert (folder / "stdout.txt").read_text() == f"{algorithm} --speed={speed} {speed}\nready\n"
        assert 0 < float(done.table[number - 1]["StartupTime"]) < 20
    started, ended = done.journal("subject")[:2]
    assert started["command"][-2:] == ["dwa", "--speed=0.1"]
    assert started["output"] == "runs/r_1/Planner"
    assert (ended["ended"], ended["was_asked"]) == ("SIGTERM ended it", True)
    bound = done.journal("bound")[0]["parameters"]
    assert bound["command[4][1]"] == {"factor": "Speed", "value": 0.1}


@pytest.mark.long
def test_all_that_a_program_started_ends_with_its_run(
    execute: Callable[..., Executed], rude_tree: Callable[..., list[str]], token: str
) -> None:
    command = rude_tree()
    done = execute(f"plugins = [Program({command!r}, name='Tree', ready='started', grace_s=0.3)]", table=TWO_RUNS)
    assert done.finished.done_count == 2
    assert alive(token) == []
    warnings = [finding.problem for finding in done.finished.findings if finding.where.endswith("Tree")]
    assert warnings == ["Tree did not end within 0.3 s of SIGTERM and was killed"] * 2


@pytest.mark.long
def test_a_death_fails_the_run_at_once_with_its_last_words(
    execute: Callable[..., Executed], rude_tree: Callable[..., list[str]], token: str
) -> None:
    command = rude_tree("sleep 0.5; echo 'no map: /maps/hall.yaml' >&2; exit 3", is_rude=False)
    started = time.monotonic()
    body = (
        f"plugins = [Program({command!r}, name='Nav')]\ndef launch_mission(self, context):\n    context.clock.sleep(60)"
    )
    done = execute(body)
    assert time.monotonic() - started < 30
    (failure,) = done.finished.failures
    assert "Nav has died: exit code 3; it wrote last: no map: /maps/hall.yaml" in failure
    assert gone(token)


def test_what_is_not_ready_in_time_or_dies_before_fails_its_run(execute: Callable[..., Executed], token: str) -> None:
    body = """
    plugins = [Program(["sh", "-c", "echo waiting for a map; sleep 100", "{token}"], ready="goal", ready_timeout_s=0.5)]
    """
    done = execute(body.replace("{token}", token))
    assert (
        "it still did not hold that 'goal' stands in the output of Program: waiting for a map"
        in done.finished.failures[0]
    )
    assert alive(token) == []
    done = execute("plugins = [Program(['sh', '-c', 'kill -35 $$'], ready='x')]", experiment_name="dead")
    assert "Program has died: signal 35 ended it" in done.finished.failures[0]


@pytest.mark.long
@pytest.mark.parametrize("robot", [None, "simulated"])
def test_it_is_ready_once_a_condition_holds_in_real_time_whatever_clock_the_robot_has(
    execute: Callable[..., Executed], robot: str | None
) -> None:
    port = claim_port()
    serve = f"import http.server as s; s.test(s.SimpleHTTPRequestHandler, port={port}, bind='127.0.0.1')"
    command = [sys.executable, "-u", "-c", f"import time; time.sleep(1); print('up'); {serve}"]
    body = f"""
    robot = {robot!r}
    plugins = [
        Program({command!r}, name="Server", ready=all_of(port_open({port}), text_in("Server/stdout.txt", "up")))
    ]
    """
    done = execute(body)
    assert done.finished.failures == ()
    assert 1 < float(done.table[0]["StartupTime"]) < 40
    (waited,) = done.journal("waited")
    assert (waited["owner"], waited["holds"]) == ("Server", True) if "owner" in waited else waited["holds"]


@pytest.mark.long
@pytest.mark.parametrize("process", soak_but({"FORK"}, ["FORK", "SPAWN"]))
def test_a_subject_of_the_experiment_is_started_once_and_told_of_in_each_run(
    execute: Callable[..., Executed], rude_tree: Callable[..., list[str]], token: str, process: str
) -> None:
    command = rude_tree(is_rude=False)
    body = f"plugins = [Program({command!r}, name='World', per='experiment', ready='started', grace_s=0.3)]"
    done = execute(f"{body}\nrun_process = RunProcess.{process}", table=TWO_RUNS)
    assert done.finished.done_count == 2
    told = [record for record in done.journal("subject") if "pid" in record]
    assert len({record["pid"] for record in told}) == 1
    assert {record["output"] for record in told} == {"subjects/World/1"}
    assert (done.folder / "subjects/World/1/stdout.txt").read_text().startswith("started")
    assert "StartupTime" not in done.table[0]
    assert alive(token) == []


def startup_and_all_before_the_mission(
    context: RobotRunnerContext, program: Program, begin: Callable[[], None] = lambda: None
) -> tuple[float, float]:
    """Return the startup time, and what went by from `begin` until the mission: other parts of it are no startup."""
    begun, launched = time.monotonic(), list[float]()
    begin()
    measures = rehearse(context, program, mission=lambda: launched.append(time.monotonic()))
    return measures["StartupTime"], launched[0] - begun


def test_what_its_supervisor_needs_is_no_part_of_the_startup_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = tmp_path / "python"
    slow.write_text(f'#!/bin/sh\nsleep 1.5\nexec "{sys.executable}" "$@"\n')
    slow.chmod(0o755)
    monkeypatch.setattr("robot_runner.subjects.supervised_program.sys", SimpleNamespace(executable=str(slow)))
    program = Program(["sh", "-c", "sleep 0.2; echo ready; exec sleep 100"], ready="ready")
    context = make_context(tmp_path, program, clock=SystemClock())
    startup_time, until_mission = startup_and_all_before_the_mission(context, program)
    assert 0.2 <= startup_time <= until_mission - 1.5


def test_the_wait_for_the_end_of_an_earlier_start_is_no_part_of_the_startup_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = (tmp_path / "lock").open("w")
    fcntl.flock(held, fcntl.LOCK_EX)
    monkeypatch.setattr(Program, "_lock", lambda *_: tmp_path / "lock")
    program = Program(["sleep", "100"])
    context = make_context(tmp_path, program, clock=SystemClock())
    opening = Timer(2.0, held.close)
    startup_time, until_mission = startup_and_all_before_the_mission(context, program, opening.start)
    assert startup_time <= until_mission - 2.0


def test_a_program_is_ended_at_once_where_its_run_is_interrupted_while_it_is_being_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, token: str
) -> None:
    def interrupt(_program: SupervisedProgram) -> None:
        wait_until(lambda: alive(token))
        raise RunInterrupted

    monkeypatch.setattr(SupervisedProgram, "_await_start", interrupt)
    program = Program(["sh", "-c", "while :; do sleep 0.2; done", token])
    with pytest.raises(RunInterrupted):
        program.start_run(make_context(tmp_path, program, clock=SystemClock()))
    assert not alive(token)


def test_a_subject_whose_run_is_interrupted_before_it_is_watched_is_stopped_without_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, token: str
) -> None:
    def interrupt(_thread: Thread) -> None:
        raise RunInterrupted

    program = Program(["sh", "-c", "while :; do sleep 0.2; done", token])
    context = make_context(tmp_path, program, clock=SystemClock())
    monkeypatch.setattr(Thread, "start", interrupt)
    with pytest.raises(RunInterrupted):
        program.start_run(context)
    program.stop_run(context)
    assert not alive(token)


def test_a_program_that_has_ended_by_the_time_that_it_is_looked_for_was_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy machine, a build that takes milliseconds was refused: `'/bin/sh' was not started: exit code 0`."""
    pid, looked = SupervisedProgram.pid.fget, []

    def late(program: SupervisedProgram) -> int | None:
        if not looked:
            looked.append(program._supervisor.wait(60))
            return None
        return pid(program)

    monkeypatch.setattr(SupervisedProgram, "pid", property(late))
    program = SupervisedProgram(tmp_path, Task(command=("true",), environment={}), name="Planner")
    assert looked == [0]
    assert program.stop().code == 0


def test_what_kills_all_of_a_runs_session_leaves_the_supervisor_that_ends_its_program(tmp_path: Path) -> None:
    program = SupervisedProgram(tmp_path, Task(command=("sleep", "1000"), environment={}), name="Planner")
    supervisor = program._supervisor.pid
    assert os.getsid(supervisor) == os.getpgid(supervisor) == supervisor
    program.stop()


def test_what_a_program_has_started_is_ended_where_its_supervisor_was_killed(tmp_path: Path, token: str) -> None:
    child = f"'{sys.executable}' -c 'import time; time.sleep(1000)' {token}"
    program = SupervisedProgram(tmp_path, Task(command=("sh", "-c", f"{child} & wait"), environment={}), name="Planner")
    wait_until(lambda: len(alive(token)) >= 2)
    os.kill(program._supervisor.pid, signal.SIGKILL)
    program.stop()
    assert gone(token)


@pytest.mark.long
def test_a_subject_of_the_experiment_that_died_is_started_again_for_the_next_run(
    execute: Callable[..., Executed], tmp_path: Path
) -> None:
    mark = tmp_path / "first"
    # It looks for the mark before it says that it is up: the mission makes it then.
    again = '[ -e "$0" ] && echo up && exec sleep 100'
    command = ["sh", "-c", f'{again}; echo up; while [ ! -e "$0" ]; do sleep 0.1; done; exit 9', str(mark)]
    body = f"""
    plugins = [Program({command!r}, name="World", per="experiment", ready="up")]

    def launch_mission(self, context):
        Path({str(mark)!r}).touch()
        context.clock.sleep(60 if context.run_number == 1 else 0)
    """
    done = execute(body, table=TWO_RUNS)
    assert [row["status"] for row in done.table] == ["Failed", "Done"]
    assert "World has died: exit code 9" in done.finished.failures[0]
    assert any("it is started again before this run" in finding.problem for finding in done.finished.findings)
    assert sorted(path.name for path in (done.folder / "subjects/World").iterdir()) == ["1", "2"]


@pytest.mark.long
def test_a_program_that_computes_something_is_the_mission(execute: Callable[..., Executed]) -> None:
    body = """
    plugins = [Program(["sh", "-c", "sleep 0.3; exit 4"], exit_codes=[0, 4])]

    def launch_mission(self, context):
        assert self.plugins[0].wait(context, timeout_s=20) == 4
    """
    done = execute(body)
    assert (done.finished.failures, done.table[0]["ExitCode"]) == ((), "4")
    refused = execute(body.replace("exit 4", "exit 5"), experiment_name="refused")
    assert "Program has died: exit code 5" in refused.finished.failures[0]
    endless = body.replace("sleep 0.3; exit 4", "echo no way yet; sleep 100").replace("timeout_s=20", "timeout_s=0.5")
    late = execute(endless, experiment_name="late")
    said = "launch_mission of config: Program has not ended within 0.5 s; it wrote last: no way yet"
    assert said in late.finished.failures[0]


#: Takes 0.3 s of the processor in a child, and 0.9 s in all at least.
BURN = f"'{sys.executable}' -ISc 'import time\nwhile time.process_time() < 0.3: pass'; sleep 0.6"


@pytest.mark.long
@pytest.mark.parametrize("per", ["run", "mission"])
def test_a_program_that_had_begun_before_the_mission_makes_values_doubtful_and_one_of_the_mission_none(
    execute: Callable[..., Executed], per: str
) -> None:
    body = f"""
    solver = Program(["sh", "-c", {BURN!r}], name="Solver", exit_codes=[0], per={per!r})
    plugins = [solver]

    def start_measurement(self, context):
        context.clock.sleep(0.3)  # as meters take to start

    def launch_mission(self, context):
        self.solver.wait(context, timeout_s=20)
    """
    done = execute(body)
    assert (done.finished.failures, done.table[0]["ExitCode"]) == ((), "0")
    (window,) = done.journal("window")
    (ended,) = done.journal("attempt_finished")
    doubts = " ".join(ended["measures"]["ExitCode"].get("doubts", ()))
    if per == "mission":
        assert window["end"] - window["start"] >= 0.9
        assert float(done.table[0]["CPUTime"]) == pytest.approx(0.3, abs=0.15)
    assert ("Solver had been executed for" in doubts) is (per == "run")


@pytest.mark.parametrize("leaves", ["(BURN &); AWAIT", "BURN & AWAIT", "BURN"])
def test_what_a_program_did_not_await_is_told_to_be_missing_from_its_cpu_time(tmp_path: Path, leaves: str) -> None:
    burnt = tmp_path / "burnt"
    stays = "" if leaves == "BURN" else "; exec sleep 1000"  # it is there when the program ends
    loop = f"""sh -c 'i=0; while [ $i -lt 60000 ]; do i=$((i+1)); done; : >"$0"{stays}' "$0\""""  # some 50 ms
    script = leaves.replace("BURN", loop).replace("AWAIT", 'while [ ! -e "$0" ]; do sleep 0.05; done')
    solver = Program(["sh", "-c", script, str(burnt)], name="Solver", exit_codes=[0], per="mission")
    context = make_context(tmp_path, solver, clock=SystemClock())
    rehearse(context, solver, mission=lambda: solver.wait(context, timeout_s=20))
    told = [finding.problem for finding in context.broker.findings if "did not await" in finding.problem]
    assert len(told) == (leaves != "BURN"), told
    assert all("which CPUTime lacks" in problem for problem in told)


@pytest.mark.parametrize("handling", ["SIG_IGN", "SIG_DFL"])
def test_a_program_whose_children_the_kernel_does_not_count_is_told(tmp_path: Path, handling: str) -> None:
    program = f"""
import os, signal
signal.signal(signal.SIGCHLD, signal.{handling})
if os.fork() == 0:
    sum(range(1_000_000))
    os._exit(0)
try:
    os.wait()
except ChildProcessError:
    pass
"""
    solver = Program([sys.executable, "-c", program], name="Solver", exit_codes=[0], per="mission")
    context = make_context(tmp_path, solver, clock=SystemClock())
    rehearse(context, solver, mission=lambda: solver.wait(context, timeout_s=20))
    assert [finding.problem for finding in context.broker.findings] == (
        ["Solver ignores SIGCHLD, so that the kernel counts no CPU time of its children, which CPUTime lacks"]
        if handling == "SIG_IGN"
        else []
    )


@pytest.mark.long
@pytest.mark.parametrize("per", soak_but({"experiment"}, ["run", "experiment"]))
def test_nobody_is_left_when_the_orchestrator_is_killed(
    tmp_path: Path, rude_tree: Callable[..., list[str]], token: str, per: str
) -> None:
    command = rude_tree(is_rude=False)
    body = f"""
    plugins = [Program({command!r}, ready="started", per={per!r}, grace_s=0.3)]

    def launch_mission(self, context):
        print("mission", flush=True)
        context.clock.sleep(100)
    """
    config = written_config(tmp_path, body, head=OURS, table=ONE_RUN)
    orchestrator = subprocess.Popen([PROGRAM, "run", config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    log = tmp_path / "results/trial/current_log.txt"
    deadline = time.monotonic() + 60
    while not (log.exists() and "mission" in log.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert len(alive(token)) >= 3
    os.kill(orchestrator.pid, signal.SIGKILL)
    orchestrator.wait()
    assert gone(token)


def test_what_cannot_be_is_found_with_each_treatment_before_anything_moves(tmp_path: Path) -> None:
    missing = findings(tmp_path, "plugins = [Program([treatment('Algorithm'), treatment('Speed')])]")
    assert missing == [
        f"plugin Program: with Algorithm = {name}, Speed = 0.1; Algorithm = {name}, Speed = 0.2: "
        f"the program '{name}' is not there → Install it, or give its full path."
        for name in ("dwa", "teb")
    ]
    once = findings(tmp_path, "plugins = [Program(['sleep', treatment('Speed')], per='experiment')]")
    assert "is started once for all runs, and bound to the factor 'Speed'" in once[0]


@pytest.mark.parametrize(
    ("per", "bob", "is_told"),
    [("experiment", "domain=8", True), ("experiment", "domain=7,namespace=bob", False), ("run", "domain=8", False)],
)
def test_a_program_of_all_runs_is_said_not_to_be_on_the_graphs_of_several_robots(
    tmp_path: Path, per: str, bob: str, is_told: bool
) -> None:
    robots = f"robot = Robots(alice='dds:domain=7,namespace=alice', bob='dds:{bob}')"
    found = findings(tmp_path, f"plugins = [Program(['sleep', '9'], per={per!r})]\n{robots}")
    told = [each for each in found if "plugin Program" in each]
    said = "it is started once for all runs, on one graph (domain 7), and robots are on domain 8"
    assert [said in each for each in told] == [True] * is_told
    (nowhere,) = findings(tmp_path, "plugins = [Program(['true'], folder='nowhere')]")
    assert "there is no folder 'nowhere'" in nowhere
    (setup,) = findings(tmp_path, "plugins = [Program(['true'], setup='install/setup.bash')]")
    assert "there is no file 'install/setup.bash' to source" in setup


@pytest.mark.parametrize(
    ("wrong", "fix"),
    [
        ({"command": "planner --fast"}, "Give a list of words: ['planner', '--fast']"),
        ({"command": []}, "Give a list of words"),
        ({"command": ["planner", object]}, "Give texts, numbers or paths."),
        ({"command": ["planner"], "per": "experimnt"}, "Did you mean 'experiment'?"),
        ({"command": ["planner"], "grace_s": 0}, "Give grace_s a number of seconds above 0."),
        ({"command": ["planner"], "stop_signal": "sigint"}, "Give a member of it: stop_signal=signal.SIGINT."),
        ({"command": ["planner"], "stop_signal": "SIGTERM"}, "Give a member of it: stop_signal=signal.SIGTERM."),
        ({"command": ["planner"], "stop_signal": True}, "Give a member of it: stop_signal=signal.SIGINT."),
        ({"command": ["planner"], "environment": {"A=b": "c"}}, "Give a mapping"),
        ({"command": ["planner"], "environment": ["A=b"]}, "Give a mapping"),
        ({"command": ["planner"], "ready": 8080}, "Give a condition"),
        ({"command": ["planner"], "ready": re.compile(b"up")}, "Give a condition"),
        ({"command": ["planner"], "ready_timeout_s": "60"}, "Give ready_timeout_s a number of seconds above 0."),
        ({"command": ["planner"], "exit_codes": 0}, "Give a list of whole numbers: exit_codes=[0]."),
        ({"command": ["planner"], "exit_codes": "0"}, "Give a list of whole numbers: exit_codes=[0]."),
        ({"command": b"planner"}, "Give a list of words"),
        ({"command": 8080}, "Give a list of words"),
        ({"command": ["planner"], "per": 5}, "Choose one of: 'run', 'mission', 'experiment'."),
        ({"command": ["planner"], "host": "-oProxyCommand=x"}, "Name it as for ssh"),
        ({"command": ["planner"], "ssh_config": "x"}, "Leave ssh_config out."),
    ],
)
def test_a_parameter_that_cannot_be_is_refused(wrong: dict[str, Any], fix: str) -> None:
    with pytest.raises(PluginError) as caught:
        Program(**wrong)
    assert caught.value.fix.startswith(fix)


def test_the_supervisor_that_is_sent_to_other_computers_is_python_of_theirs() -> None:
    ast.parse(Path(supervisor.__file__).read_text(encoding="utf-8"), feature_version=(3, 6))


def test_what_keeps_a_script_from_being_started_is_told(execute: Callable[..., Executed], tmp_path: Path) -> None:
    script = tmp_path / "my planner"
    script.write_text("echo hi\n")
    (finding,) = Program(["./my planner"], folder=tmp_path).program_findings("plugin")
    assert (finding.problem, finding.fix) == (
        "the program './my planner' is not executable",
        f"Make it so: chmod +x '{script}'",
    )
    script.chmod(0o755)
    done = execute(f"plugins = [Program([{str(script)!r}])]")
    assert "Exec format error" in done.finished.failures[0]
    assert "Give a script a first line such as #!/bin/sh" in str(done.journal())


@pytest.mark.parametrize("folder", [None, "."])
def test_a_program_that_lies_in_the_current_folder_is_found(
    folder: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "planner").write_text("#!/bin/sh\n")
    (tmp_path / "planner").chmod(0o755)
    assert list(Program(["./planner"], folder=folder).program_findings("plugin")) == []
    assert list(Program(["./other"], folder=folder).program_findings("plugin"))


@pytest.mark.parametrize("whose", ["the supervisor's", "the program's"])
def test_where_the_system_has_no_process_for_a_program_it_is_said_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whose: str
) -> None:
    refusal = BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    supervisor_of_it = SimpleNamespace(pid=2**31 - 1, stdin=None, poll=lambda: 0, wait=lambda: 0)
    started = Mock(side_effect=refusal) if whose == "the supervisor's" else Mock(return_value=supervisor_of_it)
    monkeypatch.setattr(subprocess, "Popen", started)
    told = {"refused": {"refused": refusal.strerror}}
    monkeypatch.setattr(Start, "_told", lambda _, kind: told.get(kind, {}))
    task = Task(command=("true",), environment={})
    with pytest.raises(RobotRunnerError, match=os.strerror(errno.EAGAIN)) as caught:
        SupervisedProgram(tmp_path / "start", task, name="Planner")
    assert "ulimit -u" in caught.value.findings[0].fix


def test_a_setup_file_may_lie_at_home_and_a_program_is_named_as_the_system_takes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "my ws").mkdir()
    (tmp_path / "my ws" / "setup.sh").write_text("PLANNER=teb\nexport PLANNER\n")
    (tmp_path / "planner").write_text("#!/bin/sh\n")
    (tmp_path / "planner").chmod(0o755)
    around = Program(["true"], setup="~/my ws/setup.sh").surroundings
    assert list(around.findings("plugin")) == []
    assert around.ask(["sh", "-c", "echo $PLANNER"]).said == "teb\n"
    (missing,) = Program(["~/planner"]).program_findings("plugin")  # nobody but a shell would find it
    assert missing.problem == "the program '~/planner' is not there"


@pytest.mark.long
def test_a_setup_file_is_sourced_first(execute: Callable[..., Executed], tmp_path: Path) -> None:
    (tmp_path / "setup.sh").write_text("PLANNER=teb$#\nexport PLANNER\n")
    command = ["sh", "-c", "echo $PLANNER $0; exec sleep 100", "a"]
    done = execute(f"plugins = [Program({command!r}, folder={str(tmp_path)!r}, setup='setup.sh', ready='teb')]")
    assert (done.folder / "runs/r_1/Program/stdout.txt").read_text() == "teb0 a\n"
    assert json.loads(json.dumps(done.journal("subject")[0]))["setup"] == "setup.sh"


def test_a_cache_that_cannot_be_written_is_named_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/none")  # as of a user without a home of its own, in a container
    program = Program(["sleep", "1000"])
    context = make_context(tmp_path, program, robot=None)
    tree = WorkTree(str(tmp_path), "0" * 40, "")
    workshop = Workshop(tmp_path, lambda: False, print)
    for attempt in (lambda: program.start_run(context), lambda: tree.made("main", tmp_path / "log", workshop)):
        with pytest.raises(StorageError, match="your folder of caches cannot be written") as caught:
            attempt()
        assert caught.value.fix == "Set XDG_CACHE_HOME to a folder of your own."


def test_a_cache_that_cannot_be_made_is_found_before_anything_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "home").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home" / "cache"))
    versions = Factor.revisions("Version", str(tmp_path), ["main"])
    for findings in (
        Program(["sleep", "1000"]).check(Circumstances(robot=None)),
        REVISIONS.findings([versions], {}),
    ):
        first = next(iter(findings))
        assert first.is_error
        assert "your folder of caches" in first.problem
        assert first.fix == "Set XDG_CACHE_HOME to a folder of your own."
