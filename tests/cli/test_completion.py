"""What TAB offers, asked in real shells; and that it costs no more than the help."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pexpect
import pytest
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

BIN = str(Path(sys.executable).parent)
#: How each shell is begun without anybody's own settings, and what it has to be told first.
SHELLS = {
    "bash": (["--norc", "--noprofile", "-i"], "PS1='$ '; bind 'set enable-bracketed-paste off'"),
    "zsh": (["-f", "-i"], "PS1='$ '; autoload -Uz compinit; compinit -u -D; unset zle_bracketed_paste"),
}


@pytest.fixture(params=SHELLS)
def shell(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[pexpect.spawn]:
    """Return an interactive shell in the test's own folder, in which robot-runner is completed."""
    name = request.param
    if shutil.which(name) is None:
        pytest.skip(f"{name} is not installed")
    (tmp_path / "study.py").touch()
    arguments, first = SHELLS[name]
    path = f"{BIN}:{os.environ['PATH']}"
    settings = {"PATH": path, "HOME": str(tmp_path), "TERM": "dumb", "LANG": "C.UTF-8"}
    settings |= {each: os.environ[each] for each in ("FPATH", "MODULE_PATH") if each in os.environ}
    child = pexpect.spawn(
        shutil.which(name), arguments, env=settings, cwd=tmp_path, timeout=PATIENCE, dimensions=(50, 200)
    )
    child.sendline(f'{first}; eval "$(robot-runner completion {name})"; echo is rea""dy')
    child.expect("is ready")
    yield child
    child.close(force=True)


def completed(shell: pexpect.spawn, typed: str, whole: str) -> None:
    """Type a part of a line and TAB, and see that it became the whole line."""
    shell.sendline("echo next")
    shell.expect("next\r\n")
    shell.send(f"{typed}\t")
    shell.expect_exact(typed)  # which may hold what is added: `queue ad` holds a d
    shell.expect_exact(whole.removeprefix(typed))
    shell.sendcontrol("u")


@pytest.mark.long
def test_commands_options_plugins_and_configs_are_completed(shell: pexpect.spawn) -> None:
    completed(shell, "robot-runner extend stu", "robot-runner extend study.py")
    completed(shell, "robot-runner smo", "robot-runner smoke")
    completed(shell, "robot-runner check study.py --pro", "robot-runner check study.py --probe")
    completed(shell, "robot-runner try BasicT", "robot-runner try BasicTurtlebot3")
    completed(shell, "robot-runner queue ad", "robot-runner queue add")
    completed(shell, "robot-runner stu", "robot-runner study.py")
    completed(shell, "robot-runner study.py --work", "robot-runner study.py --workers")
    completed(shell, "robot-runner run --set robot=sim", "robot-runner run --set robot=simulated")


@pytest.mark.long
@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed")
def test_fish_completes_it_by_the_line_that_the_command_names(tmp_path: Path) -> None:
    (tmp_path / "study.py").touch()
    settings = {"PATH": f"{BIN}:{os.environ['PATH']}", "HOME": str(tmp_path), "TERM": "dumb", "LANG": "C.UTF-8"}
    for typed, whole in {"robot-runner smo": "smoke", "robot-runner check study.py --pro": "--probe"}.items():
        line = f'robot-runner completion fish | source; complete -C "{typed}"'
        answer = subprocess.run(
            [shutil.which("fish"), "-c", line], env=settings, cwd=tmp_path, capture_output=True, text=True, check=True
        )
        assert answer.stdout.split()[0] == whole, answer.stderr


def offered(line: str, tmp_path: Path) -> list[str]:
    """Return what is offered for a line, as the function of the shell asks for it."""
    target = tmp_path / "offered"
    settings = {
        **os.environ,
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(target),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    subprocess.run([f"{BIN}/robot-runner"], env=settings, cwd=tmp_path, check=True, capture_output=True)
    return [each.strip() for each in target.read_text().split("\013")]


@pytest.mark.long
def test_all_commands_are_offered_and_a_tab_costs_hardly_more_than_the_help(tmp_path: Path) -> None:
    assert {"demo", "doctor", "replicate", "--help"} <= set(offered("robot-runner ", tmp_path))

    def seconds(action: Callable[[], object]) -> float:
        """Return the processor time of what it starts: unlike the time, hardly more on a busy machine."""
        begun = sum(os.times()[2:4])
        action()
        return sum(os.times()[2:4]) - begun

    tabs, helps = [], []
    for _ in range(3):  # by turns, so that the machine is as busy with both
        tabs.append(seconds(lambda: offered("robot-runner ch", tmp_path)))
        helps.append(
            seconds(lambda: subprocess.run([f"{BIN}/robot-runner", "check", "--help"], check=True, capture_output=True))
        )
    assert min(tabs) < 2 * min(helps)


def test_without_the_library_the_command_names_the_extra(
    robot_runner: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "argcomplete", None)
    answer = robot_runner("completion", "bash")
    assert answer.code == 2
    assert "pip install 'robot-runner[completion]'" in answer.err
