"""Whatever a name holds, a table says it and means nothing else by it."""

from __future__ import annotations

import csv
import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.analysis.report.blocks import Cell, Chart, Code, Column, Document, Paragraph, Place, Section, Table
from robot_runner.analysis.report.rendering import (
    SafeNames,
    csv_of,
    file_name,
    files_of_tables,
    html_of,
    latex_label,
    latex_of,
    latex_text,
    markdown_of,
    markdown_text,
)
from robot_runner.analysis.wording import MISSING, shown_number

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)


@given(texts)
def test_latex_commands_are_only_ours(text):
    written = latex_text(text)
    commands = (
        r"\\(textbackslash|textasciitilde|textasciicircum|textless|textgreater|textbar|textasciigrave|char34|ldots)\{\}"
    )
    rest = re.sub(commands, "", written)
    rest = re.sub(r"\$(-|\\[A-Za-z]+)\$", "", rest)
    rest = re.sub(r"\\(textsu(per|b)script\{[^\\{}]*\}|textdegree\{\}|[{}$&#_%])", "", rest)
    rest = re.sub(r"(?<=[-',])\{\}|^\{\}(?=[\[*])", "", rest)
    assert not set(rest) & set("\\{}$&#_%~^")


@given(texts)
def test_markdown_stays_on_one_line_and_every_sign_is_escaped(text):
    written = markdown_text(text)
    assert "\n" not in written
    assert not re.search(r"(?<!\\)(?:\\\\)*[*_|<>\[\]`$#]", written)


@given(st.lists(st.tuples(texts, texts), max_size=5))
def test_csv_gives_back_what_was_put_in(rows):
    table = Table("t", "c", (Column("a"), Column("b")), tuple(tuple(map(Cell.of_text, row)) for row in rows))
    [_, *read] = csv.reader(io.StringIO(csv_of(table), newline=""))
    assert [tuple(row) for row in read if row] == [(a, b) for a, b in rows]


def test_columns_for_programs_are_in_files_and_columns_for_readers_on_the_page():
    columns = (Column("n"), Column("CI", place=Place.PAGE), Column("CI, low", place=Place.FILE))
    table = Table("t", "c", columns, ((Cell(1, "1"), Cell.of_text("[2, 3]"), Cell(2.0, "2")),))
    assert csv_of(table).splitlines() == ["n,CI, low".replace("CI, low", '"CI, low"'), "1,2.0"]
    assert "[2, 3]" in latex_of(table, latex_label)
    assert "low" not in latex_of(table, latex_label)


def test_missing_values_are_empty_in_csv():
    table = Table("t", "c", (Column("a"),), ((Cell(None, MISSING),), (Cell(0, "0"),)))
    assert csv_of(table).splitlines() == ["a", '""', "0"]


def test_columns_that_say_nothing_are_left_out():
    rows = ((Cell(1, "1"), Cell(0, "0"), Cell(None, MISSING)), (Cell(2, "2"), Cell(0, "0"), Cell("", "")))
    table = Table("t", "c", (Column("a"), Column("Missing"), Column("Odd")), rows).without_blank("Missing", "Odd")
    assert [column.name for column in table.columns] == ["a"]
    kept = Table("t", "c", (Column("Missing"),), ((Cell(0, "0"),), (Cell(3, "3"),)))
    assert len(kept.without_blank("Missing").columns) == 1


@given(st.lists(texts, unique=True, max_size=12))
def test_no_two_names_become_one(names):
    safe = SafeNames()
    given_names = [safe(name) for name in names]
    assert len({name.casefold() for name in given_names}) == len(names)
    assert given_names == [safe(name) for name in names]


@given(st.text())
def test_a_file_name_is_safe_whatever_the_name(text):
    name = file_name(text)
    assert re.fullmatch(r"[A-Za-z0-9_-]{1,80}", name)
    assert name not in {"", ".", ".."}


