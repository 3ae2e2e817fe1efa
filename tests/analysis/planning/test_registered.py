"""Each way in which an experiment can deviate from its registration is told; none is where there is none."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.planning.registered import registered
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.storage.registration import write_registration

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner.analysis.planning.registered import Registered

CONFIG = "# the config\n"
PLAN = AnalysisPlan("Energy").as_mapping()


def registered_experiment(
    root: Path,
    change: Callable[[dict[str, Any]], object],
    report: dict[str, Any] | None = None,
    made: dict[str, Any] | None = None,
    **registration: Any,
) -> Registered:
    """Return what is told of an experiment that was registered, with its manifest changed.

    Args:
        root: of its folder.
        change: of the manifest.
        report: how its report is asked for.
        made: what is made otherwise.
        registration: what it has otherwise.
    """
    given: dict[str, Any] = {
        "values": lambda treatments, repetition: {"Energy": 10.0 * treatments["Speed"] + repetition},
        "analysis": PLAN,
    }
    factors = [Factor("Task", ["Video", "Network"]), Factor("Speed", [1, 2], unit="m/s")]
    folder = make_experiment(root / "made", factors, **given | (made or {}))
    folder.config.mkdir()
    (folder.config / "study.py").write_text(CONFIG, encoding="utf-8")
    manifest = json.loads(folder.manifest.read_text(encoding="utf-8"))
    design = {name: each for name, each in manifest["design"].items() if name != "source"}
    content = {
        "registered_at": "2026-01-30T12:00:00.000Z",
        "experiment": "made",
        "config": {"file": "study.py", "sha256": hashlib.sha256(CONFIG.encode()).hexdigest(), "modules": {}},
        "design": {**design, "excluded": []},
        "seed": 7,
        "measures": [{"name": "Energy", "unit": ""}],
        "analysis": PLAN,
        "power": None,
    }
    content |= registration
    made = write_registration(folder.registration, content)
    manifest["registration"] = made.facts()
    manifest["executions"] = [{"started_at": "2026-01-31T12:00:00.000Z", "deviations": {}}]
    change(manifest)
    folder.manifest.write_text(json.dumps(manifest), encoding="utf-8")
    results = load_results(folder.root)
    found = registered(results, analyse(results, **(report or {})))
    assert found is not None
    return found


def test_an_experiment_that_followed_its_registration_has_no_deviations(tmp_path: Path) -> None:
    found = registered_experiment(tmp_path, lambda manifest: None)
    assert found.deviations == ()
    assert found.sentence.endswith(f"SHA-256 {found.sha256}. Deviations: none.")


DEVIATION = {"at": "2026-02-01T12:00:00.000Z", "run": "r_1", "column": "Energy", "was": "877", "is": "878"}
BATCHES = [
    {"batch": 1, "repetitions": 3, "runs": 12},
    {"batch": 2, "repetitions": 4, "runs": 4, "at": "2026-02-01T12:00:00.000Z"},
]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda each: each.update(seed=8, design={**each["design"], "shuffle": True}), "the seed of the order is 8"),
        (lambda each: each.update(seed=8), "whether the order is randomised: no, and yes was registered"),
        (
            lambda each: each.update(analysis=AnalysisPlan("Energy", doubtful=Doubtful.REFUSE).as_mapping()),
            "doubtful of the analysis plan: refuse, and keep was registered",
        ),
        (lambda each: each["design"].update(repetitions=5), "repetitions: 5, and 3 was registered"),
        (lambda each: each["design"].update(blocks="Task"), "blocks of the order: Task, and none was registered"),
        (
            lambda each: each["design"].update(batches=BATCHES, repetitions=4),
            "extended beyond what was registered: batch",
        ),
        (lambda each: each.update(analysis_changes=[{}]), "the analysis plan was changed after runs"),
        (lambda each: each.update(analysis={**PLAN, "alpha": 0.1}), "alpha of the analysis plan: 0.1"),
        (
            lambda each: each.update(table_deviations=[DEVIATION, DEVIATION]),
            "the run table was edited by hand (2 changes)",
        ),
        (lambda each: each.update(registration_changes=[{"registration": {}}]), "another registration took the place"),
        (lambda each: each.update(repeat_until_changes=[{}]), "how precisely measures are to be known was changed"),
        (
            lambda each: each["executions"][0].update(started_at="2026-01-29T00:00:00.000Z"),
            "registered after the first",
        ),
        (lambda each: each["executions"][0].update(deviations={"attempts": "2"}), "set from outside on 2026-01-31"),
    ],
)
def test_a_deviation_is_told(tmp_path: Path, change: Callable[[dict[str, Any]], object], told: str) -> None:
    found = registered_experiment(tmp_path, change, **({"design": _shuffled()} if "order is" in told else {}))
    assert any(told in each for each in found.deviations), found.deviations
    assert len(found.deviations) == 1


def _shuffled() -> dict[str, Any]:
    factors = {"Task": ["Video", "Network"], "Speed": ["1", "2"]}
    return {"factors": factors, "repetitions": 3, "shuffle": True, "blocks": None, "excluded": []}


def test_another_unit_of_a_factor_is_told_and_a_whole_number_with_a_point_is_no_other_treatment(tmp_path: Path) -> None:
    factors = {"Task": ["Video", "Network"], "Speed": ["1.0", "2.0"]}
    design = {**_shuffled(), "shuffle": False, "factors": factors, "units": {"Speed": "km/h"}}
    found = registered_experiment(tmp_path, lambda manifest: None, design=design)
    assert found.deviations == ("Speed is in m/s, and km/h was registered",)


def test_combinations_and_configs_other_than_the_registered_ones_are_told(tmp_path: Path) -> None:
    design = {**_shuffled(), "shuffle": False, "excluded": [["Video", "2"]]}
    config = {"file": "study.py", "sha256": "0" * 64, "modules": {}}
    found = registered_experiment(tmp_path, lambda manifest: None, design=design, config=config)
    assert found.deviations == (
        "1 combination not registered: Video / 2",
        "the file study.py was changed after the registration",
    )


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda each: each["registration"].update(sha256="0" * 64), "its checksum differs"),
        (
            lambda each: each.update(registration=None, registration_changes=[{"registration": {"sha256": "1"}}]),
            "made after the first run, and does not count",
        ),
    ],
)
def test_a_registration_that_does_not_count_is_told(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], problem: str
) -> None:
    found = registered_experiment(tmp_path, change)
    assert problem in found.problem
    assert problem in found.sentence
    assert found.deviations == ()


#: Asked for a report of a plan with covariates; and what of it deviates.
REPORTS: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    ({}, ("measures tested that were not planned: CPU",)),
    ({"measures": ["Energy", "Time", "Voltage"]}, ()),
    ({"measures": ["Voltage"]}, ("planned measures that this report leaves out: Energy, Time",)),
    (
        {"alpha": 0.01},
        ("this report does not follow the plan, as its level of significance or its correction is another",),
    ),
    ({"plan": AnalysisPlan("Energy")}, ("this report follows a plan that was given for it, and not the experiment's",)),
]


@pytest.mark.parametrize(("report", "told"), REPORTS)
def test_of_a_report_exactly_what_was_not_planned_is_told(
    tmp_path: Path, report: dict[str, Any], told: tuple[str, ...]
) -> None:
    names = ("Energy", "Time", "Voltage", "CPU")
    random = np.random.default_rng(1)
    plan = AnalysisPlan("Energy", secondary="Time", covariates="Voltage").as_mapping()
    measured = {"measures": list(names), "analysis": plan}
    found = registered_experiment(
        tmp_path,
        lambda manifest: None,
        report,
        made={**measured, "values": lambda *_: dict(zip(names, random.normal(size=4).tolist(), strict=True))},
        analysis=plan,
        measures=[{"name": name, "unit": ""} for name in names],
    )
    assert found.deviations == told
