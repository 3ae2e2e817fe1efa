from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import written_config
from tests.core.execution.conftest import RecordingObserver

from robot_runner.cli.planning import plan_of
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.events.manager import EventManager
from robot_runner.core.execution.durations import Durations, TimeLeft
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.known_durations import DeclaredDurations
from robot_runner.core.execution.notices import AttemptFinished, AttemptStarted, ExperimentStarted
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.plugin import System
from robot_runner.core.storage.journal import last_records
from robot_runner.core.treatments import bind, treatment
from robot_runner.ros.turtlebot3.basic_turtlebot3 import BasicTurtlebot3

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

VIDEO, NETWORK = {"Task": "Video"}, {"Task": "Network"}
FOUR = [VIDEO, NETWORK, VIDEO, NETWORK]


def learn(durations: Durations, runs: list[tuple[Mapping[str, Any], float]], *, pause: float = 0.0) -> float:
    now = 0.0
    for combination, seconds in runs:
        durations.begin(combination, now)
        now += seconds
        durations.end(now, "done", is_last=True)
        now += pause
    return now


@pytest.mark.parametrize("seconds", [-3600.0, 31_536_000.0])
def test_a_clock_that_was_set_in_a_run_or_a_pause_lengthens_nothing(seconds: float) -> None:
    durations, run = Durations(), {"run": "r_1", "combination": VIDEO}
    began = datetime(2026, 1, 31, 12, tzinfo=UTC)

    def take(kind: str, after: float, **fields: Any) -> None:
        durations.take_record({"kind": kind, "at": (began + timedelta(seconds=after)).isoformat(), **fields})

    ended = {"status": "done", "is_last": True}
    take("attempt_started", 0.0, **run)
    take("clock_set", seconds + 10.0, seconds=seconds)
    take("attempt_finished", seconds + 10.0, **run, **ended)
    take("clock_set", 2 * seconds + 12.0, seconds=seconds)
    take("attempt_started", 2 * seconds + 12.0, **run)
    take("attempt_finished", 2 * seconds + 22.0, **run, **ended)
    assert durations.of_run(VIDEO) == 10.0
    assert durations.pause == 2.0


class Said(System):
    def __init__(self, seconds: Any = 95.0) -> None:
        super().__init__()
        self.seconds = seconds

    def launch_mission(self) -> None:
        pass

    def duration_s(self, combination: Mapping[str, Any]) -> float | None:
        if isinstance(self.seconds, Exception):
            raise self.seconds
        return self.seconds


def declared_by(*plugins: System, config: Any = None, robot: str | None = None) -> DeclaredDurations:
    events = EventManager()
    for plugin in plugins:
        events.subscribe_methods(plugin, owner=plugin.name, kind=0)  # type: ignore[arg-type] # systems first
    return DeclaredDurations.of(config, plugins, events, robot)


def test_nothing_is_invented_where_nobody_knows_anything() -> None:
    durations = Durations(rest_s=5.0)
    durations.plan(FOUR)
    assert durations.left() is None
    estimate = durations.estimate()
    assert estimate.seconds is None
    assert "how long a run takes, until one has ended" in str(estimate)


def test_what_the_first_run_tells_is_known_at_once_however_long_it_took_to_find_out_that_nothing_was() -> None:
    durations = Durations()
    durations.plan(FOUR)
    assert durations.left() is None
    durations._cost = 1e6  # as where the machine was busy with something else meanwhile
    learn(durations, [(VIDEO, 3.0)])
    assert durations.left() is not None


def test_what_plugins_know_and_the_rests_add_up() -> None:
    declared = declared_by(BasicTurtlebot3(), Said(5.0))
    durations = Durations(declared, FOUR, rest_s=2.0, waits=["the operator between two runs"])
    durations.plan(FOUR)
    estimate = durations.estimate(probe_s=0.5)
    assert estimate.seconds == pytest.approx(4 * 100.0 + 3 * 2.0 + 0.5)
    assert estimate.is_least, "what the operator takes comes on top"
    assert "4 runs of 1 min 40 s, as BasicTurtlebot3 and Said say" in str(estimate)
    assert "the operator between two runs" in estimate.unknown


