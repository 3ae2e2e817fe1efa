"""Every number of a report comes out again in R and in Python, from the run table alone and without Robot Runner.

R computes with functions of its own where it has them: t.test, oneway.test, anova.mlm, lm, p.adjust, cor.test,
shapiro.test, power.t.test. So these tests are proof of our arithmetic as well.
"""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import shutil
import subprocess
import warnings
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pytest
from tests.analysis.experiment_folders import searched
from tests.analysis.made_experiment import make_experiment
from tests.conftest import TABLE, written_config
from tests.long_cases import long_but, soak_but

from robot_runner import AnalysisPlan, Estimand
from robot_runner.analysis import DeclaredDesign, analyse, load_results
from robot_runner.analysis.importing.adoption import adopt
from robot_runner.analysis.importing.description import ImportDescription
from robot_runner.analysis.importing.understanding import understand
from robot_runner.analysis.recomputing import fact_finding
from robot_runner.analysis.recomputing.literals import _templates
from robot_runner.analysis.recomputing.recomputations import Recomputation, r_script, write_recomputations
from robot_runner.analysis.recomputing.recomputations import notebook as notebook_of
from robot_runner.analysis.report.document import plain
from robot_runner.analysis.statistics.outcome import Description
from robot_runner.cli.extension import ExtensionRequest, extend_experiment
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.design.extended_design import Additions, NewFactor
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.numeric_range import Range
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.designs import (
    Blocks,
    CentralComposite,
    Crossover,
    DOptimal,
    FractionalFactorial,
    LatinSquare,
    OneFactorAtATime,
    SplitPlot,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from robot_runner.analysis import ExperimentStatistics
    from robot_runner.analysis.recomputing.study_facts import StudyFacts

needs_r = pytest.mark.skipif(
    shutil.which("Rscript") is None, reason="R is not installed (Debian: apt install r-base-core)"
)

TASKS, MAPS = Factor("Task", ["Video", "Network", "Idle"]), Factor("Map", ["lab", "hall"])
SENSOR = Factor("Sensor", ["camera", "lidar", "sonar"])
RESOLUTION = Factor("Resolution", ["720p", "1080p"], when={"Sensor": "camera"})
BEAMS = Factor("Beams", [1, 2, 3], when={"Sensor": ["lidar", "sonar"]})
NESTED_PLAN = {
    "measures": ["Energy"],
    "hypotheses": [
        {"statement": "So.", "measure": "Energy", "factors": ["Beams"], "contrast": {"1": 1, "3": -1}, "within": 9}
    ],
}
PLAN = {
    "measures": ["Energy"],
    "secondary": ["CPU"],
    "hypotheses": [
        {"statement": "It matters.", "measure": "Energy", "factors": ["Task"]},
        {
            "statement": 'It takes "as long".',
            "measure": "Energy",
            "factors": ["Task"],
            "contrast": {"Video": 1, "Idle": -1},
            "within": 4,
        },
        {
            "statement": "Less.",
            "measure": "Energy",
            "factors": ["Task"],
            "contrast": {"Video": 1, "Idle": -1},
            "below": 4,
        },
    ],
}
SUCCESS = {
    "measures": ["Energy"],
    "hypotheses": [
        *PLAN["hypotheses"][1:],
        PLAN["hypotheses"][2] | {"statement": "They differ.", "below": None},
        {
            "statement": "Weighted.",
            "measure": "Energy",
            "factors": ["Task"],
            "contrast": {"Video": 1, "Network": -0.5, "Idle": -0.5},
        },
    ],
}
ALWAYS = {
    "measures": ["Energy"],
    "hypotheses": [
        {
            "statement": "As good.",
            "measure": "Energy",
            "factors": ["Task"],
            "contrast": {"Video": 1, "Network": -1},
            "below": 40,
        },
        SUCCESS["hypotheses"][0],
    ],
}
#: What would be executed if a name became code, in R or in Python.
EVIL = '"); system("touch hacked'
EVILS = [EVIL, "'); import os; os.system('touch hacked') #", 'a\\"b` $HOME # %% é \N{GREEK SMALL LETTER OMEGA}']

#: Factors, how often combinations are repeated, the runs that are not done, and what else makes the experiment.
DESIGNS: dict[str, tuple[list[Factor], int, set[int], dict[str, Any]]] = {
    "two treatments": ([MAPS], 4, set(), {}),
    "three treatments": ([TASKS], 5, {4}, {}),
    "three values, ties": ([TASKS], 3, set(), {}),
    "seconds since 1970": ([MAPS], 4, set(), {}),
    "many small groups": ([Factor("Speed", [0.5, 1.0, 1.5, 2.0, 2.5, 3.0])], 3, set(), {}),
    "two factors, unequal numbers": ([TASKS, MAPS], 4, {1, 8}, {}),
    "two factors, spreads far apart": ([TASKS, MAPS], 5, set(), {}),
    "a planned contrast, doubtful values": ([TASKS], 6, set(), {"analysis": PLAN, "doubts": {"r_2": "weak"}}),
    "outliers left out": (
        [TASKS],
        8,
        set(),
        {"analysis": {"measures": ["Energy"], "outliers": {"interquartile_ranges": 0.4}}},
    ),
    "measures that are correlated without outliers": (
        [TASKS, MAPS],
        6,
        {3},
        {
            "analysis": {"measures": ["Energy", "CPU"], "outliers": {"interquartile_ranges": 0.5}},
            "blocks": "Repetition",
        },
    ),
    "no value within the bounds": (
        [MAPS],
        4,
        set(),
        {"analysis": {"measures": ["Energy"], "outliers": {"bounds": {"Energy": [None, 5.0]}}}},
    ),
    "adjusted for a covariate": ([TASKS], 5, set(), {"analysis": {"measures": ["Energy"], "covariates": ["CPU"]}}),
    "blocks": ([TASKS], 7, set(), {"blocks": "Repetition"}),
    "blocks, values far from 0": ([TASKS], 7, set(), {"blocks": "Repetition"}),
    "few blocks, two factors, one lacking": ([TASKS, MAPS], 5, {2}, {"blocks": "Repetition"}),
    "few blocks of many treatments": (
        [Factor("Speed", [0.5, 1.0, 1.5, 2.0, 2.5])],
        8,
        set(),
        {"blocks": "Repetition"},
    ),
    "incomplete blocks": ([TASKS], 8, {1, 5, 9, 13}, {"blocks": "Repetition"}),
    "incomplete blocks, tiny differences": ([TASKS, MAPS], 6, {3, 8, 9}, {"blocks": "Repetition"}),
    "blocks, margins and gaps": ([TASKS, MAPS], 6, {3, 8, 9}, {"blocks": "Repetition"}),
    "replicated blocks": ([MAPS, Factor("Room", ["a", "b", "c", "d", "e"])], 2, set(), {"blocks": "Room"}),
    "incomplete blocks of several runs": (
        [Factor("Room", ["a", "b", "c", "d", "e"]), TASKS],
        3,
        {1, 2, 9, 16, 24, 31, 39},
        {"blocks": "Room"},
    ),
    "ranks": ([TASKS], 5, set(), {"analysis": {"measures": ["Energy"], "estimand": "rank"}}),
    "trimmed means": ([TASKS], 6, set(), {"analysis": {"measures": ["Energy"], "estimand": "trimmed mean"}}),
    "ANOVA-type, large differences": (
        [TASKS],
        5,
        set(),
        {"analysis": {"measures": ["Energy"], "statistic": "anova-type"}},
    ),
    "combinations without runs": ([TASKS, MAPS, Factor("Room", ["a", "b"])], 3, {1, 13, 25}, {}),
    "combinations without runs, two runs of others": ([TASKS, MAPS], 2, {1, 7}, {}),
    "a run in a cell": ([TASKS, MAPS], 2, {1, 4}, {}),
    "yes or no": ([MAPS], 12, {1}, {}),
    "yes or no, bounds": ([TASKS, MAPS], 12, {1, 5}, {"analysis": SUCCESS}),
    "yes or no, bounds, replicated blocks": (
        [Factor("Room", list("abcde")), TASKS],
        4,
        {1},
        {"blocks": "Room", "analysis": SUCCESS},
    ),
    "yes or no, all succeed": ([Factor("Room", list("abcde")), TASKS], 4, {1}, {"blocks": "Room", "analysis": SUCCESS}),
    "yes or no, saved by R": ([MAPS], 12, {1}, {}),
    "yes or no, saved by Excel in Dutch": ([MAPS], 12, {1}, {}),
    "yes or no, three treatments": ([TASKS], 8, set(), {}),
    "yes or no, two factors": ([TASKS, MAPS], 7, {2, 3}, {"analysis": {"measures": ["Energy", "CPU"]}}),
    "yes or no, blocks": ([TASKS, MAPS], 9, {4}, {"blocks": "Repetition"}),
    "yes or no, two blocks": ([TASKS, MAPS], 2, set(), {"blocks": "Repetition"}),
    "yes or no, a run of each in a block": ([TASKS], 9, {4}, {"blocks": "Repetition"}),
    "yes or no, replicated blocks, two always succeed": (
        [Factor("Room", list("abcde")), TASKS],
        4,
        {1},
        {"blocks": "Room", "analysis": ALWAYS},
    ),
    "yes or no, replicated blocks": (
        [Factor("Room", ["a", "b", "c", "d", "e"]), TASKS],
        3,
        {1, 2, 9, 16},
        {"blocks": "Room"},
    ),
    "conditional factors": ([SENSOR, BEAMS, RESOLUTION, MAPS], 3, {1, 9}, {"analysis": NESTED_PLAN}),
    "a conditional factor, blocks": ([SENSOR, RESOLUTION, MAPS], 8, {4}, {"blocks": "Repetition"}),
    "yes or no, a conditional factor": ([SENSOR, BEAMS, MAPS], 6, {4}, {}),
    "odd names": ([Factor(EVIL, EVILS), Factor("is on", [True, False])], 2, set(), {}),
    "two blocks that hardly differ, unequal": ([TASKS], 2, {2, 3}, {"blocks": "Repetition"}),
}
LAYINGS, DRIVERS = Factor("Laying", range(1, 9)), Factor("Driver", list("abcdef"))
DAYS, SPEED, RATE = (
    Factor("Day", ["Mon", "Tue", "Wed"]),
    Factor("Speed", Range(0.05, 0.25)),
    Factor("Rate", Range(1, 9)),
)
BITS = [Factor(name, [0, 1]) for name in "WXYZ"]
#: Designs of their own, in the same way.
DESIGNED: dict[str, tuple[list[Factor], int, set[int], dict[str, Any]]] = {
    "a split plot": ([MAPS, LAYINGS, TASKS], 1, set(), {"chosen": SplitPlot(hard="Map", plot="Laying")}),
    "a split plot that lost runs": ([MAPS, LAYINGS, TASKS], 1, {3, 8, 13}, {"chosen": SplitPlot("Map", "Laying")}),
    "a split plot of two factors within, adjusted for bytes, a plot lacking one": (
        [MAPS, LAYINGS, TASKS, Factor("Speed", [1, 2])],
        2,
        {3, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24},
        {"chosen": SplitPlot("Map", "Laying"), "analysis": {"measures": ["Energy"], "covariates": ["CPU"]}},
    ),
    "a crossover of two factors": (
        [TASKS, MAPS, Factor("Driver", list("abcdefghijkl")), Factor("Period", [1, 2, 3, 4, 5, 6])],
        1,
        set(),
        {"chosen": Crossover("Driver", "Period"), "analysis": PLAN},
    ),
    "a crossover, carried over": (
        [TASKS, DRIVERS, Factor("Period", [1, 2, 3])],
        2,
        {4, 5},
        {"chosen": Crossover("Driver", "Period")},
    ),
    "a square": (
        [TASKS, DAYS, Factor("Room", ["a", "b", "c"])],
        3,
        {7},
        {"chosen": LatinSquare(rows="Day", columns="Room"), "analysis": PLAN},
    ),
    "incomplete blocks of days": (
        [Factor("Task", list("abcd")), Factor("Day", list("MDWTFS"))],
        3,
        {5},
        {"chosen": Blocks("Day"), "analysis": {"measures": ["Energy"], "covariates": ["CPU", "order"]}},
    ),
    "a surface": ([SPEED, RATE], 2, {6}, {"chosen": CentralComposite()}),
    "ranks of a surface": (
        [SPEED, RATE, MAPS],
        1,
        set(),
        {
            "chosen": DOptimal(runs=16, model="quadratic"),
            "analysis": {"measures": ["Energy"], "estimand": "rank"},
        },
    ),
    "single runs of a fraction": (BITS, 1, set(), {"chosen": FractionalFactorial(resolution=4)}),
    "one factor at a time": ([TASKS, MAPS], 3, {4}, {"chosen": OneFactorAtATime(base={"Task": "Network"})}),
}


class Written(NamedTuple):
    statistics: ExperimentStatistics
    facts: StudyFacts
    notebook: Path
    script: Path


def experiment(folder: Path, name: str) -> Path:
    factors, repetitions, missing, more = (DESIGNS | DESIGNED)[name]
    random = np.random.default_rng(len(name))
    chosen = [factor for factor in factors if factor.range is None]  # of the others a design chooses the numbers
    places = {factor.name: {text: at for at, text in enumerate(factor.texts)} for factor in chosen}
    runs = iter(range(1, 10_000))

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any] | None:
        effect = sum(at[str(treatments[each])] for each, at in places.items())
        energy = 50 + (20 if "large" in name else 1.5) * effect + repetition % 3 + (1 + effect % 2) * random.normal()
        if "far apart" in name and effect == 0:
            energy += 1e6 * random.normal()
        if "ties" in name:  # of three values two are equal: to rounding, the p-value of Shapiro and Wilk is 0
            energy = 2 * round(energy / 2)
        if "since 1970" in name:
            energy = 1.764e9 + energy / 1000
        if "far from 0" in name:
            energy += 1e6
        if "tiny differences" in name:
            energy = 50 + energy * 1e-7
        told = bool(random.random() < 0.3 + 0.2 * effect) if "yes or no" in name else float(energy)
        told = told or ("two always succeed" in name and treatments["Task"] != "Idle")
        told = told or "all succeed" in name
        beside = float(random.lognormal()) * (1e11 if "bytes" in name else 1)  # far from the size of other columns
        is_lacking = "saved by" in name and repetition == 3
        measured = {"Energy": None if is_lacking and treatments["Map"] == "lab" else told, "CPU": beside}
        measured |= {"CPU": None} if is_lacking else {}
        return None if next(runs) in missing else measured

    made = make_experiment(
        folder / "made",
        factors,
        values,
        repetitions=repetitions,
        measures=["Energy", "CPU"],
        units={"Energy": "J"},
        **more,
    )
    if "saved by" in name:
        saved = as_r_saves if "by R" in name else as_excel_saves_in_dutch
        made.run_table.write_text(saved(made.run_table.read_text(encoding="utf-8")), encoding="utf-8")
    return made.root


