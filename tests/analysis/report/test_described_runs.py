"""Tables, figures, captions and cards of a report tell of the same runs, treatments and intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.figures.style import INK
from robot_runner.analysis.plan_file import choices_in_words
from robot_runner.analysis.report.blocks import Facts, Paragraph, Remarks
from robot_runner.analysis.report.document import report_document
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.wording import ALPHA
from robot_runner.core.design.analysis_plan import AnalysisPlan, Estimand
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.hypothesis import Hypothesis
from robot_runner.core.design.outliers import Outliers
from robot_runner.designs.blocked import Blocks
from robot_runner.designs.squares import LatinSquare

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.analysis.report.blocks import Document, FigureBlock, Table

TASK, SPEED, MAP = Factor("Task", ["A", "B"]), Factor("Speed", [1, 2]), Factor("Map", ["m1", "m2"])
VALUES = (10.0, 11.0, 12.0, 13.0, 11.5, 300.0)


def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
    # A square of additive values would leave nothing but rounding.
    square = 0.3 * (treatments.get("Day") == 2 and treatments.get("Hour") == 3)
    energy = VALUES[repetition - 1] + (treatments["Task"] == "B") + 0.1 * repetition + square
    return {"Energy": energy, "Reached": repetition % 2 == 1}


def report(
    folder: Path, factors: list[Factor], chosen: Any = None, plan: AnalysisPlan | None = None, **made: Any
) -> Document:
    make_experiment(
        folder,
        factors,
        lambda treatments, repetition: None if treatments.get("Map") == "m2" else values(treatments, repetition),
        repetitions=6,
        measures=("Energy", "Reached"),
        shuffle=True,
        chosen=chosen,
        analysis=None if plan is None else plan.as_mapping(),
        **made,
    )
    results = load_results(folder)
    return report_document(Material(results, analyse(results)), made="")


@pytest.mark.long
def test_of_many_outliers_those_that_are_farthest_from_the_others_are_named(tmp_path: Path) -> None:
    def energy(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        crashed = (treatments["Task"], repetition) == ("B", 30)
        odd = 160.0 if crashed else 1010.0 if repetition % 4 == 0 else 990.0
        return {"Energy": odd if repetition <= 14 or crashed else 1000.0 + repetition / 100}

    make_experiment(tmp_path, [TASK], energy, repetitions=60)
    results = load_results(tmp_path)
    document = report_document(Material(results, analyse(results)), made="")
    (told,) = [each.text for each in document.blocks() if isinstance(each, Paragraph) and "fences" in each.text]
    assert told.startswith("29 outliers by Tukey's fences, the farthest from their medians first: r_60 (160.0, ")


def figure(document: Document, name: str) -> FigureBlock:
    return next(each for each in document.figures if each.name == name)


def table(document: Document, name: str) -> Table:
    return next(each for each in document.tables if each.name == name)


def cards(document: Document) -> list[str]:
    return [f"{each.value} {each.label} {each.note}" for each in document.sections[0].blocks[0].cards]


@pytest.mark.long
def test_values_that_the_plan_leaves_out_are_in_no_mean_of_a_figure(tmp_path: Path) -> None:
    plan = AnalysisPlan("Energy", outliers=Outliers(interquartile_ranges=3))
    document = report(tmp_path / "trial", [TASK, SPEED], plan=plan)
    drawn = figure(document, "distribution Energy by Task / Speed")
    assert "A / 1: mean 11.80, n = 5;" in drawn.alternative
    lines = figure(document, "interaction Energy Task Speed").draw().axes[0].get_lines()
    assert max(max(line.get_ydata()) for line in lines) < 20
    means = table(document, "means")
    assert means.rows[0][1].text.startswith("11.80 ±")
    assert means.note == (
        "Mean of the runs that are done, but for values that the analysis leaves out, and their standard deviation "
        "(± SD). Of a measure that is yes or no, how many of the runs that are done, but for values that the analysis "
        "leaves out, say yes."
    )


@pytest.mark.long
def test_of_many_pairs_of_factors_those_are_drawn_whose_interaction_is_clearest(tmp_path: Path) -> None:
    def energy(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        noise = hash((tuple(treatments.values()), repetition)) % 97 / 97
        return {"Energy": 9.0 * (treatments["F1"] == treatments["F6"]) + noise}

    factors = [Factor(f"F{number}", [1, 2]) for number in range(1, 7)]
    folder = make_experiment(tmp_path / "six", factors, energy, repetitions=2)
    results = load_results(folder.root)
    document = report_document(Material(results, analyse(results)), made="")
    drawn = [each.name for each in document.figures if each.name.startswith("interaction")]
    assert (len(drawn), "interaction Energy F1 F6" in drawn) == (10, True)


def test_what_was_fixed_names_each_planned_measure_and_whose_values_a_rule_leaves_out(tmp_path: Path) -> None:
    rule = Outliers(interquartile_ranges=3, bounds={"Energy": (0, None)})
    document = report(tmp_path / "trial", [TASK], plan=AnalysisPlan("Energy", secondary=["Reached"], outliers=rule))
    facts = next(each for each in document.sections[1].blocks if isinstance(each, Facts))
    spread = "more than 3 interquartile ranges beyond the quartiles of its combination"
    assert dict(facts.rows)["Fixed beforehand"] == (
        f"measures Energy, secondary Reached, {ALPHA} = 0.05, Holm; "
        f"left out as outliers: values of Energy {spread}, or below 0; "
        f"left out as outliers: values of every other numeric measure {spread}"
    )


def test_a_rule_without_bounds_is_said_to_hold_for_every_numeric_measure() -> None:
    (choice,) = choices_in_words(AnalysisPlan("Energy", outliers=Outliers(median_deviations=3)), lambda _: "J")
    assert choice.startswith("left out as outliers: values of every numeric measure more than 3 median absolute")


def test_that_ranks_were_fixed_beforehand_is_said() -> None:
    assert list(choices_in_words(AnalysisPlan("Trust", estimand=Estimand.RANK), str)) == [
        "ranks are compared, not means"
    ]


def test_a_single_treatment_has_its_mean_in_brief_and_the_interval_that_the_caption_names(tmp_path: Path) -> None:
    document = report(tmp_path / "trial", [Factor("Task", ["A"])])
    means = table(document, "means")
    assert (means.caption, [row[0].text for row in means.rows]) == (
        "Means and proportions of all runs.",
        ["Energy", "Reached"],
    )
    assert means.note.endswith("how many of the runs that are done say yes.")
    drawn = figure(document, "distribution Energy")
    assert "diamond and bar: mean and its 95% confidence interval" in drawn.caption
    bars = [each for each in drawn.draw().axes[0].get_lines() if each.get_color() == INK and len(each.get_xdata()) == 2]
    assert len(bars) == 1


@pytest.mark.long
def test_the_unit_of_a_factor_stands_on_axes_and_in_the_table_of_factors(tmp_path: Path) -> None:
    document = report(tmp_path / "trial", [TASK, Factor("Speed", [1, 2], unit="m/s")])
    factors = table(document, "factors")
    assert [column.name for column in factors.columns][:2] == ["Factor", "Unit"]
    told = [(row[0].text, row[1].value) for row in factors.rows]
    assert told == [("Task", ""), ("Speed", "m/s"), ("Repetition", "")]
    drawn = figure(document, "distribution Energy by Task / Speed")
    assert drawn.draw().axes[0].get_xlabel() == "Task / Speed (m/s)"


def test_means_that_differ_by_little_of_themselves_are_told_apart(tmp_path: Path) -> None:
    def way(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        return {"Energy": 3.452 + repetition / 5_000 + (treatments["Task"] == "B") / 2_500}

    make_experiment(tmp_path, [TASK], way, repetitions=3)
    results = load_results(tmp_path)
    document = report_document(Material(results, analyse(results)), made="")
    (row,) = table(document, "means").rows
    assert [cell.text for cell in row] == ["Energy", "3.45240 ± 0.00020", "3.45280 ± 0.00020"]
    described = {column.name: cell.text for column, cell in zip(*_first_row(document), strict=True)}
    assert (described["Minimum"], described["CI of the mean"]) == ("3.45220", "[3.45190, 3.45290]")


def test_a_treatment_that_hardly_varies_gives_no_digits_to_others(tmp_path: Path) -> None:
    def way(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        return {"Energy": 10 + repetition / (2 if treatments["Task"] == "A" else 1e8)}

    make_experiment(tmp_path, [TASK], way, repetitions=3)
    results = load_results(tmp_path)
    described = table(report_document(Material(results, analyse(results)), made=""), "describe Energy by Task")
    assert [row[2].text for row in described.rows] == ["11.00", "10.000000020"]


def _first_row(document: Document) -> tuple[Any, Any]:
    described = table(document, "describe Energy by Task").for_readers
    return described.columns, described.rows[0]


@pytest.mark.parametrize("other", [Factor("Map", ["m1"]), MAP], ids=["one treatment", "one executed"])
def test_a_factor_that_did_not_vary_leaves_figures_and_tables_as_they_are(tmp_path: Path, other: Factor) -> None:
    document = report(tmp_path / "trial", [TASK, SPEED, other])
    proportions = figure(document, "distribution Reached by Task / Speed")
    assert "A / 1: 3 of 6; A / 2: 3 of 6" in proportions.alternative
    drawn = figure(document, "distribution Energy by Task / Speed")
    assert "Named runs are outliers." in drawn.caption
    headings = [column.name for column in table(document, "means").columns]
    assert headings == ["Measure", "A / 1", "A / 2", "B / 1", "B / 2"]
    assert [row[1].text for row in table(document, "means").rows if "Reached" in row[0].text] == ["50.00 % (3 of 6)"]
    assert table(document, "describe Energy").columns[0].name == "Task / Speed"


@pytest.mark.long
def test_blocks_are_no_treatments_of_the_means_and_cards(tmp_path: Path) -> None:
    document = report(tmp_path / "trial", [Factor("Day", [1, 2, 3]), TASK], chosen=Blocks("Day"))
    assert "2 treatments of Task" in cards(document)
    assert "6 runs each of a combination" in cards(document)
    means = table(document, "means")
    assert means.caption == "Means and proportions by Task."
    assert [column.name for column in means.columns] == ["Measure", "A", "B"]


@pytest.mark.long
def test_captions_say_what_residuals_are_left_of(tmp_path: Path) -> None:
    square = [Factor("Day", [1, 2, 3]), Factor("Hour", [1, 2, 3]), Factor("Task", ["A", "B", "C"])]
    designed = report(tmp_path / "square", square, chosen=LatinSquare("Day", "Hour"))
    assert "(value less what effects and blocks of the design add to it)" in figure(designed, "qq Energy").caption
    in_blocks = report(tmp_path / "blocks", [Factor("Day", [1, 2, 3]), TASK], chosen=Blocks("Day"))
    assert (
        "(value less the mean of its combination and what blocks add to it)" in figure(in_blocks, "qq Energy").caption
    )
    plain = report(tmp_path / "plain", [TASK])
    assert "each run less the mean of its combination. Dashed" in figure(plain, "order Energy").caption
    assert "(value less the mean of its combination)" in figure(plain, "qq Energy").caption


@pytest.mark.long
def test_intervals_have_their_level_beside_them(tmp_path: Path) -> None:
    plan = AnalysisPlan("Energy", alpha=0.01, covariates="order")
    document = report(tmp_path / "trial", [Factor("Task", ["A", "B", "C"])], plan=plan)
    pairs = table(document, "pairs Energy Task").note
    assert "99% confidence intervals, in brackets, belong to p." in pairs
    for name, level in {"slopes Energy": "99", "adjusted Energy": "99", "describe Energy by Task": "95"}.items():
        assert table(document, name).note.startswith(f"CI: {level}% confidence interval")


@pytest.mark.long
def test_an_interval_below_0_of_values_that_are_not_is_told_to_be_one_of_few_runs(tmp_path: Path) -> None:
    few = table(report(tmp_path / "few", [TASK]), "describe Energy by Task")
    assert "reaches below 0 where no value does: there are few runs for so large a spread" in few.note
    plan = AnalysisPlan("Energy", outliers=Outliers(interquartile_ranges=3))
    close = table(report(tmp_path / "close", [TASK], plan=plan), "describe Energy by Task")
    assert "below 0" not in close.note


def test_without_a_config_no_commands_and_no_config_are_spoken_of(tmp_path: Path) -> None:
    section = report(tmp_path / "trial", [TASK]).sections[-1]
    told = " ".join(str(block) for block in section.blocks)
    assert "The folder holds no config" in told
    assert "These commands" not in told
    assert "config/" not in told


def test_a_hypothesis_is_named_where_it_is_said_to_stand(tmp_path: Path) -> None:
    hypothesis = Hypothesis("B needs more than A", measure="Energy", factors="Task", contrast={"A": -1, "B": 1})
    plan = AnalysisPlan("Energy", hypotheses=[hypothesis], outliers=Outliers(interquartile_ranges=3))
    document = report(tmp_path / "trial", [TASK], plan=plan, doubts={"r_1": "the battery was low"})
    told = [each for each in document.blocks() if isinstance(each, Paragraph) and "support it" in each.text]
    assert told
    assert {each.lead.removesuffix(".") for each in told} == {"B needs more than A"}
    (threat,) = [
        each
        for block in document.blocks()
        if isinstance(block, Remarks)
        for each in block.remarks
        if each.title == "Energy has doubtful values"
    ]
    assert "B needs more than A: Without the 1 run" in threat.text


def test_effects_that_are_not_tested_without_doubtful_runs_take_one_sentence(tmp_path: Path) -> None:
    every = {f"r_{place}": "the computer was busy" for place in range(1, 25)}
    document = report(tmp_path / "trial", [TASK, SPEED], doubts=every)
    remarks = [each for block in document.blocks() if isinstance(block, Remarks) for each in block.remarks]
    (threat,) = [each for each in remarks if each.title == "Energy has doubtful values"]
    assert threat.text.count("Without the 24 runs") == 1
    assert "3 effects on Energy cannot be tested: whether these conclusions stand is not known." in threat.text
