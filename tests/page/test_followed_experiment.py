"""An experiment that is followed from its folder, as it grows, is made anew, or is hostile."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest
from tests.analysis import experiment_folders

from robot_runner.analysis.importing.adoption import adopt
from robot_runner.analysis.importing.description import ImportDescription
from robot_runner.analysis.importing.understanding import understand
from robot_runner.core.execution import experiment_status
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import Holder
from robot_runner.page import followed_experiment, followed_table, found_experiments, sampled_curves
from robot_runner.page.followed_experiment import FollowedExperiment
from robot_runner.page.followed_table import JournalTail
from robot_runner.page.found_experiments import FoundExperiments, id_of
from robot_runner.page.sampled_curves import RunCurves, ThinnedSamples

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

AT = "2026-01-31T12:00:00.000Z"


def line(kind: str, **fields: Any) -> str:
    return json.dumps({"kind": kind, "at": AT, **fields}, separators=(",", ":")) + "\n"


def begin(run: str) -> str:
    return line("attempt_started", run=run, attempt=1)


def end(run: str, energy: float | None, *, status: str = "done", doubts: tuple[str, ...] = ()) -> str:
    measure = {"value": energy, "owner": "config", "origin": None, "doubts": list(doubts)}
    facts = {"seconds": 1.0, "failure": "it fell" if status == "failed" else None, "is_last": True, "stamps": {}}
    return line("attempt_finished", run=run, attempt=1, status=status, measures={"Energy": measure}, **facts)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Return an experiment of two tasks with two runs each, none of which was executed."""
    return written(experiment_folders.two_tasks(tmp_path / "trial", (870.0, 872.0), (834.0, 836.0)).root)


def written(folder: Path) -> Path:
    """Have the journal say that the table on disk is as new as its records."""
    with (folder / "journal.jsonl").open("a") as journal:
        journal.write(line("table_written"))
    return folder


def settled(experiment: FollowedExperiment) -> dict[str, Any]:
    parts = experiment.look()
    while experiment.is_behind:
        parts |= experiment.look()
    return parts


def test_imported_results_are_told_as_such(tmp_path: Path) -> None:
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "run_table.csv").write_text("Task,Energy\nIdle,1.5\nVideo,2.5\n")
    said = ImportDescription(factors=("Task",), measures=("Energy",))
    adopt(understand(tmp_path / "study", said), tmp_path / "ours")
    assert settled(FollowedExperiment(tmp_path / "ours"))["state"]["word"] == "imported"


def test_it_tells_what_status_tells(root: Path) -> None:
    followed = FollowedExperiment(root)
    parts = settled(followed)
    told, status = parts["state"], read_status(root)
    assert told["counts"]["done"] == status.done == 4
    assert (told["word"], told["name"]) == ("done", status.experiment_name)
    assert followed.look() == {}, "nothing has happened"
    means = next(each for each in parts["means"] if each["factor"] == "Task")
    count, mean, half = means["rows"][0]["cells"][0]
    assert (count, mean) == (2, pytest.approx(871.0))
    assert half == pytest.approx(12.706, abs=0.001)  # t(0.975, 1) * 1.4142 / sqrt(2)


def test_records_reach_rows_means_and_findings(root: Path) -> None:
    followed = FollowedExperiment(root)
    settled(followed)
    with (root / "journal.jsonl").open("a") as journal:
        journal.write(line("experiment_started", runs=4) + begin("r_1"))
        journal.flush()
        settled(followed)
        assert followed.rows(0, 9, status="running")["rows"] == [], "nobody executes it"
        journal.write(end("r_1", 900.0, doubts=("the sensor was at its limit",)))
        journal.write(line("finding", run="r_1", owner="Ina219", problem="it is odd", fix="Look."))
        journal.flush()
        parts = settled(followed)
    (row,) = parts["rows"]["rows"]
    assert (row[1:3], row[4], row[5]) == (["r_1", "done"], [900.0], ["Energy"])
    means = next(each for each in parts["means"] if each["factor"] == "Task")
    assert any(cells[0][1] == pytest.approx(886.0) for cells in (each["cells"] for each in means["rows"]))
    assert parts["findings"]["last"][-1]["problem"] == "it is odd"


