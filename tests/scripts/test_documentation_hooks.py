"""Tables of the documentation look the same on GitHub and on the built site."""

from __future__ import annotations

import doctest

from scripts.documentation_hooks import on_page_content, on_page_markdown

from scripts import documentation_hooks


def test_the_example_of_a_table_with_types_works() -> None:
    assert doctest.testmod(documentation_hooks).failed == 0


def test_a_table_that_is_shown_as_code_is_left_alone() -> None:
    shown = "```text\n| `a \\| b` |\n```\n\n| `c \\| d` | e |\n"
    assert on_page_markdown(shown) == "```text\n| `a \\| b` |\n```\n\n| `c | d` | e |\n"


def test_only_long_names_in_tables_may_be_broken() -> None:
    assert on_page_content("<td><code>short_name</code></td>") == "<td><code>short_name</code></td>"
    assert on_page_content("<td><code>required_ros_version</code></td>").count("<wbr>") == 2
    assert "<wbr>" not in on_page_content("<p><code>required_ros_version</code></p>")
