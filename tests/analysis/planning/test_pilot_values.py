"""A pilot tells means, spreads and how blocks vary, as they were drawn."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy import stats
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis import load_results
from robot_runner.analysis.planning.assumed_values import AssumedMeasure
from robot_runner.analysis.planning.pilot_values import pilot_values
from robot_runner.analysis.planning.planned_study import Study
from robot_runner.analysis.planning.power_analysis import Assumptions, power_analysis, scenarios_of
from robot_runner.analysis.planning.power_search import Search
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import AnalysisError
from robot_runner.designs import Blocks, Crossover, SplitPlot

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.analysis.results import Results

TASK = Factor("Task", ["Video", "Network"])
ROBOT = Factor("Robot", [f"robot {number}" for number in range(40)])


def study_of(*factors: Factor, blocks: str | None = None) -> Study:
    model = RunTableModel(list(factors), repetitions=4, blocks=blocks)
    return Study.of_model("study", model, AnalysisPlan("Energy"), {"Energy": "J"})


def pilot_of(root: Path, study: Study, assumed: AssumedMeasure, repetitions: int) -> Results:
    """Return a pilot whose values are drawn as is assumed; its blocks are those of the study."""
    place = list(study.factors).index("Robot") if study.blocks == "Robot" else None
    cells = [study.cells[number] for number in study.cells_of(repetitions)]
    blocks = [
        cell[place] if place is not None else f"{number // len(study.cells)}" for number, cell in enumerate(cells)
    ]
    # Blocks respond to tasks, and a robot is no task.
    if place is not None:
        cells = [tuple(text for at, text in enumerate(cell) if at != place) for cell in cells]
    names = [name for name in study.factors if place is None or name != "Robot"]
    (values,) = assumed.draw(np.random.default_rng(5), 1, names, cells, blocks)

    def value(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        cell = tuple(map(str, treatments.values()))
        return {"Energy": float(values[(repetition - 1) * len(study.cells) + study.cells.index(cell)])}

    factors = [Factor(name, list(texts)) for name, texts in study.factors.items()]
    made = make_experiment(root, factors, value, repetitions=repetitions, units={"Energy": "J"}, blocks=study.blocks)
    return load_results(made.root)


def assumed(spread: float = 10.0, *, block_sd: float = 0.0, response_sd: float = 0.0) -> AssumedMeasure:
    means: dict[tuple[str, ...], float] = {("Video",): 100.0, ("Network",): 120.0}
    spreads: dict[tuple[str, ...], float] = {("Video",): spread, ("Network",): 2 * spread}
    return AssumedMeasure("Energy", means, spreads, block_sd, {("Task",): response_sd} if response_sd else {})


def test_means_and_spreads_of_combinations_are_those_that_were_drawn(tmp_path: Path) -> None:
    study = study_of(TASK)
    found = pilot_values(study, pilot_of(tmp_path / "pilot", study, assumed(), 200), ["Energy"]).measures["Energy"]
    assert found.means[("Network",)] - found.means[("Video",)] == pytest.approx(20, abs=4)
    assert [found.spreads[cell] for cell in study.cells] == pytest.approx([10, 20], rel=0.12)
    assert (found.block_sd, found.responses) == (0, {})


def test_a_pilot_in_another_unit_is_converted_and_one_of_another_quantity_refused(tmp_path: Path) -> None:
    study = study_of(TASK)
    pilot = pilot_of(tmp_path / "pilot", study, assumed(), 10)
    joules = pilot_values(study, pilot, ["Energy"]).measures["Energy"]
    in_kilojoules = pilot_values(replace(study, units={"Energy": "kJ"}), pilot, ["Energy"])
    for ours, theirs in zip(
        (joules.means, joules.spreads),
        (in_kilojoules.measures["Energy"].means, in_kilojoules.measures["Energy"].spreads),
        strict=True,
    ):
        assert [1000 * theirs[cell] for cell in study.cells] == pytest.approx([ours[cell] for cell in study.cells])
    told = "Energy is in J in the pilot, and in kJ in the config: its values are converted to kJ."
    assert told in in_kilojoules.notes
    with pytest.raises(AnalysisError, match="The units are W and J, which measure different quantities"):
        pilot_values(replace(study, units={"Energy": "W"}), pilot, ["Energy"])
    assert pilot_values(replace(study, units={"Energy": ""}), pilot, ["Energy"]).measures["Energy"] == joules


def test_spreads_of_few_runs_are_pooled(tmp_path: Path) -> None:
    study = study_of(TASK)
    found = pilot_values(study, pilot_of(tmp_path / "pilot", study, assumed(), 3), ["Energy"]).measures["Energy"]
    assert len(set(found.spreads.values())) == 1


def test_blocks_are_told_from_chance(tmp_path: Path) -> None:
    study = study_of(TASK, blocks="Repetition")
    drawn = pilot_of(tmp_path / "pilot", study, assumed(block_sd=30.0), 120)
    found = pilot_values(study, drawn, ["Energy"]).measures["Energy"]
    assert found.block_sd == pytest.approx(30, rel=0.2)
    one, other = (found.spreads[cell] for cell in study.cells)
    assert np.hypot(one, other) == pytest.approx(np.hypot(10, 20), rel=0.15)


def test_responses_of_robots_are_told_from_chance(tmp_path: Path) -> None:
    study = study_of(ROBOT, TASK, blocks="Robot")
    drawn = pilot_of(tmp_path / "pilot", study, assumed(block_sd=30.0, response_sd=15.0), 6)
    found = pilot_values(study, drawn, ["Energy"]).measures["Energy"]
    assert found.block_sd == pytest.approx(30, rel=0.35)
    assert found.responses == {("Task",): pytest.approx(15, rel=0.35)}


MAP = Factor("Map", ["lab", "hall"])


@pytest.mark.long
def test_how_robots_respond_to_each_factor_is_told_apart(tmp_path: Path) -> None:
    """By one response to combinations, Task would be tested against less than half the variance that it has."""
    study, cells = study_of(ROBOT, TASK, MAP, blocks="Robot"), list(product(("Video", "Network"), ("lab", "hall")))
    drawn = AssumedMeasure("Energy", dict.fromkeys(cells, 100.0), dict.fromkeys(cells, 5.0), 30.0, {("Task",): 15.0})
    for repetitions, spread in ((3, 5.0), (1, 5.0)):
        pilot = pilot_of(tmp_path / f"{repetitions}", study, drawn, repetitions)
        found = pilot_values(study, pilot, ["Energy"]).measures["Energy"]
        assert found.block_sd == pytest.approx(30, rel=0.35)
        assert found.responses["Task",] == pytest.approx(15, rel=0.3)
        assert all(size < 3 for term, size in found.responses.items() if term != ("Task",))
        assert np.mean(list(found.spreads.values())) == pytest.approx(spread, rel=0.15)


@pytest.mark.long
def test_a_pilots_answers_are_planned_with_and_can_be_left_out(tmp_path: Path) -> None:
    plan = AnalysisPlan(["Energy", "Ok"])
    study = Study.of_model("study", RunTableModel([TASK], repetitions=4), plan, {"Energy": "J", "Ok": ""})
    random = np.random.default_rng(3)
    made = make_experiment(
        tmp_path / "pilot",
        [TASK],
        lambda _, number: {"Energy": float(random.normal(100)), "Ok": number % 3 > 0},
        repetitions=8,
        measures=["Energy", "Ok"],
    )
    pilot = load_results(made.root)
    both = Assumptions(pilot=pilot, shares=["Ok=50"], differences=["Energy:Task=2", "Ok:Task=60"])
    found = power_analysis(
        study, replace(both, pilot=None, spreads=["Energy=1"]), Search(first=4, last=4, simulations=100)
    )
    assert [claim.measure for claim in found.scenarios[-1].claims] == ["Energy", "Ok"]
    (energy, ok) = scenarios_of(study, both)[0].measures
    assert (energy.is_share, ok.is_share) == (False, True)
    assert list(ok.means.values()) == pytest.approx([50, 50]), "the share of all runs is the stated one"
    assumptions = Assumptions(pilot=pilot, measures=["Energy"], differences=["Task=2"])
    found = power_analysis(study, assumptions, Search(first=4, last=4, simulations=100))
    assert [claim.label for claim in found.scenarios[-1].claims] == ["effect of Task on Energy"]
    (note,) = [note for note in found.notes if "controlled together" in note]
    assert "those of Ok, of which nothing is assumed" in note


@pytest.mark.long
def test_a_pilot_answers_at_its_own_effect_and_at_the_smallest_of_interest(tmp_path: Path) -> None:
    study = study_of(TASK)
    pilot = pilot_of(tmp_path / "pilot", study, assumed(), 10)
    assumptions = Assumptions(pilot=pilot, differences=["Task=10"])
    found = power_analysis(study, assumptions, Search(last=80, simulations=500))
    of_pilot, of_interest = found.scenarios
    assert "pilot" in of_pilot.scenario.title
    assert "interest" in of_interest.scenario.title
    assert of_pilot.needed is not None
    assert of_interest.needed is not None
    assert of_pilot.needed.repetitions < of_interest.needed.repetitions
    assert any("uncertain" in note for note in found.notes)
    # The spreads are the pilot's, the difference is the stated one.
    (interest,) = of_interest.scenario.measures
    (own,) = of_pilot.scenario.measures
    assert interest.spreads == own.spreads
    assert interest.means[("Network",)] - interest.means[("Video",)] == pytest.approx(10)


@pytest.mark.parametrize(
    ("study", "measure", "told"),
    [
        (study_of(Factor("Task", ["Video", "Idle"])), "Energy", "no runs with Task = Idle"),
        (study_of(TASK), "Enerjy", "no measure 'Enerjy'"),
    ],
)
def test_a_pilot_that_lacks_something_is_refused(tmp_path: Path, study: Study, measure: str, told: str) -> None:
    pilot = pilot_of(tmp_path / "pilot", study_of(TASK), assumed(), 3)
    with pytest.raises(AnalysisError, match=told) as raised:
        pilot_values(study, pilot, [measure])
    assert raised.value.fix


def test_a_pilot_without_repetitions_has_no_spread(tmp_path: Path) -> None:
    study = study_of(TASK)
    with pytest.raises(AnalysisError, match="single run"):
        pilot_values(study, pilot_of(tmp_path / "pilot", study, assumed(), 1), ["Energy"])


def test_factors_that_the_pilot_did_not_vary_have_no_effect(tmp_path: Path) -> None:
    pilot = pilot_of(tmp_path / "pilot", study_of(TASK), assumed(), 20)
    found = pilot_values(study_of(TASK, Factor("Speed", [0.1, 0.2])), pilot, ["Energy"])
    means = found.measures["Energy"].means
    assert means["Video", "0.1"] == means["Video", "0.2"] < means["Network", "0.1"]
    assert any("Speed" in note for note in found.notes)


def test_a_spread_that_is_given_takes_the_place_of_the_pilots(tmp_path: Path) -> None:
    study = study_of(TASK)
    pilot = pilot_of(tmp_path / "pilot", study, assumed(), 6)
    (told,) = scenarios_of(study, Assumptions(pilot=pilot, spreads=["40"]))
    assert (told.title, set(told.measures[0].spreads.values())) == ("the pilot's effects", {40.0})


def test_how_little_a_small_pilot_knows_of_the_spread_is_told(tmp_path: Path) -> None:
    study = study_of(TASK)
    quick = Search(first=5, last=6, simulations=20)

    def told(repetitions: int, *spreads: str) -> list[str]:
        pilot = pilot_of(tmp_path / f"pilot_{repetitions}_{len(spreads)}", study, assumed(), repetitions)
        found = power_analysis(study, Assumptions(pilot=pilot, spreads=spreads), quick)
        return [note for note in found.notes if "standard deviation" in note]

    (note,) = told(3)
    spread = pilot_values(study, load_results(tmp_path / "pilot_3_0"), ["Energy"]).measures["Energy"].spreads
    at_most = next(iter(spread.values())) * math.sqrt(4 / stats.chi2.ppf(0.2, 4))
    assert "4 degrees of freedom" in note
    assert "1.56 times" in note
    assert f"--sd Energy={at_most:.3g}" in note
    assert told(3, "40") == []  # it is not the pilot's
    assert told(40) == []


def test_values_that_do_not_vary_have_no_power(tmp_path: Path) -> None:
    study = study_of(TASK)
    given = [
        Assumptions(spreads=["0"], differences=["Task=5"]),
        Assumptions(pilot=pilot_of(tmp_path / "pilot", study, assumed(spread=0.0), 4)),
    ]
    for assumptions in given:
        told = "assumed to have the same Energy, so that nothing can be tested.*AnalysisPlan"
        with pytest.raises(AnalysisError, match=f"(?s){told}"):
            scenarios_of(study, assumptions)


def test_what_an_extension_changed_is_not_spread_and_costs_a_degree_of_freedom() -> None:
    study = study_of(TASK)
    # Between the batches Video grows by 4 and Network by 10: 1.5 of each run is left, with one degree of freedom.
    extended = study.results(2, {"Energy": np.array([100.0, 120.0, 104.0, 130.0])}, first_batch=1)
    found = pilot_values(study, extended, ["Energy"])
    assert found.measures["Energy"].spreads[("Video",)] == pytest.approx(3.0)
    assert found.freedoms["Energy"] == 1


def test_batches_of_different_sizes_are_told_from_combinations() -> None:
    study = study_of(TASK)
    values = np.array([100.0, 120.0, 104.0, 130.0, 112.0, np.nan])  # the last run has none
    extended = study.results(3, {"Energy": values}, first_batch=1)
    batches, video = np.array([0, 0, 1, 1, 1]), np.array([1, 0, 1, 0, 1])
    (left,) = np.linalg.lstsq(np.column_stack([video, 1 - video, batches]), values[:5])[1]
    found = pilot_values(study, extended, ["Energy"])
    assert found.measures["Energy"].spreads[("Video",)] == pytest.approx(math.sqrt(left / 2))
    assert found.freedoms["Energy"] == 2


def test_an_extended_pilot_with_one_run_in_each_batch_has_no_spread() -> None:
    study = study_of(Factor("Task", ["Video"]))
    extended = study.results(2, {"Energy": np.array([100.0, 104.0])}, first_batch=1)
    with pytest.raises(AnalysisError, match="a single run of each combination in each batch"):
        pilot_values(study, extended, ["Energy"])


PEOPLE = Factor("Person", list(range(8)))
CROSSOVER = RunTableModel(
    [Factor("Task", ["a", "b"]), PEOPLE, Factor("Day", [1, 2])],
    shuffle=True,
    seed=3,
    design=Crossover(unit="Person", period="Day"),
)
INCOMPLETE = RunTableModel(
    [Factor("Task", ["a", "b", "c"]), Factor("Person", list(range(6)))],
    repetitions=4,
    shuffle=True,
    seed=3,
    design=Blocks("Person"),
)
SPLIT_PLOT = RunTableModel(
    [Factor("Task", ["a", "b"]), Factor("Speed", [1, 2]), PEOPLE],
    shuffle=True,
    seed=3,
    design=SplitPlot(hard="Task", plot="Person"),
)


@pytest.mark.long
@pytest.mark.parametrize("model", [CROSSOVER, INCOMPLETE, SPLIT_PLOT], ids=["crossover", "incomplete", "split plot"])
def test_units_of_special_designs_are_told_from_chance(model: RunTableModel) -> None:
    study = Study.of_model("study", model, None, {"Energy": "J"})
    assert study.arranged is not None
    people = np.array([int(run.blocks["Person"]) for run in study.arranged(model.repetitions)])
    blocks, chances = [], []
    for seed in range(20):
        random = np.random.default_rng(seed)
        values = 10 * random.normal(size=8)[people] + random.normal(size=len(people))
        found = pilot_values(study, study.results(model.repetitions, {"Energy": values}), ["Energy"])
        (told,) = found.measures.values()
        blocks.append(told.block_sd**2)
        chances.append(told.spreads[study.cells[0]] ** 2)
    assert np.mean(blocks) == pytest.approx(100, rel=0.3)
    assert np.mean(chances) == pytest.approx(1, rel=0.3)


SPEED, MANY = Factor("Speed", [1, 2]), Factor("Person", list(range(12)))
OF_TWO = RunTableModel(
    [Factor("Task", ["a", "b"]), SPEED, MANY, Factor("Day", [1, 2, 3, 4])],
    shuffle=True,
    seed=3,
    design=Crossover(unit="Person", period="Day", washout_in_s=60),
)
PLOTS_OF_TWO = RunTableModel(
    [Factor("Floor", ["x", "y"]), Factor("Task", ["a", "b"]), SPEED, MANY],
    shuffle=True,
    seed=3,
    design=SplitPlot(hard="Floor", plot="Person"),
)


@pytest.mark.long
@pytest.mark.parametrize("model", [OF_TWO, PLOTS_OF_TWO], ids=["crossover", "split plot"])
def test_how_subjects_and_plots_respond_to_each_factor_is_told_apart(model: RunTableModel) -> None:
    """Taken for chance of runs, Task would be tested against a third of the variance that it has."""
    study = Study.of_model("study", model, None, {"Energy": "J"})
    assert study.arranged is not None
    runs = study.arranged(1)
    people = np.array([int(run.blocks["Person"]) for run in runs])
    task = np.array([run.cell[list(study.factors).index("Task")] == "a" for run in runs], dtype=int)
    told = []
    for seed in range(12):
        random = np.random.default_rng(seed)
        values = 10 * random.normal(size=12)[people] + 3 * random.normal(size=(12, 2))[people, task]
        results = study.results(1, {"Energy": values + random.normal(size=len(runs))})
        (found,) = pilot_values(study, results, ["Energy"]).measures.values()
        others = sum(size**2 for term, size in found.responses.items() if term != ("Task",))
        told.append((found.block_sd**2, found.responses["Task",] ** 2, found.spreads[study.cells[0]] ** 2, others))
    blocks, responses, chance, others = np.mean(told, axis=0)
    assert (blocks, responses, chance) == pytest.approx((100, 9, 1), rel=0.25)
    assert others < 0.5


def test_whole_plots_of_a_balanced_pilot_vary_as_the_analysis_of_variance_says() -> None:
    study = Study.of_model("study", SPLIT_PLOT, None, {"Energy": "J"})
    assert study.arranged is not None
    runs = [(run.cell[0], run.cell[1], int(run.blocks["Person"])) for run in study.arranged(1)]
    chance = np.random.default_rng(1).normal(size=len(runs))
    values = {run: 3.0 * run[2] + each for run, each in zip(runs, chance, strict=True)}
    sums: dict[str, list[float]] = {"a": [], "b": []}
    gaps: dict[str, list[float]] = {"a": [], "b": []}
    for task, plot in sorted({(task, plot) for task, _, plot in runs}):
        slow, fast = values[task, "1", plot], values[task, "2", plot]
        sums[task].append(slow + fast)
        gaps[task].append(slow - fast)
    # Mean squares of whole plots, and of runs within these, with 2 x (4 - 1) degrees of freedom each.
    plots, within = (sum(np.var(each, ddof=1) / 2 for each in of.values()) / 2 for of in (sums, gaps))
    found = pilot_values(study, study.results(1, {"Energy": np.array(list(values.values()))}), ["Energy"])
    assert found.measures["Energy"].block_sd == pytest.approx(math.sqrt((plots - within) / 2))
    assert found.measures["Energy"].spreads[study.cells[0]] == pytest.approx(math.sqrt(within))
    assert found.freedoms["Energy"] == 6


@pytest.mark.long
def test_blocks_of_a_pilot_are_chance_in_a_study_without_any(tmp_path: Path) -> None:
    blocked, plain = study_of(ROBOT, TASK, blocks="Robot"), study_of(TASK)
    drawn = pilot_of(tmp_path / "pilot", blocked, assumed(block_sd=30.0, response_sd=15.0), 6)
    found = pilot_values(plain, drawn, ["Energy"])
    told = found.measures["Energy"]
    assert (told.block_sd, told.responses) == (0, {})
    assert told.spreads[("Video",)] == pytest.approx(math.hypot(10, 30, 15), rel=0.35)
    assert "The study has no blocks: how those of the pilot vary is taken for chance between runs." in found.notes
