"""Render a document as HTML and Markdown, and its tables as CSV and LaTeX.

Each format has its own templates and environment, which escapes all printed values, so that names of users are never
markup.
"""

from __future__ import annotations

import base64
import csv
import gzip
import io
import json
import re
import tarfile
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from importlib.resources import files
from itertools import chain
from typing import TYPE_CHECKING, Any
from unicodedata import normalize

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from robot_runner.analysis.figures.style import verbatim
from robot_runner.analysis.report.drawings import drawing_of
from robot_runner.analysis.statistics.experiment_statistics import OnStep, unheard

if TYPE_CHECKING:
    from robot_runner.analysis.report.blocks import Document, Table

_PACKAGE = "robot_runner.analysis.report"
#: The most rows of a table on a page; files have all rows.
_MOST_ROWS = 400
#: Letters of a row that fit into a column of a paper, and the width of the gap between two cells, letters.
_COLUMN_OF_A_PAPER, _GAP = 50, 2
#: Letters that fit on a page of a paper, and the letters of a line in a cell of a table that is wider than that.
_PAGE_OF_A_PAPER, _LINE_OF_A_CELL = 105, 36
#: Lines of rows that fit on a page of LaTeX's own classes, which have 43 at 10 points, with caption, heads and note.
_LINES_OF_A_PAGE = 35
#: What ends a line of a cell; no text has it, as its backslashes are escaped.
_END_OF_LINE = r" \\ "
#: An interval, which is kept on one line of a cell, and the temporary replacement of its blanks.
_INTERVAL, _UNBROKEN = re.compile(r"\[[^\[\]]*\]"), "\N{NO-BREAK SPACE}"
#: Invisible characters that are kept on a page: line breaks, and joiners of letters and of parts of a character.
_KEPT = "\n\u200c\u200d"
_LONGEST_NAME = 80  # letters of a file's name
#: Of the compression of tables.
_LEVEL = 6
_BLANK_LINES = re.compile(r"\n{3,}")
#: How many texts are remembered as LaTeX: the table of many runs says few different ones over and over.
_REMEMBERED = 10_000
#: Characters with a meaning anywhere in Markdown, and those that begin a list or underline a heading.
_MARKDOWN = re.compile(r"([\\`*_{}\[\]<>#|~$!&]|(?:^|(?<=^[0-9])|(?<=^[0-9]{2}))[-+=.)](?=[-=\s]|$))")


def file_name(text: str) -> str:
    """Return a name of letters, digits, hyphens and underscores, which is valid in file systems, URLs and LaTeX.

    Example:
        >>> file_name("Energy (J) of ../Größe")
        'Energy_J_of_Grosse'
    """
    plain = normalize("NFKD", text.replace("ß", "ss")).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9-]+", "_", plain).strip("_")[:_LONGEST_NAME] or "unnamed"


class SafeNames:
    """Map each name to a unique safe one for files and links; the same name always gets the same.

    Example:
        >>> names = SafeNames()
        >>> [names("a/b"), names("a b"), names("a/b")]
        ['a_b', 'a_b-2', 'a_b']
    """

    def __init__(self, plain: Callable[[str], str] = file_name) -> None:
        self._plain = plain
        self._given: dict[str, str] = {}
        self._taken: set[str] = set()

    def __call__(self, name: str) -> str:
        """Return the safe name."""
        if name not in self._given:
            safe = base = self._plain(name)
            number = 1
            while safe.casefold() in self._taken:
                number += 1
                safe = f"{base}-{number}"
            self._taken.add(safe.casefold())
            self._given[name] = safe
        return self._given[name]


@dataclass(frozen=True, slots=True)
class TableFiles:
    """The files of a table: their name without suffix, and their contents."""

    name: str
    csv: str
    latex: str

    @property
    def contents(self) -> tuple[tuple[str, bytes], ...]:
        """The name and the content of each file."""
        return (f"{self.name}.csv", self.csv.encode()), (f"{self.name}.tex", self.latex.encode())


def files_of_tables(document: Document, on_step: OnStep = unheard) -> dict[str, TableFiles]:
    """Return the files of all tables of a document, by the table's name; report progress to `on_step`."""
    names, labels = SafeNames(), SafeNames(latex_label)
    made = {}
    for number, table in enumerate(document.tables):
        on_step("tables", number, len(document.tables))
        made[table.name] = TableFiles(names(table.name), csv_of(table), latex_of(table, labels))
    return made


