"""Results made elsewhere are analysed by the design that their user declares: figures of Montgomery 2013."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from tests.analysis.statistics.designed_data import FILTRATION_HALF, PAPER, PROCESS, PROPELLANTS

from robot_runner.analysis import DeclaredDesign, analyse, load_results, with_declared_design
from robot_runner.analysis.importing.adoption import adopt
from robot_runner.analysis.importing.description import ImportDescription, description_text, read_description
from robot_runner.analysis.importing.understanding import understand
from robot_runner.core.errors import AnalysisError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from robot_runner.analysis.results import Results


def table(folder: Path, headings: str, rows: Iterable[Iterable[Any]]) -> Path:
    folder.mkdir(parents=True)
    lines = [headings, *(",".join(map(str, row)) for row in rows)]
    (folder / "run_table.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def imported(root: Path, declared: dict[str, Any] | None, **said: Any) -> Results:
    design = None if declared is None else DeclaredDesign.of_mapping(declared)
    target = root.parent / f"{root.name}_{'with' if design else 'without'}"
    adopt(understand(root, ImportDescription(design=design, **said)), target)
    return load_results(target)


def figures(results: Results) -> dict[str, tuple[float, ...]]:
    found = analyse(results).measure("y")
    assert found.test is not None, found.not_computed
    return {":".join(each.factors): (each.statistic, *each.degrees_of_freedom) for each in found.test.effects}


PLOTS = [(f"{rep}/{method}", rep, method, heat, y) for rep, method, heat, y in PAPER]


@pytest.mark.long
def test_a_split_plot_has_the_errors_of_the_textbook_once_it_is_declared(tmp_path: Path) -> None:
    root = table(tmp_path / "paper", "batch,rep,method,temperature,y", PLOTS)
    columns = {"factors": ("method", "temperature"), "measures": ("y",)}
    declared = {"kind": "split_plot", "plot": "batch", "blocks": "rep"}
    results = imported(root, declared, **columns)
    found = figures(results)
    assert found["method"] == pytest.approx((7.08, 2, 4), abs=0.005)  # table 14.15
    assert found["temperature"] == pytest.approx((36.43, 3, 18), abs=0.005)
    assert results.manifest["design"]["facts"]["declared"] == "the import"
    # Imported without a word, it is declared when the report is made.
    plain = imported(root, None, ignore=("batch", "rep"), **columns)
    assert figures(plain)["method"][-1] > 10, "runs of one batch pass for independent ones"
    columns["factors"] += ("batch", "rep")
    kept = imported(table(tmp_path / "again", "batch,rep,method,temperature,y", PLOTS), None, **columns)
    later = with_declared_design(kept, DeclaredDesign.of_mapping(declared), "plan.toml")
    assert figures(later) == {name: pytest.approx(each) for name, each in found.items()}


@pytest.mark.long
def test_a_square_a_fraction_a_surface_and_a_base_are_analysed_as_such(tmp_path: Path) -> None:
    rows = [(batch, operator, letter, y) for batch, operator, letter, _, y in PROPELLANTS]
    square = table(tmp_path / "square", "batch,operator,formulation,y", rows)
    found = figures(imported(square, {"kind": "latin_square", "rows": "batch", "columns": "operator"}))
    assert found == {"formulation": pytest.approx((330 / 4 / (128 / 12), 4, 12))}  # table 4.12
    half = imported(table(tmp_path / "half", "A,B,C,D,y", FILTRATION_HALF), {"kind": "fractional_factorial"})
    effects = analyse(half).measure("y").test.effects
    assert effects[0].label == "A (aliased with B x C x D)"
    assert len(effects) == 7
    process = table(tmp_path / "process", "time,heat,y", PROCESS)
    ranges = {"time": [80, 90], "heat": [170, 180]}
    surface = analyse(imported(process, {"kind": "response_surface", "ranges": ranges})).measure("y").surface
    estimates = {each.label: each.estimate for each in surface.coefficients}
    assert estimates["time^2"] == pytest.approx(-1.38, abs=0.006)  # table 11.7
    assert surface.stationary.value == pytest.approx(80.21, abs=0.005)
    lines = [("low", "low", 3.0 + place / 8) for place in range(4)]
    lines += [(one, other, 5.0 + place / 8) for one, other in (("high", "low"), ("low", "high")) for place in range(4)]
    base = {"kind": "one_factor_at_a_time", "base": {"a": "low", "b": "low"}}
    of_base = analyse(imported(table(tmp_path / "base", "a,b,y", lines), base)).measure("y").test
    assert [each.label for each in of_base.effects] == ["a", "b"]
    assert any("compared with the base alone" in note for note in of_base.notes)


@pytest.mark.long
def test_a_declaration_goes_through_a_file_and_back_and_by_an_option(tmp_path: Path, robot_runner: Any) -> None:
    root = table(tmp_path / "paper", "batch,rep,method,temperature,y", PLOTS)
    words = ("import", root, "--yes", "--factor", "method", "--factor", "temperature", "--measure", "y")
    answer = robot_runner(
        *words, "--design", "split_plot:plot=batch,blocks=rep", "--to", "ours", "--save-description", "said.toml"
    )
    assert answer.code == 0, answer.err
    assert "declared as split plot (plot batch, blocks rep)" in " ".join(answer.out.split())
    said = read_description(tmp_path / "said.toml")
    assert said.design == DeclaredDesign.of_mapping({"kind": "split_plot", "plot": "batch", "blocks": "rep"})
    surface = DeclaredDesign.of_mapping({"kind": "response_surface", "ranges": {"speed [m/s]": [0.1, 0.3]}})
    (tmp_path / "surface.toml").write_text(description_text(ImportDescription(design=surface)), encoding="utf-8")
    assert read_description(tmp_path / "surface.toml").design == surface
    assert robot_runner("import", root, "--yes", "--description", "said.toml", "--to", "again").code == 0
    assert figures(load_results(tmp_path / "again")) == figures(load_results(tmp_path / "ours"))
    # A plan may declare it: in the report it says where it was declared.
    assert robot_runner(*words, "--factor", "rep", "--factor", "batch", "--to", "plain").code == 0
    (tmp_path / "plan.toml").write_text('[design]\nkind = "split_plot"\nplot = "batch"\nblocks = ["rep"]\n')
    answer = robot_runner("report", "plain", "--plan", "plan.toml", "--format", "json", "--figures", "none")
    assert answer.code == 0, answer.err
    text = (tmp_path / "plain" / "report" / "report.json").read_text(encoding="utf-8")
    effects = json.loads(text)["statistics"]["measures"][0]["test"]["effects"]
    assert effects[0]["degrees_of_freedom"] == [2, 4]
    words = ("--plan", "plan.toml", "--format", "md", "--figures", "none")
    assert robot_runner("report", "ours", *words).code == 0
    text = (tmp_path / "ours" / "report" / "report.md").read_text(encoding="utf-8")
    assert "declared in plan.toml, and not by what executed the runs: split plot (plot batch, blocks rep)" in text


@pytest.mark.parametrize(
    ("declared", "problems"),
    [
        ({"kind": "split_plt", "plot": "batch"}, ["no kind of design 'split_plt' → Did you mean 'split_plot'?"]),
        (
            {"kind": "crossover", "unt": "rep", "washout": "soon"},
            [
                "a crossover has no 'unt' → Did you mean 'unit'?",
                "takes the column of its unit",
                "takes the column of its period",
                "washout is 'soon'",
            ],
        ),
        ({"kind": "split_plot", "plot": "bach"}, ["no column 'bach' → Did you mean 'batch'?"]),
        ({"kind": "split_plot", "plot": "y"}, ["'y' is a measure of these results"]),
        ({"kind": "split_plot", "plot": ["rep", "batch"]}, ["plot is rep and batch → Name one column."]),
        ({"kind": "split_plot", "plot": "rep"}, ["no factor stays as it is for a whole plot (rep)"]),
        (
            {"kind": "crossover", "unit": "batch", "period": "rep"},
            ["4 combinations of method and temperature, and should have one"],
        ),
        (
            {"kind": "latin_square", "rows": "rep", "columns": "method"},
            ["combinations of batch and temperature, and should have one"],
        ),
        (
            {"kind": "one_factor_at_a_time", "base": {"method": "m9", "temprature": 200}},
            ["there is no factor 'temprature' → Did you mean 'temperature'?"],
        ),
        ({"kind": "one_factor_at_a_time", "base": {"method": "m9"}}, ["method = 'm9', which no run has"]),
        ({"kind": "response_surface", "ranges": {"method": [1, 1]}}, ["the range of method is [1, 1]"]),
    ],
)
def test_what_the_runs_cannot_have_been_planned_by_is_refused_with_everything_at_once(
    tmp_path: Path, declared: dict[str, Any], problems: list[str]
) -> None:
    root = table(tmp_path / "paper", "batch,rep,method,temperature,y", PLOTS)
    factors = ("batch", "rep", "method", "temperature")
    results = imported(root, None, factors=factors, measures=("y",))
    with pytest.raises(AnalysisError) as caught:
        with_declared_design(results, DeclaredDesign.of_mapping(declared, "plan.toml"), "plan.toml")
    told = "\n".join(map(str, caught.value.findings or [caught.value]))
    assert [each for each in problems if each not in told] == []
