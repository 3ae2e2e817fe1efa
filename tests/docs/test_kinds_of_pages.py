"""Each page of the documentation is of one kind, and a guide is short enough to be read while one does what it says."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
KINDS = ("Tutorials", "How-to guides", "Reference", "Explanation", "Decisions")
#: Three screens at 1280 px: lines of the source, without what is not shown.
MOST_LINES = 150
LEAST_GUIDES = 25
#: Looked up rather than read: what of an earlier tool is what here, and what each package holds.
LONGER = {"architecture.md", "migration.md"}


def _nav() -> list[dict[str, Any]]:
    parts: list[dict[str, Any]] = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    return parts


def _pages(part: object) -> Iterator[str]:
    if isinstance(part, str):
        yield part
    elif isinstance(part, dict):
        for value in part.values():
            yield from _pages(value)
    elif isinstance(part, list):
        for value in part:
            yield from _pages(value)


def _of_kind(kind: str) -> list[str]:
    return [page for part in _nav() if kind in part for page in _pages(part)]


GUIDES = _of_kind("How-to guides")
READ = [*GUIDES, *_of_kind("Tutorials"), *_of_kind("Explanation")]


def test_there_are_four_kinds_and_the_decisions() -> None:
    assert [name for part in _nav() for name in part if name in KINDS] == list(KINDS)
    assert len(list(_pages(_nav()))) == len(set(_pages(_nav()))), "no page is of two kinds"


def test_each_page_is_in_the_navigation() -> None:
    assert {page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md")} == set(_pages(_nav()))


@pytest.mark.parametrize("page", [page for page in READ if page not in LONGER])
def test_a_page_that_is_read_has_at_most_three_screens(page: str) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    shown = re.sub(r"<!--.*?-->\n", "", text, flags=re.DOTALL)
    assert len(shown.splitlines()) <= MOST_LINES


def _guides_with(block: str) -> list[str]:
    return [page for page in GUIDES if re.search(rf"^```{block}$", (DOCS / page).read_text("utf-8"), re.MULTILINE)]


def test_enough_guides_are_executed_and_each_shows_what_is_typed() -> None:
    assert len(_guides_with("python")) >= LEAST_GUIDES
    assert set(GUIDES) - set(_guides_with("(python|py|console|sh|text)")) == set()


@pytest.mark.parametrize(
    ("need", "page"),
    [
        ("Get notified", "notifications.md"),
        ("Warm up", "warm-up.md"),
        ("Use Docker", "docker.md"),
        ("Add repetitions", "extend.md"),
        ("Why did my run fail", "why-did-my-run-fail.md"),
    ],
)
def test_what_newcomers_looked_for_in_vain_stands_in_the_list_of_guides(need: str, page: str) -> None:
    titles = dict(re.findall(r"^ +- ([^:\n]+): (\S+\.md)$", (ROOT / "mkdocs.yml").read_text("utf-8"), re.MULTILINE))
    assert [title for title, leads_to in titles.items() if leads_to == page and title.startswith(need)]
