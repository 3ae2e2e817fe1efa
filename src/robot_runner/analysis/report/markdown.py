"""Tables as CSV and LaTeX, and names that mean nothing to LaTeX, Markdown or a shell of either."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.report.blocks import (
    Block,
    Cards,
    Chart,
    Code,
    Facts,
    FigureBlock,
    Gallery,
    Paragraph,
    Part,
    Place,
    Remarks,
    Table,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from robot_runner.analysis.report.blocks import Badge, Document

__all__ = ["csv_of", "latex_of", "latex_text", "markdown_of", "markdown_text"]


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


# A document as Markdown, with links to the files of its figures.

_ = markdown_text


def markdown_of(document: Document, figure_path: Callable[[str], str]) -> str:
    """Return a document as Markdown.

    Args:
        document: what is written.
        figure_path: returns the path of a figure's file by the figure's name, relative to the document.
    """
    lines = [f"# {_(document.title)}", "", f"{_(document.kicker)}. {_(document.subtitle)}", ""]
    lines += [f"**{_(badge.text)}** {_(badge.explanation)}".rstrip() + "\n" for badge in document.badges]
    lines += [f"{number}. [{_(section.title)}](#{section.name})" for number, section in enumerate(document.sections, 1)]
    writer = _Writer(figure_path)
    for section in document.sections:
        lines += ["", f'<a id="{section.name}"></a>', "", f"## {_(section.title)}"]
        for block in section.blocks:
            lines += ["", *writer.lines(block, 3)]
    return "\n".join([*lines, "", _(document.made), ""])


@dataclass(frozen=True, slots=True)
class _Writer:
    """Writes blocks as lines."""

    figure_path: Callable[[str], str]

    def lines(self, block: Block, level: int) -> Iterator[str]:
        """Yield the lines of a block; headings inside of it are of this level."""
        match block:
            case FigureBlock():
                yield from self._figure(block)
            case Gallery():
                for figure in block.figures:
                    yield from (*self._figure(figure), "")
            case Part():
                yield f"{'#' * level} {_(block.title)}{_badges(block.badges)}"
                for inner in block.blocks:
                    yield from ("", *self.lines(inner, level + 1))
            case Table():
                yield from _table(block)
            case Chart():  # for pages only; figures say the same
                return
            case _:
                yield from _text(block)

    def _figure(self, figure: FigureBlock) -> Iterator[str]:
        yield f"![{_(figure.alternative)}]({self.figure_path(figure.name)})"
        yield from ("", _(figure.caption))


def _text(block: Paragraph | Facts | Cards | Remarks | Code) -> Iterator[str]:
    match block:
        case Paragraph():
            lead = f"**{_(block.lead)}**{_badges(block.badges)} " if block.lead else ""
            yield f"{lead}{_(block.text)}"
        case Facts():
            yield from (f"- {_(name)}: {_(fact)}" for name, fact in block.rows)
        case Cards():
            yield from (f"- **{_(card.value)}** {_(card.label)}, {_(card.note)}".rstrip(", ") for card in block.cards)
        case Remarks():
            for remark in block.remarks:
                kind = f" ({_(remark.kind)})" if remark.kind else ""
                yield f"- **{_(remark.title)}**{kind}: {_(remark.text)}"
        case Code():
            yield from (f"```{block.language}", block.text, "```")


def _badges(badges: Sequence[Badge]) -> str:
    return "".join(f" *{_(badge.text)}*" for badge in badges)


def _table(table: Table) -> Iterator[str]:
    table = table.without(Place.FILE)
    yield f"{_(table.caption)}"
    yield ""
    yield f"| {' | '.join(_(column.name) for column in table.columns)} |"
    yield f"|{'|'.join('---:' if column.is_number else '---' for column in table.columns)}|"
    for row in table.rows:
        yield f"| {' | '.join(_(cell.text) for cell in row)} |"
    if table.note:
        yield from ("", _(table.note))
