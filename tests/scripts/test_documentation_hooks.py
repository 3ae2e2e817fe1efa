"""Tables of the documentation look the same on GitHub and on the built pages, which say of which version they are."""

from __future__ import annotations

import doctest
import runpy
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

from mkdocs.config.defaults import MkDocsConfig

if TYPE_CHECKING:
    import pytest

ROOT = Path(__file__).parents[2]
HOOKS = runpy.run_path(str(ROOT / "scripts" / "documentation_hooks.py"))
on_config, on_page_content, on_page_markdown = (
    HOOKS[name] for name in ("on_config", "on_page_content", "on_page_markdown")
)


def test_each_page_says_of_which_version_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    monkeypatch.delenv("READTHEDOCS_VERSION", raising=False)
    monkeypatch.delenv("READTHEDOCS_CANONICAL_URL", raising=False)
    here = on_config(MkDocsConfig())
    assert (here.copyright, here.site_url) == (f"Robot Runner {version}", None)
    monkeypatch.setenv("READTHEDOCS_VERSION", "stable")
    monkeypatch.setenv("READTHEDOCS_CANONICAL_URL", "https://docs.example/stable/")
    there = on_config(MkDocsConfig())
    assert (there.copyright, there.site_url) == (f"Robot Runner {version} (stable)", "https://docs.example/stable/")


def test_the_example_of_a_table_with_types_works() -> None:
    (example,) = (each for each in doctest.DocTestFinder().find(on_page_markdown, globs=dict(HOOKS)) if each.examples)
    assert doctest.DocTestRunner().run(example).failed == 0


def test_a_table_that_is_shown_as_code_is_left_alone() -> None:
    shown = "```text\n| `a \\| b` |\n```\n\n| `c \\| d` | e |\n"
    assert on_page_markdown(shown) == "```text\n| `a \\| b` |\n```\n\n| `c | d` | e |\n"


def test_only_long_names_in_tables_may_be_broken() -> None:
    assert on_page_content("<td><code>short_name</code></td>") == "<td><code>short_name</code></td>"
    assert on_page_content("<td><code>required_ros_version</code></td>").count("<wbr>") == 2
    assert "<wbr>" not in on_page_content("<p><code>required_ros_version</code></p>")