def html_of(document: Document, drawings: Mapping[str, bytes], tables: Mapping[str, TableFiles]) -> str:
    """Return a document as one HTML file that fetches nothing: style, scripts, figures and data are in it.

    Its figures are drawn as SVG, and its tables made as files for download, both by name.
    """
    anchors = SafeNames()
    for section in document.sections:  # links may rely on the names of sections, so reserve them first
        anchors(section.name)
    drawn = {name: drawing_of(svg) for name, svg in drawings.items()}
    shown = {"document": document, "drawings": drawn, "tables": tables, "archive": _archive(tables.values())}
    return _pages().get_template("report.html.j2").render(shown, anchor=anchors, most_rows=_MOST_ROWS)


def markdown_of(document: Document, figure_path: Callable[[str], str]) -> str:
    """Return a document as Markdown."""
    template = _environment(markdown_text).get_template("report.md.j2")
    return _BLANK_LINES.sub("\n\n", template.render(document=document, figure_path=figure_path))


# Escapes for LaTeX without further packages.

_LATEX_TEXT = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "_": r"\_", "%": r"\%",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"\char34{}", "`": r"\textasciigrave{}", "\N{EN DASH}": "--", "°": r"\textdegree{}",
    "…": r"\ldots{}", "℉": r"\textdegree{}F", "\N{MINUS SIGN}": "$-$", "\N{ASTERISK OPERATOR}": "$*$",
    "\N{DIVISION SLASH}": "/",
    "\N{PRIME}": r"$^{\prime}$", "\N{DOUBLE PRIME}": r"$^{\prime\prime}$",
}  # fmt: skip
#: Mathematical symbols, each with its command.
_MATHEMATICS = (
    "\N{MULTIPLICATION SIGN}times ±pm ∓mp ·cdot ⋅cdot ≤leq ≥geq ≪ll ≫gg ≈approx ≠neq ≡equiv ≃simeq ≅cong "
    "\N{TILDE OPERATOR}sim ∝propto ∞infty √surd ∂partial ∇nabla ∆Delta ∑sum ∏prod ∫int ∈in ∉notin ∋ni "
    "∅emptyset ∀forall ∃exists ∧wedge \N{LOGICAL OR}vee ∩cap \N{UNION}cup ⊂subset ⊃supset ⊆subseteq ⊇supseteq "
    "⇐Leftarrow ⇒Rightarrow ⇔Leftrightarrow ↔leftrightarrow ∘circ ∠angle ∥parallel ⊥perp ⌈lceil ⌉rceil "
    "⌊lfloor ⌋rfloor ★star \N{SCRIPT SMALL L}ell ℏhbar ϵepsilon ϑvartheta ϕphi ϖvarpi "
    "\N{GREEK RHO SYMBOL}varrho"
)
_SUPERSCRIPTS = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁼⁽⁾ⁿⁱ", "0123456789+=()ni", strict=True))
_SUBSCRIPTS = dict(zip("₀₁₂₃₄₅₆₇₈₉₊₌₍₎ₐₑₒₓₙᵢ", "0123456789+=()aeoxni", strict=True))
#: Greek letters from each code point on: LaTeX has no command for letters that look like Latin ones.
_GREEK = (
    (0x391, "A B Gamma Delta E Z H Theta I K Lambda M N Xi O Pi P"),
    (0x3A3, "Sigma T Upsilon Phi X Psi Omega"),
    (0x3B1, "alpha beta gamma delta varepsilon zeta eta theta iota kappa lambda mu nu xi o pi rho"),
    (0x3C2, "varsigma sigma tau upsilon varphi chi psi omega"),
)
#: The commands of accents on Greek letters: over Latin letters, and in mathematics.
_ACCENTS = {"\N{COMBINING ACUTE ACCENT}": (r"\'", r"\acute"), "\N{COMBINING DIAERESIS}": (r"\"", r"\ddot")}