def as_r_saves(table: str) -> str:
    """Return a run table as `write.csv` saves it: of the measures, what is missing is `NA`."""
    heading, *lines = [line.split(",") for line in table.splitlines()]
    rows = [[*line[:-2], *(cell or "NA" for cell in line[-2:])] for line in lines]
    return "".join(",".join(row) + "\n" for row in [heading, *rows]).replace("True", "TRUE").replace("False", "FALSE")


def as_excel_saves_in_dutch(table: str) -> str:
    """Return a run table as Excel saves it in the Netherlands: words, decimal signs and delimiters are Dutch."""
    heading, *lines = [line.split(",") for line in table.splitlines()]
    rows = [[*line[:-1], line[-1].replace(".", ",")] for line in lines]
    return "".join(";".join(row) + "\n" for row in [heading, *rows]).replace("True", "WAAR").replace("False", "ONWAAR")


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
    plt.close("all")


def executed(path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Execute a notebook's cells one after the other, as Jupyter does, and return what the last one printed."""
    monkeypatch.chdir(path.parent)
    told = io.StringIO()
    monkeypatch.setattr(gc, "collect", lambda: 0)  # as each call of multipletests does, of all that the tests have made
    with quiet(), contextlib.redirect_stdout(told):
        space: dict[str, Any] = {}
        for place, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), f"cell {place}", "exec"), space)  # noqa: S102 - the point
    return told.getvalue()


