"""Experiments executed by scripts, threads, notebooks and tests."""

from __future__ import annotations

import asyncio
import json
import linecache
import mmap
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil
import pytest
from tests.conftest import written_config
from tests.core.execution.conftest import RecordingObserver
from tests.forked_program import child_processes
from tests.instructions import Instructions
from tests.long_cases import soak_but
from tests.waiting import wait_until

from robot_runner import (
    ConfigError,
    ExecutionError,
    ExperimentConfig,
    Factor,
    OperationType,
    RunProcess,
    RunTableModel,
    run_experiment,
)
from robot_runner.core.execution.notices import AttemptFinished
from robot_runner.notebook import apart, from_python

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator
    from types import FrameType

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")


class Study(ExperimentConfig):
    experiment_name = "study"
    watch_machines = False
    probe = False
    speed_up = 1.0

    def __init__(self) -> None:
        self.seen: list[str] = []

    def before_run(self, context: Any) -> None:
        self.seen.append(context.run_id)

    def launch_mission(self, context: Any) -> None:
        if context.combination["Task"] == "Bad":
            raise ValueError("bumped")

    def populate_run_data(self, context: Any) -> dict[str, float]:
        return {"Energy": 2.5 * self.speed_up}

    def create_run_table(self) -> RunTableModel:
        return RunTableModel([Factor("Task", ["Good", "Bad"])], repetitions=2, data_columns=["Energy"])


class Unnamed(Study):
    experiment_name = ""
    attempts = 0


def here(call: Callable[[], Any]) -> Any:
    return call()


def in_thread(call: Callable[[], Any]) -> Any:
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(call).result()


@pytest.fixture(params=[here, in_thread])
def wherever(request: pytest.FixtureRequest) -> Callable[[Callable[[], Any]], Any]:
    """Return what calls something in the main thread, and in another one."""
    return request.param


@pytest.mark.long
def test_rows_failures_and_findings_come_back(wherever: Any, tmp_path: Path) -> None:
    said: list[str] = []
    results = wherever(lambda: run_experiment(Study, folder=tmp_path, say=said.append))
    assert [row["Energy"] for row in results.rows] == [2.5, None, 2.5, None]
    assert [row["Task"] for row in results.rows] == ["Good", "Bad", "Good", "Bad"]
    assert [row["status"] for row in results.rows] == ["Done", "Failed", "Done", "Failed"]
    assert json.loads(json.dumps(results.rows)) == list(results.rows)
    assert results.folder == tmp_path / "study"
    assert results.failures == dict.fromkeys(("r_2", "r_4"), "launch_mission of config: ValueError: bumped")
    assert (results.done_count, results.failed_count, results.todo_count, results.exit_code) == (2, 2, 0, 1)
    assert any("r_1 is done after" in line for line in said)
    assert any("r_2 failed: launch_mission of config" in line for line in said)
    assert list(results.frame()["Energy"].dropna()) == [2.5, 2.5]
    assert (results.folder / "config" / "test_from_python.py").read_text() == Path(__file__).read_text()
    again = wherever(lambda: run_experiment(Study, folder=tmp_path, only=["r_1"], redo=["r_1"]))
    assert again.done_count == 2


