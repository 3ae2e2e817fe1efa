from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.analysis.made_experiment import make_experiment
from tests.long_cases import soak_but

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.report.writing import ReportFormat, write_report
from robot_runner.analysis.statistics.disclosed import Beside
from robot_runner.analysis.statistics.outcome import Standing
from robot_runner.analysis.statistics.robustness import gathered

if TYPE_CHECKING:
    from pathlib import Path

HOT = "the sensor was hot"
#: Watts of two tasks that differ by little, and of the same by much.
NEAR = {"Video": [9.9, 10.0, 10.1, 10.0, 9.9, 10.1], "Network": [10.0, 9.9, 10.1, 9.9, 10.1, 10.0]}
FAR = {"Video": [9.9, 10.0, 10.1, 10.0, 9.9, 10.1], "Network": [12.0, 11.9, 12.1, 11.9, 12.1, 12.0]}
PLAN = {
    "alpha": 0.05,
    "correction": "holm",
    "measures": ["Energy"],
    "hypotheses": [{"statement": "Tasks differ.", "measure": "Energy", "factors": ["Task"]}],
}


def results(folder: Path, watts: dict[str, list[float]], doubts: dict[str, str], **more: Any) -> Any:
    """Return an experiment whose odd runs are of Video, and whose even ones are of Network."""
    made = make_experiment(
        folder / "made",
        values=lambda treatments, repetition: {"Energy": watts[treatments["Task"]][repetition - 1]},
        repetitions=len(watts["Video"]),
        doubts=doubts,
        **more,
    )
    return load_results(made.root)


def standing(folder: Path, watts: dict[str, list[float]], doubts: dict[str, str], **more: Any) -> Standing:
    [one] = analyse(results(folder, watts, doubts, **more)).standings
    return one


def test_where_no_value_is_doubtful_nothing_is_computed_twice(tmp_path: Path) -> None:
    statistics = analyse(results(tmp_path, FAR, {}))
    assert (statistics.without_doubtful, statistics.standings) == ((), ())


@pytest.mark.long
def test_all_values_count_whatever_their_quality(tmp_path: Path) -> None:
    with_doubts = analyse(results(tmp_path / "a", FAR, {"r_1": HOT}))
    without = analyse(results(tmp_path / "b", FAR, {}))
    assert with_doubts.measures == without.measures


def test_an_effect_that_doubtful_values_do_not_make_stands(tmp_path: Path) -> None:
    one = standing(tmp_path, FAR, {"r_1": HOT, "r_8": HOT})
    assert one.stands is True
    assert one.left_out == ("r_1", "r_8")
    assert "Without the 2 runs whose Energy is doubtful (r_1, r_8), the effect of Task on Energy is" in one.conclusion
    assert one.conclusion.endswith("the conclusion stands.")


def test_an_effect_that_doubtful_values_make_does_not_stand(tmp_path: Path) -> None:
    watts = {"Video": [*NEAR["Video"][:3], 8.0, 8.1, 7.9], "Network": [*NEAR["Network"][:3], 12.0, 12.1, 11.9]}
    one = standing(tmp_path, watts, {f"r_{number}": HOT for number in range(7, 13)})
    assert one.p_value is not None
    assert one.p_value_without is not None
    assert one.p_value < 0.05 < one.p_value_without
    assert one.stands is False
    assert "is no longer significant" in one.conclusion


@pytest.mark.long
def test_an_effect_that_doubtful_values_turn_does_not_stand(tmp_path: Path) -> None:
    watts = {"Video": [*FAR["Video"], *(value + 8 for value in FAR["Video"] * 3)], "Network": FAR["Network"] * 4}
    one = standing(tmp_path, watts, {f"r_{number}": HOT for number in range(13, 49, 2)})
    assert one.stands is False
    assert "significant in the other direction" in one.conclusion


@pytest.mark.long
@pytest.mark.parametrize("contrast", [{}, {"contrast": {"Video": 1, "Network": -1}}], ids=["effect", "contrast"])
def test_a_hypothesis_whose_difference_doubtful_values_turn_does_not_stand(
    tmp_path: Path, contrast: dict[str, Any]
) -> None:
    watts = {"Video": [*FAR["Video"], *(value + 8 for value in FAR["Video"] * 3)], "Network": FAR["Network"] * 4}
    plan = {**PLAN, "hypotheses": [{**PLAN["hypotheses"][0], **contrast}]}
    doubts = {f"r_{number}": HOT for number in range(13, 49, 2)}
    found = analyse(results(tmp_path, watts, doubts, analysis=plan))
    [one] = [each for each in found.standings if each.statement]
    assert (found.hypotheses[0].is_supported, one.stands) == (True, False)
    assert "the data support it in the other direction (p < 0.001 after correction)" in one.conclusion


