from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.cli.screens.ending import print_outcome
from robot_runner.cli.screens.progress import Progress
from robot_runner.core.errors import Finding
from robot_runner.core.events.measure import Origin

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def told(clock: Any, screenful: Any, notices: Any) -> Any:
    """Return what tells the end of an experiment of which the screen saw some runs."""

    def tell(*, seen: int = 4, origin: Origin = Origin.MEASURED, **facts: Any) -> str:
        progress = Progress(clock)
        progress.take(notices.started())
        for number in range(1, seen + 1):
            progress.take(notices.done(number, origin=origin))
        shown = screenful()
        print_outcome(shown.console, notices.finished(**facts), progress, command="robot-runner c.py")
        return shown.text

    return tell


@pytest.mark.parametrize(
    ("facts", "verdict"),
    [
        ({}, "All 4 runs are done (1 min 01 s)."),
        ({"seen": 0}, "All 4 runs are done before: nothing was executed."),
        ({"done_count": 1}, "The one run is done (1 min 01 s)."),
        ({"done_count": 3, "failed_count": 1, "failed": ["r_1"]}, "3 of 4 runs done, 1 failed, 0 to do (1 min 01 s)."),
        (
            {"done_count": 1, "todo_count": 3, "interrupted": True},
            "Interrupted: 1 of 4 runs done, 0 failed, 3 to do (1 min 01 s).",
        ),
        (
            {"done_count": 1, "todo_count": 2, "failed_count": 1, "failed": ["r_2"], "stopped_by": "on_failure"},
            "Stopped by on_failure: 1 of 4 runs done, 1 failed, 2 to do (1 min 01 s).",
        ),
    ],
)
def test_the_verdict(told: Any, facts: dict[str, Any], verdict: str) -> None:
    assert told(**facts).splitlines()[1] == verdict


def test_values_that_were_not_measured_are_labelled(told: Any) -> None:
    assert "Energy: simulated, not measured" in told(origin=Origin.SIMULATED)
    assert "Energy: estimated, not measured" in told(origin=Origin.ESTIMATED)
    assert "not measured" not in told()


def test_reasons_and_findings_that_many_runs_share_are_said_once(told: Any) -> None:
    findings = [Finding.warning(f"r_{n}, Ina219", f"{n} samples lost", "Look at the cable.") for n in range(1, 5)]
    findings.append(Finding.warning("c.py, RobotRunnerConfig", "exclude_combinations[1] removes nothing"))
    text = told(
        done_count=0,
        failed_count=3,
        failed=["r_1", "r_2", "r_3"],
        failures=["r_1: stop_run: no way", "r_2: stop_run: no way", "r_3: it was killed"],
        findings=findings,
    )
    assert [line for line in text.splitlines() if line.startswith(("  ✗", "  !", "    "))] == [
        "  ✗ r_1, r_2: stop_run: no way",
        "  ✗ r_3: it was killed",
        "  ! Ina219: 1 samples lost, and the like (in r_1, r_2, r_3, r_4)",
        "    Look at the cable.",
        "  ! c.py, RobotRunnerConfig: exclude_combinations[1] removes nothing",
    ]


def test_endless_lists_are_cut(told: Any) -> None:
    failures = [f"r_{n}: reason {chr(97 + n)}" for n in range(20)]
    findings = [Finding.warning("c.py", f"odd {chr(97 + n)}") for n in range(20)]
    lines = told(failed_count=20, failed=["r_0"], failures=failures, findings=findings).splitlines()
    assert sum(line.startswith("  ✗") for line in lines) == 9
    assert "  ✗ 12 more reasons: journal.jsonl has them all" in lines
    assert "  ! 12 more findings: journal.jsonl has them all" in lines


def test_what_to_do_next_fits_how_it_ended(told: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "Next     for figures, tests and threats to validity: robot-runner report results/trial" in told()
    assert "go on with the 3 runs that are left: robot-runner c.py" in told(done_count=1, todo_count=3)
    failed = {"done_count": 2, "failed_count": 1, "failed": ["r_2"], "todo_count": 1}
    assert "look at results/trial/journal.jsonl, then execute what is left (1 failed, 1 to do)" in told(**failed)
    log = tmp_path / "results" / "trial" / "runs" / "r_2" / "log.txt"
    log.parent.mkdir(parents=True)
    log.write_text("it was dark", encoding="utf-8")
    text = told(**failed)
    assert "look at results/trial/runs/r_2/log.txt, then" in text
    assert "results/trial/runs/<run>/ has what the run printed" in text
