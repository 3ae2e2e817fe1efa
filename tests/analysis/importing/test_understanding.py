"""What is in a results folder is seen without being told, or is as it is told."""

from __future__ import annotations

import os

import pytest
from tests.analysis.importing.foreign_folder import EARLIER_TABLE, make_earlier_folder, write

from robot_runner.analysis.importing import foreign_table, units
from robot_runner.analysis.importing.adoption import adopt
from robot_runner.analysis.importing.description import ImportDescription, SamplesDescription, parse_recipe
from robot_runner.analysis.importing.understanding import understand
from robot_runner.analysis.results import load_results
from robot_runner.core.errors import AnalysisError, StorageError
from robot_runner.core.storage import cells
from robot_runner.core.storage.cells import RunStatus

NOTHING = ImportDescription()


@pytest.fixture
def root(tmp_path):
    return make_earlier_folder(tmp_path / "earlier")


def table_only(tmp_path, text, encoding="utf-8", **said):
    write(tmp_path / "results" / "run_table.csv", text, encoding)
    return understand(tmp_path / "results", ImportDescription(**said))


def test_the_columns_of_the_earlier_tools_are_known(root):
    roles = understand(root, NOTHING).roles
    assert (roles.run_id, roles.status, roles.repetition) == ("__run_id", "__done", "repetition")
    assert roles.factors == ("task", "offloaded")
    assert roles.measures == ("duration_s", "avg_cpu", "energy_J")


def test_ids_and_links_of_others_take_no_file_from_elsewhere_without_a_word(tmp_path):
    """`../home/.ssh` for an id had keys copied; what was a folder, or a link to nowhere, ended in a traceback."""
    write(tmp_path / "home" / ".ssh" / "id_rsa", "a key")
    results, other, long = tmp_path / "results", str(tmp_path / "home"), 300 * "x"
    ids = ("../home/.ssh", other, long, "run_1", "linked")
    rows = "".join(f"{each},{number % 2},{number}.5\n" for number, each in enumerate(ids))
    write(results / "run_table.csv", f"run_id,mode,energy\n{rows}")
    write(results / "run_1" / "power.csv", "time,power\n0,1\n1,2\n")
    (results / "run_1" / "folder.csv").mkdir()
    (results / "run_1" / "lost.csv").symlink_to("/no/such/file.csv")
    (results / "linked").symlink_to(tmp_path / "home")
    found = understand(results, ImportDescription(run_id="run_id"))
    folders = {run.source_id: run.folder for run in found.runs if run.folder}
    assert folders == {"run_1": results / "run_1", "linked": results / "linked"}
    assert [each.file for each in found.samples] == ["power.csv"]
    told = "\n".join(found.notes)
    assert "2 run ids would lead out of the folder, such as '../home/.ssh': no raw files are taken" in told
    assert "links to raw files lead nowhere (run_1/lost.csv): bring the files" in told
    assert f"the files are copied to which links lead out of the folder: linked to {other}" in told


def test_a_link_above_the_folders_of_runs_is_told_where_it_leads_out(tmp_path):
    """The files were copied from elsewhere without a word."""
    results, other = tmp_path / "results", tmp_path / "else"
    write(results / "run_table.csv", "run_id,mode,energy\nr_1,a,1.5\nr_2,b,2.5\n")
    for run_id in ("r_1", "r_2"):
        write(other / run_id / "power.csv", "time,power\n0,1\n1,2\n")
    (results / "runs").symlink_to(other)
    told = "\n".join(understand(results, ImportDescription(run_id="run_id")).notes)
    assert f"the files are copied to which links lead out of the folder: runs to {other}" in told
    (results / "runs").unlink()
    other.rename(results / "inside")
    (results / "runs").symlink_to("inside")
    told = "\n".join(understand(results, ImportDescription(run_id="run_id")).notes)
    assert "lead out of the folder" not in told


OWN_TABLE = """\
run_id,status,excluded,start_run_at,continue_at,Task,Repetition,batch,warm_up,Energy
w_1,Done,,2026-01-31T12:00:00.250Z,,Idle,0,1,True,99
r_1,Done,,2026-01-31T12:01:00.250Z,,Idle,1,1,False,7.5
r_2,Done,"it fell, twice",2026-01-31T12:02:00.250Z,,Video,1,1,False,60
r_3,Done,,2026-01-31T12:03:00.250Z,,Idle,2,2,False,7.75
r_4,Done,,2026-01-31T12:04:00.250Z,,Video,2,2,False,9
"""


def test_of_a_table_of_ours_what_is_not_analysed_is_left_out_and_told(tmp_path):
    found = table_only(tmp_path, OWN_TABLE)
    assert [(run.run_id, run.repetition) for run in found.runs] == [("r_1", 1), ("r_3", 2), ("r_4", 2)]
    assert (found.roles.factors, found.roles.measures) == (("Task",), ("Energy",))
    told = [note for note in found.notes if "left out" in note]
    assert told == ["2 runs left out that Robot Runner does not analyse: w_1 (warm-up), r_2 (it fell, twice)"]
    assert any("several batches are compared as one" in note for note in found.notes)
    assert not found.questions
    named = table_only(tmp_path, OWN_TABLE, ignore=["excluded", "warm_up"], block="batch")
    assert (len(named.runs), named.roles.block) == (5, "batch"), "as the user says"


def test_of_a_table_of_others_columns_of_these_names_mean_what_they_mean_there(tmp_path):
    text = OWN_TABLE.replace("run_id,status", "trial_id,state").replace("it fell, twice", "no")
    assert len(table_only(tmp_path, text, ignore=["batch", "excluded", "warm_up"]).runs) == 5


def test_rows_may_be_in_any_state(root):
    found = understand(root, NOTHING)
    assert [run.status for run in found.runs] == [RunStatus.DONE] * 3 + [RunStatus.TODO]
    assert found.runs[3].measures == {"duration_s": None, "avg_cpu": None, "energy_J": None}


def test_units_come_from_headings(root):
    units = understand(root, NOTHING).units
    assert {name: unit.symbol if unit else None for name, unit in units.items()} == {
        "duration_s": "s",
        "avg_cpu": None,
        "energy_J": "J",
    }


def test_samples_and_their_times_are_seen(root):
    found = {each.file: each for each in understand(root, NOTHING).samples}
    assert set(found) == {"power.csv", "resources.csv"}
    assert (found["power.csv"].time, found["power.csv"].time_unit) == ("timestamp", "iso")
    assert found["power.csv"].heading("power_mW") == "power_W"
    assert len(found["power.csv"].paths) == 3


