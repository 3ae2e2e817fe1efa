"""An adopted folder is an experiment of our own format; the originals stay as they are."""

from __future__ import annotations

import csv
import hashlib
import json

import pytest
from tests.analysis.importing.foreign_folder import make_earlier_folder, write

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.importing.adoption import adopt
from robot_runner.analysis.importing.description import (
    ImportDescription,
    SamplesDescription,
    parse_recipe,
    read_description,
)
from robot_runner.analysis.importing.recomputation import agreements
from robot_runner.analysis.importing.understanding import understand
from robot_runner.analysis.report.document import report_document
from robot_runner.analysis.report.material import Material
from robot_runner.core.errors import AnalysisError, StorageError
from robot_runner.core.execution.experiment_status import read_status


@pytest.fixture
def root(tmp_path):
    return make_earlier_folder(tmp_path / "earlier")


def adopted(root, target, **said):
    return adopt(understand(root, ImportDescription(**said)), target)


def digest(root):
    return {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(root.rglob("*")) if path.is_file()}


@pytest.mark.long
def test_the_originals_stay_as_they_are(root, tmp_path):
    before = digest(root)
    adopted(root, tmp_path / "ours")
    assert digest(root) == before


def test_the_table_keeps_its_own_values(root, tmp_path):
    adopted(root, tmp_path / "ours")
    results = load_results(tmp_path / "ours")
    assert results.factors == ("task", "offloaded")
    assert results.done["energy_J"].tolist() == [15.0, 16.0, 30.0]
    assert results.unit("energy_J") == "J"
    assert results.runs["Repetition"].tolist() == [1, 1, 2, 2]
    assert results.runs["offloaded"].cat.categories.tolist() == [False, True]


def test_samples_are_in_si_and_on_one_clock_a_run(root, tmp_path):
    adopted(root, tmp_path / "ours")
    results = load_results(tmp_path / "ours")
    power = results.samples("power", runs=["run_1"])
    assert power["power_W"].tolist() == [8.0, 8.0, 8.0]
    assert power["time_s"].tolist() == [0.5, 1.5, 2.5]  # the first sample of the CPU was half a second earlier
    assert results.samples("resources", runs=["run_1"])["time_s"].tolist() == [0.0, 1.0]


def test_moments_give_the_order_of_execution(root, tmp_path):
    adopted(root, tmp_path / "ours")
    runs = load_results(tmp_path / "ours").runs
    assert str(runs["start_measurement_at"][1]) == "2021-06-25 14:31:00+00:00"
    assert runs["start_measurement_at"].isna().tolist() == [False, False, False, True]


def test_differences_from_the_table_are_listed(root, tmp_path):
    found = {(each.measure, each.run_id): each for each in adopted(root, tmp_path / "ours").differences}
    assert (found["energy_J", "run_0"].table, found["energy_J", "run_0"].recomputed) == (15.0, 15.0)
    assert found["energy_J", "run_2"].relative == pytest.approx(-0.2)
    with (tmp_path / "ours" / "import" / "differences.csv").open() as file:
        listed = {(row["measure"], row["run_id"]): row for row in csv.DictReader(file)}
    assert float(listed["energy_J", "run_2"]["recomputed"]) == 24.0


def test_measures_that_differ_are_told_from_those_that_agree(root, tmp_path):
    found = {each.measure: each for each in agreements(adopted(root, tmp_path / "ours").differences)}
    assert [each.run_id for each in found["energy_J"].differing] == ["run_2"]
    assert [each.run_id for each in found["avg_cpu"].differing] == ["run_1"]


def test_a_mistaken_unit_is_noticed(root, tmp_path):
    found = agreements(adopted(root, tmp_path / "ours", units={"energy_J": "kJ"}).differences)
    assert next(each for each in found if each.measure == "energy_J").factor == 1e-3