def test_a_bound_parameter_is_asked_with_its_treatment() -> None:
    tasks = [{"Seconds": 20.0}, {"Seconds": 10.0}]
    turtlebot3 = BasicTurtlebot3(task_s=treatment("Seconds"))
    bind(turtlebot3, tasks[0])
    declared = declared_by(turtlebot3)
    assert [declared.seconds(each) for each in tasks] == [125.0, 95.0]


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        (ValueError("no map"), "the method raised ValueError: no map"),
        (-1.0, "the method returned -1.0"),
        (float("nan"), "the method returned nan"),
        (True, "the method returned True"),
    ],
)
def test_an_answer_that_is_no_duration_is_a_finding(answer: Any, problem: str) -> None:
    declared = declared_by(Said(answer))
    assert declared.seconds(VIDEO) is None
    assert declared.seconds(NETWORK) is None
    (finding,) = declared.findings
    assert finding.where == "Said.duration_s"
    assert problem in finding.problem


def test_the_simulated_robot_takes_as_long_as_the_physics_needs() -> None:
    declared = declared_by(BasicTurtlebot3(), robot="simulated")
    assert declared.seconds(VIDEO) is None
    durations = Durations(declared, FOUR)
    durations.plan(FOUR)
    assert "how long the simulated robot takes" in str(durations.estimate())


def test_who_takes_part_in_the_mission_and_says_nothing_is_named() -> None:
    class Mute(System):
        def launch_mission(self) -> None:
            pass

    durations = Durations(declared_by(Said(95.0), Mute()), FOUR)
    durations.plan(FOUR)
    assert "launch_mission of Mute" in durations.estimate().unknown


def test_runs_that_ended_correct_the_estimate_by_treatment() -> None:
    durations = Durations(rest_s=1.0)
    durations.plan(FOUR)
    learn(durations, [(VIDEO, 100.0), (NETWORK, 10.0)], pause=6.0)
    assert durations.left() == TimeLeft(0.0, 110.0 + 2 * 6.0)
    durations.begin(VIDEO, 122.0)
    assert durations.left() == TimeLeft(100.0, 10.0 + 6.0)
    estimate = durations.estimate()
    assert estimate.seconds is not None
    assert "as the 2 runs that ended" in str(estimate)


def test_a_combination_that_was_not_seen_has_the_sum_of_its_treatments_effects() -> None:
    durations = Durations()
    cells = {("a", 1): 10.0, ("a", 2): 20.0, ("b", 1): 110.0}
    learn(durations, [({"F": f, "G": g}, seconds) for (f, g), seconds in cells.items()])
    expected = durations.of_run({"F": "b", "G": 2})
    assert expected is not None
    assert 60.0 < expected <= 110.0
    assert durations.of_run({"F": "a", "G": 2}) == 20.0


def test_what_runs_take_beyond_what_was_said_holds_for_the_others() -> None:
    class Two(Said):
        def duration_s(self, combination: Mapping[str, Any]) -> float:
            return {"Video": 95.0, "Network": 300.0}[combination["Task"]]

    durations = Durations(declared_by(Two()), FOUR)
    durations.plan(FOUR)
    learn(durations, [(VIDEO, 99.0)])
    assert durations.of_run(NETWORK) == pytest.approx(304.0)


def test_all_attempts_of_a_run_count_and_interrupted_ones_do_not() -> None:
    durations = Durations()
    video = VIDEO
    durations.begin(video, 0.0)
    durations.end(10.0, "failed", is_last=False)
    durations.begin(video, 11.0)
    durations.end(16.0, "done", is_last=True)
    assert durations.of_run(video) == 16.0
    durations.begin(video, 20.0)
    durations.end(21.0, "interrupted", is_last=True)
    durations.begin(video, 5000.0)
    durations.end(5001.0, "failed", is_last=True)
    assert durations.of_run(video) == 16.0, "runs that failed say less than one that is done"
    assert durations.pause == 4.0


def test_a_pause_that_took_a_night_does_not_count() -> None:
    durations = Durations(rest_s=3.0)
    learn(durations, [(VIDEO, 10.0), (VIDEO, 10.0)], pause=40_000.0)
    assert durations.pause == 3.0