def test_what_cannot_be_computed_without_them_is_not_known(tmp_path: Path) -> None:
    one = standing(tmp_path, FAR, {f"r_{number}": HOT for number in range(2, 13)})
    assert one.stands is None
    assert "cannot be tested" in one.conclusion


def test_hypotheses_are_judged_again(tmp_path: Path) -> None:
    found = analyse(results(tmp_path, FAR, {"r_1": HOT}, analysis=PLAN)).standings
    assert [(one.label, one.stands) for one in found] == [("Task", True), ("Tasks differ.", True)]
    assert "the data still support it" in found[1].conclusion


def test_quality_is_told_by_run_and_column(tmp_path: Path) -> None:
    quality = results(tmp_path, FAR, {"r_2": HOT}).quality
    assert list(quality.columns) == ["run_id", "measure", "quality", "reasons"]
    assert len(quality) == 12
    row = quality.set_index("run_id").loc["r_2"]
    assert (row["measure"], row["quality"], row["reasons"]) == ("Energy", "doubtful", HOT)
    assert (quality["quality"] == "good").sum() == 11


def test_the_schema_tells_of_quality_where_there_is_no_journal(tmp_path: Path) -> None:
    made = results(tmp_path, FAR, {"r_2": HOT})
    (made.folder / "journal.jsonl").unlink()
    quality = load_results(made.folder).quality
    assert list(quality.loc[quality["quality"] == "doubtful", "reasons"]) == [HOT]


def test_columns_of_qualities_are_no_measures(tmp_path: Path) -> None:
    made = make_experiment(
        tmp_path / "made",
        values=lambda _treatments, _repetition: {"Energy": 1.0, "Energy.quality": "good"},
        measures=("Energy", "Energy.quality"),
    )
    assert load_results(made.root).measures == ("Energy",)


@pytest.mark.long
@pytest.mark.parametrize("kind", soak_but({"md", "json"}, ["html", "md", "json"]))
def test_the_report_says_what_is_doubtful_and_what_stands(tmp_path: Path, kind: str) -> None:
    made = results(tmp_path, FAR, {"r_1": HOT, "r_8": HOT})
    written = write_report(made, ReportFormat(kind), figures=())
    said = " ".join(written.document.read_text(encoding="utf-8").replace("\\", "").split())
    assert HOT in said
    assert "Energy has doubtful values" in said
    assert "the conclusion stands." in said
    if kind == "html":
        assert "2 values doubtful or missing" in said
    if kind != "json":
        assert "Doubtful and missing values" in said
        latex = {path.name: path.read_text(encoding="utf-8") for path in written.tables if path.suffix == ".tex"}
        assert "stands" in latex["without_doubtful.tex"]
        assert HOT in latex["doubtful_values.tex"]


@pytest.mark.long
def test_a_report_without_doubtful_values_says_nothing_of_them(tmp_path: Path) -> None:
    written = write_report(results(tmp_path, FAR, {}), ReportFormat.MARKDOWN, figures=())
    assert "oubtful" not in written.document.read_text(encoding="utf-8")


def test_in_brief_many_conclusions_that_share_a_verdict_take_one_sentence() -> None:
    def told(label: str, stands: bool | None, beside: Beside = Beside.WITHOUT_DOUBTFUL) -> Standing:
        said = {True: "stands", False: "does not stand", None: "is not known"}[stands]
        return Standing("Energy", (label,), "", ("r_1", "r_2"), 0.5, 0.5, stands, f"{label} {said}.", beside)

    few = [told("A", True), told("B", True), told("A x B", None)]
    assert list(gathered(few, most=2)) == ["A stands.", "B stands.", "A x B is not known."]
    left_out = "Without the 2 runs whose Energy is doubtful (r_1, r_2),"
    unknown = [told(label, None) for label in ("A", "B", "A x B")]
    assert list(gathered(unknown, most=2)) == [
        f"{left_out} 3 effects on Energy cannot be tested: whether these conclusions stand is not known."
    ]
    most = [told("A", False), *(told(label, True) for label in ("B", "C", "B x C"))]
    others = [told(label, True, Beside.WITHOUT_COVARIATES) for label in ("A", "B", "C")]
    assert list(gathered([*most, *others], most=2)) == [
        "A does not stand.",
        f"{left_out} 3 other conclusions on Energy stand.",
        "A stands.",
        "B stands.",
        "C stands.",
    ]