def test_all_findings_are_raised(wherever: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as raised:
        wherever(lambda: run_experiment(Unnamed, folder=tmp_path))
    assert {finding.where.rpartition(".")[2] for finding in raised.value.findings} >= {"experiment_name", "attempts"}
    with pytest.raises(ConfigError, match="there is no such file"):
        wherever(lambda: run_experiment(tmp_path / "nothing.py"))


@pytest.mark.long
def test_settings_are_recorded_as_deviations_and_stay_with_their_call(wherever: Any, tmp_path: Path) -> None:
    study = Study()
    settings = {"speed_up": 2.0, "operation_type": OperationType.AUTO, "robot": None}
    for number, config in enumerate((Study, study)):
        results = wherever(
            lambda config=config, number=number: run_experiment(
                config, folder=tmp_path, settings={**settings, "experiment_name": f"study_{number}"}, only=["r_1"]
            )
        )
        assert results.rows[0]["Energy"] == 5.0
        manifest = json.loads((results.folder / "manifest.json").read_text())
        assert manifest["deviations"]["speed_up"] == "2.0"
        assert manifest["config"] == {"file": "test_from_python.py", "class": "Study"}
    assert (Study.speed_up, study.speed_up, Study.experiment_name) == (1.0, 1.0, "study")
    with pytest.raises(ConfigError, match="there is no static parameter 'sped_up'"):
        wherever(lambda: run_experiment(Study, folder=tmp_path, settings={"sped_up": 1.0}))
    with pytest.raises(ConfigError, match="of type object cannot be set"):
        run_experiment(Study, folder=tmp_path, settings={"robot": object()})


def test_a_config_file_is_executed(wherever: Any, tmp_path: Path) -> None:
    config = written_config(tmp_path, "def populate_run_data(self): return {'Energy': 1.0}")
    results = wherever(lambda: run_experiment(str(config), settings={"watch_machines": False}))
    assert [row["Energy"] for row in results.rows] == [1.0] * 4
    assert results.folder == tmp_path / "results" / "trial"
    assert results.exit_code == 0


def test_a_path_among_the_folders_of_modules_is_passed_over_as_python_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = ["from robot_runner import ConfigError", "def execute(request, tell):", "    raise ConfigError('found')"]
    (tmp_path / "work_of_mine.py").write_text("\n".join(lines))
    monkeypatch.setattr(sys, "path", [*sys.path, tmp_path / "elsewhere", str(tmp_path)])
    with pytest.raises(ConfigError, match="found"):
        apart.execute_in_interpreter("work_of_mine:execute", {}, None)


def test_what_is_asked_for_stands_in_no_list_of_processes_and_may_be_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = [
        "import sys",
        "from pathlib import Path",
        "from robot_runner import ConfigError",
        "def execute(request, tell):",
        "    words = Path('/proc/self/cmdline').read_bytes()",
        "    raise ConfigError(repr((len(request['key']), b'sesame' in words, sys.stdin.read())))",
    ]
    (tmp_path / "long_work.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=r"\(1800000, False, ''\)"):
        apart.execute_in_interpreter("long_work:execute", {"key": "sesame" * 300_000}, None)


def test_in_the_main_thread_an_instance_and_an_observer_see_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(from_python, "_is_free", lambda: True)  # whatever threads the test program has
    study, observer = Study(), RecordingObserver()
    run_experiment(study, folder=tmp_path, observer=observer)
    assert study.seen == ["r_1", "r_2", "r_3", "r_4"]
    assert sum(isinstance(notice, AttemptFinished) for notice in observer.notices) == 4


def test_what_cannot_be_is_refused_clearly(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is not a config"):
        run_experiment(42)
    with pytest.raises(ExecutionError, match="an observer can only watch"):
        in_thread(lambda: run_experiment(Study, folder=tmp_path, observer=RecordingObserver()))
    with pytest.raises(ConfigError, match="run_process is SPAWN"):
        run_experiment(Study(), folder=tmp_path, settings={"run_process": RunProcess.SPAWN})


def test_a_class_without_a_file_is_kept_as_far_as_can_be_and_the_manifest_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "nowhere"}
    exec(  # noqa: S102 - as a console does
        "from robot_runner import *\n"
        "class Console(ExperimentConfig):\n"
        "    experiment_name = 'console'\n"
        "    watch_machines = False\n"
        "    def create_run_table(self): return RunTableModel([Factor('A', [1])])\n",
        names,
    )
    results = run_experiment(names["Console"])
    assert results.folder == tmp_path / "experiments" / "console"
    manifest = json.loads((results.folder / "manifest.json").read_text())
    assert manifest["config"] == {"file": "config_from_python.py", "class": "Console", "kept": "nothing"}
    assert any("its source is not kept" in finding.problem for finding in results.findings)


CELL = """
class Cell(ExperimentConfig):
    experiment_name = "cell"
    run_process = RunProcess.IN_PROCESS
    watch_machines = False

    def populate_run_data(self, context):
        return {{"Energy": {energy}}}

    def create_run_table(self):
        return RunTableModel([Factor("Task", [1])], data_columns=["Energy"])
"""


def defined(name: str, text: str, names: dict[str, Any]) -> None:
    """Execute a cell as a notebook does, which keeps its text by its name."""
    linecache.cache[name] = (len(text), None, text.splitlines(keepends=True), name)
    exec(compile(text, name, "exec"), names)  # noqa: S102 - as a notebook does


def test_the_cells_of_a_class_without_methods_and_of_its_base_are_kept_and_their_changes_refused(
    tmp_path: Path,
) -> None:
    names: dict[str, Any] = {"__name__": "notebook"}
    defined("<cell base 1>", "from robot_runner import *\n" + CELL.format(energy=1.0), names)
    defined("<cell short 1>", "class Short(Cell):\n    speed_up = 2.0\n", names)
    defined("<cell short 2>", "if False:\n    class Short(Cell):\n        speed_up = 3.0\n", names)
    results = run_experiment(names["Short"], folder=tmp_path)
    kept = (results.folder / "config" / "config_from_python.py").read_text()
    assert '{"Energy": 1.0}' in kept
    assert "speed_up = 2.0" in kept
    assert json.loads((results.folder / "manifest.json").read_text())["config"]["kept"] == "cell"
    defined("<cell base 2>", "from robot_runner import *\n" + CELL.format(energy=2.0), names)
    defined("<cell short 3>", "class Short(Cell):\n    speed_up = 2.0\n", names)
    with pytest.raises(ExecutionError, match=r"'return {\"Energy\": 1\.0}' and is 'return {\"Energy\": 2\.0}'"):
        run_experiment(names["Short"], folder=tmp_path, redo=["r_1"])


def test_what_is_refused_is_told_in_the_words_of_who_calls_a_function(tmp_path: Path) -> None:
    def cell(energy: float) -> Any:
        name, text = f"<cell {energy}>", CELL.format(energy=energy)
        linecache.cache[name] = (len(text), None, text.splitlines(keepends=True), name)
        exec(compile(text, name, "exec"), names := {**globals(), "__name__": "nowhere"})  # noqa: S102 - as a notebook
        return names["Cell"]

    run_experiment(cell(1.5), folder=tmp_path)
    with pytest.raises(ExecutionError) as refused:
        run_experiment(cell(2.5), folder=tmp_path, settings={"grace_in_s": 5})
    line, setting = refused.value.findings
    assert line.where.startswith("the class:")
    assert "(accept_changes=True)" in line.fix
    assert (setting.where, setting.problem.partition(" and ")[2]) == (
        'settings["grace_in_s"]',
        'is set by settings={"grace_in_s": "5"}',
    )


INTERRUPTED = """
import sys, threading, time
from robot_runner import *

class Slow(ExperimentConfig):
    experiment_name = "slow"
    watch_machines = False
    def launch_mission(self): time.sleep(60)
    def create_run_table(self): return RunTableModel([Factor("A", [1, 2])])

if {threads}:
    threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
results = run_experiment(Slow, folder=sys.argv[1], say=lambda line: print(line, flush=True))
print("interrupted", results.is_interrupted, results.exit_code, flush=True)
"""


@contextmanager
def in_its_first_run(tmp_path: Path, *, threads: bool) -> Iterator[subprocess.Popen[str]]:
    """Execute that script, and yield its process once the first run has begun."""
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED.format(threads=threads))
    words = [sys.executable, str(script), str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout is not None
        next(line for line in process.stdout if "r_1) starts" in line)
        yield process


@pytest.mark.long
@pytest.mark.parametrize("threads", [False, True])
def test_ctrl_c_ends_it_cleanly_with_and_without_threads(tmp_path: Path, threads: bool) -> None:
    with in_its_first_run(tmp_path, threads=threads) as process:
        time.sleep(0.5)
        process.send_signal(2)
        out, _ = process.communicate(timeout=60)
    assert "interrupted True 130" in out


def test_a_script_that_is_killed_leaves_nobody(tmp_path: Path) -> None:
    with in_its_first_run(tmp_path, threads=True) as process:
        process.kill()
    wait_until(lambda: not _executing(str(tmp_path / "script.py")))


def _executing(script: str) -> list[int]:
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if script.encode() in words and int(folder.name) != os.getpid():
            found.append(int(folder.name))
    return found


CELLS = [
    "import threading\nfrom robot_runner import ExperimentConfig, Factor, RunTableModel, run_experiment",
    """class Notebook(ExperimentConfig):
    experiment_name = "notebook"
    watch_machines = False
    def before_run(self, context):
        print("preparing", context.run_id)
    def populate_run_data(self, context):
        return {"Way": context.combination["Speed"] * 10}
    def create_run_table(self):
        return RunTableModel([Factor("Speed", [0.1, 0.2])], data_columns=["Way"])""",
    "results = run_experiment(Notebook, say=print)",
    "print(threading.active_count() > 1, [row['Way'] for row in results.rows], results.findings[0].problem)",
]


class Kernel:
    """A real kernel of Jupyter, which executes cells."""

    def __init__(self, manager: Any, client: Any) -> None:
        self._manager = manager
        self._client = client

    async def execute(self, cell: str) -> str:
        """Return what a cell printed and showed."""
        taken: list[str] = []

        def take(message: Any) -> None:
            content = message["content"]
            shown = content.get("data", {}).get("text/plain", "")
            taken.append(content.get("text", "") or shown or "\n".join(content.get("traceback", [])))

        reply = await self._client.execute_interactive(cell, timeout=120, output_hook=take)
        assert reply["content"]["status"] == "ok", "".join(taken)
        return "".join(taken)

    async def interrupt(self) -> None:
        """Do what the button of a notebook does."""
        await self._manager.interrupt_kernel()


def in_a_kernel(folder: Path, told: Callable[[Kernel], Coroutine[Any, Any, None]]) -> None:
    from jupyter_client.manager import start_new_async_kernel  # takes half a second to import

    async def executed() -> None:
        manager, client = await start_new_async_kernel(kernel_name="python3", cwd=str(folder))
        try:
            await told(Kernel(manager, client))
        finally:
            client.stop_channels()
            await manager.shutdown_kernel(now=True)
            manager.context.destroy()

    asyncio.run(executed())


@pytest.mark.long
def test_it_works_in_a_notebook(tmp_path: Path) -> None:
    async def told(kernel: Kernel) -> None:
        said = "".join([await kernel.execute(cell) for cell in CELLS])
        assert "preparing r_1" in said
        assert "r_2 is done after" in said
        assert "True [1.0, 2.0] it stands in no file" in said
        assert (await kernel.execute("results")).endswith("experiments/notebook: 2 done; 1 finding>")

    in_a_kernel(tmp_path, told)
    folder = tmp_path / "experiments" / "notebook"
    assert "class Notebook(ExperimentConfig):" in (folder / "config" / "config_from_python.py").read_text()
    assert json.loads((folder / "manifest.json").read_text())["config"]["kept"] == "cell"


SLOW = """    def launch_mission(self, context):
        from pathlib import Path
        Path("begun").touch()
        context.clock.sleep(0 if Path("again").exists() else 600)
    def stop_run(self, context):
        print("closed")
    def before_run"""


@pytest.mark.long
def test_the_button_that_interrupts_a_notebook_closes_the_run_and_the_next_call_resumes(tmp_path: Path) -> None:
    async def told(kernel: Kernel) -> None:
        await kernel.execute(CELLS[0])
        await kernel.execute(CELLS[1].replace("    def before_run", SLOW))
        cell = "results = run_experiment(Notebook, say=print)\nprint(results.is_interrupted, results)"
        executing = asyncio.create_task(kernel.execute(cell))
        await asyncio.to_thread(wait_until, (tmp_path / "begun").exists, "the run has begun")
        await kernel.interrupt()
        said = await executing
        assert "the user interrupted the experiment" in said
        assert "True <ExperimentResults of " in said
        assert ": 2 to do; " in said
        assert "closed" in (tmp_path / "experiments/notebook/runs/r_1/log.txt").read_text()
        (tmp_path / "again").touch()
        assert ": 2 done; " in await kernel.execute("run_experiment(Notebook)")

    in_a_kernel(tmp_path, told)


def test_where_what_takes_the_lines_fails_the_experiment_goes_on(wherever: Any, tmp_path: Path) -> None:
    def fail(line: str) -> None:
        raise ValueError(line)

    results = wherever(lambda: run_experiment(Study, folder=tmp_path, say=fail))
    assert (results.done_count, results.failed_count, results.todo_count) == (2, 2, 0)


@pytest.mark.long
@pytest.mark.parametrize("only", soak_but(["r_1,r_3", ("Task=Good",)], ["r_1", "r_1,r_3", ["r_1"], ("Task=Good",)]))
def test_runs_are_chosen_as_on_the_command_line(wherever: Any, tmp_path: Path, only: Any) -> None:
    config = written_config(tmp_path, "def populate_run_data(self, context): return {'Energy': 1.0}")
    config.write_text(config.read_text().replace("Video", "Good"))
    results = wherever(lambda: run_experiment(config, only=only))
    assert results.done_count == (1 if only in ("r_1", ["r_1"]) else 2)


@pytest.mark.parametrize(
    ("asked", "problem"),
    [
        ({"only": [1]}, "1 names no run"),
        ({"redo": [None]}, "None names no run"),
        ({"settings": {1: 2}}, "1 is not the name of a static parameter"),
    ],
)
def test_what_is_no_text_where_a_text_belongs_is_told(tmp_path: Path, asked: dict[str, Any], problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        run_experiment(Study, folder=tmp_path, **asked)


@pytest.mark.long
def test_where_what_is_printed_cannot_be_shown_the_experiment_goes_on(tmp_path: Path) -> None:
    class Printing(Study):
        def before_run(self, context: Any) -> None:
            sys.stdout.write(f"caf\u00e9 {context.run_id}\n")

    with (tmp_path / "told.txt").open("w", encoding="ascii") as told, redirect_stdout(told):
        results = in_thread(lambda: run_experiment(Printing, folder=tmp_path))
    assert (results.done_count, results.failed_count, results.todo_count) == (2, 2, 0)
    assert (tmp_path / "told.txt").read_text() == "".join(f"caf? r_{number}\n" for number in range(1, 5))


def test_a_class_may_stand_in_a_file_of_any_encoding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (
        "# -*- coding: latin-1 -*-\n"
        "from robot_runner import ExperimentConfig, RunTableModel, Factor\n"
        "class Latin(ExperimentConfig):\n"
        "    experiment_name = 'latin'\n"
        "    watch_machines = False\n"
        "    def create_run_table(self): return RunTableModel([Factor('Caf\u00e9', ['d\u00e9j\u00e0'])])\n"
    )
    (tmp_path / "written_in_latin.py").write_text(text, encoding="latin-1")
    monkeypatch.syspath_prepend(tmp_path)
    results = run_experiment(import_module("written_in_latin").Latin, folder=tmp_path)
    assert results.rows[0]["Caf\u00e9"] == "d\u00e9j\u00e0"


def test_an_interrupt_while_much_is_being_printed_tears_no_line() -> None:
    said: list[int] = []
    is_printing = mmap.mmap(-1, 1)  # both processes have it

    def work(tell: Callable[[str], object]) -> Any:
        tell(f"{os.getpid():33}")
        long = "long" * 500_000
        is_printing[0] = 1
        tell(long)

    def say(line: str) -> None:
        said.append(len(line))
        if len(said) == 1:
            printing = psutil.Process(int(line))
            wait_until(lambda: is_printing[0])
            wait_until(lambda: printing.status() == psutil.STATUS_SLEEPING, "the pipe is full, as nobody reads on")
            printing.send_signal(signal.SIGINT)

    with pytest.raises(ExecutionError, match="KeyboardInterrupt"):
        apart.execute_forked(work, say)
    assert said == [33, 2_000_000]


@pytest.mark.long
def test_wherever_an_interrupt_comes_it_ends_the_copy_and_none_goes_on_without_its_program() -> None:
    def work(tell: Callable[[str], object]) -> Any:
        tell("begun")
        time.sleep(60)

    def interrupted(at: int | None) -> int:
        """Interrupt at an instruction, or once the work has begun; return how many there were until then."""

        def interrupt(frame: FrameType) -> None:
            signal.getsignal(signal.SIGINT)(signal.SIGINT, frame)  # type: ignore[misc, operator]

        def say(_line: str) -> None:
            if at is None:
                sys.settrace(None)
                os.kill(process, signal.SIGINT)

        process, there = os.getpid(), child_processes()
        instructions = Instructions(apart.__file__, at=at, act=interrupt)
        with pytest.raises(KeyboardInterrupt), instructions:
            apart.execute_forked(work, say)
        assert child_processes() <= there
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        return instructions.count

    count = interrupted(None)
    for at in range(3, count, count // 40):
        interrupted(at)


def test_a_file_that_executes_its_class_while_it_is_loaded_is_refused_and_nothing_is_executed(tmp_path: Path) -> None:
    config = written_config(tmp_path, "")
    line = len(config.read_text("utf-8").splitlines()) + 1
    with config.open("a", encoding="utf-8") as file:
        file.write("run_experiment(RobotRunnerConfig)\n")
    for given in (config, str(config)):
        with pytest.raises(ConfigError) as refused:
            run_experiment(given)
        (finding,) = refused.value.findings
        assert finding.where == f"{config}:{line}, run_experiment"
        assert "while it is loaded" in finding.problem
        assert "__main__" in finding.fix
    assert [each.name for each in tmp_path.iterdir()] == [config.name]


def test_a_class_whose_file_imports_relative_to_its_package_is_executed_and_told_not_to_be_replicable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "relative_study"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "speeds.py").write_text("SPEEDS = [0.1, 0.2]\n", "utf-8")
    (package / "study.py").write_text(
        "from robot_runner import *\n"
        "from .speeds import SPEEDS\n\n\n"
        "class Relative(ExperimentConfig):\n"
        "    experiment_name = 'relative'\n"
        "    watch_machines = False\n\n"
        "    def create_run_table(self):\n"
        "        return RunTableModel([Factor('Speed', SPEEDS)])\n",
        "utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    results = run_experiment(import_module("relative_study.study").Relative)
    assert results.done_count == 2
    (told,) = [each for each in results.findings if "relative" in each.problem]
    assert "study.py, line 2," in told.problem
    assert "a replication package of it cannot be executed" in told.problem