def test_a_recomputed_measure_that_the_table_lacks_gets_a_column(root, tmp_path):
    recipes = (parse_recipe("PeakPower=max(power.csv:power_mW)"), parse_recipe("Samples=count(power.csv)"))
    adopted(root, tmp_path / "ours", recipes=recipes)
    results = load_results(tmp_path / "ours")
    assert results.done["PeakPower"].tolist() == [7.5, 8.0, 12.0]
    assert (results.unit("PeakPower"), results.unit("Samples")) == ("W", "1")


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        ("integral(power.csv:p)", 8.5),
        ("mean(power.csv:p)", 3.0),
        ("time_mean(power.csv:p)", 8.5 / 3),
        ("mean_times_duration(power.csv:p)", 9.0),
        ("sum(power.csv:p)", 9.0),
        ("min(power.csv:p)", 2.0),
        ("max(power.csv:p)", 4.0),
        ("median(power.csv:p)", 3.0),
        ("change(power.csv:p)", 2.0),
        ("count(power.csv)", 3.0),
        ("duration(power.csv)", 3.0),
    ],
)
def test_each_way_of_computing_a_measure(tmp_path, how, expected):
    write(tmp_path / "r" / "run_table.csv", "__run_id,t,e\nrun_0,a,1\n")
    write(tmp_path / "r" / "run_0" / "power.csv", "time_s,p\n5,2\n7,3\n8,4\n")
    recipes = (parse_recipe(f"x={how}"),)
    (run,) = adopted(tmp_path / "r", tmp_path / "ours", recipes=recipes).runs
    assert run.recomputed["x"] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("times", "seconds"),
    [
        (("1736296650586", "1736296651086"), [0.0, 0.5]),
        (("1736296650.5", "1736296651"), [0.0, 0.5]),
        (("2021-06-25T23:59:59.750Z", "2021-06-26T00:00:00.250Z"), [0.0, 0.5]),
        (("23:59:59.75", "00:00:00.25"), [0.0, 0.5]),
        (("3", "3.5"), [0.0, 0.5]),
    ],
    ids=["milliseconds since 1970", "seconds since 1970", "ISO 8601", "times of day, past midnight", "counted"],
)
def test_times_in_whichever_way_they_are_written(tmp_path, times, seconds):
    write(tmp_path / "r" / "run_table.csv", "__run_id,t,e\nrun_0,a,1\n")
    write(tmp_path / "r" / "run_0" / "power.csv", "time,p\n" + "".join(f"{time},1\n" for time in times))
    adopted(tmp_path / "r", tmp_path / "ours")
    samples = load_results(tmp_path / "ours").samples()["time_s"]
    assert (samples - samples[0]).tolist() == pytest.approx(seconds)


def test_samples_that_are_not_in_order_are_sorted_and_noted(tmp_path):
    write(tmp_path / "r" / "run_table.csv", "__run_id,t,e\nrun_0,a,1\n")
    write(tmp_path / "r" / "run_0" / "power.csv", "time_s,p\n2,20\n1,10\n")
    adopted(tmp_path / "r", tmp_path / "ours")
    assert load_results(tmp_path / "ours").samples()["p"].tolist() == [10, 20]
    notes = json.loads((tmp_path / "ours" / "manifest.json").read_text("utf-8"))["imported"]["notes"]
    assert "times were not in order, or missing, in run_0/power.csv" in notes


def test_what_was_not_understood_is_kept(root, tmp_path):
    adopted(root, tmp_path / "ours")
    assert (tmp_path / "ours" / "runs" / "run_0" / "original" / "notes.csv").read_text() == "who,what\nme,nothing\n"


def test_the_manifest_says_where_it_comes_from(root, tmp_path):
    adopted(root, tmp_path / "ours", origin="simulated")
    manifest = json.loads((tmp_path / "ours" / "manifest.json").read_text("utf-8"))
    assert (manifest["origin"], manifest["imported"]["from"]) == ("imported", "earlier")
    power = (root / "run_0" / "power.csv").read_bytes()
    assert manifest["imported"]["sources"]["run_0"]["power.csv"] == hashlib.sha256(power).hexdigest()
    assert load_results(tmp_path / "ours").columns["energy_J"].origin == "simulated"


def test_an_import_can_be_repeated_from_the_description_that_it_leaves(root, tmp_path):
    adopted(root, tmp_path / "ours", recipes=(parse_recipe("Peak=max(power.csv:power_mW)"),))
    said = read_description(tmp_path / "ours" / "import" / "description.toml")
    adopt(understand(root, said), tmp_path / "again")
    for name in ("run_table.csv", "run_table.schema.json", "import/differences.csv", "runs/run_0/power/samples.csv"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "ours" / name).read_bytes()