def test_what_no_sample_is_stays_as_it_is(root):
    assert "notes.csv is left as it is: no column is recognised as the time" in understand(root, NOTHING).notes


def test_a_file_of_samples_with_a_heading_that_is_there_twice_stays_as_it_is(root):
    for number in range(3):
        write(root / f"run_{number}" / "meter.csv", "time,amps,amps\n0,1,2\n1,1,2\n")
    assert "meter.csv is left as it is: heading 'amps' is there twice" in understand(root, NOTHING).notes


def test_which_measure_comes_out_of_which_samples_is_guessed(root):
    recipes = {recipe.measure: (recipe.words, recipe.is_guessed) for recipe in understand(root, NOTHING).recipes}
    assert recipes == {
        "avg_cpu": ("mean(resources.csv:cpu)", True),
        "energy_J": ("integral(power.csv:power_mW)", True),
    }


def test_a_counter_of_joules_is_read_off_at_its_ends(tmp_path):
    write(tmp_path / "r" / "run_table.csv", "__run_id,__done,t,PACKAGE (J)\nrun_0,DONE,a,5.0\n")
    write(tmp_path / "r" / "run_0" / "energibridge.csv", "Time,PACKAGE (J)\n1736296650586,100\n1736296651586,105\n")
    (recipe,) = understand(tmp_path / "r", NOTHING).recipes
    assert recipe.words == "change(energibridge.csv:PACKAGE (J))"


def test_what_is_said_counts_more_than_what_is_guessed(root):
    said = ImportDescription(recipes=(parse_recipe("avg_cpu=max(resources.csv:cpu)"),), units={"energy_J": "mJ"})
    found = understand(root, said)
    assert next(each for each in found.recipes if each.measure == "avg_cpu").words == "max(resources.csv:cpu)"
    assert found.units["energy_J"].symbol == "mJ"


def test_without_guessing_nothing_is_taken_for_samples(root):
    found = understand(root, ImportDescription(guess=False))
    assert (found.samples, found.recipes) == ((), ())


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        (EARLIER_TABLE, "utf-8-sig"),
        ("\r\n,,,\r\n" + EARLIER_TABLE, "utf-8"),
        (EARLIER_TABLE.replace(",", ";").replace(".0", ",0"), "utf-8"),
        (EARLIER_TABLE.replace(",", "\t"), "utf-16"),
        ("sep=;\r\n" + EARLIER_TABLE.replace(",", ";"), "utf-8"),
        ('\r\n"sep=\t"\r\n' + EARLIER_TABLE.replace(",", "\t"), "utf-16"),
        (EARLIER_TABLE.replace("true", "TRUE").replace("false", "False").replace("DONE", "True"), "utf-8"),
        (EARLIER_TABLE.replace("\r\n", ",,\r\n"), "utf-8"),
        (EARLIER_TABLE.replace("__run_id,__done", "Run ID,Status"), "utf-8"),
        (EARLIER_TABLE.replace("__run_id,__done", "ID,Done").replace("DONE", "x"), "utf-8"),
    ],
    ids=[
        "byte-order mark",
        "blank first lines",
        "semicolons",
        "tabs, UTF-16",
        "Excel's line of the separator",
        "the same in quotes",
        "booleans",
        "empty columns",
        "renamed",
        "x",
    ],
)
def test_what_a_spreadsheet_makes_of_it_means_the_same(tmp_path, text, encoding):
    found = table_only(tmp_path, text, encoding)
    assert [run.source_id for run in found.runs] == ["run_0", "run_1", "run_2", "run_3"]
    assert [run.status for run in found.runs][2:] == [RunStatus.DONE, RunStatus.TODO]
    assert [run.treatments for run in found.runs][:2] == [
        {"task": "video", "offloaded": "True"},
        {"task": "network", "offloaded": "False"},
    ]
    assert found.runs[2].measures == {"duration_s": 2.0, "avg_cpu": 20.0, "energy_J": 30.0}


def test_letters_of_another_character_set_are_read(tmp_path):
    text = "__run_id,__done,ort,energy_J\nrun_0,DONE,München,1.0\nrun_1,DONE,Köln,2.0\n"
    assert table_only(tmp_path, text, "cp1252").runs[0].treatments == {"ort": "München"}


def test_repetitions_may_be_in_the_run_ids(tmp_path):
    rows = "".join(f"run_{run}_repetition_{again},DONE,{run},{again}.5\n" for run in range(2) for again in range(2))
    found = table_only(tmp_path, f"__run_id,__done,level,energy\n{rows}")
    assert [run.repetition for run in found.runs] == [1, 2, 1, 2]
    assert "repetitions are numbered from 1 here, not from 0" in found.notes


def test_a_table_without_ids_has_its_runs_numbered(tmp_path):
    found = table_only(tmp_path, "task,energy_J\nvideo,1.5\nnetwork,\n", factors=("task",))
    assert [run.run_id for run in found.runs] == ["r_1", "r_2"]
    assert [run.status for run in found.runs] == [RunStatus.DONE, RunStatus.TODO]


def test_numbers_that_repeat_are_treatments_and_others_are_measured(tmp_path):
    rows = "".join(f"run_{place},DONE,{place % 2 * 500},{place * 1.5}\n" for place in range(6))
    roles = table_only(tmp_path, f"__run_id,__done,length,energy\n{rows}").roles
    assert (roles.factors, roles.measures) == (("length",), ("energy",))


def test_numbers_that_are_written_differently_are_one_treatment(tmp_path):
    rows = "".join(f"{gain},{place}.5\n" for place, gain in enumerate(("1", "2.0", "1.0", "2", "01", "2")))
    found = table_only(tmp_path, f"gain,energy\n{rows}", factors=("gain",))
    assert [run.treatments["gain"] for run in found.runs] == ["1", "2.0"] * 3


def test_a_number_that_is_missing_is_not_a_treatment_that_is_called_none(tmp_path):
    rows = "".join(f"{gain},{place}.5\n" for place, gain in enumerate(("", "2", "nan", "2")))
    found = table_only(tmp_path, f"gain,energy\n{rows}", factors=("gain",))
    assert [run.treatments["gain"] for run in found.runs] == ["", "2", "nan", "2"]


def test_a_truth_value_that_is_missing_keeps_its_word_and_is_noted(tmp_path):
    rows = "".join(f"{('TRUE', 'false', 'NA')[n % 3]},{n}.5\n" for n in range(6))
    found = table_only(tmp_path, f"is_on,energy_J\n{rows}")
    assert found.treatments("is_on") == ("False", "NA", "True")
    assert "is_on has 'NA' in 2 runs: a treatment here. If it is missing, fill it in, or leave these runs out" in (
        found.notes
    )