def test_latex_takes_the_beginning_of_a_row_for_no_argument_and_two_hyphens_for_no_dash():
    names = ("[0, 1]", "*", "--fast", "a''b")
    table = Table("t", "c", (Column("[s]"),), tuple((Cell.of_text(name),) for name in names))
    lines = [line.strip().removesuffix(r" \\") for line in latex_of(table, latex_label).splitlines()]
    assert [line for line in lines if line.startswith("{}")] == ["{}[s]", "{}[0, 1]", "{}*"]
    assert {"-{}-fast", "a'{}'b"} <= set(lines)


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("θ = 0.1 µm", r"$\theta$ = 0.1 µm"),
        ("Δλ", r"$\Delta$$\lambda$"),
        ("Βος", r"Bo$\varsigma$"),
        ("m·s⁻¹", r"m$\cdot$s\textsuperscript{$-$}\textsuperscript{1}"),
        ("CO₂ in kg/m³", r"CO\textsubscript{2} in kg/m\textsuperscript{3}"),
        ("a ≠ b ≈ ∞ ≤ √2", r"a $\neq$ b $\approx$ $\infty$ $\leq$ $\surd$2"),
        ("e\u0301", "é"),
        ("Ωμέγα, Άλφα", r"$\Omega$$\mu$$\acute{\varepsilon}$$\gamma$$\alpha$, \'{A}$\lambda$$\varphi$$\alpha$"),
        ("\u0390", r"$\acute{\ddot{\iota}}$"),
        ("∆T ∉ ∅", r"$\Delta$T $\notin$ $\emptyset$"),
    ],
)
def test_greek_and_the_signs_of_units_and_formulas_need_no_further_package_in_latex(text, written):
    assert latex_text(text) == written


def test_all_greek_letters_are_ones_that_latex_has():
    letters = [chr(code) for code in (*range(0x391, 0x3A2), *range(0x3A3, 0x3AA), *range(0x3AA, 0x3CF))]
    assert not [letter for letter in letters if not latex_text(letter).isascii()]


def test_a_table_in_latex_that_is_wider_than_a_column_of_a_paper_spans_the_page_and_never_leaves_it():
    narrow, wide = (Table("t", "c", (Column("a"), Column("b")), ((Cell.of_text("x" * n),) * 2,)) for n in (20, 30))
    assert r"\begin{table}" in latex_of(narrow, latex_label)
    written = latex_of(wide, latex_label)
    assert r"\begin{table*}" in written
    assert r"\end{table*}" in written
    assert r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}" in written


def test_of_a_table_in_latex_that_is_wider_than_a_page_cells_have_lines_and_others_are_as_they_were():
    long = "Cohen's d = 0.5 [0.1, 0.9] (95%), small; Cliff's delta = 0.3, small; [0, 1] " + "word " * 9
    wide, narrow = (
        Table("t", "c", (Column("a"), Column("b")), ((Cell.of_text(each),) * 2,)) for each in (long, "x; y")
    )
    written = latex_of(wide, latex_label)
    (row,) = (line for line in written.splitlines() if "Cohen" in line)
    lines = row.partition(" & ")[0].strip().removeprefix(r"\begin{tabular}[t]{@{}l@{}}").removesuffix(r"\end{tabular}")
    assert lines.split(r" \\ ") == [
        "Cohen's d = 0.5 [0.1, 0.9] (95\\%),",
        "small;",
        "Cliff's delta = 0.3, small;",
        "{}[0, 1] word word word word word word",
        "word word word",
    ]
    assert "x; y & x; y" in latex_of(narrow, latex_label)


def test_a_table_in_latex_that_is_longer_than_a_page_is_several_of_one_number():
    rows = tuple((Cell.of_text(f"r{n}"),) for n in range(71))
    written = latex_of(Table("t", "Runs.", (Column("a"),), rows), latex_label)
    parts = written.split(r"\end{table}")[:-1]
    assert [re.findall(r"caption\{(.*)\}", part) for part in parts] == [[f"Runs. ({n} of 3)"] for n in (1, 2, 3)]
    assert [r"\addtocounter{table}{-1}" in part for part in parts] == [False, True, True]
    assert written.count(r"\label{tab:t}") == 1
    assert re.findall(r"^    (r\d+)", written, re.MULTILINE) == [row[0].text for row in rows]
    whole = latex_of(Table("t", "Runs.", (Column("a"),), rows[:35]), latex_label)
    assert whole.count(r"\begin{table}") == 1
    assert "(1 of" not in whole