def test_folders_of_runs_columns_left_out_and_blocks_are_in_the_description(tmp_path):
    rows = "".join(f"{n},r{n % 3},t{n // 3 % 2},{n}.5,x\n" for n in range(12))
    write(tmp_path / "r" / "run_table.csv", f"nr,robot,task,energy,who\n{rows}")
    for n in range(12):
        write(tmp_path / "r" / "raw" / f"run{n}" / "power.csv", "time_s,power_W\n0,1\n1,1\n")
    first = understand(tmp_path / "r", ImportDescription(run_folder="raw/run{run_id}", ignore=("who",), block="robot"))
    adopt(first, tmp_path / "ours")
    again = understand(tmp_path / "r", read_description(tmp_path / "ours" / "import" / "description.toml"))
    assert (again.roles.block, again.roles.extras, again.runs) == ("robot", (), first.runs)
    assert all(run.folder is not None for run in again.runs)


def test_an_adopted_experiment_can_be_analysed_exported_and_looked_at(root, tmp_path):
    adopted(root, tmp_path / "ours")
    results = load_results(tmp_path / "ours")
    assert analyse(results).design.used == 3
    assert results.export()
    status = read_status(tmp_path / "ours")
    assert (status.done, status.todo, status.experiment_name) == (3, 1, "earlier")


def test_a_folder_that_holds_something_is_left_alone(root, tmp_path):
    write(tmp_path / "ours" / "mine.txt", "mine")
    with pytest.raises(StorageError, match="there is something already"):
        adopted(root, tmp_path / "ours")
    assert [path.name for path in (tmp_path / "ours").iterdir()] == ["mine.txt"]


def test_nothing_is_written_into_the_results_themselves(root):
    with pytest.raises(StorageError, match="inside of the results"):
        adopted(root, root / "ours")


def test_an_import_that_fails_leaves_nothing(root, tmp_path):
    write(root / "run_1" / "power.csv", "timestamp,power_mW\nsoon,1\n")
    with pytest.raises(Exception, match="times cannot be read"):
        adopted(root, tmp_path / "ours")
    assert [path.name for path in tmp_path.iterdir()] == ["earlier"]


def test_when_and_how_long_is_not_made_up(tmp_path):
    write(tmp_path / "r" / "run_table.csv", "__run_id,t,e\nrun_0,a,1\nrun_1,b,2\n")
    adopted(tmp_path / "r", tmp_path / "ours")
    results = load_results(tmp_path / "ours")
    assert results.attempts[["started_at", "seconds"]].isna().all(axis=None)
    document = report_document(Material(results, analyse(results)), made="now")
    assert "timeline" not in [figure.name for figure in document.figures]
    [runs] = [table for table in document.tables if table.name == "runs"]
    assert "Took" not in [column.name for column in runs.columns]


def traces(tmp_path, heading, cells, files):
    """Make runs with a trace each; return what is said of the traces."""
    rows = "".join(f"run_{n},t{n % 2},{each}\n" for n, each in enumerate(cells))
    write(tmp_path / "r" / "run_table.csv", f"__run_id,task,{heading}\n{rows}")
    for number, text in enumerate(files):
        write(tmp_path / "r" / f"run_{number}" / "power.csv", f"time_s,power_W\n{text}")
    return adopted(tmp_path / "r", tmp_path / "ours").warnings


def seconds(*times):
    return "".join(f"{time},1\n" for time in times)


def test_traces_that_outlast_the_run_or_end_before_it_are_told(tmp_path):
    files = [seconds(0, 10), seconds(0, 10.2), seconds(0, 14), seconds(0, 10), seconds(0, 4)]
    told = traces(tmp_path, "duration_s", ["10.0", "10.1", "9.9", "10.3", "10.2"], files)
    assert told == (
        "power.csv outlasts the run in 1 of 5 runs (run_2), by up to 3.6 s (run_2)",
        "power.csv ends before the run does: cut off? in 1 of 5 runs (run_4), by up to 5.69 s (run_4)",
    )
    notes = json.loads((tmp_path / "ours" / "manifest.json").read_text("utf-8"))["imported"]["notes"]
    assert told[0] in notes


def test_a_log_of_events_may_end_before_its_run(tmp_path):
    assert traces(tmp_path, "duration_s", ["10.0", "10.1", "9.9"], [seconds(0, 6), seconds(0, 7), seconds(0, 5)]) == ()


@pytest.mark.parametrize("first", [0, 0.75, 84211.25], ids=["from the start", "a little later", "since it was booted"])
def test_how_long_a_run_took_is_from_its_first_sample_to_its_last_wherever_times_count_from(tmp_path, first):
    begins = [first + 100 * number * (first > 1) for number in range(3)]
    assert traces(tmp_path, "energy", ["1.5", "2.5", "3.5"], [seconds(each, each + 10) for each in begins]) == ()
    results = load_results(tmp_path / "ours")
    assert results.attempts["seconds"].tolist() == [10.0, 10.0, 10.0]
    assert results.samples("power")["time_s"].tolist() == [0.0, 10.0] * 3


def test_times_below_zero_are_from_before_the_mission(tmp_path):
    traces(tmp_path, "energy", ["1.5", "2.5"], [seconds(-0.5, 0, 10), seconds(-0.25, 10)])
    results = load_results(tmp_path / "ours")
    assert results.attempts["seconds"].tolist() == [10.0, 10.0]
    assert results.samples("power")["time_s"].tolist() == [-0.5, 0.0, 10.0, -0.25, 10.0]


def test_times_that_count_from_before_the_run_are_set_beside_its_other_samples(tmp_path):
    write(tmp_path / "r" / "run_table.csv", "__run_id,t,e\nrun_0,a,1\n")
    write(tmp_path / "r" / "run_0" / "cpu.csv", "time_s,cpu\n84211.5,20\n84221.5,30\n")
    write(tmp_path / "r" / "run_0" / "load.csv", "elapsed_s,load\n4,1\n8,2\n")
    write(tmp_path / "r" / "run_0" / "power.csv", "timestamp,power_W\n1736296650,5\n1736296660,6\n")
    (run,) = adopted(tmp_path / "r", tmp_path / "ours").runs
    results = load_results(tmp_path / "ours")
    assert (run.duration, run.stamps["stop_measurement_at"]) == (10.0, "2025-01-08T00:37:40.000Z")
    assert [results.samples(name)["time_s"].tolist() for name in ("cpu", "power")] == [[0.0, 10.0]] * 2
    assert results.samples("load")["time_s"].tolist() == [4.0, 8.0]


def test_moments_of_a_file_that_begins_when_another_one_is_over_stay_where_they_are(tmp_path):
    write(tmp_path / "r" / "run_table.csv", "__run_id,t,e\nrun_0,a,1\n")
    write(tmp_path / "r" / "run_0" / "power.csv", "timestamp,power_W\n1736296650,5\n1736296660,6\n")
    write(tmp_path / "r" / "run_0" / "radio.csv", "timestamp,signal\n1736296680,5\n1736296690,6\n")
    (run,) = adopted(tmp_path / "r", tmp_path / "ours").runs
    assert run.duration == 40.0
    assert load_results(tmp_path / "ours").samples("radio")["time_s"].tolist() == [30.0, 40.0]


def test_a_format_of_times_of_day_is_in_the_description(tmp_path):
    write(tmp_path / "r" / "run_table.csv", "__run_id,t,e\nrun_0,a,1\n")
    write(tmp_path / "r" / "run_0" / "power.csv", "when,power_W\n11:59:59 PM,5\n12:00:01 AM,6\n")
    said = SamplesDescription("power.csv", time="when", time_unit="%I:%M:%S %p")
    (run,) = adopted(tmp_path / "r", tmp_path / "ours", samples=(said,)).runs
    assert (run.duration, run.started_at) == (2.0, None)
    again = understand(tmp_path / "r", read_description(tmp_path / "ours" / "import" / "description.toml"))
    assert [each.time_unit for each in again.samples] == ["%I:%M:%S %p"]


@pytest.mark.long
def test_when_runs_were_executed_is_not_made_up_where_only_how_long_is_known(tmp_path):
    traces(tmp_path, "energy", ["1.5", "2.5"], [seconds(0, 10), seconds(0, 12)])
    results = load_results(tmp_path / "ours")
    assert results.attempts["started_at"].isna().all()
    assert results.attempts["seconds"].tolist() == [10.0, 12.0]
    assert results.events()["at"].isna().all()
    document = report_document(Material(results, analyse(results)), made="now")
    assert "timeline" not in [figure.name for figure in document.figures]
    [points] = [chart for chart in document.charts if chart.kind == "points"]
    assert points.data["place"] == "Place in the order of the table"


def test_samples_before_and_after_the_moments_of_the_run_are_told(tmp_path):
    moments = [f"{1_600_000_000 + n * 100}.5,{1_600_000_010 + n * 100}.5,{n}.5" for n in range(3)]
    files = [
        seconds(*(1_600_000_000 + n * 100 + each for each in (-4 * (n == 1), 1, 10 + 7 * (n == 2)))) for n in range(3)
    ]
    assert traces(tmp_path, "start_time,end_time,energy", moments, files) == (
        "power.csv begins before the run in 1 of 3 runs (run_1), by up to 4.5 s (run_1)",
        "power.csv outlasts the run in 1 of 3 runs (run_2), by up to 6.5 s (run_2)",
    )


def test_traces_that_were_cut_off_are_told(tmp_path):
    told = traces(tmp_path, "energy", ["1.5", "2.5"], [seconds(0, 1, 2), "0,1\n1,1\n2"])
    assert told == (
        "1 row left out of power.csv, cut off or with other cells than its heading, in 1 of 2 runs (run_1)",
    )


def test_times_of_another_kind_than_in_other_runs_are_refused(tmp_path):
    with pytest.raises(Exception, match="times are of another kind than in other runs"):
        traces(tmp_path, "energy", ["1.5", "2.5"], [seconds(0, 1), seconds(1_600_000_000, 1_600_000_001)])


def test_blocks_are_what_the_statistics_go_by(tmp_path):
    rows = "".join(
        f"tb_{robot},{task},{again},{robot * 10 + again + 5 * (task == 'a')}.5\n"
        for robot in range(4)
        for task in "ab"
        for again in (1, 2)
    )
    write(tmp_path / "r" / "run_table.csv", f"robot,task,repetition,energy_J\n{rows}")
    adopted(tmp_path / "r", tmp_path / "ours")
    results = load_results(tmp_path / "ours")
    design = analyse(results).design
    assert (results.block, design.factors, design.block) == ("robot", ("task",), "robot")


def test_the_repetition_can_be_the_block(tmp_path):
    rows = "".join(f"{task},{again},{again}.{'ab'.index(task)}\n" for task in "ab" for again in (1, 2, 3))
    write(tmp_path / "r" / "run_table.csv", f"task,repetition,energy_J\n{rows}")
    adopted(tmp_path / "r", tmp_path / "ours", block="repetition")
    assert load_results(tmp_path / "ours").block == "Repetition"


@pytest.mark.long
def test_repetitions_that_run_ids_count_can_be_the_blocks(tmp_path):
    rows = "".join(f"run_{at}_repetition_{n},DONE,{'ab'[at]},{10 * at + n * n}.5\n" for n in range(4) for at in (0, 1))
    write(tmp_path / "r" / "run_table.csv", f"__run_id,__done,task,e\n{rows}")
    understood = understand(tmp_path / "r", ImportDescription(block="Repetition"))
    assert understood.design_words == "2 (task), 4 runs a combination, in 4 blocks (Repetition): 8 runs"
    adopt(understood, tmp_path / "ours")
    adopt(understand(tmp_path / "r", understood.description), tmp_path / "again")
    for name in ("ours", "again"):
        assert analyse(load_results(tmp_path / name)).design.block == "Repetition"


def test_repetitions_that_nothing_counts_cannot_be_the_blocks(tmp_path):
    write(tmp_path / "r" / "run_table.csv", "task,e\na,1\nb,2\na,3\nb,4\n")
    with pytest.raises(AnalysisError, match="there is no column 'Repetition'"):
        understand(tmp_path / "r", ImportDescription(block="Repetition"))