def test_the_minus_sign_of_documents_is_a_minus(tmp_path):
    rows = "".join(f"{'ab'[n % 2]},\N{MINUS SIGN}{n}.5,{n}.25\n" for n in range(6))
    found = table_only(tmp_path, f"task,offset_m,energy_J\n{rows}")
    assert [run.measures["offset_m"] for run in found.runs[:2]] == [-0.5, -1.5]


def test_treatments_are_in_an_order_that_means_something(tmp_path):
    rows = "".join(f"run_{place},DONE,{level},{place}.5\n" for place, level in enumerate((500, 50, 1000) * 2))
    assert table_only(tmp_path, f"__run_id,__done,length,energy\n{rows}").treatments("length") == ("50", "500", "1000")


def test_a_name_that_is_taken_gets_a_line_at_its_end(tmp_path):
    found = table_only(tmp_path, "ID,Done,task,attempt\nrun_0,x,a,1.5\n", factors=("task",))
    assert found.headings["attempt"] == "attempt_"
    assert "column 'attempt' is called 'attempt_' here: the name is taken" in found.notes


def test_an_id_that_cannot_name_a_folder_is_mended(tmp_path):
    found = table_only(tmp_path, "ID,Done,task,e\nrun 1/a,x,a,1.5\n", factors=("task",))
    assert (found.runs[0].run_id, found.runs[0].source_id) == ("run_1_a", "run 1/a")


def test_a_word_among_decimal_commas_takes_neither_the_numbers_nor_their_unit(tmp_path):
    rows = "video;97,79\nvideo;fehlt\nnetwork;95,23\nnetwork;103,76\n"
    found = table_only(tmp_path, f"task;energy_J\n{rows}")
    assert [run.measures["energy_J"] for run in found.runs] == [97.79, "fehlt", 95.23, 103.76]
    assert found.units["energy_J"].symbol == "J"
    assert any("energy_J is text in 1 run" in note for note in found.notes)


@pytest.mark.parametrize("word", ["Summe", "Mean:", "TOTAL"])
def test_whether_a_row_sums_up_the_others_is_asked(tmp_path, word):
    text = f"task,energy\na,1.5\na,2.5\nb,2.25\nb,3.5\n{word},9.75\n"
    (question,) = table_only(tmp_path, text).questions
    assert question.problem == f"line 6 has {word!r} for task, as if it summed up the runs above it"
    assert question.fix == "Remove the line; if it is a run, say --factor task."
    assert not table_only(tmp_path, text, factors=("task",)).questions
    assert not table_only(tmp_path, "gain,energy\nmin,1.5\nmax,2.5\nmin,2.25\nmax,3.5\n").questions


@pytest.mark.parametrize("yes_and_no", ["ja nein", "Oui Non", "WAHR FALSCH"])
def test_yes_and_no_are_known_in_other_languages(tmp_path, yes_and_no):
    yes, no = yes_and_no.split()
    said = [yes, yes, no, yes, no, yes, yes, no]
    rows = "".join(f"{'ab'[place % 2]},{place}.5,{word}\n" for place, word in enumerate(said))
    found = table_only(tmp_path, f"task,energy,success\n{rows}", measures=("success",))
    assert [run.measures["success"] for run in found.runs] == [word == yes for word in said]


@pytest.mark.parametrize(("success", "is_noted"), [("1 0 1 1 0 1 1 1", True), ("1 0 2 1 0 1 1 1", False)])
def test_numbers_that_may_be_yes_and_no_are_noted(tmp_path, success, is_noted):
    rows = "".join(f"{'ab'[place % 2]},{place // 2},{cell},{place}.5\n" for place, cell in enumerate(success.split()))
    told = (
        "success is 0 or 1 in all runs: if that is no and yes, write False and True, so that proportions are compared"
    )
    assert (told in table_only(tmp_path, f"policy,trial,success,time\n{rows}").notes) is is_noted


def test_a_title_in_the_first_cell_of_the_first_row_is_no_heading(tmp_path):
    with pytest.raises(AnalysisError, match="only the first has a heading, 'Study of May'") as raised:
        table_only(tmp_path, "Study of May;;\ntask;energy;time\na;1,5;3\n")
    assert raised.value.fix == "Remove the lines above the heading, or name each column."


def test_a_negative_number_of_nines_among_positive_ones_is_noted(tmp_path):
    rows = "".join(f"{'ab'[place % 2]},{cell}\n" for place, cell in enumerate(("930.5", "-999", "951.25", "944.5")))
    told = "energy is -999 in 1 run, far from all others: a missing value? Then leave these cells empty"
    assert told in table_only(tmp_path, f"task,energy\n{rows}").notes


def test_units_in_a_row_of_their_own_are_asked_about(tmp_path):
    (question,) = table_only(tmp_path, "task,energy,time\n,J,[ms]\na,1.5,3\na,2.5,4\nb,2.25,5\nb,3.5,6\n").questions
    assert question.problem == "line 2 has units rather than values (J and [ms])"


def test_a_second_heading_is_asked_about(tmp_path):
    text = ",,DWB,,MPPI,\nrobot,no,energy_J,time_s,energy_J,time_s\n"
    rows = "".join(f"{'ab'[place % 2]},{place},{place}.5,1.{place},{place}.75,2.{place}\n" for place in range(1, 7))
    (question,) = table_only(tmp_path, text + rows).questions
    assert question.problem == "line 2 has words rather than values ('energy_J' and 'energy_J')"
    assert question.fix == "Write one heading above each column, and remove the line; of a run, leave the cells empty."


def test_a_first_run_with_one_number_is_a_run(tmp_path):
    text = "task,energy,time\na,failed,3.5\na,2.5,4.5\nb,2.25,5.5\nb,3.5,6.5\n"
    assert not table_only(tmp_path, text).questions


@pytest.mark.parametrize(
    ("name", "units", "asked"),
    [
        ("time_unit", "us ms", True),
        ("Unit", "ns/op us/op", True),
        ("time_unit", "ms ms", False),
        ("unit", "robot_1 robot_2", False),
    ],
)
def test_whether_numbers_in_several_units_are_to_be_compared_is_asked(tmp_path, name, units, asked):
    """Google Benchmark and JMH write the unit of each row into a column."""
    first, second = units.split()
    rows = "".join(f"plan,{900 + place}.5,{first}\nmap,1.{place},{second}\n" for place in range(5))
    found = table_only(tmp_path, f"benchmark,score,{name}\n{rows}")
    told = [question for question in found.questions if "units" in question.problem]
    assert bool(told) is asked
    if asked:
        assert told[0].problem == f"column {name!r} has several units ({first}, {second}), which are not converted"
        assert told[0].fix == f"Write the numbers of each column in one unit, or say --ignore {name}."
        assert not table_only(tmp_path, f"benchmark,score,{name}\n{rows}", ignore=(name,)).questions