def rscript(path: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["Rscript", "--vanilla", path],
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
        # Compiling each function takes longer than to execute it a few times.
        env=(environment or os.environ) | {"R_ENABLE_JIT": "0"},
    )


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Written]:
    """Return what writes the notebook and the script of a design, once for all tests."""

    @cache
    def write(name: str) -> Written:
        results = load_results(experiment(tmp_path_factory.mktemp("study"), name))
        found: list[ExperimentStatistics] = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(fact_finding, "analyse", lambda *of, **how: found.append(analyse(*of, **how)) or found[-1])
            study = fact_finding.facts_of_study(results, results.folder)
        notebook, script = (results.folder / kind.value for kind in Recomputation)
        notebook.write_text(notebook_of(study), encoding="utf-8")
        script.write_text(r_script(study), encoding="utf-8")
        return Written(found[0], study, notebook, script)

    return write


#: In `make test` as well; and that of which some numbers are not computed again.
SHORT, NOT_ALL = ["two treatments", "yes or no"], "adjusted for a covariate"
#: Those that are computed again every time: together they have all but a few lines of the R scripts, and of the
#: notebooks, of all designs, and the numbers that are hardest to agree upon.
IN_BOTH = {
    "a planned contrast, doubtful values",
    "measures that are correlated without outliers",
    NOT_ALL,
    "trimmed means",
    "conditional factors",
    "yes or no, a conditional factor",
    "yes or no, bounds",
    "yes or no, saved by R",
    "yes or no, saved by Excel in Dutch",
    "odd names",
    "a split plot that lost runs",
    "a split plot of two factors within, adjusted for bytes, a plot lacking one",
    "a crossover of two factors",
    "a crossover, carried over",
    "ranks of a surface",
    "single runs of a fraction",
}
IN_R = IN_BOTH | {
    "three values, ties",
    "two factors, spreads far apart",
    "incomplete blocks, tiny differences",
    "blocks, values far from 0",
    "replicated blocks",
    "combinations without runs",
    "yes or no, two blocks",
    "yes or no, replicated blocks, two always succeed",
    "yes or no, bounds, replicated blocks",
    "yes or no, all succeed",
    "a conditional factor, blocks",
    "a surface",
}


