"""What tests of several floors share: config files in a folder of the test's own, one browser, and one ROS 1 master."""

from __future__ import annotations

import gc
import importlib.util
import os
import subprocess
import sys
import textwrap
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers
from tests.command_line import PROGRAM, program, robot_runner, terminal
from tests.headless_browser import browser
from tests.made_once import made_once

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["browser", "program", "robot_runner", "terminal"]
_FIXED, _SOAK = "fixed", "soak"
#: Far more than a test takes that has no mark, s of processor time: computers differ, and one of each kind is dear.
_LONG = 4.0
#: Has rclpy beside what this Python has: scripts/set_up.sh.
ROS2_PYTHON = Path(sys.prefix, "ros2", "bin", "python")

# Each of several processes has one core at most: OpenBLAS' threads would burn it while they wait for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Without a clock and with a fixed seed, what passes on one machine passes on every machine, however busy it is.
settings.register_profile(
    _FIXED, derandomize=True, database=None, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile(
    _SOAK,
    max_examples=10_000,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
    print_blob=True,
)
settings.load_profile(_FIXED)


def pytest_configure(config: pytest.Config) -> None:
    """Let the examples of the fixed search depend on nothing but the test.

    hypothesis also tries the constants of those local modules that happen to be imported. Which ones are, depends on
    the tests that the same worker of pytest-xdist executed before; only the random search uses them.
    """
    if config.getoption("--hypothesis-profile") != _SOAK:
        providers.is_local_module_file = lambda _path: False


def pytest_collection_finish() -> None:
    """Leave what was imported and collected out of each later garbage collection, for good.

    It is half a million objects, and each execution of an experiment collects: a quarter of a second otherwise. What
    orchestrators freeze stays so; counting the frozen ones, as each plan does, would look at all of them.
    """
    gc.collect()
    gc.freeze()
    gc.unfreeze, gc.get_freeze_count = lambda: None, lambda: 1


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Name the tests that make `make test` long and have no mark that says so.

    The folders of configs that a test has loaded leave `sys.path`: another one would import what is called the same.
    """
    before, folders = sum(os.times()[:4]), [*sys.path]
    try:
        return (yield)
    finally:
        sys.path[:] = folders
        seconds = sum(os.times()[:4]) - before
        if seconds > _LONG and not any(map(item.get_closest_marker, ("long", "soak"))):
            figure = f"{item.nodeid} took {seconds:.1f} s of processor time: should it be marked `long`?"
            item.user_properties.append(("figure", figure))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the figures that tests measured: `record_property("figure", "...")`."""
    reports = [each for outcome in ("passed", "failed") for each in terminalreporter.stats.get(outcome, [])]
    properties = [pair for each in reports for pair in getattr(each, "user_properties", ()) if each.when == "call"]
    figures = [text for name, text in properties if name == "figure"]
    if figures:
        terminalreporter.section("figures")
        for text in sorted(figures):
            terminalreporter.write_line(text)


HEAD = """\
from pathlib import Path
from robot_runner import *


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
"""

TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=2, data_columns=["Energy"], seed=1)
"""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the tests of ROS 2 and of DDS where rclpy or cyclonedds is missing: not every system has them.

    The Python of .venv/ros2 executes those of ROS 2, where there is one: scripts/execute_tests.py.
    """
    if importlib.util.find_spec("rclpy") is None:
        for_ros2 = [item for item in items if item.get_closest_marker("ros2")]
        if ROS2_PYTHON.exists():
            config.hook.pytest_deselected(items=for_ros2)
            items[:] = [item for item in items if item not in for_ros2]
        for item in for_ros2:
            item.add_marker(pytest.mark.skip(reason="no ROS 2 is sourced, and none is published for this machine"))
    if importlib.util.find_spec("cyclonedds") is None:
        missing = pytest.mark.skip(reason="cyclonedds is not installed: it is not published built for this machine")
        for item in items:
            if "dds" in item.nodeid.lower():
                item.add_marker(missing)


def written_config(
    folder: Path, body: str = "", *, table: str = TABLE, head: str = HEAD, name: str = "config.py"
) -> Path:
    """Write a config: `body` goes into its class, `table` (a whole method) replaces the run table."""
    parts = [head.rstrip(), textwrap.indent(textwrap.dedent(body).strip(), "    "), table.rstrip()]
    path = folder / name
    path.write_text("\n\n".join(part for part in parts if part.strip()) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="session", autouse=True)
def _environment_is_active() -> Iterator[None]:
    """Have the program found by its name, as in a shell in which the environment was activated."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", f"{Path(PROGRAM).parent}{os.pathsep}{os.environ['PATH']}")
        yield


@pytest.fixture(scope="session", autouse=True)
def _disk_is_not_waited_for() -> Iterator[None]:
    """Have `os.fsync` look at the descriptor alone: executions wait a fifth of their time for the disk.

    What is not flushed is lost with the power only, which no test cuts. This is so in this process and its forks;
    programs that are started, and what `ForkedProgram` forks, flush as ever.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: os.fstat(file if isinstance(file, int) else file.fileno()) and None)
        yield


@pytest.fixture(scope="session", autouse=True)
def _claims_of_this_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what experiments claim on this machine apart from those of other processes that execute tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        patch.setenv("ROBOT_RUNNER_LOCKS", "")  # and from those of other users, who may be measuring
        yield


@pytest.fixture(scope="session", autouse=True)
def _git_knows_no_hook() -> Iterator[None]:
    """Leave out what a hook of git that executes the tests hands on: they would commit into its repository."""
    with pytest.MonkeyPatch.context() as patch:
        for name in [each for each in os.environ if each.startswith("GIT_")]:
            patch.delenv(name)
        yield


@pytest.fixture
def write_config(tmp_path: Path) -> Callable[..., Path]:
    """Return what writes a config into the test's own folder, as `written_config` does."""
    return partial(written_config, tmp_path)


@pytest.fixture(scope="session")
def executed_demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which `robot-runner demo` was executed, once for all tests; read it only.

    `answer.txt` in it is what the program said.
    """
    return made_once(tmp_path_factory, "demo", _execute_demo)


def _execute_demo(folder: Path) -> None:
    answer = subprocess.run([PROGRAM, "demo"], cwd=folder, check=True, capture_output=True, text=True, timeout=250)
    assert answer.stderr == ""
    (folder / "answer.txt").write_text(answer.stdout, encoding="utf-8")


@pytest.fixture(scope="session")
def master_uri(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """One master for all tests of ROS 1: a process can join the graph of one only."""
    from tests.ros.ros1_master import ros1_environment, ros1_master

    folder = Path(tmp_path_factory.mktemp("ros1"))
    with ros1_master(folder) as uri:
        before = dict(os.environ)
        os.environ.update(ros1_environment(uri, folder))
        try:
            yield uri
        finally:
            os.environ.clear()
            os.environ.update(before)