def test_whether_quantities_in_one_column_are_to_be_compared_is_asked(tmp_path):
    rows = "".join(f"{planner},{n},{metric},{n}.5\n" for n in (1, 2) for planner in "ab" for metric in ("time", "path"))
    (question,) = table_only(tmp_path, f"planner,trial,metric,value\n{rows}").questions
    assert question.problem == "column 'metric' names what the numbers beside it are (time, path)"
    assert question.fix == "Write a column for each; if they are treatments, say --factor metric."
    assert not table_only(tmp_path, f"planner,trial,metric,value\n{rows}", factors=("metric",)).questions


def test_whether_rows_between_the_runs_sum_them_up_is_asked(tmp_path):
    """Google Benchmark writes aggregates behind the repetitions, Excel subtotals behind each group."""
    runs = [f"{name},{place}.5" for name in ("BM_plan", "BM_map") for place in range(4)]
    rows = [*runs[:4], "BM_plan_mean,2.0", "BM_plan_stddev,1.29", *runs[4:], "BM_map mean,2.0"]
    (question,) = table_only(tmp_path, "\n".join(["name,real_time", *rows])).questions
    assert question.problem == "3 lines, such as line 6 with 'BM_plan_mean' for name, sum up other runs"
    assert question.fix == "Remove the lines; if they are runs, say --factor name."
    assert not table_only(tmp_path, "\n".join(["name,real_time", *rows]), factors=("name",)).questions


def test_merged_cells_are_asked_about(tmp_path):
    rows = [f"{'ab'[n // 6] if n % 6 == 0 else ''},{'xy'[n // 3 % 2] if n % 3 == 0 else ''},{n}.5" for n in range(12)]
    found = table_only(tmp_path, "\n".join(["robot,planner,energy", *rows]))
    assert [question.problem for question in found.questions] == [
        "column 'robot' is kept as text: text in the first of 6 rows alone, as merged cells are saved: fill it down",
        "column 'planner' is kept as text: text in the first of 3 rows alone, as merged cells are saved: fill it down",
    ]
    assert not table_only(tmp_path, "task,remark,energy\na,fell,1.5\na,,2.5\nb,,3.5\nb,,1.25\n").questions


def test_that_nothing_is_compared_is_noted(tmp_path):
    told = "no column is taken for a factor: nothing is compared. Name one with --factor"
    found = table_only(tmp_path, "seed,navfn_s,smac_s\n0,40.5,42.25\n1,41.5,43.5\n2,39.75,41.0\n")
    assert f"{told}; of treatments with a column each, write a row for each" in found.notes


def test_a_title_above_the_heading_is_refused_whatever_stands_between_the_cells(tmp_path):
    with pytest.raises(AnalysisError, match="the row has 2 cells, the heading has 1") as raised:
        table_only(tmp_path, "Study of May\ntask;energy\na;1,5\na;2,5\n")
    assert raised.value.fix == "Give it a cell under each heading, or remove the lines above the heading."


def test_treatments_that_differ_in_case_or_blanks_alone_are_noted(tmp_path):
    tasks = ("Video", "video", "Network", "net  work", "net work")
    rows = "".join(f"{tasks[place % 5]},{place}.25\n" for place in range(20))
    notes = [note for note in table_only(tmp_path, f"task,energy\n{rows}").notes if "two treatments" in note]
    told = "two treatments here. If they are one, spell them alike"
    assert notes == [f"task has 'Video' and 'video': {told}", f"task has 'net  work' and 'net work': {told}"]


def test_text_among_numbers_is_noted(tmp_path):
    rows = "run_0,DONE,a,1.5\nrun_1,DONE,a,overflow\nrun_2,DONE,b,2.5\nrun_3,DONE,b,3.5\n"
    found = table_only(tmp_path, f"__run_id,__done,task,energy\n{rows}")
    told = "energy is text in 1 run, such as run_1: no statistics of it"
    assert f"{told}. Where a value is missing, leave the cell empty" in found.notes


@pytest.mark.parametrize(("cells", "told"), [("0.31 -999999 -999999 0.29", True), ("-99 0.5 0.25 0.75", True)])
def test_nines_that_may_stand_for_a_missing_value_are_noted(tmp_path, cells, told):
    rows = "".join(f"run_{place},DONE,{'ab'[place % 2]},{cell}\n" for place, cell in enumerate(cells.split()))
    found = table_only(tmp_path, f"__run_id,__done,task,r2\n{rows}")
    nines = min(cells.split())
    count = "2 runs" if nines == "-999999" else "1 run"
    note = f"r2 is {nines} in {count}, far from all others: a missing value? Then leave these cells empty"
    assert (note in found.notes) is told


def test_minus_one_among_large_numbers_is_noted(tmp_path):
    cells = ("28.5", "-1.00", "31.25", "-1", "0.5", "29.75")
    rows = "".join(f"{'ab'[place % 2]},{cell}\n" for place, cell in enumerate(cells))
    told = "time_s is -1 in 2 runs, and no other is below 0: a missing value? Then leave these cells empty"
    assert told in table_only(tmp_path, f"planner,time_s\n{rows}").notes


@pytest.mark.parametrize(
    "cells",
    [
        "-99 -101.5 -80 -120",
        "999 1001 850 720",
        "99 98.5 97 1.5",
        "-999 -999 -999 -999",
        "-1 0.5 1 0.25",
        "-1 -2.5 30 20",
    ],
)
def test_nines_among_numbers_like_them_are_numbers(tmp_path, cells):
    rows = "".join(f"run_{place},DONE,{'ab'[place % 2]},{cell}\n" for place, cell in enumerate(cells.split()))
    assert not any("missing value" in note for note in table_only(tmp_path, f"__run_id,__done,task,e\n{rows}").notes)


