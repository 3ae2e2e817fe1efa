"""Compose projects under test. Docker's daemon needs rights that tests have not: a stand-in answers as `docker` does.

What it keeps of a container is a file, so that it is seen which are left; a container outlives its client.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from functools import partial
from typing import TYPE_CHECKING

import pytest
from tests.command_line import PROGRAM
from tests.conftest import HEAD, written_config
from tests.core.execution.conftest import Executed, execute_in

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import PluginError
from robot_runner.plugins.systems import ComposeProject

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

STAND_IN = """\
#!/bin/sh
state=STATE
echo "$*" >>"$state/calls"
if [ "$1" = version ]; then
    [ -e "$state/daemon" ] && exit 0
    echo "Cannot connect to the Docker daemon at unix:///var/run/docker.sock." >&2; exit 1
fi
[ "$1 $2 $4" = "compose --project-name --file" ] || { echo "docker: unknown command: docker $1" >&2; exit 1; }
project=$3 file=$5
shift 5
[ -e "$file" ] || { echo "open $file: no such file or directory" >&2; exit 14; }
case "$1" in
    config) exit 0;;
    up)
        echo "$ALGORITHM" >"$state/$project-planner"
        echo "planner-1  | plans with $ALGORITHM"
        trap 'echo "Gracefully stopping..."; exit 130' INT
        while [ ! -e "$state/crash" ]; do sleep 0.1; done
        echo "planner-1 exited with code 7"; exit 7;;
    down) sleep 0.2; rm "$state/$project-planner";;
esac
"""


@pytest.fixture
def docker(tmp_path: Path) -> Path:
    """Return the folder of a `docker` on PATH; its state is in `state`."""
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "state").mkdir()
    (folder / "state/daemon").touch()
    (folder / "docker").write_text(STAND_IN.replace("STATE", str(folder / "state")))
    (folder / "docker").chmod(0o755)
    (tmp_path / "compose.yaml").write_text("services: {planner: {image: 'nav:${ALGORITHM}'}}\n")
    return folder


OURS = HEAD.replace("import *\n", "import *\nfrom robot_runner.plugins.systems import ComposeProject\n", 1)
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Algorithm", ["dwa", "teb"])], seed=1, shuffle=False)
"""


def body_of(docker: Path, mission: str = "", **parameters: str) -> str:
    path = f"{docker}:{os.environ['PATH']}"
    more = "".join(f", {name}={value}" for name, value in parameters.items())
    return (
        f"plugins = [ComposeProject({str(docker.parent / 'compose.yaml')!r}, name='Nav', ready='plans with', "
        f"environment={{'PATH': {path!r}, 'ALGORITHM': treatment('Algorithm')}}{more})]\n{mission}"
    )


@pytest.fixture
def execute(tmp_path: Path) -> Callable[..., Executed]:
    return partial(execute_in, tmp_path, head=OURS, table=TABLE)


def containers(docker: Path) -> list[str]:
    return [path.name for path in (docker / "state").glob("*-*")]


@pytest.mark.long
def test_a_project_comes_up_with_the_treatments_and_is_taken_down(
    execute: Callable[..., Executed], docker: Path
) -> None:
    done = execute(body_of(docker))
    assert (done.finished.failures, done.finished.done_count, containers(docker)) == ((), 2, [])
    output = (done.folder / "runs/r_2/Nav/stdout.txt").read_text()
    assert output == "planner-1  | plans with teb\nGracefully stopping...\n"
    calls = [line.split("compose.yaml ")[-1] for line in (docker / "state/calls").read_text().splitlines()]
    up = "up --force-recreate --remove-orphans --abort-on-container-exit"
    assert [call for call in calls if call.startswith(("up", "down"))] == [up, "down --remove-orphans"] * 2


@pytest.mark.long
def test_a_container_that_ends_fails_the_run_and_the_rest_is_taken_down(
    execute: Callable[..., Executed], docker: Path
) -> None:
    crash = str(docker / "state/crash")
    mission = f"def launch_mission(self, context):\n    Path({crash!r}).touch()\n    context.clock.sleep(60)"
    done = execute(body_of(docker, mission))
    assert (
        "Nav has died: exit code 7; it wrote last: planner-1  | plans with dwa | planner-1 exited"
        in done.finished.failures[0]
    )
    assert containers(docker) == []


@pytest.mark.long
def test_nothing_is_left_when_the_orchestrator_is_killed(tmp_path: Path, docker: Path) -> None:
    mission = "def launch_mission(self, context):\n    context.clock.sleep(60)"
    config = written_config(tmp_path, body_of(docker, mission), head=OURS, table=TABLE)
    orchestrator = subprocess.Popen([PROGRAM, "run", config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not containers(docker):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    os.kill(orchestrator.pid, signal.SIGKILL)
    orchestrator.wait()
    while containers(docker):
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.long
def test_the_containers_of_a_run_that_was_killed_are_gone_before_the_next_begins(
    execute: Callable[..., Executed], docker: Path
) -> None:
    mission = """
def launch_mission(self, context):
    import os, signal
    if context.combination["Algorithm"] == "dwa":
        os.kill(os.getpid(), signal.SIGKILL)
"""
    done = execute(body_of(docker, mission))
    assert [row["status"] for row in done.table] == ["Failed", "Done"]
    calls = [line.split("compose.yaml ")[-1].split()[0] for line in (docker / "state/calls").read_text().splitlines()]
    assert [call for call in calls if call in {"up", "down"}] == ["up", "down"] * 2
    assert containers(docker) == []


def test_what_docker_would_refuse_is_found_before_anything_moves(tmp_path: Path, docker: Path) -> None:
    def problems() -> list[str]:
        config = written_config(tmp_path, body_of(docker), head=OURS, table=TABLE)
        return [finding.problem for finding in prepare(config).findings]

    (tmp_path / "compose.yaml").rename(tmp_path / "other.yaml")
    (docker / "state/daemon").unlink()
    refused, silent = problems()
    assert refused.startswith(
        f"docker compose refuses {tmp_path / 'compose.yaml'}: open {tmp_path / 'compose.yaml'}: no such"
    )
    assert silent.startswith("the daemon of Docker does not answer: Cannot connect to the Docker daemon")


@pytest.mark.parametrize("wrong", [{"project": "Nav!"}, {"services": "planner"}, {"name": "x" * 70}])
def test_a_parameter_that_cannot_be_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(PluginError):
        ComposeProject("compose.yaml", **wrong)
