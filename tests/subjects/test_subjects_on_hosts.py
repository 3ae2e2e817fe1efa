"""Subjects on another computer: a real sshd on loopback."""

from __future__ import annotations

import os
import threading
import time
from functools import partial
from typing import TYPE_CHECKING

import pytest
from tests.conftest import HEAD, written_config
from tests.core.execution.conftest import Executed, execute_in
from tests.subjects.conftest import alive, gone
from tests.waiting import wait_until

from robot_runner.core.config.preparation import prepare

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.core.links.ssh_server import SshServer

OURS = HEAD.replace("import *\n", "import *\nfrom robot_runner.plugins.systems import Program\n", 1)
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Algorithm", ["dwa", "teb"])], seed=1, shuffle=False)
"""
ONE_RUN = TABLE.replace(', "teb"', "")


@pytest.fixture
def execute(tmp_path: Path) -> Callable[..., Executed]:
    return partial(execute_in, tmp_path, head=OURS, table=TABLE)


@pytest.mark.long
def test_the_treatments_reach_a_program_over_there_and_its_output_comes_here(
    execute: Callable[..., Executed], server: SshServer, tmp_path: Path, rude_tree: Callable[..., list[str]], token: str
) -> None:
    (tmp_path / "over there").mkdir()
    command = rude_tree("pwd >&2; printf '%s' \"$WHO\"; printf '\\377\\n'; exec sleep 100", is_rude=False)
    body = f"""
    plugins = [
        Program(
            [*{command!r}, treatment("Algorithm")],
            name="Nav",
            host="robot",
            ssh_config={str(server.config)!r},
            ready="it's me",
            folder={str(tmp_path / "over there")!r}, environment={{"WHO": "it's me"}},
        )
    ]
    """
    done = execute(body)
    assert (done.finished.failures, done.finished.done_count) == ((), 2)
    for run_id, algorithm in (("r_1", "dwa"), ("r_2", "teb")):
        folder = done.folder / "runs" / run_id / "Nav"
        assert (folder / "stdout.txt").read_bytes() == f"started with {token} {algorithm}\nit's me".encode() + b"\xff\n"
        assert (folder / "stderr.txt").read_text() == f"{tmp_path / 'over there'}\n"
    assert done.journal("subject")[0]["host"] == "robot"
    assert gone(token)


def test_a_death_over_there_fails_the_run_at_once(execute: Callable[..., Executed], server: SshServer) -> None:
    body = f"""
    plugins = [
        Program(
            ["sh", "-c", "sleep 0.5; echo bad wheel >&2; kill -ABRT $$"],
            host="robot",
            ssh_config={str(server.config)!r},
        )
    ]

    def launch_mission(self, context):
        context.clock.sleep(60)
    """
    started = time.monotonic()
    done = execute(body, table=ONE_RUN)
    assert time.monotonic() - started < 40
    assert "Program has died: SIGABRT ended it; it wrote last: bad wheel" in done.finished.failures[0]


@pytest.mark.long
def test_a_connection_that_is_cut_fails_the_run_and_leaves_nobody_over_there(
    execute: Callable[..., Executed], server: SshServer, rude_tree: Callable[..., list[str]], token: str
) -> None:
    def cut() -> None:
        wait_until(lambda: len(alive(token)) >= 3)
        time.sleep(0.5)
        server.cut()

    command = rude_tree(is_rude=False)
    body = f"""
    plugins = [Program({command!r}, host="robot", ssh_config={str(server.config)!r}, ready="started", grace_s=0.5)]

    def launch_mission(self, context):
        context.clock.sleep(60)
    """
    cutter = threading.Thread(target=cut)
    cutter.start()
    done = execute(body, table=ONE_RUN)
    cutter.join()
    assert "Program has died: the connection is lost" in done.finished.failures[0]
    assert gone(token)


@pytest.fixture
def shouting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Have ssh reach this machine by a login shell that writes, and return the home that it has there."""
    ssh, home = tmp_path / "bin" / "ssh", tmp_path / "the home"
    ssh.parent.mkdir()
    home.mkdir()
    greeting = "printf 'Welcome to robot 0\\n\\033]0;robot\\007'"
    ssh.write_text(f'#!/bin/sh\ncd\n{greeting}\nfor last; do :; done\nexec sh -c "$last"\n')
    ssh.chmod(0o755)
    monkeypatch.setenv("PATH", str(ssh.parent), prepend=os.pathsep)
    monkeypatch.setenv("HOME", str(home))
    return home


@pytest.mark.long
def test_what_a_login_shell_writes_is_no_answer_and_paths_may_begin_at_home(
    execute: Callable[..., Executed], shouting: Path
) -> None:
    (shouting / "signal.py").write_text("raise SystemExit('the author had a look at a signal here')")
    (shouting / "ws").mkdir()
    (shouting / "ws" / "setup.sh").write_text("PLANNER=teb$#\nexport PLANNER\n")
    body = """
    plugins = [
        Program(
            ["sh", "-c", "pwd; echo $PLANNER $0; exec sleep 100", "a"],
            host="pi@robot", folder="~/ws", setup="~/ws/setup.sh", ready="teb",
        )
    ]
    """
    done = execute(body, table=ONE_RUN)
    assert (done.finished.failures, done.finished.done_count) == ((), 1)
    assert (done.folder / "runs/r_1/Program/stdout.txt").read_text() == f"{shouting / 'ws'}\nteb0 a\n"


@pytest.mark.long
def test_what_is_not_over_there_is_found_before_anything_moves(tmp_path: Path, server: SshServer) -> None:
    def problems(parameters: str) -> list[str]:
        body = f"plugins = [Program({parameters}, host='robot', ssh_config={str(server.config)!r})]"
        return [
            finding.problem for finding in prepare(written_config(tmp_path, body, head=OURS, table=ONE_RUN)).findings
        ]

    assert problems("['no-such-planner']") == ["the program 'no-such-planner' is not there on robot"]
    assert problems("['sh', '-c', 'true'], environment={'PATH': '/nowhere'}") == [
        "the program 'sh' is not there on robot"
    ]
    assert problems("['true'], folder='/no/where'") == ["robot: there is no folder '/no/where'"]
    assert problems("['true'], folder='/', setup='opt.sh'") == ["robot: there is no file 'opt.sh' to source"]