@pytest.mark.parametrize(
    ("heading", "cells", "told"),
    [
        ("total_energy", "28841.5 -224720.9 28949.7 29024.4", True),
        ("cpu (J)", "841.5 -64711.9 949.7 824.4", True),
        ("memory_energy", "0.2 -0.3 0.1 0.2", False),
        ("energy_saving", "28841.5 -224720.9 28949.7 29024.4", False),
        ("energy_J", "-5.5 -4.25 -6.75 1.5", False),
        ("energy_J", "-5.5 -4.25 -6.75 -1.5", False),
        ("voltage_change", "28841.5 -224720.9 28949.7 29024.4", False),
    ],
)
def test_energies_that_are_far_below_zero_in_a_few_runs_are_noted(tmp_path, heading, cells, told):
    rows = "".join(f"run_{place},DONE,{'ab'[place % 2]},{cell}\n" for place, cell in enumerate(cells.split()))
    found = table_only(tmp_path, f"__run_id,__done,task,{heading}\n{rows}")
    note = f"{heading} is negative in 1 run, such as run_1: a counter that wrapped around, or was reset?"
    assert (f"{note} Then leave these cells empty" in found.notes) is told
    assert told or not any("negative" in each for each in found.notes)


def test_a_table_that_blanks_alone_separate_is_no_run_table(tmp_path):
    with pytest.raises(AnalysisError, match="the table has one column, of text") as raised:
        table_only(tmp_path, "  Time    User   Sys  Watts\n10:22:21   3.1   8.2   7.5\n10:22:22   7.3   1.9   7.6\n")
    fix = "Separate its cells by commas, semicolons or tabs, or name the table of the runs: --table FILE."
    assert raised.value.fix == fix


def test_what_a_spreadsheet_has_for_not_available_is_a_missing_number(tmp_path):
    rows = "run_0,DONE,a,1.5\nrun_1,DONE,a,#N/A\nrun_2,DONE,b,<NA>\nrun_3,DONE,b,3.5\n"
    found = table_only(tmp_path, f"__run_id,__done,task,energy_J\n{rows}")
    assert [run.measures["energy_J"] for run in found.runs] == [1.5, None, None, 3.5]
    assert found.units["energy_J"] is not None


def test_run_folders_may_be_elsewhere(tmp_path):
    write(tmp_path / "r" / "run_table.csv", "__run_id,__done,t,e\nrun_0,DONE,a,5.0\n")
    write(tmp_path / "r" / "raw" / "exp-run_0" / "power.csv", "time_s,power_W\n0,1\n1,1\n")
    found = understand(tmp_path / "r", ImportDescription(run_folder="raw/exp-{run_id}"))
    assert found.runs[0].folder.name == "exp-run_0"


def test_a_description_of_samples_is_followed(tmp_path):
    write(tmp_path / "r" / "run_table.csv", "__run_id,__done,t,e\nrun_0,DONE,a,5.0\n")
    write(tmp_path / "r" / "run_0" / "meter.csv", "when;value\n0;1,5\n1;2,5\n")
    said = SamplesDescription("meter.csv", name="Meter", time="when", time_unit="ms", units={"value": "mW"})
    (samples,) = understand(tmp_path / "r", ImportDescription(samples=(said,))).samples
    assert (samples.name, samples.time_unit, samples.heading("value"), samples.guesses) == (
        "Meter",
        "ms",
        "value_W",
        (),
    )


def test_measured_numbers_that_repeat_are_told_from_treatments_by_the_repetitions(tmp_path):
    rows = [(run, again, 100 * run, (20, 21)[again]) for run in range(3) for again in range(2)]
    by_id = "".join(f"run_{run}_repetition_{again},DONE,{level},{time}\n" for run, again, level, time in rows)
    by_column = "".join(f"{run}{again},DONE,{level},{again},{time}\n" for run, again, level, time in rows)
    for text in ("id,done,length,time\n" + by_id, "id,done,length,repetition,time\n" + by_column):
        roles = table_only(tmp_path, text).roles
        assert (roles.factors, roles.measures) == (("length",), ("time",))


def test_a_treatment_that_only_the_repetition_tells_apart_stays_one(tmp_path):
    rows = "".join(f"{speed}{again},{again},{speed},{speed}.{again}\n" for speed in (2, 3) for again in (1, 2))
    assert table_only(tmp_path, f"id,repetition,speed,energy\n{rows}").roles.factors == ("speed",)


def test_rows_that_are_there_twice_are_left_out_once(tmp_path):
    found = table_only(tmp_path, "__run_id,t,e\nrun_0,a,1.5\nrun_1,b,2.5\nrun_0,a,1.5\n")
    assert [run.run_id for run in found.runs] == ["run_0", "run_1"]
    assert "1 row left out that is there twice, cell by cell" in found.notes


def test_runs_that_share_an_id_are_told_apart_and_have_no_raw_files(tmp_path):
    write(tmp_path / "results" / "run_0" / "power.csv", "time_s,power_W\n0,1\n1,1\n")
    found = table_only(tmp_path, "__run_id,t,e\nrun_0,a,1.5\nRUN_0_2,a,1.5\nrun_0,b,2.5\n")
    assert [run.run_id for run in found.runs] == ["run_0", "RUN_0_2", "run_0_3"]
    assert [run.folder for run in found.runs] == [None] * 3
    assert any("'run_0' in line 4 is called 'run_0_3' here" in note for note in found.notes)


def test_files_that_are_named_by_numbers_go_together(tmp_path):
    for number, process in enumerate((77, 1044)):
        for name in (
            f"power_{process}.csv",
            f"power_{process}.csv-{process}.csv",
            f"twice_{number}.csv",
            "p.csv",
            "p_.csv",
        ):
            write(tmp_path / "results" / f"run_{number}" / name, "time_s,power_W\n0,1\n1,1\n")
    write(tmp_path / "results" / "run_1" / "twice_7.csv", "time_s,power_W\n0,1\n1,1\n")
    found = table_only(tmp_path, "__run_id,t,e_J\nrun_0,a,1.5\nrun_1,b,2.5\n")
    kinds = {each.file: (each.name, [*each.paths]) for each in found.samples}
    both = ["run_0", "run_1"]
    assert kinds == {
        "p.csv": ("p", both),
        "p_.csv": ("p_2", both),
        "power_*.csv": ("power", both),
        "power_*.csv-*.csv": ("power_csv", both),
        "twice_0.csv": ("twice_0", ["run_0"]),
        "twice_1.csv": ("twice_1", ["run_1"]),
        "twice_7.csv": ("twice_7", ["run_1"]),
    }
    adopted = adopt(found, tmp_path / "adopted")
    results = load_results(adopted.folder)
    assert len(results.samples("power")) == len(results.samples("power_csv")) == 4
    assert not list(adopted.folder.glob("runs/*/original"))


