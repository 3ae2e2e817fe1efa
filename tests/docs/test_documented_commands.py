"""Commands that the documentation tells people to type are commands that are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from robot_runner.cli.commands import command_module, installed_commands
from robot_runner.cli.parser import parser_of

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md")])
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())


@each_page
def test_make_targets_that_a_page_names_exist(page: Path) -> None:
    assert _named_targets(page.read_text(encoding="utf-8")) <= TARGETS


@each_page
def test_commands_and_options_that_a_page_names_exist(page: Path) -> None:
    typed = _typed(page.read_text(encoding="utf-8"), "robot-runner")
    assert [words for words in typed if not _is_understood(words.split())] == []


def _is_understood(words: list[str]) -> bool:
    command = words[0] if words[0] in installed_commands() else "run"
    if command != words[0] and not re.search(r"\.py$|^--(help|version)$|^[A-Z]+$|^<.*>$", words[0]):
        return False
    module = command_module(installed_commands()[command])
    actions = module.action_parsers() if hasattr(module, "action_parsers") else {}
    named = re.findall(r"[\w-]+", words[1]) if actions and len(words) > 1 and words[1][0] != "[" else []
    if not set(named) <= set(actions):
        return False
    parser = actions[named[0]] if named else parser_of(command, module)
    known = {option for action in parser.documented for option in action.option_strings}
    options = [word.strip("[],").partition("=")[0] for word in words]  # in the page of commands they stand in brackets
    return {option for option in options if option.startswith("--")} <= {*known, "--version"}


def test_a_command_that_is_not_there_is_noticed() -> None:
    typed = _typed("`robot-runner chek x.py`\n```console\n$ robot-runner plan x.py --jason\n```\n", "robot-runner")
    assert typed == ["chek x.py", "plan x.py --jason"]
    assert [_is_understood(words.split()) for words in [*typed, "x.py --set a=b", "status x --json"]] == [0, 0, 1, 1]


def _typed(text: str, program: str) -> list[str]:
    """What is typed after the program's name in code: between back-quotes, or on a line of a fenced block."""
    blocks = "".join(re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
    rest = re.sub(r"^```\w*\n.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    lines = re.findall(rf"^(?:\$ *)?{program} ([^#\n]+)", blocks, re.MULTILINE)
    return [words.strip() for words in [*re.findall(rf"`{program} ([^`]+)`", rest), *lines]]


def _named_targets(text: str) -> set[str]:
    return {words.split()[0] for words in _typed(text, "make")}


def test_named_targets_are_found() -> None:
    text = "make way, `make one`\n```console\n$ make two\nmake three A=1\n```\nmake four\n"
    assert _named_targets(text) == {"one", "two", "three"}


def test_every_target_is_described_by_help() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert set(re.findall(r"^([a-z-]+):.*## .+\.$", makefile, re.MULTILINE)) == TARGETS