def test_units_in_captions_in_latex_keep_their_case_where_captions_are_small_capitals():
    written = latex_of(Table("t", "Power (mW) by Task_1: means.", (Column("a"),), ()), latex_label)
    assert r"\caption{Power \textnormal{(mW)} by Task\_1: means.}" in written


def test_a_table_in_latex_has_its_note_and_powers_of_ten_as_papers_print_them():
    columns = (Column("Log e-05"), Column("Power", is_number=True), Column("CI", is_number=True))
    interval = f"[{shown_number(-1e9, 2)}, {shown_number(2e12, 2)}]"
    row = (Cell("f1.0e-05", "f1.0e-05"), Cell(1.5e-5, shown_number(1.5e-5)), Cell(None, interval))
    written = latex_of(Table("t", "Power.", columns, (row,), "CI: 95% confidence interval."), latex_label)
    assert r"f1.0e-05 & 1.500$\times$10\textsuperscript{$-$}\textsuperscript{5} & {}[$-$1.0$\times$10" in written
    assert r"\textsuperscript{9}, 2.0$\times$10\textsuperscript{1}\textsuperscript{2}] \\" in written
    assert r"\footnotesize CI: 95\% confidence interval.}" in written
    bare = latex_of(Table("t", "Power.", columns, (row,)), latex_label)
    assert "parbox" not in bare


def test_tables_whose_names_differ_in_signs_alone_have_labels_of_their_own():
    labels = SafeNames(latex_label)
    assert [labels(name) for name in ("describe a_b", "describe a-b", "describe a_b")] == [
        "describe-a-b",
        "describe-a-b-2",
        "describe-a-b",
    ]


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("- item", r"\- item"),
        ("1. item", r"1\. item"),
        ("---", r"\---"),
        ("===", r"\==="),
        ("    x", "x"),
        ("0.5 to 1. or -2", "0.5 to 1. or -2"),
    ],
)
def test_markdown_takes_the_beginning_of_a_text_for_no_list_heading_or_code(text, written):
    assert markdown_text(text) == written


def page_of(section):
    document = Document("k", "t", "", (), (section,))
    return html_of(document, {}, files_of_tables(document))


def test_a_name_turns_the_direction_of_no_number_beside_it():
    section = Section("s", "S", (Paragraph("\u202eabc: 17 J"), Chart("c", "points", "", {"name": "\u202eabc"})))
    page = page_of(section)
    assert "\u202e" not in page
    assert " abc: 17 J" in page


def test_a_caption_begins_or_ends_its_figure_as_the_standard_of_html_asks_for():
    table = Table("t", "c", (Column("a"),), ((Cell(1, "1"),),))
    page = page_of(Section("s", "S", (Chart("c", "points", "d", {}), table)))
    figures = re.findall(r"<figure[^>]*>(.*?)</figure>", page, re.DOTALL)
    assert len(figures) == 2
    for figure in figures:
        before, after = re.split(r"<figcaption>.*</figcaption>", figure.strip(), flags=re.DOTALL)
        assert not (before and after)


def test_what_is_scrolled_can_be_reached_by_keys():
    page = page_of(Section("s", "S", (Code("pip install " * 40),)))
    assert '<pre class="code" tabindex="0" role="region" aria-label="Code">' in page


def test_a_table_in_markdown_is_one():
    table = Table("t", "c", (Column("a"), Column("b", is_number=True)), ((Cell.of_text("- x"), Cell(1, "1")),))
    text = markdown_of(Document("k", "t", "", (), (Section("s", "S", (table,)),)), str)
    assert "| a | b |\n|---|---:|\n| \\- x | 1 |\n" in text
