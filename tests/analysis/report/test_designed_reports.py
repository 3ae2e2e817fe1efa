"""Reports of designs of their own: sentences agree with tests; aliases, surfaces and failures are shown."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest
from tests.analysis.experiment_folders import searched
from tests.analysis.made_experiment import make_experiment
from tests.analysis.report.agreement import disagreements
from tests.long_cases import long_but, soak_but

from robot_runner.analysis import DeclaredDesign, load_results, with_declared_design
from robot_runner.analysis.report.blocks import FigureBlock, Paragraph, Part
from robot_runner.analysis.report.design_section import searched_part
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.outcome_section import failed_pairs
from robot_runner.analysis.report.surface_part import surface_parts
from robot_runner.analysis.report.writing import ReportFormat, write_report
from robot_runner.analysis.statistics.experiment_statistics import analyse
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.numeric_range import Range
from robot_runner.core.design.outliers import Doubtful
from robot_runner.designs.blocked import Blocks
from robot_runner.designs.covering import CoveringArray
from robot_runner.designs.crossover import Crossover
from robot_runner.designs.fractional import FractionalFactorial
from robot_runner.designs.one_at_a_time import OneFactorAtATime
from robot_runner.designs.optimal import DOptimal
from robot_runner.designs.response_surface import CentralComposite
from robot_runner.designs.space_filling import LatinHypercube
from robot_runner.designs.split_plot import SplitPlot
from robot_runner.designs.squares import LatinSquare

if TYPE_CHECKING:
    from pathlib import Path

TWO = [Factor(name, ["low", "high"]) for name in ("Speed", "Load", "Map", "Light")]
THREE = [Factor(name, ["a", "b", "c"]) for name in ("Planner", "Camera")]
NUMBERS = [Factor("Speed", Range(0.1, 0.3)), Factor("Load", Range(0.0, 2.0))]
DESIGNS = {
    "fraction": (TWO, FractionalFactorial(resolution=4), 1),
    "repeated fraction": (TWO, FractionalFactorial(resolution=4), 3),
    "covering array": ([*TWO, *THREE], CoveringArray(strength=3), 2),
    "one at a time": (TWO, OneFactorAtATime(base={each.name: "low" for each in TWO}), 4),
    "D-optimal": ([*TWO, *THREE], DOptimal(runs=16), 1),
    "D-optimal, interactions": (TWO[:3], DOptimal(runs=8, model="interactions"), 2),
    "central composite": (NUMBERS, CentralComposite(), 1),
    "Latin hypercube": (NUMBERS, LatinHypercube(runs=14), 1),
    "Latin square": ([Factor("Day", [1, 2, 3]), Factor("Hour", [1, 2, 3]), THREE[0]], LatinSquare("Day", "Hour"), 2),
    "crossover": (
        [Factor("Robot", list("ABCDEF")), Factor("Period", [1, 2, 3]), THREE[0]],
        Crossover("Robot", "Period"),
        1,
    ),
    "split plot": ([Factor("Plot", [1, 2, 3, 4]), *TWO[:2]], SplitPlot("Speed", "Plot"), 2),
    "incomplete blocks": ([Factor("Day", [1, 2, 3]), THREE[0]], Blocks("Day"), 2),
}
SHORT = ["incomplete blocks", "Latin square", "central composite"]
LONG = ["fraction", "one at a time", "D-optimal, interactions", "crossover", "split plot"]
#: What is written of their tests is as of one of these.
LIKE_OTHERS = ["repeated fraction", "covering array", "D-optimal", "Latin hypercube"]


def report_of(folder: Path) -> dict[str, Any]:
    written = write_report(load_results(folder), ReportFormat.JSON, output=folder.parent / "out")
    return json.loads(written.document.read_text(encoding="utf-8"))


def made(folder: Path, design: str, size: float) -> Path:
    factors, chosen, repetitions = DESIGNS[design]
    random = np.random.default_rng(len(design))

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        shift = sum(size * (str(each) in {"high", "c"}) for each in treatments.values())
        shift += sum(
            10 * size * (float(each) - 0.2) ** 2 for name, each in treatments.items() if isinstance(each, float)
        )
        return {"Energy": 50 + shift + float(random.normal())}

    return make_experiment(folder, factors, values, repetitions=repetitions, shuffle=True, chosen=chosen).root


@pytest.mark.parametrize("design", [*long_but(SHORT, [*SHORT, *LONG]), *soak_but([], LIKE_OTHERS)])
def test_sentences_agree_with_the_tests_of_every_design(tmp_path: Path, design: str) -> None:
    for size in (0.0, 6.0):
        report = report_of(made(tmp_path / f"{size:g}" / "experiment", design, size))
        assert list(disagreements(report)) == []
        (measure,) = report["statistics"]["measures"]
        assert measure["test"] is not None, measure["not_computed"]
        blocks = {"Day", "Hour", "Robot", "Period", "Plot"}
        assert not blocks & {name for effect in measure["test"]["effects"] for name in effect["factors"]}
        for effect in measure["test"]["effects"]:
            for alias in effect["aliases"]:
                assert " x ".join(alias) in effect["conclusion"]
        assert bool(measure["surface"]) is (design in {"central composite", "Latin hypercube"})


@pytest.mark.long
def test_a_surface_is_drawn_and_told(tmp_path: Path) -> None:
    folder = made(tmp_path / "experiment", "central composite", 6.0)
    written = write_report(load_results(folder), ReportFormat.HTML, output=tmp_path / "out", figures=())
    page = written.document.read_text(encoding="utf-8")
    for words in ("Response surface", "Its stationary point is", "lack of fit: F(", "Curvatures along its own axes"):
        assert words in page
    assert "Interaction of Speed and Load on Energy." not in page  # its lines would hang on few runs each


@pytest.mark.parametrize(
    ("middle", "signs"),
    [(0.2, "points are runs, a dashed line the stationary point."), (0.9, "points are runs.")],
)
def test_a_surface_over_one_factor_is_described_as_the_curve_that_is_drawn(
    tmp_path: Path, middle: float, signs: str
) -> None:
    def values(run: dict[str, Any], repetition: int) -> dict[str, Any]:
        return {"Energy": 100 * (run["Speed"] - middle) ** 2 + repetition / 100}

    folder = make_experiment(tmp_path / "experiment", [Factor("Speed", [0.1, 0.2, 0.3])], values)
    declared = DeclaredDesign.of_mapping({"kind": "response_surface"})
    results = with_declared_design(load_results(folder.root), declared, "the test")
    material = Material(results, analyse(results))
    (part,) = surface_parts(material, material.statistics.measure("Energy"))
    assert isinstance(part, Part)
    (figure,) = (block for block in part.blocks if isinstance(block, FigureBlock))
    assert figure.caption == f"Response surface of Energy over Speed; {signs}"
    assert figure.alternative == "Curve of Energy over Speed."


def test_a_surface_says_over_which_factors_it_is_averaged(tmp_path: Path) -> None:
    def values(run: dict[str, Any], repetition: int) -> dict[str, Any]:
        speed, load = float(run["Speed"]), float(run["Load"])
        height = 8.0 * (run["Map"] == "high")
        return {"Energy": 100 * (speed - 0.2) ** 2 + (load - 1) ** 2 + height + speed * load / 1000 + repetition}

    folder = make_experiment(
        tmp_path / "experiment", [*NUMBERS, TWO[2]], values, repetitions=2, chosen=LatinHypercube(runs=16)
    )
    material = Material(results := load_results(folder.root), analyse(results))
    (part,) = surface_parts(material, material.statistics.measure("Energy"))
    assert isinstance(part, Part)
    told = [block.text for block in part.blocks if isinstance(block, Paragraph)]
    assert told[0] == (
        "The surface is that of the average over the treatments of Map, which are taken to shift it as a whole: "
        "whether they change its shape or its optimum is not tested."
    )
    assert "; on average over Map, Energy is 5.5" in " ".join(told)
    (figure,) = (block for block in part.blocks if isinstance(block, FigureBlock))
    assert figure.caption.startswith("Response surface of Energy over Load and Speed, on average over Map; points are ")


def test_failures_are_told_by_pairs_of_treatments() -> None:
    rows = [
        ("x", "p", "Done"),
        ("x", "q", "Failed"),
        ("y", "q", "Done"),
        ("x", "q", "Failed"),
        ("y", "p", "Failed"),
        ("y", "p", "Done"),
    ]
    found = failed_pairs(pd.DataFrame(rows, columns=["A", "B", "status"]), ("A", "B"))
    assert [tuple(each) for each in found] == [("A = x, B = q", 2, 2), ("A = y, B = p", 2, 1)]


def test_what_a_search_tried_is_told_without_the_values_that_the_plan_leaves_out(tmp_path):
    folder = searched(tmp_path / "trial", [("a", 1, 9.0), ("a", 1, 1.0), ("b", 1, 5.0)], is_confirmed=False)
    journal, manifest = folder / "journal.jsonl", json.loads((folder / "manifest.json").read_text())
    doubtful = {"E": {"value": 1.0, "owner": "config", "origin": "measured", "doubts": ["it was dark"]}}
    records = [json.loads(line) for line in journal.read_text().splitlines()]
    kept = [
        each | {"measures": doubtful} if (each["kind"], each.get("run")) == ("attempt_finished", "r_2") else each
        for each in records
    ]
    journal.write_text("".join(f"{json.dumps(each, separators=(',', ':'))}\n" for each in kept))
    manifest["design"]["parameters"] = {"directions": {"E": "minimise"}}
    for rule, mean in ((Doubtful.KEEP, 5.0), (Doubtful.LEAVE_OUT, 9.0)):
        plan = AnalysisPlan(measures=["E"], doubtful=rule).as_mapping()
        (folder / "manifest.json").write_text(json.dumps(manifest | {"analysis": plan}))
        results = load_results(folder)
        [part] = searched_part(Material(results, analyse(results)))
        [table] = part.blocks
        assert table.rows[0][-1].value == mean
        assert ("left out, as planned" in table.note) is (rule is Doubtful.LEAVE_OUT)