def _signs() -> Iterator[tuple[str, str]]:
    yield from _LATEX_TEXT.items()
    yield from ((sign[0], f"$\\{sign[1:]}$") for sign in _MATHEMATICS.split())
    yield from ((sign, rf"\textsuperscript{{{plain}}}") for sign, plain in _SUPERSCRIPTS.items())
    yield from ((sign, rf"\textsubscript{{{plain}}}") for sign, plain in _SUBSCRIPTS.items())
    yield from (("⁻", r"\textsuperscript{$-$}"), ("₋", r"\textsubscript{$-$}"))
    greek = {
        chr(code): f"\\{name}" if len(name) > 1 else name
        for first, names in _GREEK
        for code, name in enumerate(names.split(), first)
    }
    for code in range(0x386, 0x3CF):
        letter, *accents = list(normalize("NFD", chr(code)))
        if letter in greek and all(accent in _ACCENTS for accent in accents):
            written, is_latin = greek[letter], len(greek[letter]) == 1
            for accent in accents:
                written = f"{_ACCENTS[accent][not is_latin]}{{{written}}}"
            yield chr(code), written if is_latin else f"${written}$"


_LATEX = str.maketrans(dict(_signs()))
#: Between two equal signs, which LaTeX would make one.
_TWICE = re.compile("(?<=-)(?=-)|(?<=')(?=')|(?<=,)(?=,)")


@lru_cache(_REMEMBERED)
def latex_text(text: str) -> str:
    r"""Escape a text for LaTeX.

    Example:
        >>> latex_text("50% of $x_1$ \\input{a}")
        '50\\% of \\$x\\_1\\$ \\textbackslash{}input\\{a\\}'
        >>> latex_text("--fast"), latex_text("[0, 1]")  # neither a dash nor the argument of the line that ends before
        ('-{}-fast', '{}[0, 1]')
    """
    line = normalize("NFC", verbatim(text))  # composes letters and accents, and makes an ohm sign an omega
    written = "{}".join(part.translate(_LATEX) for part in _TWICE.split(line))
    return f"{'{}' * line.startswith(('[', '*'))}{written}"


def latex_of(table: Table, labels: Callable[[str], str]) -> str:
    """Return a table as LaTeX, for `booktabs` and `graphicx`, with numbers as readers see them.

    A table that is too wide for a column of a paper spans the page. If it is too wide for the page, long cells are
    broken into lines, and a table that is still too wide is scaled down. One that is longer than a page is several with
    one number, as LaTeX prints no float beyond the end of its page. `labels` returns its label for references.
    """
    table = table.for_readers
    names = [column.name for column in table.columns]
    rows = [[cell.text for cell in row] for row in table.rows]
    width = sum(max(map(len, column)) + _GAP for column in zip(names, *rows, strict=True))
    star = "*" * (width > _COLUMN_OF_A_PAPER)
    cell_text = _in_lines if width > _PAGE_OF_A_PAPER else latex_text
    pages = _pages_of([[cell_text(cell) for cell in row] for row in rows])
    # IEEE's captions are in small capitals, which would print mW as MW.
    caption = re.sub(r"\([^()]*\)", r"\\textnormal{\g<0>}", latex_text(table.caption))
    note = rf"\parbox{{\linewidth}}{{\centering\footnotesize {latex_text(table.note)}}}"
    lines = [r"% needs \usepackage{booktabs,graphicx} and UTF-8"]
    for number, page in enumerate(pages, 1):
        which = f" ({number} of {len(pages)})" if len(pages) > 1 else ""
        lines += (
            rf"\begin{{table{star}}}",
            *((r"  \addtocounter{table}{-1}",) if number > 1 else ()),
            r"  \centering",
            rf"  \caption{{{caption}{which}}}",
            *((rf"  \label{{tab:{labels(table.name)}}}",) if number == 1 else ()),
            r"  \resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
            rf"  \begin{{tabular}}{{{''.join('r' if column.is_number else 'l' for column in table.columns)}}}",
            r"    \toprule",
            rf"    {' & '.join(map(latex_text, names))} \\",
            r"    \midrule",
            *(rf"    {' & '.join(row)} \\" for row in page),
            r"    \bottomrule",
            r"  \end{tabular}}",
            *((r"  \par\smallskip", f"  {note}") if table.note else ()),
            rf"\end{{table{star}}}",
        )
    return "\n".join(lines) + "\n"