@pytest.mark.parametrize("is_long", [False, True])
def test_runs_that_ended_after_the_table_was_written_last_are_told_to_who_comes_later(
    root: Path, monkeypatch: pytest.MonkeyPatch, is_long: bool
) -> None:
    with (root / "journal.jsonl").open("a") as journal:  # as beside an execution, and as a kill leaves it
        journal.write(begin("r_1") + end("r_1", 900.0, doubts=("it was at its limit",)))
        journal.write(begin("r_2") + end("r_2", None, status="failed"))
    if is_long:  # it takes several looks
        monkeypatch.setattr(followed_table, "_AT_ONCE", 400)
    followed = FollowedExperiment(root)
    parts = settled(followed)
    parts |= followed.look()
    rows = [row[1:3] + row[4:] for row in followed.rows(0, 2)["rows"]]
    assert rows == [["r_1", "done", [900.0], ["Energy"]], ["r_2", "failed", [None], []]]
    cells = next(each for each in parts["means"] if each["factor"] == "Task")["rows"][0]["cells"]
    assert cells == [[1, 900.0, None]]
    assert read_status(root).failed == 1


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have every experiment be executed by somebody: no process sees the locks that are its own."""
    for module in (experiment_status, followed_experiment, found_experiments):
        monkeypatch.setattr(module, "holder_of", lambda _: Holder(1, "lab", AT))


def test_a_message_of_a_run_turns_the_direction_of_no_writing(root: Path) -> None:
    followed = FollowedExperiment(root)
    settled(followed)
    with (root / "journal.jsonl").open("a") as journal:
        journal.write(line("finding", run="r_1", owner="Ina219", problem="\u202eit is odd", fix="Look."))
        journal.flush()
        findings = settled(followed)["findings"]
    assert findings["last"][-1]["problem"] == "\\u202eit is odd"


def test_measures_that_are_no_numbers_have_no_means(tmp_path: Path) -> None:
    rows = [("a", 1.0, True, "left"), ("b", 2.0, False, "right")]
    measures = {"Energy": "J", "Success": "", "Side": ""}
    folder = experiment_folders.Folder(tmp_path / "trial", {"Task": ["a", "b"]}, rows, measures)
    followed = FollowedExperiment(written(folder.write()))
    settled(followed)
    [means] = followed.snapshot()["means"]
    assert [each["name"] for each in means["measures"]] == ["Energy"]
    assert [row["cells"] for row in means["rows"]] == [[[1, 1.0, None]], [[1, 2.0, None]]]


def means_of(parts: dict[str, Any]) -> list[Any]:
    """Return how many runs the means of each task are of, and these means."""
    task = next(each for each in parts["means"] if each["factor"] == "Task")
    return [row["cells"][0][:2] for row in task["rows"]]


def test_an_empty_treatment_is_quoted_and_not_called_none(root: Path) -> None:
    table = root / "run_table.csv"
    table.write_text(table.read_text("utf-8").replace("Network", ""), "utf-8")
    followed = FollowedExperiment(root)
    means = next(each for each in settled(followed)["means"] if each["factor"] == "Task")
    assert "“”" in [row["treatment"] for row in means["rows"]]


def test_a_run_that_is_left_out_is_in_no_mean_from_then_on(root: Path) -> None:
    followed = FollowedExperiment(root)
    settled(followed)
    with (root / "journal.jsonl").open("a") as journal:
        journal.write(line("excluded", run="r_1", reason="the door was open"))
        journal.flush()
        assert means_of(settled(followed)) == means_of(followed.snapshot()) == [[1, 872.0], [2, 835.0]]
        journal.write(line("included", run="r_1"))
        journal.flush()
        assert means_of(settled(followed)) == [[2, 871.0], [2, 835.0]]


@pytest.mark.parametrize(("plan", "count"), [({"doubtful": "leave out"}, 1), ({}, 2)])
def test_a_doubtful_value_is_in_a_mean_where_the_plan_of_the_analysis_has_it_in(
    root: Path, plan: dict[str, str], count: int
) -> None:
    manifest = json.loads((root / "manifest.json").read_text())
    (root / "manifest.json").write_text(json.dumps(manifest | {"analysis": plan}))
    with (root / "journal.jsonl").open("a") as journal:
        journal.write(begin("r_1") + end("r_1", 870.0, doubts=("the window was short",)))
    followed = FollowedExperiment(root)
    settled(followed)
    assert [cell[0] for cell in means_of(followed.snapshot())] == [count, 2]


@pytest.mark.usefixtures("held")
def test_each_place_that_waits_at_a_gate_is_told(root: Path) -> None:
    def gate(run: str, state: str, seen: str) -> str:
        return line("gate", run=run, attempt=1, condition=f"{run} is cool", state=state, seen=seen, seconds=1.0)

    followed = FollowedExperiment(root)
    with (root / "journal.jsonl").open("a") as journal:
        journal.write(gate("r_1", "waiting", "52") + gate("r_2", "waiting", "53") + gate("r_1", "waiting", "51"))
        journal.flush()
        told = settled(followed)["state"]["gates"]
        assert [(each["run"], each["seen"]) for each in told] == [("r_1", "51"), ("r_2", "53")]
        assert told[0]["condition"] == "r_1 is cool"
        journal.write(gate("r_2", "open", "49"))
        journal.flush()
        assert [each["run"] for each in settled(followed)["state"]["gates"]] == ["r_1"]
        journal.write(line("experiment_started", runs=4))
        journal.flush()
        assert settled(followed)["state"]["gates"] == []


@pytest.mark.usefixtures("held")
def test_who_comes_while_a_run_goes_on_is_told_what_is_left_by_then(root: Path) -> None:
    begun = datetime.now(UTC) - timedelta(seconds=600)
    left = {"run": 1000.0, "others": 50.0, "is_least": False}
    with (root / "journal.jsonl").open("a") as journal:
        journal.write(json.dumps(json.loads(begin("r_1")) | {"at": begun.isoformat(), "left": left}) + "\n")
        journal.flush()
        followed = FollowedExperiment(root)
        told = settled(followed)["state"]["left"]
        assert told == pytest.approx(450.0, abs=60)
        found = FoundExperiments(root.parent)
        assert found.look()["experiments"][0]["left"] == pytest.approx(told, abs=60)
        for each in (followed, *found._followed.values()):  # as if that long had passed since
            each._history._left_at = (begun - timedelta(seconds=200)).isoformat()
        assert followed.snapshot()["state"]["left"] == pytest.approx(told - 200, abs=60)
        assert followed.snapshot()["state"]["left_of_others"] == 50.0
        assert found.look()["experiments"][0]["left"] == pytest.approx(told - 200, abs=60)


@pytest.mark.usefixtures("held")
def test_a_run_goes_on_for_as_long_however_the_clock_was_set_meanwhile(root: Path) -> None:
    followed = FollowedExperiment(root)
    with (root / "journal.jsonl").open("a") as journal:
        journal.write(begin("r_1") + line("clock_set", seconds=3600.0) + begin("r_2"))
        journal.write(line("clock_set", seconds=-60.0) + line("clock_set", seconds=1e300))
    since = {each["run"]: each["since"] for each in settled(followed)["state"]["in_flight"]}
    assert since == {"r_1": "2026-01-31T12:59:00.000Z", "r_2": "2026-01-31T11:59:00.000Z"}


def test_a_folder_that_is_gone_is_told_and_shown_again_once_it_is_back(root: Path) -> None:
    followed = FollowedExperiment(root)
    settled(followed)
    away = root.rename(root.with_name("renamed"))
    state = settled(followed)["state"]
    assert (state["word"], "no longer there" in state["problem"]["problem"]) == ("unreadable", True)
    away.rename(root)
    settled(followed)
    assert followed.snapshot()["state"]["word"] == "done"


def test_a_journal_in_the_place_of_one_that_was_removed_is_read_from_its_beginning(tmp_path: Path) -> None:
    path, away = tmp_path / "journal.jsonl", tmp_path / "away"
    tail = JournalTail(path)
    path.write_text(begin("r_1"))
    tail.read()
    path.rename(away)
    assert tail.read() == []
    away.write_text(begin("r_1") + begin("r_2"))  # the system gives the number of a file that was removed again
    away.rename(path)
    assert [each["run"] for each in tail.read()] == ["r_1", "r_2"]
    assert tail.has_begun_anew


def test_an_experiment_that_begins_anew_has_no_doubts_of_the_one_before(root: Path) -> None:
    followed = FollowedExperiment(root)
    settled(followed)
    journal = root / "journal.jsonl"
    with journal.open("a") as file:
        file.write(begin("r_1") + end("r_1", 900.0, doubts=("the sensor was at its limit",)))
    settled(followed)
    assert followed.rows(0, 1)["rows"][0][5] == ["Energy"]
    again = journal.with_name("again")
    again.write_text(line("experiment_started", runs=4))
    again.replace(journal)
    settled(followed)
    assert followed.rows(0, 1)["rows"][0][5] == []


@pytest.mark.usefixtures("held")
def test_the_curves_of_a_run_that_is_tried_again_are_those_of_the_new_attempt(root: Path) -> None:
    samples = root / "runs" / "r_1" / "Ina219" / "samples.csv"
    samples.parent.mkdir(parents=True, exist_ok=True)
    with (root / "journal.jsonl").open("a") as journal:
        journal.write(begin("r_1"))
        journal.flush()
        samples.write_text("time_s,power_w\n" + "".join(f"{second},1.0\n" for second in range(5)))
        followed = FollowedExperiment(root)
        version = settled(followed)["samples"]["runs"]["r_1"]
        samples.write_text("time_s,power_w\n" + "".join(f"{second},2.0\n" for second in range(9)))
        journal.write(end("r_1", None, status="failed").replace('"is_last":true', '"is_last":false') + begin("r_1"))
        journal.flush()
        assert settled(followed)["samples"]["runs"]["r_1"] > version
        (curves,) = (each for each in followed.curves("r_1") if each["plugin"] == "Ina219")
        assert curves["columns"][0]["low"] == [2.0] * 9


def test_the_journal_is_read_once_and_torn_or_damaged_lines_harm_nothing(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    tail = JournalTail(path)
    assert tail.read() == []
    path.write_text(begin("r_1") + "{broken\n" + '{"kind":"event","at":5}\n' + begin("r_2")[:20])
    assert [each["run"] for each in tail.read()] == ["r_1"]
    assert tail.damaged == 2
    with path.open("a") as file:
        file.write(begin("r_2")[20:])
    assert [each["run"] for each in tail.read()] == ["r_2"]
    assert tail.read() == []
    other = tmp_path / "other"
    other.write_text(begin("r_9"))
    other.replace(path)
    assert [each["run"] for each in tail.read()] == ["r_9"]
    assert (tail.has_begun_anew, tail.damaged) == (True, 0)
    path.write_bytes(b"x" * 3_000_000 + b"\n" + begin("r_3").encode() * 20_000)
    records = tail.read()
    while tail.is_behind:
        records += tail.read()
    assert (len(records), tail.damaged) == (20_000, 1)


@pytest.mark.parametrize("name", ["journal.jsonl", "run_table.csv", "manifest.json", "run_table.schema.json"])
@pytest.mark.parametrize("harm", ["link", "pipe", "binary", "deep", "folder"])
def test_a_hostile_folder_is_told_and_harms_nobody(root: Path, name: str, harm: str) -> None:
    path = root / name
    path.unlink()
    harms: dict[str, Callable[[], object]] = {
        "link": lambda: path.symlink_to("/etc/passwd"),
        "pipe": lambda: os.mkfifo(path),
        "binary": lambda: path.write_bytes(bytes(range(256)) * 100),
        "deep": lambda: path.write_text("[" * 100_000 + "]" * 100_000),
        "folder": path.mkdir,
    }
    harms[harm]()
    followed = FollowedExperiment(root)
    state = settled(followed).get("state") or followed.snapshot()["state"]
    assert state["word"]
    assert "root:" not in json.dumps(followed.snapshot())
    summaries = FoundExperiments(root.parent).look()["experiments"]
    assert len(summaries) <= 1


def test_only_experiments_below_the_folder_are_found_and_links_are_not_followed(root: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path.parent / f"{tmp_path.name}-elsewhere"
    root.rename(elsewhere)
    (tmp_path / "lab" / "deep").mkdir(parents=True)
    experiment_folders.two_tasks(tmp_path / "lab" / "deep" / "trial", (1.0, 2.0), (3.0, 4.0))
    (tmp_path / "lab" / "linked").symlink_to(elsewhere)
    found = FoundExperiments(tmp_path)
    (one,) = found.look()["experiments"]
    assert (one["word"], one["folder"].endswith("lab/deep/trial")) == ("done", True)
    assert found.folder(one["id"]) == tmp_path / "lab" / "deep" / "trial"
    assert found.folder(id_of(elsewhere)) is None


def test_samples_are_thinned_to_least_and_largest_values() -> None:
    samples = ThinnedSamples(1)
    for place in range(100_000):
        samples.add(float(place), [1000.0 if place == 77_777 else float(place % 3)])
    assert 200 <= len(samples.times) <= 400
    assert max(each for each in samples.high[0] if each is not None) == 1000.0
    assert min(each for each in samples.low[0] if each is not None) == 0.0


def test_the_last_sample_and_place_of_a_long_file_are_its_own(root: Path) -> None:
    folder = root / "runs" / "r_1" / "Long"
    folder.mkdir(parents=True)
    rows = "".join(f"{place},{place % 50},{place},0\n" for place in range(10_000))
    (folder / "samples.csv").write_text(f"time_s,power_W,x_m,y_m\n{rows}10000,7.5,10000,0\n")
    curves = RunCurves(ExperimentFolder(root), "r_1")
    curves.look()
    (told,) = [each for each in curves.told() if each["plugin"] == "Long"]
    assert (told["columns"][0]["last"], told["columns"][0]["last_at"]) == (7.5, 10_000.0)
    assert told["pose"][:2] == (10_000.0, 0.0)


def test_samples_are_told_by_the_seconds_since_the_first_and_not_since_the_machine_was_started(root: Path) -> None:
    folder = root / "runs" / "r_1" / "Meter"
    folder.mkdir(parents=True)
    (folder / "early.csv").write_text("time_s,power_W\n27370.25,5\n27370.5,6\n27372.25,7\n")
    (folder / "late.csv").write_text("time_s,power_W\n27371.25,5\n")
    curves = RunCurves(ExperimentFolder(root), "r_1")
    curves.look()
    told = {each["file"]: each for each in curves.told() if each["plugin"] == "Meter"}
    assert (told["early.csv"]["times"], told["early.csv"]["columns"][0]["last_at"]) == ([0.0, 0.25, 2.0], 2.0)
    assert told["late.csv"]["times"] == [1.0]


def test_a_sensor_that_fell_silent_is_told_with_the_time_of_its_last_value(root: Path) -> None:
    folder = root / "runs" / "r_1" / "Meter"
    folder.mkdir(parents=True)
    rows = "".join(f"{place},{12.1 if place <= 20 else ''},5\n" for place in range(96))
    (folder / "samples.csv").write_text(f"time_s,voltage_V,power_W\n{rows}")
    curves = RunCurves(ExperimentFolder(root), "r_1")
    curves.look()
    (told,) = [each for each in curves.told() if each["plugin"] == "Meter"]
    assert [(each["last"], each["last_at"]) for each in told["columns"]] == [(12.1, 20.0), (5.0, 95.0)]


def test_curves_grow_with_their_files_and_live_samples_give_way(root: Path) -> None:
    folder = root / "runs" / "r_1" / "Meter"
    folder.mkdir(parents=True)
    live = folder / ".samples.csv.live"
    live.write_text("time_s,power_W\n0.5,7.5\n1.0,8.")
    curves = RunCurves(ExperimentFolder(root), "r_1")
    curves.look()
    (told,) = [each for each in curves.told() if each["plugin"] == "Meter"]
    assert (told["is_live"], told["times"], told["columns"][0]["high"]) == (True, [0.0], [7.5])
    with live.open("a") as file:
        file.write("5\n")
    version = curves.version
    curves.look()
    assert curves.version > version
    assert curves.told()[0]["columns"][0]["high"][-1] == 8.5
    (folder / "samples.csv").write_text("time_s,x_m,y_m,heading_rad\n0,0,0,0\n1,1,0,0.5\n2,nan,1,0\n")
    (folder / "secret.csv").symlink_to("/etc/passwd")
    curves.look()
    (told,) = [each for each in curves.told() if each["plugin"] == "Meter"]
    assert (told["is_live"], told["way"], told["pose"]) == (False, [(0.0, 0.0), (1.0, 0.0)], (1.0, 0.0, 0.5))


def test_samples_beyond_what_is_drawn_of_a_file_are_said_to_be_missing(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = root / "runs" / "r_1" / "Long"
    folder.mkdir(parents=True)
    (folder / "samples.csv").write_text("time_s,power_W\n" + "".join(f"{second},5\n" for second in range(100)))
    for most, times, is_cut in ((10_000, 100, False), (60, 11, True)):
        monkeypatch.setattr(sampled_curves, "_MOST_BYTES", most)
        curves = RunCurves(ExperimentFolder(root), "r_1")
        curves.look()
        (told,) = [each for each in curves.told() if each["plugin"] == "Long"]
        assert (len(told["times"]), told["is_cut"]) == (times, is_cut)


@pytest.mark.long
def test_how_much_of_a_long_journal_is_read_is_told_until_it_is_whole(root: Path) -> None:
    with (root / "journal.jsonl").open("a", encoding="utf-8") as file:
        for _ in range(60_000):
            file.write(line("event", event="start_run", clock=1.0))
    followed = FollowedExperiment(root)
    shares = []
    state = followed.look()["state"]
    while followed.is_behind:
        assert state["word"] == "reading"
        shares.append(state["read"])
        state = followed.look()["state"]
    assert len(shares) > 2
    assert shares == sorted(shares)
    assert 0 < shares[0] < shares[-1] < 1
    assert state["counts"]["done"] == 4
