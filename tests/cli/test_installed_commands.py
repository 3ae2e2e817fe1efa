"""Commands come from installed packages, ours like anybody's; a broken one is a finding and hides no other."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from tests.command_line import Answer

from robot_runner.cli.commands import command_module, installed_commands, summary_of
from robot_runner.core import entry_points as entry_points_module
from robot_runner.core.entry_points import EntryPoint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

CORE = [
    *("demo", "new", "check", "plan", "smoke", "run", "status", "queue"),
    *("pause", "continue", "extend", "exclude", "include", "plugins", "try", "doctor", "completion"),
]
LIBRARIES = {
    "analysis": ["pandas", "scipy", "numpy", "matplotlib"],
    "simulator": ["mujoco", "numpy"],
    "replication": ["rocrate", "packaging", "spdx"],
}

WEIGH = '''\
"""Weigh the robot.

It is put on a scale.
"""

def add_arguments(parser):
    parser.add_argument("--grams", action="store_true", help="in grams")

def execute(arguments):
    print("1000 g" if arguments.grams else "1 kg")
    return 0
'''


@pytest.fixture
def announce(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Return what installs a stranger's package of these modules, with these commands."""

    installed: list[str] = []

    def install(modules: dict[str, str], **commands: str) -> None:
        folder = tmp_path / "site"
        about = folder / "stranger-1.0.dist-info"
        about.mkdir(parents=True)
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
        lines = [f"{name} = {module}" for name, module in commands.items()]
        (about / "entry_points.txt").write_text("\n".join(["[robot_runner.commands]", *lines]))
        for name, text in modules.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)
            installed.append(name.partition("/")[0].removesuffix(".py"))
        monkeypatch.setattr(entry_points_module, "_read_before", {})
        monkeypatch.syspath_prepend(folder)

    yield install
    for name in installed:
        sys.modules.pop(name, None)


def test_the_core_s_commands_come_first_and_those_of_a_room_stand_together() -> None:
    names = [name for name, point in installed_commands().items() if point.is_own]
    assert names[: len(CORE)] == CORE
    rooms = [installed_commands()[name].module.split(".")[1] for name in names[len(CORE) :]]
    assert rooms == sorted(rooms)


@pytest.mark.long
def test_examples_in_the_help_of_each_command_fit_a_terminal_of_80_columns() -> None:
    """They are not folded, as their columns and commands would fall apart."""
    texts = {name: command_module(point).__doc__ or "" for name, point in installed_commands().items()}
    examples = [(name, line) for name, text in texts.items() for line in text.splitlines() if line.startswith(" ")]
    assert [each for each in examples if len(each[1]) > 80] == []


def test_a_stranger_s_command_is_listed_and_executed_like_ours(robot_runner: Callable, announce: Callable) -> None:
    announce({"scale/__init__.py": "raise RuntimeError", "scale_command.py": WEIGH}, weigh="scale_command")
    assert list(installed_commands())[-1] == "weigh"
    assert "  weigh            Weigh the robot.\n" in robot_runner("--help").out
    assert "scale_command" not in sys.modules  # its help is read, and not imported
    assert robot_runner("weigh", "--grams").out == "1000 g\n"
    assert "It is put on a scale." in robot_runner("weigh", "--help").out
    assert "Did you mean 'weigh'?" in robot_runner("weihg").err


def test_help_imports_no_package_of_a_command(robot_runner: Callable, announce: Callable) -> None:
    announce(
        {"scales/__init__.py": "raise RuntimeError('imported')", "scales/commands/weigh.py": WEIGH},
        weigh="scales.commands.weigh",
    )
    assert "  weigh            Weigh the robot.\n" in robot_runner("--help").out


@pytest.mark.parametrize(
    ("modules", "problem"),
    [
        ({}, "ModuleNotFoundError"),
        ({"broken_command.py": "raise RuntimeError('no scale')"}, "RuntimeError: no scale"),
        ({"broken_command.py": "def add_arguments(parser):\n    pass\n"}, "the command has no function execute"),
        ({"broken_command.py": "def ("}, "SyntaxError"),
        ({"broken_command.py": "\0"}, "the command cannot be imported"),
        ({"broken_command.py": WEIGH.replace("print(", "1 / 0 or (")}, "the command raised ZeroDivisionError"),
        ({"broken_command.py": WEIGH.replace("--grams", "--debug")}, "the command raised ArgumentError"),
    ],
)
def test_a_broken_command_is_a_finding_and_hides_no_other(
    robot_runner: Callable, announce: Callable, modules: dict[str, str], problem: str
) -> None:
    announce(modules, weigh="broken_command")
    overview = robot_runner("--help")
    assert overview.code == 0
    assert all(f"  {name} " in overview.out for name in (*CORE, "weigh"))
    answer = robot_runner("weigh")
    assert answer.code == 2
    assert problem in answer.err
    assert "command weigh (broken_command, of stranger 1.0)" in answer.err
    assert "fix: Install or repair the package stranger." in answer.err