def _pages_of(rows: Iterable[Sequence[str]]) -> list[list[Sequence[str]]]:
    """Return rows, whose cells may have several lines, page by page; of no rows, one page."""
    pages: list[list[Sequence[str]]] = [[]]
    used = 0
    for row in rows:
        lines = 1 + max((cell.count(_END_OF_LINE) for cell in row), default=0)
        if used + lines > _LINES_OF_A_PAGE and pages[-1]:
            pages.append([])
            used = 0
        pages[-1].append(row)
        used += lines
    return pages


@lru_cache(_REMEMBERED)
def _in_lines(text: str) -> str:
    """Return the text of a cell as LaTeX, broken into lines; each item of an enumeration begins a line."""
    whole = _INTERVAL.sub(lambda found: found[0].replace(" ", _UNBROKEN), text)
    parts = whole.split("; ")
    parts[:-1] = [f"{each};" for each in parts[:-1]]
    folded = (textwrap.wrap(part, _LINE_OF_A_CELL, break_long_words=False) or [part] for part in parts)
    lines = [latex_text(line.replace(_UNBROKEN, " ")) for line in chain.from_iterable(folded)]
    written = _END_OF_LINE.join(lines)
    return r"\begin{tabular}[t]{@{}l@{}}" + written + r"\end{tabular}" if len(lines) > 1 else written


def latex_label(name: str) -> str:
    """Return a name in the form of LaTeX labels."""
    return file_name(name).replace("_", "-").lower()


def csv_of(table: Table) -> str:
    """Return a table as CSV, with numbers in full and missing values empty."""
    table = table.for_programs
    into = io.StringIO()
    # With \r\n (RFC 4180), cells with either character are quoted.
    rows = csv.writer(into, lineterminator="\r\n")
    rows.writerow(column.name for column in table.columns)
    rows.writerows(["" if cell.value is None else cell.value for cell in row] for row in table.rows)
    return into.getvalue()


def markdown_text(text: str) -> str:
    r"""Escape a text for Markdown, on one line, so that it also fits into a table.

    Example:
        >>> markdown_text("a|b *c* <d>")
        'a\\|b \\*c\\* \\<d\\>'
    """
    return _MARKDOWN.sub(r"\\\1", verbatim(text).strip())


def templates_of(package: str, finalize: Callable[[object], object], **settings: Any) -> Environment:
    """Return the templates of a package; `finalize` processes each printed value."""
    return Environment(  # noqa: S701 - the caller says how values are escaped
        loader=PackageLoader(package),
        finalize=finalize,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        **settings,
    )


@cache
def _environment(escape: Callable[[str], str] | None = None) -> Environment:
    """Return the templates of a format; they escape values by `escape`, or as HTML, unless these are `Markup`."""

    def finalize(value: object) -> object:
        if hasattr(value, "__html__"):
            return value
        if escape is None:
            return verbatim(str(value), _KEPT)
        return Markup(escape(str(value)))  # noqa: S704 - that it is escaped for another format is the point

    environment = templates_of(_PACKAGE, finalize, autoescape=True)
    environment.globals["kind_of"] = lambda block: type(block).__name__
    return environment


@cache
def _pages() -> Environment:
    environment = _environment()
    shared = partial(_asset, package="robot_runner.core")  # assets that the report shares with the live page
    environment.globals.update(asset=_asset, shared_asset=shared, json_of=_json_of)
    return environment


def _asset(name: str, package: str = _PACKAGE) -> Markup:
    # Our own file, not a user's: it may contain markup.
    return Markup(files(package).joinpath("assets", name).read_text(encoding="utf-8"))  # noqa: S704


def _json_of(data: Mapping[str, Any]) -> Markup:
    """Return JSON that cannot close the HTML element around it."""
    text = verbatim(json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False), _KEPT)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)  # noqa: S704 - every character that HTML knows was escaped


def _archive(tables: Iterable[TableFiles]) -> Markup:
    """Return a data URL of an archive of all tables: they are similar, and single files take ten times the space."""
    into = io.BytesIO()
    # Without times, so that the same tables give the same bytes; the usual level is thrice as slow and saves nothing.
    with (
        gzip.GzipFile(fileobj=into, mode="wb", compresslevel=_LEVEL, mtime=0) as packed,
        tarfile.open(fileobj=packed, mode="w") as archive,
    ):
        for name, content in chain.from_iterable(table.contents for table in tables):
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))
    return Markup(f"data:application/gzip;base64,{base64.b64encode(into.getvalue()).decode()}")  # noqa: S704 - as said