def test_only_the_end_of_a_long_journal_is_read(tmp_path: Path) -> None:
    journal = tmp_path / "journal.jsonl"
    head = '{"kind":"attempt_started","at":"2026-01-31T12:00:00Z"'
    lines = [f'{head},"run":"r_{number}","attempt":1}}\n' for number in range(1000)]
    journal.write_text("".join(lines) + '{"kind":"attempt_st')
    found = [record["run"] for record in last_records(journal, kinds=["attempt_started"], within=700)]
    assert found[-1] == "r_999"
    assert 1 < len(found) < 12
    assert list(last_records(tmp_path / "nothing", kinds=["attempt_started"])) == []


def test_what_a_journal_tells_of_time_left_is_not_trusted() -> None:
    assert TimeLeft.of_facts(TimeLeft(1.0, 2.0, is_least=True).facts()) == TimeLeft(1.0, 2.0, is_least=True)
    for odd in (None, [], "x", {"run": None, "others": 1, "is_least": 0}, {}):
        assert TimeLeft.of_facts(odd) is None


SLOW = """
def duration_s(self, combination): return 60.0
def launch_mission(self): time.sleep(0.2)
def populate_run_data(self): return {"Energy": 1.0}
"""
HEAD = """\
import time
from pathlib import Path
from robot_runner import *


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
    time_between_runs_in_ms = 50
"""


@pytest.fixture
def moments(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[float]]:
    """Return when runs began and ended, by the name of what is told so: the clock is read some time before a record."""
    told: dict[str, list[float]] = {"begin": [], "end": []}
    begin, end = Durations.begin, Durations.end

    def begin_and_tell(each: Durations, combination: Mapping[str, Any], now: float, *more: Any) -> None:
        told["begin"].append(now)
        begin(each, combination, now, *more)

    def end_and_tell(each: Durations, now: float, *more: Any, **named: Any) -> None:
        told["end"].append(now)
        end(each, now, *more, **named)

    monkeypatch.setattr(Durations, "begin", begin_and_tell)
    monkeypatch.setattr(Durations, "end", end_and_tell)
    return told


def test_plan_screens_and_status_tell_the_same_and_correct_themselves(
    tmp_path: Path, moments: dict[str, list[float]]
) -> None:
    config = written_config(tmp_path, SLOW, head=HEAD)
    assert plan_of(config, {}).duration.seconds == pytest.approx(4 * 60.0 + 3 * 0.05)
    observer = RecordingObserver()
    execute_experiment(prepare_or_refuse(config, {}), observer, resumption=Resumption(only=("r_1", "r_2")))
    started = next(each for each in observer.notices if isinstance(each, ExperimentStarted))
    assert started.left == TimeLeft(0.0, pytest.approx(2 * 60.0 + 2 * 0.05), is_least=True)
    begun = [each.left for each in observer.notices if isinstance(each, AttemptStarted)]
    ended = [each.left for each in observer.notices if isinstance(each, AttemptFinished)]
    assert begun[0] is not None
    assert begun[0].run == 60.0
    assert ended[0] is not None
    journal = [json.loads(line) for line in (tmp_path / "results/trial/journal.jsonl").read_text().splitlines()]
    began, over = (
        [datetime.fromisoformat(record["at"]) for record in journal if record["kind"] == kind]
        for kind in ("attempt_started", "attempt_finished")
    )
    first, second = ((late - soon).total_seconds() for soon, late in zip(began, over, strict=True))
    took = moments["end"][0] - moments["begin"][0]
    assert 0.2 <= took < 60
    assert ended[0].others == pytest.approx(took + 0.05), "one run has shown how long it takes"
    assert not ended[0].is_least
    kept = [record["left"] for record in journal if record["kind"] == "attempt_finished"]
    assert kept == [each.facts() for each in ended if each is not None]
    planned = plan_of(config, {}).duration
    status = read_status(tmp_path / "results/trial")
    assert planned.seconds == pytest.approx(status.seconds_left)
    between = (began[1] - over[0]).total_seconds()
    assert planned.seconds == pytest.approx(first + second + 2 * between, abs=0.01)
    assert "as the 2 runs that ended" in str(planned)
