"""Every relative link of a Markdown page leads to a file that is there, and every anchor to a heading."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md")])
_FENCE = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
_INLINE_CODE = re.compile(r"`[^`\n]*`")
_LINK = re.compile(r"!?\[[^\]]*\]\(\s*<?([^)>\s]+)>?[^)]*\)|<(?:img|a)\b[^>]*?(?:src|href)=\"([^\"]+)\"")
_HEADING = re.compile(r"^#{1,6}\s+(.*?)\s*#*\s*$", re.MULTILINE)
_ELSEWHERE = re.compile(r"[a-z][a-z0-9+.-]*:|//", re.IGNORECASE)


def _name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def _links(page: Path) -> list[str]:
    text = _INLINE_CODE.sub("", _FENCE.sub("", page.read_text(encoding="utf-8")))
    return [first or second for first, second in _LINK.findall(text)]


@cache
def _anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and as Python-Markdown spell them."""
    headings = _HEADING.findall(_FENCE.sub("", page.read_text(encoding="utf-8")))
    plain = [re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings]
    words = [re.sub(r"[^\w\s-]", "", heading).strip() for heading in plain]
    return {word.replace(" ", "-") for word in words} | {re.sub(r"[-\s]+", "-", word) for word in words}


def _fault(page: Path, link: str) -> str | None:
    path, _, anchor = unquote(link).partition("#")
    target = (page.parent / path).resolve() if path else page
    if not target.exists():
        return f"{link}: there is no {path}"
    if anchor and target.suffix == ".md" and anchor not in _anchors(target):
        return f"{link}: {target.name} has no such heading"
    return None


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    relative = [link for link in _links(page) if not _ELSEWHERE.match(link)]
    assert [fault for link in relative if (fault := _fault(page, link))] == []


def test_a_broken_link_is_noticed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Here\n[a](nowhere.md) [b](#there) [c](#here) `[d](code.md)`\n", encoding="utf-8")
    assert _links(page) == ["nowhere.md", "#there", "#here"]
    assert [bool(_fault(page, link)) for link in _links(page)] == [True, True, False]


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent == ROOT / "docs"], ids=_name)
def test_pages_of_the_docs_link_only_to_pages_of_the_docs(page: Path) -> None:
    """The site is built from docs/ alone, so that a link out of it would be dead there."""
    relative = [link.partition("#")[0] for link in _links(page) if not _ELSEWHERE.match(link)]
    docs = ROOT / "docs"
    assert [link for link in relative if link and not (page.parent / link).resolve().is_relative_to(docs)] == []
