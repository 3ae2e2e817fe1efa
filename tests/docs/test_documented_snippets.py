"""Every Python block of the documentation is executed; the blocks of one page share their names, as for a reader.

A block that cannot be executed here says why, in a comment above it: `<!-- skip: next "needs a robot" -->`.
"""

from __future__ import annotations

import re
from pathlib import Path
from unittest import SkipTest

import pytest
from sybil import Sybil
from sybil.parsers.markdown import PythonCodeBlockParser, SkipParser

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md")])
MOST_SKIPPED = 5
#: Guides whose blocks execute experiments, analyse them or draw, each a quarter of a second or more.
LONG = {
    *("adaptive", "analysis", "choose-runs", "declare-a-design", "exclude", "from-python", "live-page"),
    *("meta-analysis", "operator", "pause", "plan-the-analysis", "recompute", "samples", "statistics", "treatments"),
    *("until-precise", "why-did-my-run-fail"),
}
#: A visible import from a module that is below the promised ones.
_DOORS = r"plugins(?:\.(?:profilers|systems))?|testing|analysis|designs|adaptive"
_BELOW = re.compile(rf"^ *(?:from|import) robot_runner\.(?!(?:{_DOORS}) )\S+", re.MULTILINE)
_HIDDEN = re.compile(r"<!-- invisible-code-block.*?-->", re.DOTALL)
_SKIP = re.compile(r"<!--+\s*skip:\s*(\w+)(.*?)--+>")


def _name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.parametrize(
    "page", [pytest.param(page, id=_name(page), marks=[pytest.mark.long] * (page.stem in LONG)) for page in PAGES]
)
def test_the_python_blocks_of_a_page_work(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # whatever a snippet writes is written here
    monkeypatch.setenv("HOME", str(tmp_path))
    sybil = Sybil([PythonCodeBlockParser(), SkipParser()], pattern="*.md", path=str(ROOT))
    for example in sybil.parse(page).examples():
        try:
            example.evaluate()
        except SkipTest:
            continue


def test_blocks_that_are_not_executed_are_few_and_say_why() -> None:
    skipped = [(_name(page), *match) for page in PAGES for match in _SKIP.findall(page.read_text(encoding="utf-8"))]
    unexplained = [skip for skip in skipped if skip[1] != "next" or not re.fullmatch(r'\s*"[^"]{5,}"\s*', skip[2])]
    assert not unexplained, 'write <!-- skip: next "why" --> above one block'
    assert len(skipped) <= MOST_SKIPPED, skipped


def test_a_page_that_imports_what_is_not_promised_says_so() -> None:
    texts = {_name(page): page.read_text(encoding="utf-8") for page in PAGES if "decisions" not in page.parts}
    importing = {name for name, text in texts.items() if _BELOW.search(_HIDDEN.sub("", text))}
    assert importing <= {name for name, text in texts.items() if "not among the promised modules" in text}


def test_the_pages_are_found() -> None:
    assert {"README.md", "CONTRIBUTING.md", "docs/index.md", "docs/glossary.md"} <= set(map(_name, PAGES))
    assert {page.stem for page in PAGES} >= LONG
