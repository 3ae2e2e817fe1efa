"""Tables as CSV and LaTeX, and names that mean nothing to LaTeX, Markdown or a shell of either."""

from __future__ import annotations

import csv
import io
import re
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.report.blocks import Place

if TYPE_CHECKING:
    from robot_runner.analysis.report.blocks import Table

__all__ = ["csv_of", "latex_of", "latex_text", "markdown_text"]

_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "_": r"\_",
    "%": r"\%",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "\N{MINUS SIGN}": "$-$",
    "\N{EN DASH}": "--",
    "\N{MULTIPLICATION SIGN}": r"$\times$",
    "±": r"$\pm$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "\N{GREEK SMALL LETTER ALPHA}": r"$\alpha$",
    "\N{GREEK SMALL LETTER RHO}": r"$\rho$",
    "η": r"$\eta$",
    "ω": r"$\omega$",
    "δ": r"$\delta$",
    "χ": r"$\chi$",
    "²": r"\textsuperscript{2}",
    "°": r"\textdegree{}",
    "·": r"$\cdot$",
    "…": r"\ldots{}",
}  # fmt: skip
_MARKDOWN = re.compile(r"([\\`*_{}\[\]<>#|~$!&])")


def latex_text(text: str) -> str:
    r"""Return a text that LaTeX prints as it is.

    Example:
        >>> latex_text("50% of $x_1$ \\input{a}")
        '50\\% of \\$x\\_1\\$ \\textbackslash{}input\\{a\\}'
    """
    return "".join(_LATEX.get(character, character if character.isprintable() else " ") for character in text)


def markdown_text(text: str) -> str:
    r"""Return a text that Markdown shows as it is, on one line, in a table as well.

    Example:
        >>> markdown_text("a|b *c* <d>")
        'a\\|b \\*c\\* \\<d\\>'
    """
    line = "".join(character if character.isprintable() else " " for character in text)
    return _MARKDOWN.sub(r"\\\1", line)


def csv_of(table: Table) -> str:
    """Return a table as CSV, with numbers in full and missing values empty."""
    table = table.without(Place.PAGE)
    into = io.StringIO()
    # With \r\n (RFC 4180) cells that hold either of the two are quoted.
    rows = csv.writer(into, lineterminator="\r\n")
    rows.writerow(column.name for column in table.columns)
    rows.writerows([_plain(cell.value) for cell in row] for row in table.rows)
    return into.getvalue()


def latex_of(table: Table) -> str:
    """Return a table as LaTeX, for `booktabs`, with numbers as a reader sees them."""
    table = table.without(Place.FILE)
    alignment = "".join("r" if column.is_number else "l" for column in table.columns)
    label = re.sub(r"[^A-Za-z0-9]+", "-", table.name).strip("-").lower()
    lines = [
        r"% needs \usepackage{booktabs} and UTF-8",
        r"\begin{table}",
        r"  \centering",
        rf"  \caption{{{latex_text(table.caption)}}}",
        rf"  \label{{tab:{label}}}",
        rf"  \begin{{tabular}}{{{alignment}}}",
        r"    \toprule",
        f"    {' & '.join(latex_text(column.name) for column in table.columns)} \\\\",
        r"    \midrule",
        *(f"    {' & '.join(latex_text(cell.text) for cell in row)} \\\\" for row in table.rows),
        r"    \bottomrule",
        r"  \end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _plain(value: Any) -> Any:
    return "" if value is None else value
