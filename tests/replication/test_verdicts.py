"""A replication ends in a verdict on each primary measure, one sentence, and an exit code that says the same."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from tests.analysis.experiment_folders import Folder, two_tasks
from tests.command_line import PROGRAM
from tests.replication.small_experiment import own_modules

from robot_runner.analysis.comparison.comparing import compare
from robot_runner.analysis.comparison.comparison_document import json_of_comparison
from robot_runner.analysis.libraries import MissingLibraryError
from robot_runner.cli.main import main
from robot_runner.core.errors import PackageError
from robot_runner.core.events.measure import OPERATOR_OWNER, ROBOTS_OWNER
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole
from robot_runner.replication.commands import replication_verdict
from robot_runner.replication.explanation import explain_run
from robot_runner.replication.needed_runs import needed_runs, runs_for_difference, runs_for_equivalence
from robot_runner.replication.run_by_run import Sameness, identical_values
from robot_runner.replication.verdicts import (
    Conclusion,
    margins_of,
    reached_verdict,
    why_not_primary,
)

CONFIG = """\
import os
import random
from pathlib import Path

from robot_runner import AnalysisPlan, ExperimentConfig, Factor, Hypothesis, RunProcess, RunTableModel


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "noisy"
    results_output_path = Path("results")
    run_process = RunProcess.IN_PROCESS
    {plan}

    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], repetitions={repetitions}, seed=7,
                             data_columns=["Energy", "Count", "Label"])

    def populate_run_data(self, context):
        noise = random.Random(f"{{os.environ['WHO']}} {{context.run_number}}").gauss(0, 1)
        return {{"Energy": 100 + float(os.environ.get("SHIFT", 0)) + noise, "Count": context.run_number,
                "Label": os.environ["WHO"]}}
"""
PLAN = 'analysis = AnalysisPlan(measures=["Energy"], hypotheses=[Hypothesis("They cost alike.", measure="Energy", '
PLAN += 'factors="Task", within={within})])'


@pytest.fixture(autouse=True)
def _modules_of_its_own():
    with own_modules():
        yield


@pytest.fixture
def replicated(robot_runner, tmp_path, monkeypatch):
    """Return what executes an experiment whose values are noise, replicates it, and returns the answer."""

    def replicate(*words, plan="", repetitions=6, shift="0"):
        config = tmp_path / "noisy.py"
        config.write_text(CONFIG.format(plan=plan, repetitions=repetitions), encoding="utf-8")
        monkeypatch.setenv("WHO", "ada")
        assert robot_runner("run", "noisy.py").code == 0
        monkeypatch.setenv("WHO", "grace")
        monkeypatch.setenv("SHIFT", shift)
        return robot_runner("replicate", "results/noisy", "--yes", "--to", "again", *words)

    return replicate


ONLY_ENERGY = 'analysis = AnalysisPlan(measures=["Energy"])'


def _last(answer):
    return answer.out.rstrip("\n").rpartition("\n")[2]


@pytest.mark.long
def test_noise_within_the_default_bound_is_equivalent_and_the_default_is_said_to_be_one(replicated, tmp_path):
    answer = replicated(plan=ONLY_ENERGY)
    assert answer.code == 0, answer.out + answer.err
    assert (
        "Energy is equivalent within 5 % (the default, as neither --bound nor the plan says what matters)" in answer.out
    )
    assert _last(answer) == "The results are equivalent: no difference reaches the bound of 5 %."
    assert "Label could not be decided: it differs in 12 of 12 runs, and its values are not numbers" in answer.out
    assert "It does not count: the plan does not name it as primary." in answer.out
    facts = json.loads((tmp_path / "again" / "verdict.json").read_text("utf-8"))
    assert (facts["verdict"], facts["exit_code"], facts["environment"]) == ("equivalent", 0, "here")
    assert [each["name"] for each in facts["measures"]] == ["Energy", "Count", "Label"]
    again = main(["replicate", "results/noisy", "--yes", "--to", "again", "--bound", "0.001", "--json"])
    assert again == 4


@pytest.mark.long
def test_what_chance_does_not_explain_is_different_and_json_says_the_same(replicated):
    answer = replicated("--json", "--bound", "Energy=3", plan=ONLY_ENERGY, shift="50")
    assert answer.code == 3, answer.err
    facts = answer.json
    assert (facts["verdict"], facts["exit_code"]) == ("different", 3)
    energy = facts["measures"][0]
    assert (energy["conclusion"], energy["bound"], energy["bound_source"]) == ("different", "3", "as --bound says")
    assert facts["sentence"] == "The results are different: Energy."
    assert "All 12 runs are done" in answer.err


@pytest.mark.long
def test_too_few_runs_are_undecided_by_the_margin_of_the_plan_and_it_is_said_what_would_do(replicated):
    answer = replicated(plan=PLAN.format(within=0.5), repetitions=3)
    assert answer.code == 4, answer.out
    assert "within 0.5 (the margin of equivalence in the plan of the original)" in answer.out
    assert "there are 3 runs a combination, and about " in answer.out
    assert "of each experiment would be needed" in answer.out
    assert _last(answer) == "Whether the results agree could not be decided: Energy."


@pytest.mark.long
def test_without_the_libraries_the_comparison_gets_an_environment_of_its_own(replicated, monkeypatch, tmp_path):
    made = []

    def absent():
        raise MissingLibraryError("pandas is not installed", where="here", fix="")

    def make(folder):
        made.append(folder)
        return Path(PROGRAM)

    monkeypatch.setattr(replication_verdict, "require_libraries", absent)
    monkeypatch.setattr(replication_verdict, "make_comparison_environment", make)
    answer = replicated(plan=ONLY_ENERGY)
    assert answer.code == 0, answer.out + answer.err
    assert made == [tmp_path / "again" / "comparison_environment"] * 2  # before anything moves, and to compare
    assert "Energy is equivalent within 5 %" in answer.out
    assert (tmp_path / "again" / "comparison.html").is_file()
    assert json.loads((tmp_path / "again" / "comparison.json").read_text("utf-8"))["measures"]


@pytest.mark.long
def test_nothing_compared_is_never_a_success(replicated, monkeypatch):
    def absent():
        raise MissingLibraryError("pandas is not installed", where="here", fix="")

    def fail(folder):
        raise PackageError("the environment cannot be made", where=str(folder), fix="Correct it.")

    monkeypatch.setattr(replication_verdict, "require_libraries", absent)
    monkeypatch.setattr(replication_verdict.Comparing, "prepare", lambda *_, **__: None)
    monkeypatch.setattr(replication_verdict, "make_comparison_environment", fail)
    answer = replicated(plan=ONLY_ENERGY)
    assert answer.code == 4
    assert "the environment cannot be made" in answer.err
    assert "install the extra `analysis`, and repeat the command: no run is executed again" in answer.out
    assert _last(answer) == "Whether the results agree could not be decided: Energy."


@pytest.mark.long
def test_an_environment_that_cannot_be_made_is_found_before_a_robot_moves(replicated, monkeypatch, tmp_path):
    def absent():
        raise MissingLibraryError("pandas is not installed", where="here", fix="")

    def fail(folder):
        raise PackageError("the environment cannot be made", where=str(folder), fix="Correct it.")

    monkeypatch.setattr(replication_verdict, "require_libraries", absent)
    monkeypatch.setattr(replication_verdict, "make_comparison_environment", fail)
    assert replicated().code == 2
    assert not (tmp_path / "again" / "noisy").exists()


@pytest.mark.long
def test_a_bound_for_a_measure_that_is_not_there_is_refused_before_anything_is_executed(replicated, tmp_path):
    answer = replicated("--bound", "Enrgy=3")
    assert answer.code == 2
    assert "'Energy'" in answer.err
    assert not (tmp_path / "again" / "noisy").exists()


@pytest.mark.long
def test_runs_without_a_verdict_on_request(replicated, tmp_path):
    answer = replicated("--without-verdict")
    assert answer.code == 0
    assert "The results" not in answer.out
    assert not (tmp_path / "again" / "verdict.json").exists()


def _measure(name, unit="J", origin="simulated"):
    return ColumnDescription(name=name, role=ColumnRole.MEASURE, unit=unit, origin=origin)


def test_how_long_the_machine_took_which_robot_was_free_and_what_the_operator_answered_are_not_primary():
    columns = [
        _measure("Energy"),
        _measure("Took", "ms", "measured"),
        _measure("Mission", "s"),
        _measure("Took.quality"),
    ]
    simulated, real = {"robot": "simulated:battery=0.5"}, {"robot": "ros2"}
    assert {name for name, because in why_not_primary(columns, simulated).items() if because} == {"Took"}
    assert not any(why_not_primary(columns, real).values())
    assert not any(why_not_primary([columns[1]], simulated).values())  # there is nothing else
    robot = ColumnDescription(name="Robot", role=ColumnRole.MEASURE, owner=ROBOTS_OWNER)
    assert why_not_primary([columns[0], robot], real) == {"Energy": "", "Robot": "it is which robot was free"}
    voltage = ColumnDescription(name="voltage", role=ColumnRole.MEASURE, unit="V", owner=OPERATOR_OWNER)
    assert why_not_primary([columns[0], voltage], real)["voltage"] == "it is what the operator answered"
    assert why_not_primary([voltage], real) == {"voltage": ""}  # there is nothing else
    planned = {**simulated, "analysis": {"measures": ["Took"]}}
    assert [name for name, because in why_not_primary(columns, planned).items() if not because] == ["Took"]


def test_the_margin_is_what_is_given_then_what_is_planned_then_the_default():
    contrast = {"measure": "Energy", "within": 10, "contrast": {"a": 2, "b": -2}}
    plan = {"analysis": {"hypotheses": [{"measure": "Energy", "within": 8}, contrast, {"measure": "CPU"}]}}
    margins = margins_of(dict.fromkeys(["Energy", "CPU", "Memory"], ""), plan, ["Memory=3"])
    assert {name: margin.text for name, margin in margins.items()} == {"Energy": "5", "CPU": "5%", "Memory": "3"}
    assert "plan" in margins["Energy"].source
    assert {margin.text for margin in margins_of({"Energy": "J", "CPU": "%"}, plan, ["2%"]).values()} == {"2%"}


def test_the_default_of_a_temperature_is_no_percentage_which_says_nothing_of_it():
    units = {"Room": "\N{DEGREE SIGN}C", "Oven": "degF", "Noise": "dB(A)", "Sky": "K"}
    margins = margins_of(units, {}, [])
    assert [margin.text for margin in margins.values()] == ["2", "3.6", "1", "5%"]


@pytest.mark.parametrize(
    ("second", "conclusion"),
    [(100.0, Conclusion.IDENTICAL), (101.0, Conclusion.EQUIVALENT), (150.0, Conclusion.DIFFERENT)],
)
def test_values_without_any_spread_are_judged_as_compare_judges_them(tmp_path, second, conclusion):
    manifest = {"robot": "simulated"}
    folders = [
        two_tasks(tmp_path / name, (value,) * 3, (7.0,) * 3, manifest=manifest).root
        for name, value in (("one", 100.0), ("other", second))
    ]
    comparison = json.loads(json_of_comparison(compare(*folders, bound="5%")))
    margins = margins_of({"Energy": "J"}, manifest, [])
    verdict = reached_verdict([_measure("Energy")], manifest, identical_values(*folders), margins, comparison)
    assert verdict.conclusion is conclusion
    assert comparison["verdict"] == conclusion.value


def test_values_of_which_one_is_missing_in_one_experiment_are_equivalent_where_none_differs(tmp_path):
    folders = [
        two_tasks(tmp_path / name, values, (7.0,) * 3).root
        for name, values in (("one", (1.0, 1.0, None)), ("other", (1.0,) * 3))
    ]
    comparison = json.loads(json_of_comparison(compare(*folders, bound="5%")))
    margins = margins_of({"Energy": "J"}, {}, [])
    verdict = reached_verdict([_measure("Energy")], {}, identical_values(*folders), margins, comparison)
    assert (verdict.conclusion, comparison["verdict"]) == (Conclusion.EQUIVALENT, "identical")
    assert "is equivalent within 5 %" in verdict.measures[0].sentence


@pytest.mark.parametrize("unit", ["%", "1", "kJ"])
def test_the_verdict_tells_the_largest_difference_as_the_comparison_does(tmp_path, unit):
    folders = []
    for name, shift in (("original", 0), ("again", -12345.6)):
        factors, rows = {"Task": ["Video", "Network"]}, [("Video", 8e4 + shift + each) for each in range(4)]
        rows += [("Network", 5.0 + each) for each in range(4)]
        folders.append(Folder(tmp_path / name, factors, rows, {"CPU": unit}, day=f"2026-01-2{len(name)}").write())
    comparison = json.loads(json_of_comparison(compare(*folders, bound="5%")))
    margins = margins_of({"CPU": unit}, {}, [])
    verdict = reached_verdict([_measure("CPU", unit=unit)], {}, identical_values(*folders), margins, comparison)
    told = comparison["measures"][0]["conclusion"]
    size = told.partition("The largest difference is ")[2].removesuffix(".")
    units = {"%": " percentage points", "1": "", "kJ": " kJ"}
    assert size == f"\N{MINUS SIGN}12,346{units[unit]}, \N{MINUS SIGN}15.4 % (Video)"
    assert f"; the largest difference is {size}" in verdict.measures[0].sentence
    assert verdict.measures[0].sentence.startswith("CPU is " if unit == "1" else f"CPU ({unit}) is ")


def test_a_comparison_in_an_environment_of_an_earlier_version_lacks_the_largest_difference_and_is_judged(tmp_path):
    folders = []
    for name, shift in (("original", 0), ("again", 40)):
        rows = [(task, 80.0 + shift + each) for task in ("Video", "Network") for each in range(4)]
        folders.append(Folder(tmp_path / name, {"Task": ["Video", "Network"]}, rows, {"CPU": "%"}).write())
    comparison = json.loads(json_of_comparison(compare(*folders, bound="5%")))
    del comparison["measures"][0]["largest"]
    margins = margins_of({"CPU": "%"}, {}, [])
    verdict = reached_verdict([_measure("CPU", unit="%")], {}, identical_values(*folders), margins, comparison)
    assert verdict.conclusion is Conclusion.DIFFERENT


def test_of_a_search_that_was_confirmed_here_alone_it_is_said_that_no_combination_is_compared():
    comparison = {"measures": [{"first_name": "Energy", "differences": []}]}
    margins = margins_of({"Energy": "J"}, {}, [])
    verdict = reached_verdict([_measure("Energy")], {}, {"Energy": Sameness(4, 0)}, margins, comparison)
    assert "it differs in 4 of 4 runs, and no combination is compared that both have" in verdict.measures[0].sentence


def test_no_run_in_common_is_undecided():
    margins = margins_of({"Energy": "J"}, {}, [])
    for same in ({}, {"Energy": Sameness(0, 0)}):
        verdict = reached_verdict([_measure("Energy")], {}, same, margins, None)
        assert (verdict.conclusion.exit_code, "could not be compared" in verdict.sentence) == (4, True)


def test_results_are_not_identical_where_runs_of_the_original_have_failed_here(tmp_path):
    original = two_tasks(tmp_path / "original", (1.0, 2.0), (3.0, None)).root
    again = two_tasks(
        tmp_path / "again", (1.0, 2.0), (3.0, None), statuses={1: "Failed", 2: "Failed", 3: "Failed"}
    ).root
    same = identical_values(original, again)
    assert same == {"Energy": Sameness(1, 1, lacking=2)}
    assert identical_values(again, original) == {"Energy": Sameness(1, 1)}
    verdict = reached_verdict([_measure("Energy")], {}, same, margins_of({"Energy": "J"}, {}, []), None)
    assert verdict.conclusion is Conclusion.UNDECIDED
    assert "identical in the one run that can be compared, and 2 runs of the original are not done" in (
        verdict.measures[0].sentence
    )


@pytest.mark.parametrize("others", [(1.0, 2.0), (1.0, 2.1)])
def test_runs_that_whoever_replicates_has_excluded_are_told_and_not_passed_over(tmp_path, others):
    original = two_tasks(tmp_path / "original", (1.0, 2.0), (3.0, 4.0)).root
    again = two_tasks(tmp_path / "again", others, (30.0, 4.0), statuses={}).root
    with Journal(again / "journal.jsonl") as journal:
        journal.append("excluded", run="r_3", reason="odd")
    found = json.loads(json_of_comparison(compare(original, again, bound="5%")))
    assert identical_values(again, original)["Energy"].lacking == 0  # what the original excludes is its own
    same = identical_values(original, again)
    assert same == {"Energy": Sameness(3, 3 if others == (1.0, 2.0) else 2, lacking=1)}
    verdict = reached_verdict([_measure("Energy")], {}, same, margins_of({"Energy": "J"}, {}, []), found)
    assert verdict.conclusion is Conclusion.UNDECIDED
    assert "1 run of the original is not done here, or excluded." in verdict.measures[0].sentence


def test_the_same_values_of_other_treatments_are_not_identical(tmp_path):
    measured = ((1.0, 2.0), (3.0, 4.0))
    original = two_tasks(tmp_path / "original", *measured).root
    again = two_tasks(tmp_path / "again", *measured).root
    table = again / "run_table.csv"
    swapped = {"Video": "Network", "Network": "Video"}
    table.write_text(re.sub("Video|Network", lambda task: swapped[task[0]], table.read_text("utf-8")), "utf-8")
    assert identical_values(original, again) == {"Energy": Sameness(4, 0)}
    found = json.loads(json_of_comparison(compare(original, again, bound="5%")))
    verdict = reached_verdict(
        [_measure("Energy")], {}, identical_values(original, again), margins_of({"Energy": "J"}, {}, []), found
    )
    assert verdict.conclusion is not Conclusion.IDENTICAL


def test_runs_that_ended_after_the_table_was_written_last_are_compared(tmp_path):
    folders = [two_tasks(tmp_path / name, (1.0, 2.0), (3.0, 4.0)).root for name in ("original", "again")]
    with Journal(folders[0] / "journal.jsonl") as journal:  # as a kill leaves it
        journal.append("attempt_started", run="r_4", attempt=1)
        ended = {
            "measures": {"Energy": {"value": 5.0, "owner": "Meter", "origin": "measured"}},
            "stamps": {},
            "failure": None,
        }
        journal.append("attempt_finished", run="r_4", attempt=1, is_last=True, status="done", seconds=1.0, **ended)
    assert identical_values(*folders) == {"Energy": Sameness(4, 3)}
    assert explain_run(folders[0], "r_4", ["Energy"]).values[0].value == 5.0


@pytest.mark.parametrize(
    ("spreads", "bound", "shift"),
    [
        pytest.param((1.0, 1.0), 1.0, 0.0, marks=pytest.mark.long),
        ((1.0, 1.0), 1.0, 0.01),
        ((1.0, 1.0), 3.0, 0.0),
        ((1.0, 3.0), 5.0, 1.0),
    ],
)
def test_the_runs_that_are_said_to_be_needed_decide_in_a_simulation(spreads, bound, shift):
    """The formulas' own truth: about four in five simulated replications of that size; of three runs, three in four."""
    import numpy as np
    from scipy import stats

    variances = (spreads[0] ** 2, spreads[1] ** 2)
    generator = np.random.default_rng(5)
    runs = runs_for_equivalence(variances, shift, bound, 0.05)
    one, other = (generator.normal(at, each, (4000, runs)) for at, each in zip((0, shift), spreads, strict=True))
    lower = stats.ttest_ind(other + bound, one, axis=1, equal_var=False, alternative="greater").pvalue
    upper = stats.ttest_ind(other - bound, one, axis=1, equal_var=False, alternative="less").pvalue
    assert 0.73 < np.mean(np.maximum(lower, upper) < 0.05) < 0.93
    runs = runs_for_difference(variances, bound, 0.05)
    one, other = (generator.normal(at, spread, (4000, runs)) for at, spread in zip((0, bound), spreads, strict=True))
    assert 0.73 < np.mean(stats.ttest_ind(other, one, axis=1, equal_var=False).pvalue < 0.05) < 0.93


def test_as_many_runs_are_said_to_be_needed_as_by_r():
    """`ceiling(power.t.test(delta = 3, sd = 1, power = 0.8)$n)`, and so on; alpha is `sig.level`."""
    by_r = {(3.0, 0.05): 4, (2.0, 0.05): 6, (1.5, 0.05): 9, (1.0, 0.05): 17, (0.5, 0.05): 64, (2.0, 0.01): 8}
    found = {each: runs_for_difference((1.0, 1.0), *each) for each in by_r}
    assert found == by_r


def test_that_p_values_are_adjusted_for_several_combinations_takes_more_runs():
    base = {"first_n": 4, "second_n": 4, "first_sd": 1.0, "second_sd": 1.0, "difference": 1.0, "bound": None}
    alone = needed_runs([{**base, "verdict": "undecided", "p_value": 0.2}], 0.05)
    among = needed_runs([{**base, "verdict": "undecided", "p_value": 0.2}] * 4, 0.05)
    assert "about 17 of each" in alone
    assert "about 24 of each" in among  # ceiling(power.t.test(delta = 1, sd = 1, power = 0.8, sig.level = 0.0125)$n)


def test_that_a_bound_in_percent_is_of_a_mean_that_is_not_known_takes_more_runs():
    base = {"first_n": 4, "second_n": 4, "first_sd": 10.0, "second_sd": 10.0, "difference": 0.0, "bound": 20.0}
    undecided = {**base, "verdict": "undecided", "first_mean": 100.0}
    assert "about 6 of each" in needed_runs([undecided], 0.05)
    assert "about 7 of each" in needed_runs([undecided], 0.05, is_relative=True)


def test_what_more_runs_cannot_decide_is_said():
    base = {"verdict": "undecided", "first_n": 4, "second_n": 4, "second_sd": 1.0, "bound": 1.0}
    assert "2 of each experiment are the fewest" in needed_runs([{**base, "first_n": 1, "first_sd": None}], 0.05)
    assert "no number of runs would do" in needed_runs(
        [{**base, "first_sd": 1.0, "difference": 0.0, "bound": None}], 0.05
    )
    untested = {**base, "first_sd": 0.0, "second_sd": 0.0, "difference": 2.0, "not_computed": "All values are equal."}
    assert needed_runs([untested], 0.05) == "all values are equal"


def test_of_blocks_it_is_said_how_many_blocks_are_needed():
    base = {"verdict": "undecided", "first_n": 8, "second_n": 8, "first_sd": 1.0, "second_sd": 1.0, "difference": 0.0}
    days = {"unit": "Day", "first_units": 4, "second_units": 4, "first_error": 0.5, "second_error": 0.5}
    told = needed_runs([{**base, **days, "bound": 1.0}], 0.05)
    assert told.startswith("there are 8 runs a combination, of 4 units of Day, and about 18 units of each experiment")