def test_a_column_without_a_heading_is_kept_and_doubted(tmp_path):
    found = table_only(tmp_path, "__run_id,t,e,,\nrun_0,a,1.5,,7\nrun_1,b,2.5,,8\n")
    assert (found.roles.measures, found.roles.extras) == (("e",), ("column_5",))
    assert "a column has no heading (column_5 here): values may stand under headings of others" in found.notes


def test_the_numbers_of_a_data_frames_rows_are_left_out(tmp_path):
    found = table_only(tmp_path, ",__run_id,__done,t,e\n0,run_0,DONE,a,1.5\n1,run_1,DONE,b,2.5\n")
    assert (found.roles.run_id, found.roles.factors, found.roles.extras) == ("__run_id", ("t",), ())


def test_repetitions_may_be_numbered_in_words(tmp_path):
    found = table_only(tmp_path, "__run_id,t,repetition,e\nrun_0,a,r1,1.5\nrun_1,a,rep_2,2.5\n")
    assert [run.repetition for run in found.runs] == [1, 2]


def test_a_table_of_thousands_of_runs_is_looked_at_once(tmp_path, monkeypatch):
    looked_at = []
    monkeypatch.setattr(
        foreign_table, "number_of", lambda text, **how: looked_at.append(text) or cells.number_of(text, **how)
    )
    rows = "".join(f"run_{place},DONE,{place % 4},{place % 3},{place}.5\n" for place in range(2000))
    assert len(table_only(tmp_path, f"__run_id,__done,a,b,e\n{rows}").runs) == 2000
    assert len(looked_at) < 3 * 2000


REFUSED = {
    "no text": ({"run_table.csv": "\x89PNG\x00\x00"}, {}, "the file is not text: it holds zero bytes"),
    "no heading": ({"run_table.csv": "1,2\n3,4\n"}, {}, "the first row has only numbers, such as '1'"),
    "no folder": (None, {}, "there is no such folder"),
    "no table": ({}, {}, "there is no CSV file in the folder"),
    "which table": ({"a.csv": "x\n1\n", "b.csv": "x\n1\n"}, {}, "which of a.csv, b.csv is the run table?"),
    "empty": ({"run_table.csv": "\n\n"}, {}, "the table is empty"),
    "no rows": ({"run_table.csv": "__run_id,__done,a,b\n"}, {}, "there are no runs in the table"),
    "heading twice": ({"run_table.csv": "__run_id,a,a\nrun_0,1,2\n"}, {}, "heading 'a' is there twice"),
    "a row too long": ({"run_table.csv": "__run_id,a\nrun_0,1,2\n"}, {}, "the row has 3 cells, the heading has 2"),
    "no id": ({"run_table.csv": "__run_id,t,e\nrun_0,a,1\n,a,2\n"}, {}, "the run has no id"),
    "status": ({"run_table.csv": "__run_id,__done,t,e\nrun_0,MAYBE,a,1\n"}, {}, "'MAYBE' is not a status"),
    "repetition": (
        {"run_table.csv": "__run_id,repetition,e\nrun_0,first,1\n"},
        {},
        "'first' is not a repetition number",
    ),
    "factor": ({"run_table.csv": "__run_id,t,e\nrun_0,a,1\n"}, {"factors": ("task",)}, "there is no column 'task'"),
    "samples": (
        {"run_table.csv": "__run_id,t,e\nrun_0,a,1\n", "run_0/power.csv": "time,p\n0,1\n"},
        {"samples": (SamplesDescription("powr.csv"),)},
        "no run has a file 'powr.csv'",
    ),
    "recipe": (
        {"run_table.csv": "__run_id,t,e\nrun_0,a,1\n", "run_0/power.csv": "time,p\n0,1\n1,2\n"},
        {"recipes": (parse_recipe("e=integral(power.csv:q)"),)},
        "power.csv has no column 'q'",
    ),
    "time": (
        {"run_table.csv": "__run_id,t,e\nrun_0,a,1\n", "run_0/power.csv": "moment,p\nsoon,1\nlate,2\n"},
        {"samples": (SamplesDescription("power.csv", time="moment"),)},
        "the times in moment cannot be read",
    ),
}


def test_a_table_that_is_named_itself_is_refused_with_its_folder(tmp_path):
    table = tmp_path / "my runs.csv"
    table.write_text("task,energy\na,1.5\nb,2.5\n", encoding="utf-8")
    with pytest.raises(StorageError, match="this is a file, not a folder of results") as refused:
        understand(table, NOTHING)
    assert f"--table '{table.name}'" in str(refused.value)


def test_a_named_pipe_or_device_in_the_place_of_the_table_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "run_table.csv")
    (tmp_path / "runs.csv").symlink_to("/dev/zero")
    with pytest.raises(StorageError, match="there is no CSV file in the folder"):
        understand(tmp_path, NOTHING)
    (tmp_path / "results.csv").write_text("task,energy\na,1.5\nb,2.5\n", encoding="utf-8")
    assert understand(tmp_path, NOTHING).roles.measures == ("energy",)


def test_a_table_of_samples_is_no_run_table(tmp_path, monkeypatch):
    monkeypatch.setattr(foreign_table, "_MOST_RUNS", 1000)
    with pytest.raises(AnalysisError, match="more than 1,000 rows: are they samples rather than runs"):
        table_only(tmp_path, "time,power\n" + "1,2\n" * 1001)


@pytest.mark.parametrize(("where", "table"), [("", None), ("", "data.xlsx"), ("data.xlsx", None)])
def test_a_workbook_is_to_be_saved_as_csv(tmp_path, where, table):
    (tmp_path / "data.xlsx").write_bytes(b"PK\x03\x04\0\0")
    with pytest.raises(StorageError, match=r"data\.xlsx: this is a workbook.*Save it as CSV"):
        understand(tmp_path / where, ImportDescription(table=table))


@pytest.mark.parametrize(
    ("table", "problem"), [("runs.csv", "there is no 'runs.csv' in the folder"), (None, "there is no CSV file")]
)
def test_a_workbook_of_something_else_does_not_hide_that_the_table_is_missing(tmp_path, table, problem):
    (tmp_path / "~$runs.xlsx").write_bytes(b"")
    (tmp_path / "a.xlsx").mkdir()
    if table is not None:
        (tmp_path / "notes.xlsx").write_bytes(b"PK\x03\x04\0\0")
    with pytest.raises(StorageError, match=problem):
        understand(tmp_path, ImportDescription(table=table))