@pytest.mark.long
@pytest.mark.parametrize("name", soak_but(IN_BOTH, [*DESIGNS, *DESIGNED]))
def test_the_notebook_agrees_with_the_report(
    name: str, written: Callable[[str], Written], monkeypatch: pytest.MonkeyPatch
) -> None:
    study = written(name)
    told = executed(study.notebook, monkeypatch)
    count, _, total, *_ = told.split("numbers agree")[0].split()[-3:]
    assert (count, int(total) > 100) == (total, True), told
    assert not list(study.notebook.parent.rglob("hacked"))
    assert ("not computed again" in told) is (name == NOT_ALL)


@pytest.mark.long
@needs_r
@pytest.mark.parametrize("name", soak_but(IN_R, [*DESIGNS, *DESIGNED]))
def test_the_r_script_agrees_with_the_report(name: str, written: Callable[[str], Written]) -> None:
    # The odd names in a locale that knows ASCII alone.
    environment = {"LC_ALL": "C", "PATH": os.environ["PATH"]} if name == "odd names" else {}
    finished = rscript(written(name).script, **environment)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr
    assert "numbers agree" in finished.stdout
    assert not list(written(name).script.parent.rglob("hacked"))


#: Designs of their own in which runs share a unit: the factors, and the design.
SHARED = {
    "split plot": ([MAPS, LAYINGS, TASKS], SplitPlot(hard="Map", plot="Laying")),
    "crossover": (
        [TASKS, DRIVERS, Factor("Period", [1, 2, 3])],
        Crossover(unit="Driver", period="Period", washout_in_s=60),
    ),
}