def _metered(root, *traces):
    write(root / "run_table.csv", "run_id,energy_J\n" + "".join(f"r{place},10.0\n" for place in range(len(traces))))
    for place, trace in enumerate(traces):
        write(root / f"r{place}" / "power.csv", f"time_s,power_mW\n{trace}", "cp1252")
    return root


def test_a_cell_without_a_number_is_missing_and_told_and_changes_no_unit(tmp_path):
    root = _metered(tmp_path / "theirs", "0,10000\n1,10000\n", "0,10000\n0.5,ERROR\n1,10000\n")
    adoption = adopted(root, tmp_path / "ours")
    assert [each.recomputed for each in adoption.differences] == [10.0, 10.0]
    assert load_results(tmp_path / "ours").samples("power", runs=["r1"])["power_W"].dropna().tolist() == [10.0, 10.0]
    assert [each for each in adoption.warnings if "no number" in each] == [
        "1 cell of power.csv holds no number and is missing here, in 1 of 2 runs (r1)"
    ]


def test_a_measure_of_a_column_without_numbers_is_refused(tmp_path):
    root = write(tmp_path / "theirs" / "run_table.csv", "run_id,n,task\nr0,1,a\n").parent
    write(root / "r0" / "log.csv", "time_s,what\n0,begin\n1,end\n")
    with pytest.raises(AnalysisError, match="'what' holds no numbers"):
        adopted(root, tmp_path / "ours", recipes=(parse_recipe("n=mean(log.csv:what)"),))


def test_letters_of_another_character_set_are_read_far_down_in_samples(tmp_path):
    rows = "".join(f"{place / 1000},Munchen\n" for place in range(9000))
    root = write(tmp_path / "theirs" / "run_table.csv", "run_id,n,task\nr0,1,a\n").parent
    write(root / "r0" / "places.csv", f"time_s,where\n{rows}9.5,München\n", "cp1252")
    adopted(root, tmp_path / "ours")
    assert load_results(tmp_path / "ours").samples("places")["where"].iloc[-1] == "München"


def test_a_file_of_no_character_set_is_left_as_it_is(tmp_path):
    root = _metered(tmp_path / "theirs", "0,10000\n1,10000\n")
    (root / "r0" / "odd.csv").write_bytes(b"time_s,what\n0,\x81\xe9\n1,b\n")
    found = understand(root, ImportDescription())
    assert [note for note in found.notes if note.startswith("odd.csv is left as it is")]
    assert [each.file for each in found.samples] == ["power.csv"]


@pytest.mark.parametrize(
    "table", ["energy_J,host\n1.5,pc\n2.5,pc\n", "ta\x7fsk,energy_J\na,1.5\nb,2.5\na,3.5\nb,4.5\n"]
)
def test_an_import_without_factors_or_with_odd_headings_can_be_repeated_too(tmp_path, table):
    root = write(tmp_path / "theirs" / "run_table.csv", table).parent
    adopted(root, tmp_path / "ours")
    first = understand(root, ImportDescription()).roles
    again = understand(root, read_description(tmp_path / "ours" / "import" / "description.toml")).roles
    assert (again.factors, again.measures, again.extras) == (first.factors, first.measures, first.extras)


def test_a_measure_of_yes_and_no_is_compared_as_a_proportion(tmp_path):
    rows = "\n".join(f"{n},{'AB'[n % 2]},{('Yes', 'no', 'n/a')[n % 3]},{n + 0.5}" for n in range(12))
    write(tmp_path / "theirs" / "run_table.csv", f"run,planner,reached,energy\n{rows}\n")
    adoption = adopted(tmp_path / "theirs", tmp_path / "ours", factors=("planner",), measures=("reached", "energy"))
    results = load_results(adoption.folder)
    assert results.done["reached"].tolist()[:2] == [True, False]
    told = analyse(results).measure("reached").proportions.overall
    assert (told.n, told.missing, told.count) == (8, 4, 4)
    notes = json.loads((tmp_path / "ours" / "manifest.json").read_text("utf-8"))["imported"]["notes"]
    assert any("yes and no of reached are True and False" in note for note in notes)