@pytest.mark.long
def test_two_thousand_columns_are_looked_at(tmp_path):
    names = [f"m{place}" for place in range(1, 2001)]
    cells = [",".join(f"{n * place / 7:.3f}" for place in range(1, 2001)) for n in range(8)]
    rows = "".join(f"run_{n},t{n % 2},{cells[n]}\n" for n in range(8))
    found = table_only(tmp_path, f"__run_id,task,{','.join(names)}\n{rows}")
    assert (found.roles.factors, found.roles.measures) == (("task",), tuple(names))


def test_a_heading_that_cannot_stand_is_renamed(tmp_path):
    found = table_only(tmp_path, "task\x1b[31m,energy\na\x1b[2J,1.5\nb,2.5\n")
    assert found.headings["task\x1b[31m"] == "task[31m"
    assert any("a heading cannot hold all of it" in note for note in found.notes)


def test_what_the_design_would_be_is_said(tmp_path):
    rows = "".join(
        f"tb_{robot},{task},{again},{robot}.{again}\n" for robot in range(3) for task in "ab" for again in (1, 2)
    )
    found = table_only(tmp_path, f"robot,task,repetition,energy\n{rows}")
    assert found.design_words == "2 (task), 6 runs a combination, in 3 blocks (robot): 12 runs"
    found = table_only(
        tmp_path, f"robot,task,repetition,energy\n{rows.replace('tb_2,b,2,2.2', 'tb_2,b,3,2.2')}", factors=("robot",)
    )
    assert found.design_words == "3 x 2 (robot x task), 2 runs a combination: 12 runs"


def test_repetitions_that_count_all_runs_are_numbered_anew(tmp_path):
    rows = "".join(f"{task},{n},{n}.5\n" for n, task in enumerate("aabbcc" * 2, start=1))
    found = table_only(tmp_path, f"task,run,energy\n{rows}", repetition="run")
    assert [run.repetition for run in found.runs] == [1, 2] * 3 + [3, 4] * 3
    assert any("numbered again within each combination" in note for note in found.notes)


def test_questions_name_the_options_that_settle_them(tmp_path):
    rows = "".join(f'{(n % 7 == 0) + (n % 11 == 0)},"1,{100 + n}"\n' for n in range(12))
    level, energy = table_only(tmp_path, f"level x,energy\n{rows}").questions
    assert level.problem == "column 'level x' is taken for a factor: 3 numbers before the measures, unevenly repeated"
    assert level.fix == "Say what it is: --factor 'level x', --measure 'level x' or --ignore 'level x'."
    assert energy.problem == "numbers of column 'energy' can be read in two ways: 1,100 may be 1.100 or 1100"
    assert "--decimal point or --decimal comma" in energy.fix
    assert not table_only(tmp_path, f"level x,energy\n{rows}", factors=("level x",), decimal=".").questions


def test_a_table_in_which_nothing_is_taken_for_a_measure_is_noted(tmp_path):
    rows = "".join(f"{'ab'[n % 2]},{'NY'[n % 3 > 0]}\n" for n in range(12))
    note = "no column is taken for a measure: nothing can be analysed. Name one with --measure"
    assert note in table_only(tmp_path, f"task,arrived\n{rows}").notes
    assert note not in table_only(tmp_path, f"task,arrived\n{rows}", measures=("arrived",)).notes


def test_folders_are_those_of_runs_that_the_table_counts_under_any_heading(tmp_path):
    for number in range(1, 7):
        write(tmp_path / "results" / str(number) / "power.csv", "time_s,power_W\n0,1\n2,1\n")
    found = table_only(tmp_path, "Lauf,task,energy_J\n" + "".join(f"{n},t{n % 2},{n}.5\n" for n in range(1, 7)))
    assert [run.folder.name for run in found.runs] == [run.run_id for run in found.runs] == [*"123456"]
    assert [each.file for each in found.samples] == ["power.csv"]


@pytest.mark.parametrize("below", ["", "runs"])
def test_folders_none_of_which_belongs_to_a_run_are_noted(tmp_path, below):
    for number in range(4):
        write(tmp_path / "results" / below / f"video {number}" / "power.csv", "time_s,power_W\n0,1\n2,1\n")
    rows = "".join(f"video {n},t{n % 2},{n}.5\n" for n in range(4))
    (note,) = table_only(tmp_path, f"what,task,energy_J\n{rows}").notes
    assert note == (
        "4 folders with CSV files, such as video 0, belong to no run: name the column that has their names (--run-id "
        "COLUMN), or say where those of a run are (--run-folder 'raw/{run_id}')"
    )
    assert all(run.folder for run in table_only(tmp_path, f"what,task,energy_J\n{rows}", run_id="what").runs)


@pytest.mark.parametrize("files", [["plots/a.csv", "docs/a.csv"], ["plots/a.csv", "docs/b.csv", "data/c.csv"]])
def test_folders_beside_the_runs_are_not_taken_for_those_of_runs(tmp_path, files):
    for name in files:
        write(tmp_path / "results" / name, "x,y\n0,1\n2,1\n")
    rows = "".join(f"video {n},t{n % 2},{n}.5\n" for n in range(3))
    assert table_only(tmp_path, f"what,task,energy_J\n{rows}").notes == ()


def test_numbers_are_not_read_as_units(tmp_path, monkeypatch):
    """Pint is slow to load, and of a wide table each number would be parsed by it."""
    asked = []
    monkeypatch.setattr(units, "_registry", lambda: asked.append("pint"))
    rows = "".join(f"t{n % 2},1.62{n}83,1.73{n}\n" for n in range(6))
    assert table_only(tmp_path, f"task,energy_J,cost\n{rows}").questions == ()
    assert not asked


@pytest.mark.parametrize("is_used", [True, False])
def test_studies_beside_the_runs_are_not_taken_for_those_of_runs(tmp_path, is_used):
    root = tmp_path / "results"
    for number in range(4):
        write(root / f"night_{number}" / "power.csv", "time_s,power_W\n0,1\n2,1\n")
        write(root / f"night_{number + 5 * is_used}" / "run_table.csv", "task,energy_J\na,1.5\nb,2.5\n")
    rows = "".join(f"night_{n},t{n % 2},{n}.5\n" for n in range(4))
    heading = "run_id,task,energy_J" if is_used else "what,task,energy_J"
    assert table_only(tmp_path, f"{heading}\n{rows}").notes == ()