IN_ROOMS = """
def populate_run_data(self, context):
    import random
    shift = 3.0 if context.run_number > 10 else 0.0
    return {"Energy": 50.0 + shift + random.Random(context.run_seed).gauss(0.0, 1.0)}
"""

#: What is added to five rooms with one run of each task; it takes both batches, one of two, and one alone.
ADDED = {
    "repetitions": Additions(3),
    "a factor": Additions(3, factors={"Floor": NewFactor("carpet", ("wood",))}),
    "treatments": Additions(treatments={"Task": ("Idle", "Audio")}),
}


@pytest.mark.long
@needs_r
@pytest.mark.parametrize("name", soak_but({"a factor"}, ADDED))
def test_blocks_of_an_extended_experiment_are_computed_again(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rooms = TABLE.replace('[Factor("Task"', '[Factor("Room", range(5)), Factor("Task"')
    rooms = rooms.replace("repetitions=2", 'repetitions=1, shuffle=True, blocks="Room"')
    config = written_config(tmp_path, IN_ROOMS, table=rooms)
    execute_experiment(prepare_or_refuse(config), SilentObserver())
    grown = ExtensionRequest(added=ADDED[name], seed=2)
    extend_experiment(prepare(config, is_for_here=False).experiment, grown)
    folder = execute_experiment(prepare_or_refuse(config), SilentObserver()).folder
    notebook, script = write_recomputations(folder, list(Recomputation))
    assert "numbers agree" in executed(notebook, monkeypatch)
    finished = rscript(script)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr


@pytest.mark.long
@needs_r
def test_answers_of_treatments_that_were_added_are_computed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No batch has the treatment that was added beside the others: R's mantelhaen.test ends in an error."""
    answered = """
    def populate_run_data(self, context):
        import random
        return {"Energy": random.Random(context.run_seed).random() < 0.6}
    """
    table = TABLE.replace('["Video", "Network"]', '["Video", "Network", "Idle"]').replace(
        "repetitions=2", "repetitions=5"
    )
    config = written_config(tmp_path, answered, table=table)
    execute_experiment(prepare_or_refuse(config), SilentObserver())
    grown = ExtensionRequest(added=Additions(treatments={"Task": ("Audio",)}), seed=2)
    extend_experiment(prepare(config, is_for_here=False).experiment, grown)
    folder = execute_experiment(prepare_or_refuse(config), SilentObserver()).folder
    notebook, script = write_recomputations(folder, list(Recomputation))
    assert "numbers agree" in executed(notebook, monkeypatch)
    finished = rscript(script)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr


@pytest.mark.long
@needs_r
@pytest.mark.parametrize(
    ("answers", "name"),
    [
        (False, "split plot"),
        (True, "crossover"),
        pytest.param(False, "crossover", marks=pytest.mark.soak),
        pytest.param(True, "split plot", marks=pytest.mark.soak),
    ],
)
def test_intervals_of_runs_that_share_a_unit_are_computed_again(
    name: str, answers: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    factors, chosen = SHARED[name]
    random = np.random.default_rng(5)

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any] | None:
        place = factors[1].texts.index(str(treatments[factors[1].name]))
        energy = float(place % 4 + random.normal())
        if random.random() < 0.1:
            return None
        # With another measure there is a correlation of residuals.
        return {"Energy": energy > 0.8} if answers else {"Energy": energy, "Load": energy + float(random.normal())}

    measures = ["Energy"] if answers else ["Energy", "Load"]
    folder = make_experiment(tmp_path / "made", factors, values, repetitions=2, measures=measures, chosen=chosen)
    notebook, script = write_recomputations(folder.root)
    measure = analyse(load_results(folder.root)).measures[0]
    of = measure.by_treatment[0] if measure.proportions is None else measure.proportions.by_treatment[0]
    interval = of.mean_interval if isinstance(of, Description) else of.interval
    assert interval is not None
    assert interval.method.endswith(f"runs of one {factors[1].name} counting together")
    told = executed(notebook, monkeypatch)
    assert "numbers agree" in told
    assert "not computed again" not in told
    assert f"{interval.low!r}, {interval.high!r}" in notebook.read_text(encoding="utf-8")
    finished = rscript(script)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr


@pytest.mark.long
@needs_r
@pytest.mark.parametrize("last", [[6.5], []], ids=["three runs each", "two runs of one"])
def test_of_a_search_the_runs_that_confirm_it_are_computed_again(
    last: list[float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    energies = enumerate([9.0, 9.9, 8.1, 5.0, 5.2, 5.4, 6.0, 6.3, *last])
    rows = [("ab"[place % 2 if place < 3 else place > 5], 1 + (place > 2), energy) for place, energy in energies]
    notebook, script = write_recomputations(searched(tmp_path / "trial", rows, is_confirmed=True))
    assert "numbers agree" in executed(notebook, monkeypatch)
    finished = rscript(script)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr


@pytest.mark.long
@needs_r
def test_a_table_that_was_changed_does_not_agree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = experiment(tmp_path, "two treatments")
    notebook, script = write_recomputations(folder, output=tmp_path / "else where")
    table = folder / "run_table.csv"
    *rows, last = table.read_text(encoding="utf-8").splitlines()
    cells = last.split(",")
    table.write_text(
        "\n".join([*rows, ",".join([*cells[:-1], f"{float(cells[-1]) + 0.001}"])]) + "\n", encoding="utf-8"
    )
    finished = rscript(script)
    assert finished.returncode == 1
    assert "The run table was changed since the report was made." in finished.stdout
    assert "These numbers do not agree" in finished.stdout
    with pytest.raises(AssertionError, match="These numbers do not agree"):
        executed(notebook, monkeypatch)


#: Settings, points of figures, and what is simulated of a rule for outliers, are no results of the runs.
NO_RESULTS = {
    "alpha", "plan", "level", "target_power", "effect_size", "family_size", "families", "places", "residuals",
    "theoretical", "observed",
    "contrast", "within", "below", "outliers", "left_out", "is_extreme", "coding",
    "rule_false_positives",
}  # fmt: skip


def numbers(found: Any) -> Iterator[float]:
    if isinstance(found, dict):
        for name, value in found.items():
            if name not in NO_RESULTS or (name == "within" and isinstance(value, float) and "pearson" in found):
                yield from numbers(value)
    elif isinstance(found, list):
        for value in found:
            yield from numbers(value)
    elif isinstance(found, int | float) and not isinstance(found, bool):
        yield float(found)


@pytest.mark.parametrize(
    "name",
    [
        *long_but(SHORT, [*SHORT, *sorted(IN_R - {NOT_ALL})]),
        *soak_but([], [name for name in (*DESIGNS, *DESIGNED) if name not in {*SHORT, *IN_R}]),
    ],
)
def test_no_number_of_the_report_is_left_out(name: str, written: Callable[[str], Written]) -> None:
    study = written(name)
    known = {number for table in study.facts.reported for number in table.numbers}
    missing = {each for each in numbers(plain(study.statistics)) if each not in known}
    assert missing == set()
    assert study.facts.skipped == 0


def test_the_notebook_of_values_that_are_all_equal_is_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_experiment(tmp_path / "made", [MAPS], lambda treatments, repetition: {"Energy": 7.0}, repetitions=4)
    (notebook,) = write_recomputations(folder.root, [Recomputation.NOTEBOOK])
    assert "numbers agree" in executed(notebook, monkeypatch)


@pytest.mark.long
@needs_r
@pytest.mark.parametrize("blocks", [None, "Repetition"])
def test_where_one_run_differs_and_all_others_are_alike_both_agree(
    blocks: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Two treatments do not differ in any run: there is a difference of theirs, and neither a test nor an effect size.
    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        return {"Energy": 50.0 + (treatments["Task"] == "Network" and repetition == 2)}

    folder = make_experiment(
        tmp_path / "made", [TASKS], values, repetitions=3, **({"blocks": blocks} if blocks else {})
    )
    notebook, script = write_recomputations(folder.root)
    assert "numbers agree" in executed(notebook, monkeypatch)
    finished = rscript(script)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr


@pytest.mark.long
@needs_r
def test_of_treatments_that_say_yes_equally_often_both_agree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    yes = {"Video": "1101110", "Network": "1101101", "Idle": "1111001"}

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        return {"Success": yes[treatments["Task"]][repetition - 1] == "1"}

    folder = make_experiment(
        tmp_path / "made", [TASKS], values, repetitions=7, measures=["Success"], blocks="Repetition"
    )
    notebook, script = write_recomputations(folder.root)
    assert "numbers agree" in executed(notebook, monkeypatch)
    finished = rscript(script)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr


@pytest.mark.long
@needs_r
def test_of_treatments_of_the_same_sum_in_blocks_both_agree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        return {"Stops": float([3, 2, 2, 1, 0][(treatments["Speed"] - repetition) % 5]) if repetition <= 5 else 2.0}

    speeds = Factor("Speed", range(5))
    folder = make_experiment(
        tmp_path / "made", [speeds], values, repetitions=8, measures=["Stops"], blocks="Repetition"
    )
    notebook, script = write_recomputations(folder.root)
    assert "numbers agree" in executed(notebook, monkeypatch)
    finished = rscript(script)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr


@pytest.mark.long
@needs_r
def test_of_measures_that_are_multiples_of_one_another_both_agree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        charge = repetition * 0.37 % 1 + 0.1 * len(treatments["Task"])
        return {"Charge": charge, "Energy": charge / 2, "Cost": charge * 3.3}

    measures = ["Charge", "Energy", "Cost"]
    folder = make_experiment(tmp_path / "made", [TASKS], values, repetitions=5, measures=measures)
    notebook, script = write_recomputations(folder.root)
    assert "numbers agree" in executed(notebook, monkeypatch)
    finished = rscript(script)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr


@pytest.mark.long
def test_the_notebook_of_a_study_in_which_nothing_is_compared_is_executed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of_trimmed_means = {"measures": ["Energy"], "estimand": "trimmed mean"}  # which are not compared within blocks
    values = iter(np.random.default_rng(1).normal(size=8))
    folder = make_experiment(
        tmp_path / "made",
        [MAPS],
        lambda treatments, repetition: {"Energy": float(next(values))},
        repetitions=4,
        blocks="Repetition",
        analysis=of_trimmed_means,
    )
    (notebook,) = write_recomputations(folder.root, [Recomputation.NOTEBOOK])
    assert "numbers agree" in executed(notebook, monkeypatch)


@pytest.mark.long
@needs_r
def test_warm_up_runs_and_excluded_runs_of_a_table_that_r_saved_are_left_out(
    robot_runner: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing = IN_ROOMS.replace("    import random", "    assert context.run_id != 'r_3'\n    import random")
    config = written_config(tmp_path, failing, table=TABLE.replace("repetitions=2", "repetitions=5, warm_up=2"))
    folder = execute_experiment(prepare_or_refuse(config), SilentObserver()).folder
    assert robot_runner("exclude", config, "r_2", "--reason", "leaned on").code == 0
    table = folder / "run_table.csv"
    saved = table.read_text(encoding="utf-8").replace(",True", ",TRUE").replace(",False", ",FALSE")
    saved = saved.replace(",Done,,", ",Done,NA,").replace(",Failed,,", ",Failed,NA,")
    table.write_text(saved, encoding="utf-8")
    assert ",TRUE" in saved
    assert ",Done,NA," in saved
    assert ",Failed,NA," in saved
    assert len(load_results(folder).excluded) == 1
    notebook, script = write_recomputations(folder, list(Recomputation))
    assert "numbers agree" in executed(notebook, monkeypatch)
    finished = rscript(script)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr


def test_a_template_cannot_print_a_text_as_it_is() -> None:
    with pytest.raises(TypeError, match="without saying as what"):
        _templates().from_string("{{ name }}").render(name=EVIL)


@pytest.mark.long
def test_the_command_writes_both_beside_the_report(robot_runner: Any, tmp_path: Path) -> None:
    folder = experiment(tmp_path, "two treatments")
    words = ("report", folder, "--notebook", "--r", "--figures", "none", "--measure", "Energy", "--alpha", "0.01")
    answer = robot_runner(*words)
    assert answer.code == 0
    assert "made/report/recompute.ipynb" in answer.out
    assert "made/report/recompute.R" in answer.out
    notebook = json.loads((folder / "report" / "recompute.ipynb").read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert all(set(cell) >= {"cell_type", "id", "metadata", "source"} for cell in notebook["cells"])
    code = "".join("".join(cell["source"]) for cell in notebook["cells"])
    assert "../run_table.csv" in code
    assert "robot_runner" not in code
    assert "CPU" not in code
    assert "level=0.99" in code


@pytest.mark.long
def test_another_plan_is_followed_as_the_report_follows_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = AnalysisPlan(measures=["Energy"], estimand=Estimand.RANK)
    folder = experiment(tmp_path, "three treatments")
    (notebook,) = write_recomputations(folder, [Recomputation.NOTEBOOK], plan=plan)
    told = executed(notebook, monkeypatch)
    assert "numbers agree" in told
    assert "Comparisons of ranks." in notebook.read_text(encoding="utf-8")


@pytest.mark.long
@needs_r
def test_runs_of_a_subject_in_several_periods_with_one_treatment_are_computed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(3)
    lines = ["Robot,Trial,Sensor,Energy,Load"]
    for robot, trial in product(range(8), range(4)):
        sensor = "lidar" if (robot + (trial in {1, 2})) % 2 else "camera"
        lines.append(f"r{robot},{trial},{sensor},{30 + robot + random.normal():.3f},{random.normal():.3f}")
    table = tmp_path / "study" / "run_table.csv"
    table.parent.mkdir()
    table.write_text("\n".join(lines[:-1]) + "\n", encoding="utf-8")
    declared = DeclaredDesign.of_mapping({"kind": "crossover", "unit": "Robot", "period": "Trial", "washout": True})
    said = ImportDescription(factors=("Robot", "Trial", "Sensor"), measures=("Energy", "Load"), design=declared)
    adopt(understand(table.parent, said), tmp_path / "ours")
    results = load_results(tmp_path / "ours")
    (effect,) = analyse(results).measure("Energy").test.effects
    assert effect.degrees_of_freedom == (1, 5)
    study = fact_finding.facts_of_study(results, results.folder)
    notebook, script = (results.folder / kind.value for kind in Recomputation)
    notebook.write_text(notebook_of(study), encoding="utf-8")
    script.write_text(r_script(study), encoding="utf-8")
    assert "numbers agree" in executed(notebook, monkeypatch)
    finished = rscript(script)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr
