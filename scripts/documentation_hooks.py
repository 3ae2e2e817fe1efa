"""What mkdocs does beside its plugins: tables that GitHub and our own pages both show well, and the version."""

from __future__ import annotations

import logging
import os
import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig

__all__ = ["on_config", "on_page_content", "on_page_markdown"]

_PROJECT = Path(__file__).parents[1] / "pyproject.toml"

_FENCE = re.compile(r"^(```|~~~).*?^\1[^\S\n]*$", re.MULTILINE | re.DOTALL)
_ROW = re.compile(r"^\|.*\|[^\S\n]*$", re.MULTILINE)
_CODE = re.compile(r"`[^`\n]+`")
_CELL_CODE = re.compile(r"(?<=<code>)[^<]+(?=</code>)")
_CELL = re.compile(r"<t[dh]\b.*?</t[dh]>", re.DOTALL)
#: Where a long name may go on in the next line: behind these, before a letter or digit.
_BREAK = re.compile(r"(?<=[_./,:=(|\[-])(?=\w)")
#: Shorter code is not broken: characters.
_UNBROKEN = 16
#: Says which of several pages it leads to where a type is named in a signature.
_LINKS = logging.getLogger("mkdocs.plugins.mkdocs_autorefs._internal.plugin")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Have each page say of which version it is, and where it is at home, and links be warned of that are at fault.

    Read the Docs builds each released version and tells in the environment which one this is and at which address.
    """
    version = tomllib.loads(_PROJECT.read_text(encoding="utf-8"))["project"]["version"]
    published = os.environ.get("READTHEDOCS_VERSION")
    config.copyright = f"Robot Runner {version}" + (f" ({published})" if published else "")
    config.site_url = os.environ.get("READTHEDOCS_CANONICAL_URL") or config.site_url
    _LINKS.addFilter(_is_a_fault)
    return config


def _is_a_fault(record: logging.LogRecord) -> bool:
    """Whether a link is at fault: one to a class that two of the doors offer may lead to the page of either."""
    return "Could not find closest secondary URL" not in record.getMessage()


def on_page_markdown(markdown: str, **kwargs: Any) -> str:
    r"""Return the page with `str | None` in tables: GitHub needs `\|` there, and Python-Markdown would show it.

    Example:
        >>> print(on_page_markdown(r"| `str \| None` | a \| b |"))
        | `str | None` | a \| b |
    """
    del kwargs
    fences = [match.span() for match in _FENCE.finditer(markdown)]

    def row(match: re.Match[str]) -> str:
        if any(start <= match.start() < end for start, end in fences):
            return match[0]
        return _CODE.sub(lambda code: code[0].replace("\\|", "|"), match[0])

    return _ROW.sub(row, markdown)


def on_page_content(html: str, **kwargs: Any) -> str:
    """Return the page with places in the tables' long names at which a line may end, so that no table is cut."""
    del kwargs
    return _CELL.sub(lambda cell: _CELL_CODE.sub(_breakable, cell[0]), html)


def _breakable(code: re.Match[str]) -> str:
    return _BREAK.sub("<wbr>", code[0]) if len(code[0]) > _UNBROKEN else code[0]