def test_files_and_folders_that_do_not_fit_the_table_are_noted(tmp_path):
    root = tmp_path / "results"
    for number in (0, 1, 2, 3, 7):
        write(root / f"run_{number}" / "cpu.csv", "time_s,cpu\n0,1\n1,2\n")
    for number in (0, 1, 2):
        write(root / f"run_{number}" / "power.csv", "time_s,power_W\n0,1\n1,1\n" if number else "time_s,power_W\n")
    write(root / "bags" / "0.bag", "")
    rows = "".join(f"run_{n},t{n % 2},{n}.5,bags/{n}.bag\n" for n in range(5))
    notes = table_only(tmp_path, f"__run_id,task,energy,bag\n{rows}").notes
    for words in (
        "1 run done without a folder of raw files, such as run_4",
        "1 folder of raw files beside those of 4 runs that the table does not have: run_7",
        "column 'bag' names 5 files, of which 4 are missing, such as bags/1.bag",
        "power.csv is missing in 1 of 4 runs, such as run_3",
        "power.csv has no samples in 1 of 3 runs, such as run_0",
    ):
        assert words in notes


def test_numbers_with_a_unit_behind_them_are_measures(tmp_path):
    rows = "".join(f"run_0_repetition_{n},{20 + n}.01%,52{n}.94mJ\n" for n in range(4))
    found = table_only(tmp_path, f"__run_id,packet_loss,energy\n{rows}")
    assert {name: unit.symbol for name, unit in found.units.items()} == {"packet_loss": "%", "energy": "mJ"}
    assert found.runs[0].measures == {"packet_loss": 20.01, "energy": 520.94}


@pytest.mark.parametrize(("files", "said", "problem"), REFUSED.values(), ids=REFUSED.keys())
def test_what_cannot_be_understood_is_refused_with_a_fix(tmp_path, files, said, problem):
    root = tmp_path / "results"
    if files is not None:
        root.mkdir()
    for name, text in (files or {}).items():
        write(root / name, text)
    with pytest.raises((AnalysisError, StorageError)) as refused:
        understand(root, ImportDescription(**said))
    assert problem in refused.value.problem
    assert refused.value.fix


def test_letters_of_another_character_set_are_read_wherever_they_stand(tmp_path):
    rows = "".join(f"r{number},{('Muller', 'Moller')[number % 2]},{number}.5\n" for number in range(5000))
    text = f"run_id,ort,energy_J\n{rows}x1,Müller,1.5\nx2,Möller,2.5\nx3,Café"
    assert [run.treatments["ort"] for run in table_only(tmp_path, text, "cp1252").runs[-3:]] == [
        "Müller",
        "Möller",
        "Café",
    ]


def test_a_column_that_is_said_and_is_not_there_is_refused_with_the_nearest_name(tmp_path):
    for said in ({"measures": ("enrgy_J",)}, {"units": {"enrgy_J": "mJ"}}):
        with pytest.raises(AnalysisError, match="there is no column 'enrgy_J'") as caught:
            table_only(tmp_path, "task,energy_J\na,1.5\nb,2.5\n", **said)
        assert "energy_J" in (caught.value.fix or "")


def test_numbers_that_are_written_plainly_are_said_to_be_written_in_no_other_way(tmp_path):
    found = table_only(tmp_path, "task,energy_J\na,1.5\nb,1e400\n")
    assert not any("thousands" in note for note in found.notes)


def numbered_logs(root, *runs):
    """Make a folder with a run for each set of numbers, which stand in the names of its logs."""
    rows = "".join(f"run_{run},{'ab'[run % 2]},1\n" for run in range(len(runs)))
    write(root / "run_table.csv", f"__run_id,t,e\n{rows}")
    for run, numbers in enumerate(runs):
        for number in numbers:
            write(root / f"run_{run}" / f"energy-{number}.csv", "time,power (W)\n0,5\n1,5\n")
    return understand(root, NOTHING)


def test_logs_with_numbers_in_their_names_go_together_though_a_run_has_two_of_an_attempt_before(tmp_path):
    found = numbered_logs(tmp_path / "r", [1121], [1207, 1268], [1330], [1121], [1415], [1487], [1503], [1567])
    (samples,) = found.samples
    assert (samples.file, sorted(samples.paths)) == ("energy-*.csv", [f"run_{run}" for run in (0, 2, 3, 4, 5, 6, 7)])
    told = "energy-*.csv is left as it is in 1 of 8 runs, such as run_1, which has 2 of them"
    assert f"{told}: keep the one that belongs to the run" in found.notes


@pytest.mark.parametrize("runs", [([1, 2], [1], [1]), ([1, 2], [1, 2], [1]), ([30], [60], [30], [60])])
def test_logs_whose_numbers_are_the_same_in_many_runs_do_not_go_together(tmp_path, runs):
    found = numbered_logs(tmp_path / "r", *runs)
    assert [each.file for each in found.samples] == [f"energy-{number}.csv" for number in sorted(set().union(*runs))]


def test_repetitions_that_are_counted_twice_in_a_combination_are_noted(tmp_path):
    rows = "".join(
        f"{task},{repetition},{energy}\n"
        for energy, task, repetition in (
            (5.5, "a", 1),
            (5.25, "a", 2),
            (7.5, "a", 1),
            (7.25, "a", 2),
            (3.5, "b", 1),
            (3.25, "b", 2),
        )
    )
    found = table_only(tmp_path, f"task,repetition,energy\n{rows}")
    told = "2 repetitions are there more than once, such as repetition 1 of task a"
    assert f"{told}: is a factor missing, or was a series repeated?" in found.notes


def test_runs_to_do_that_have_raw_files_are_noted(tmp_path):
    for run in range(2):
        write(tmp_path / "results" / f"run_{run}" / "power.csv", "time_s,power (W)\n0,5\n1,5\n")
    (tmp_path / "results" / "run_2").mkdir()
    found = table_only(tmp_path, "__run_id,__done,task,e\nrun_0,TODO,a,\nrun_1,TODO,b,\nrun_2,TODO,a,\nrun_3,TODO,b,\n")
    told = "2 runs to do have raw files, such as run_0: if they were executed, say --ignore __done"
    assert told in found.notes


def test_a_folder_with_a_log_of_each_run_and_no_table_says_what_to_do(tmp_path):
    for number in range(3):
        write(tmp_path / f"energy_{number:02}.csv", f"timestamp,power_W\n10:22:2{number},{number}.5\n")
    with pytest.raises(
        StorageError, match=r"which of energy_00.csv, energy_01.csv, energy_02.csv is the run"
    ) as raised:
        understand(tmp_path, NOTHING)
    assert "If each is the log of a run, write a table of the runs" in raised.value.fix