@pytest.mark.parametrize(
    ("source", "summary"),
    [
        ('"""Weigh the robot."""', "Weigh the robot."),
        ('# a comment\n"""Weigh the robot.\n\nMore."""', "Weigh the robot."),
        ("'Weigh the robot.'", "Weigh the robot."),
        ('"""\n\nWeigh the robot."""', "Weigh the robot."),
        ('"""Weigh\\tthe \\x1b[2J robot."""', r"'Weigh\tthe \x1b[2J robot.'"),
        ("import os", ""),
        ("", ""),
    ],
)
def test_a_summary_is_the_first_line_of_the_docstring_however_it_is_spelt(
    announce: Callable, source: str, summary: str
) -> None:
    announce({"odd_command.py": source}, odd="odd_command")
    assert summary_of(installed_commands()["odd"]) == summary


def test_a_command_whose_file_is_gone_says_so() -> None:
    point = EntryPoint("weigh", "robot_runner.commands", "gone", lambda: ("stranger", "1.0"))
    assert summary_of(point).endswith("install or repair the package stranger")


def _without(libraries: list[str], *calls: list[str]) -> list[Answer]:
    """Call the program, once for each list of words, in a Python that has none of these libraries."""
    program = (
        "import sys\n"
        f"class Missing:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name.partition('.')[0] in {libraries!r}:\n"
        "            raise ModuleNotFoundError(f'No module named {name!r}', name=name)\n"
        "sys.meta_path.insert(0, Missing())\n"
        "import importlib.util\n"
        "find = importlib.util.find_spec\n"
        f"importlib.util.find_spec = lambda name, *rest: None if name in {libraries!r} else find(name, *rest)\n"
        "from robot_runner.cli.main import main\n"
        f"for words in {list(calls)!r}:\n"
        "    code = main(words)\n"
        "    print(chr(0), end=str(code), flush=True)\n"
        "    print(chr(0), end='', flush=True, file=sys.stderr)\n"
    )
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=100, check=False)
    assert told.returncode == 0, told.stderr
    # Behind each NUL is the exit code of the call before it.
    outs = told.stdout.split("\0")
    codes, texts = [int(each[0]) for each in outs[1:]], [outs[0], *(each[1:] for each in outs[1:])]
    return [Answer(*each) for each in zip(codes, texts, told.stderr.split("\0"), strict=False)]


@pytest.mark.long
@pytest.mark.parametrize(
    ("libraries", "words", "extra"),
    [
        (LIBRARIES["analysis"], ["report", "results"], "analysis"),
        (LIBRARIES["analysis"], ["compare", "a", "b"], "analysis"),
        (LIBRARIES["analysis"], ["export", "results"], "analysis"),
        (LIBRARIES["analysis"], ["import", "results"], "analysis"),
        (LIBRARIES["simulator"], ["simulate", "turtlebot3", "--link", "dds"], "sim"),
        (LIBRARIES["simulator"], ["demo", "--folder", "demo"], "sim"),
    ],
)
def test_without_its_extra_a_command_has_help_and_names_the_extra(
    libraries: list[str], words: list[str], extra: str
) -> None:
    helped, executed = _without(libraries, [words[0], "--help"], words)
    assert (helped.code, helped.err) == (0, "")
    assert f"usage: robot-runner {words[0]}" in helped.out
    assert executed.code == 2, executed.err
    assert f"pip install 'robot-runner[{extra}]'" in executed.err


@pytest.mark.long
def test_without_any_extra_every_command_has_help() -> None:
    commands = ["pack", "verify", "replicate", "explain", "fit-power-model", "convert"]
    missing = sorted({name for names in LIBRARIES.values() for name in names})
    answers = _without(missing, *([command, "--help"] for command in commands))
    assert [(each.code, each.err) for each in answers] == [(0, "")] * len(commands)
    for command, answer in zip(commands, answers, strict=True):
        assert f"usage: robot-runner {command}" in answer.out
