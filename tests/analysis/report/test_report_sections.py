"""Sections say what the folder knows, and label what was not measured."""

from __future__ import annotations

import pytest

from robot_runner.analysis.figures.style import looks_by
from robot_runner.analysis.report.blocks import Chart, Facts, Paragraph, Part, Remarks, Tone
from robot_runner.analysis.report.document import report_document
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.mission_figures import mission_courses, mission_parts, sampled_measures
from robot_runner.analysis.report.rendering import markdown_of
from robot_runner.analysis.report.summary_section import summary_section
from robot_runner.analysis.report.threats_section import threats_of
from robot_runner.analysis.results import load_results
from robot_runner.analysis.statistics.experiment_statistics import analyse
from robot_runner.analysis.wording import p_values_in_words, shown_number
from robot_runner.core.storage.journal import Journal


def material_of(folder):
    results = load_results(folder.root)
    return Material(results, analyse(results))


def threats(folder):
    return {threat.title: threat for threat in threats_of(material_of(folder))}


def document(folder):
    return report_document(material_of(folder), made="now")


def test_measured_values_are_no_threat(two_tasks):
    found = threats(two_tasks())
    assert not {"Values are simulated", "Values are estimated", "Runs failed"} & found.keys()
    assert document(two_tasks()).badges == ()


@pytest.mark.parametrize("origin", ["simulated", "estimated", "measured, simulated"])
def test_values_that_were_not_measured_are_labelled_everywhere(two_tasks, origin):
    folder = two_tasks(origin=origin)
    word = origin.rpartition(" ")[2]
    assert threats(folder)[f"Values are {word}"].kind == "Construct validity"
    made = document(folder)
    assert [badge.text for badge in made.badges] == ["some values not measured"]
    conclusions = [block for block in made.sections[0].blocks if isinstance(block, Paragraph)]
    assert all([badge.text for badge in block.badges] == [word] for block in conclusions)
    captions = [figure.caption for figure in made.figures if figure.name.startswith("distribution")]
    assert all(f"The values are {word}." in caption for caption in captions)
    parts = [part for part in made.blocks() if isinstance(part, Part) and part.name.endswith("-Energy")]
    assert any(word in [badge.text for badge in part.badges] for part in parts)


def test_what_bars_of_figures_are_is_said_below_them(make_folder):
    rows = [(a, b, 10.0 + place % 7, place % 3 == 0) for place, (a, b) in enumerate(["xp", "xq", "yp", "yq"] * 4)]
    folder = make_folder(
        factors={"A": ["x", "y"], "B": ["p", "q"]}, rows=rows, measures={"E": "J", "Ok": ""}, types={"Ok": "boolean"}
    )
    captions = {figure.name: figure.caption for figure in document(folder).figures}
    assert "diamond and bar: mean and its 95% confidence interval." in captions["distribution E by A / B"]
    assert "Bars: 95% confidence intervals." in captions["interaction E A B"]
    assert "with their 95% confidence intervals." in captions["distribution Ok by A / B"]
    more = [("pq"[place % 2], "xyz"[place % 3], 10.0 + place % 7) for place in range(18)]
    turned = make_folder(factors={"B": ["p", "q"], "A": ["x", "y", "z"]}, rows=more, measures={"E": "J"})
    captions = {figure.name: figure.caption for figure in document(turned).figures}
    assert "Bars: 95% confidence intervals." in captions["interaction E A B"]  # whichever factor came first
    single = make_folder(factors={"A": ["x", "y"], "B": ["p", "q"]}, rows=rows[:4], measures={"E": "J", "Ok": ""})
    captions = {figure.name: figure.caption for figure in document(single).figures}
    assert "confidence" not in captions["interaction E A B"] + captions["distribution E by A / B"]


@pytest.mark.parametrize(
    ("estimand", "spread", "caption"), [("mean", " J", "means"), ("rank", "", "mean relative ranks")]
)
def test_adjusted_ranks_are_not_said_to_be_means_in_the_unit_of_the_measure(make_folder, estimand, spread, caption):
    rows = [("ab"[at % 2], 900.0 + 37 * at % 11, 3.0 + 17 * at % 7) for at in range(16)]
    plan = {"measures": ["Energy"], "covariates": ["CPU"], "estimand": estimand}
    folder = make_folder(
        factors={"Task": ["a", "b"]}, rows=rows, measures={"Energy": "J", "CPU": "%"}, manifest={"analysis": plan}
    )
    material = material_of(folder)
    told = material.statistics.measure("Energy").adjustment
    made = document(folder)
    (table,) = [each for each in made.tables if each.name == "adjusted Energy"]
    assert table.caption == f"Energy (J): {caption} as measured, and at the mean of the covariates."
    (text,) = [each.text for each in made.blocks() if isinstance(each, Paragraph) and "once adjusted" in each.text]
    assert text.endswith(f" {shown_number(told.residual_spread, 3)}{spread} once adjusted for covariates.")


def test_of_pairs_it_is_said_which_treatment_is_subtracted(two_tasks):
    material = material_of(two_tasks())
    (pair,) = material.statistics.measure("Energy").post_hoc[0].comparisons
    means = {each.label: each.mean for each in material.statistics.measure("Energy").by_treatment}
    assert pair.difference == pytest.approx(means[pair.first] - means[pair.second])
    (table,) = [each for each in document(two_tasks()).tables if each.name == "pairs Energy Task"]
    assert table.caption == "Energy (J): all pairs of Task, the first less the second."


def test_measures_that_go_together_perfectly_are_highlighted(make_folder):
    rows = [("ab"[place % 2], float(place), 2.0 * place) for place in range(12)]
    made = document(make_folder(factors={"Task": ["a", "b"]}, rows=rows, measures={"E": "J", "F": "J"}))
    (table,) = [each for each in made.tables if each.name == "correlations"]
    (cell,) = [
        cell
        for row in table.rows
        for column, cell in zip(table.columns, row, strict=True)
        if "p" in column.name.split()
    ]
    assert (cell.value, cell.text, cell.tone) == (0.0, "< 0.001", Tone.GOOD)


def test_in_brief_many_interactions_that_are_not_shown_take_one_sentence(make_folder):
    rows = [
        (a, b, c, 10.0 + 5 * (a == "x") + place * 37 % 11)
        for place, (a, b, c) in enumerate(["xpv", "xpw", "xqv", "xqw", "ypv", "ypw", "yqv", "yqw"] * 4)
    ]
    folder = make_folder(factors={"A": ["x", "y"], "B": ["p", "q"], "C": ["v", "w"]}, rows=rows, measures={"E": "J"})
    material = material_of(folder)
    (brief,) = [each for each in summary_section(material, ()).blocks if isinstance(each, Paragraph)]
    effects = material.statistics.measures[0].test.effects
    least = min((each for each in effects if len(each.factors) > 1), key=lambda each: each.p_value)
    figures = p_values_in_words(least.p_value, least.adjusted_p_value)
    assert [each.is_significant for each in effects] == [True] + 6 * [False]
    gathered = (
        f"The data do not show any of 4 interactions on E (the smallest p-value: {figures}); that is not proof that "
        "there is none. The tests of each are below."
    )
    assert brief.text == " ".join([*(each.conclusion for each in effects if len(each.factors) == 1), gathered])


def test_a_simulated_robot_is_said_at_the_head(two_tasks):
    made = document(two_tasks(manifest={"robot": "simulated:initial_charge=40"}))
    assert [badge.text for badge in made.badges] == ["simulated robot"]


def test_software_that_imported_results_is_not_told_as_that_of_the_experiment(two_tasks):
    software = {"python": "3.13.0", "robot_runner": "1.0", "packages": {"numpy": "2.4"}}
    for origin, told in (("imported", "Software of the import"), ("executed", "Machine and software")):
        made = document(two_tasks(manifest={"origin": origin, "software": software}))
        (part,) = [part for part in made.blocks() if isinstance(part, Part) and part.name == "design-machine"]
        assert part.title == told
        (facts,) = part.blocks
        assert (("Machine", "not recorded: the runs were executed elsewhere") in facts.rows) is (origin == "imported")


def test_the_machine_is_not_told_to_have_executed_what_workers_of_a_cluster_have(two_tasks):
    stamps = {"started_at": "2026-01-31T12:00:00.000Z"}
    folder = two_tasks(manifest={"executions": [stamps, {**stamps, "changed": {}}]})
    with Journal(folder.files.journal) as journal:
        for run, place in (("r_1", {"place": "node2", "slot": 0}), ("r_2", {"place": "node1", "slot": 0}), ("r_3", {})):
            journal.append("attempt_started", at="2026-01-31T13:00:00.000Z", run=run, attempt=2, **place)
    (part,) = [part for part in document(folder).blocks() if isinstance(part, Part) and part.name == "design-machine"]
    assert "circumstances may have changed between them" in threats(folder)["Executed in parts"].text
    told = "2 runs on workers of a cluster, whose machines are not recorded: node1, node2"
    assert ("Machine", f"described here is the one that directed {told}") in part.blocks[0].rows


def test_a_clock_that_was_set_back_between_or_in_executions_is_told_beside_their_times(two_tasks):
    first, second, third = ({"started_at": f"2026-01-31T{hour}:00:00.000Z"} for hour in (12, 13, 14))
    ended_earlier = {**third, "finished_at": first["started_at"]}
    to_the_second, half_later = {"started_at": "2026-01-31T12:00:00Z"}, {"started_at": "2026-01-31T12:00:00.500Z"}
    elsewhere = {"started_at": "2026-01-31T13:30:00+01:00"}
    set_back = "; the stamps go back: a clock was set, or another machine's differs"
    for executions, told in (
        ([first, second], "2026-01-31 12:00:00 UTC, and was not ended, in 2 executions"),
        ([second, first], f"2026-01-31 13:00:00 UTC, and was not ended, in 2 executions{set_back}"),
        ([to_the_second, half_later], "2026-01-31 12:00:00 UTC, and was not ended, in 2 executions"),
        ([elsewhere, second], ", and was not ended, in 2 executions"),
        ([ended_earlier], f"2026-01-31 14:00:00 UTC to 2026-01-31 12:00:00 UTC{set_back}"),
    ):
        text = markdown_of(document(two_tasks(manifest={"executions": executions})), str)
        assert told in text
        assert (set_back in text) is (set_back in told)


def test_what_was_set_by_hand_is_a_threat(two_tasks):
    found = threats(two_tasks(manifest={"deviations": {"robot": "simulated"}}))
    assert "robot = simulated" in found["Parameters were set by hand"].text


def test_an_order_that_was_not_randomised_is_a_threat(two_tasks):
    design = {"source": "config", "factors": {}, "repetitions": 5, "shuffle": False, "blocks": None}
    assert "The order was not randomised" in threats(two_tasks(manifest={"design": design}))
    assert "The order was not randomised" not in threats(two_tasks())


def test_an_order_as_written_is_not_said_to_have_been_drawn(two_tasks):
    """A seed is drawn all the same, for the random numbers of the runs."""
    design = {"source": "config", "factors": {}, "repetitions": 5, "shuffle": False, "blocks": None}
    text = markdown_of(document(two_tasks(manifest={"design": design, "seed_is_given": False, "seed": 7})), str)
    assert "The seed 7 was drawn" in text
    assert "order was drawn" not in text


def test_executions_in_parts_are_told(two_tasks):
    stamps = {"started_at": "2026-01-31T12:00:00.000Z", "finished_at": "2026-01-31T13:00:00.000Z"}
    found = threats(two_tasks(manifest={"executions": [stamps, {**stamps, "deviations": {"a": 1}}]}))
    assert "2 parts" in found["Executed in parts"].text
    assert "a = 1" in found["Parameters were set by hand"].text


@pytest.mark.long
def test_whether_machine_and_software_changed_between_executions_is_told(two_tasks):
    stamps = {"started_at": "2026-01-31T12:00:00.000Z"}
    found = threats(two_tasks(manifest={"executions": [stamps, {**stamps, "changed": {}}]}))
    assert found["Executed in parts"].text == "The experiment was executed in 2 parts, on one machine and software."
    changed = {"package numpy": {"was": "1.0", "is": "2.0"}}
    found = threats(two_tasks(manifest={"executions": [stamps, {**stamps, "changed": changed}, stamps]}))
    assert "package numpy (1.0, later 2.0)" in found["Machine or software changed on the way"].text
    assert "Executed in parts" not in found
    found = threats(two_tasks(manifest={"executions": [{**stamps, "changed": changed}]}))
    assert "1 part, and later runs had" in found["Machine or software changed on the way"].text
    values = {"Meter.gain": {"was": 1.0, "is": 5.0}, "second.gain": {"is": 2.0}}
    found = threats(two_tasks(manifest={"executions": [stamps, {**stamps, "changed_values": values}]}))
    told = "Meter.gain from 1.0 to 5.0, second.gain from 'not given' to 2.0"
    assert told.replace("'", "") in found["Values were changed on the way"].text


def retry(folder, *runs):
    """Add a second attempt at runs, which ends as their first one did."""
    with Journal(folder.files.journal) as journal:
        for run in runs:
            status = "done" if folder.status(int(run[2:]) - 1) == "Done" else "failed"
            ended = {"is_last": True, "status": status, "seconds": 1.0, "stamps": {}, "measures": {}, "failure": None}
            journal.append("attempt_started", at="2026-01-31T13:00:00.000Z", run=run, attempt=2)
            journal.append("attempt_finished", at="2026-01-31T13:00:01.000Z", run=run, attempt=2, **ended)


def test_of_runs_that_took_several_attempts_those_with_results_are_told(two_tasks):
    folder = two_tasks(statuses={2: "Failed"})
    retry(folder, "r_2", "r_3")
    found = threats(folder)
    assert found["Runs took more than one attempt"].text.startswith("r_2: results are those of the last attempt")
    assert found["Runs failed"].text.startswith("1 run failed")


def test_why_earlier_attempts_failed_is_told_as_their_values_are_left_out(two_tasks):
    folder = two_tasks()
    with Journal(folder.files.journal) as journal:
        for run, attempt, status, failure in (
            ("r_2", 2, "failed", "Energy: the value, 900 J, is above 880 J"),
            ("r_2", 3, "done", None),
            ("r_4", 2, "failed", "Energy: the value, 900 J, is above 880 J"),
            ("r_4", 3, "done", None),
        ):
            ended = {"is_last": status == "done", "status": status, "seconds": 1.0, "stamps": {}, "measures": {}}
            journal.append("attempt_started", at="2026-01-31T13:00:00.000Z", run=run, attempt=attempt)
            journal.append(
                "attempt_finished", at="2026-01-31T13:00:01.000Z", run=run, attempt=attempt, **ended, failure=failure
            )
    assert threats(folder)["Runs took more than one attempt"].text == (
        "r_2, r_4: results are those of the last attempt, at another time than planned. "
        "Earlier ones failed: r_2, r_4 (Energy: the value, 900 J, is above 880 J). By Task: Video 2 of 5 runs, "
        "Network 0 of 5 runs. Means are of the attempts that succeeded: where those fail that take long, say, a "
        "treatment looks better the more of its attempts fail."
    )


@pytest.mark.parametrize(
    ("manifest", "heading", "told"),
    [
        ({"robot": None}, "Robot", "none"),
        ({"robot": "ros2"}, "Robot", "ros2"),
        (
            {"robot": "ros2://alice", "robots": {"alice": "ros2://alice", "bob": "ros2://bob"}},
            "Robots",
            "alice (ros2://alice), bob (ros2://bob), which took turns",
        ),
    ],
)
def test_the_design_names_each_robot_or_says_that_there_was_none(two_tasks, manifest, heading, told):
    facts = next(block for block in document(two_tasks(manifest=manifest)).blocks() if isinstance(block, Facts))
    assert dict(facts.rows)[heading] == told


def test_doubts_that_name_their_run_are_told_once(two_tasks):
    folder = two_tasks()
    with Journal(folder.files.journal) as journal:
        for run, process in (("r_1", "node, pid 7"), ("r_2", "python3, pid 41"), ("r_3", "node, pid 9")):
            problem = f"another process ({process}) took 31 % of a core during {run}"
            journal.append("finding", run=run, attempt=1, owner="machine", problem=problem, fix="End it.")
    remarks = [each for each in threats_of(material_of(folder)) if each.title == "machine noticed"]
    assert [each.text for each in remarks] == [
        "Another process (node, pid 7) took 31 % of a core during r_1, and the like (r_1, r_2, r_3). End it."
    ]


def test_gaps_and_saturation_are_threats(two_tasks):
    folder = two_tasks()
    counts = {"expected": 100, "got": 90, "coverage": 90.0, "lost": 10, "corrupt": 1, "largest_gap": 0.5}
    folder.write_quality("Meter", {"samples": counts, "saturated": 2, "is_simulated": False})
    found = threats(folder)
    assert "100 samples lost, 10 damaged" in found["Samples of Meter have gaps"].text
    assert "at the least 90.0 %" in found["Samples of Meter have gaps"].text
    assert "20 samples" in found["Meter was saturated"].text


def test_notes_that_are_no_notes_are_passed_over(two_tasks):
    folder = two_tasks()
    folder.write_quality("Meter", {"samples": "many"})
    (folder.files.run("r_1") / "Meter" / "quality.json").write_text("{")
    (folder.files.run("r_2") / "Meter" / "quality.json").write_text("[1]")
    qualities = material_of(folder).qualities
    assert len(qualities) == 8
    assert {each.lost for each in qualities} == {None}


def test_a_drift_is_told_with_a_figure(make_folder):
    rows = [("ab"[place % 2], 100.0 + place * 3.0 + (place % 3) * 0.4) for place in range(20)]
    folder = make_folder(factors={"Task": ["a", "b"]}, rows=rows, measures={"Energy": "J"})
    assert threats(folder)["Energy drifts over the experiment"].kind == "Internal validity"
    assert "order Energy" in [figure.name for figure in document(folder).figures]


@pytest.mark.long
def test_runs_in_a_row_that_are_alike_are_told_with_a_figure(make_folder):
    series = [0.0, 9.0, -6.0, 3.0, 12.0, -12.0, 6.0, -3.0, 9.0, -6.0]
    rows = [("abcd"[place % 4], 100.0 + series[place // 4] + place % 3 * 0.4) for place in range(40)]
    folder = make_folder(factors={"Task": [*"abcd"]}, rows=rows, measures={"Energy": "J"})
    told = threats(folder)["Energy is alike in runs that follow each other"]
    assert (told.kind, told.tone) == ("Internal validity", Tone.WARNING)
    assert "order Energy" in [figure.name for figure in document(folder).figures]


def test_an_experiment_without_threats_says_so(two_tasks):
    made = document(two_tasks())
    remarks = [block for block in made.sections[6].blocks if isinstance(block, Remarks)]
    assert all(remark.tone in Tone for block in remarks for remark in block.remarks)


def test_names_of_a_document_are_unique(two_tasks):
    made = document(two_tasks())
    for several in (made.tables, made.figures, made.charts):
        names = [each.name for each in several]
        assert len(set(names)) == len(names)


def power(folder, plugin="Meter", heading="time_s,raw_counts,voltage_V,power_W"):
    folder.write_samples(
        plugin, "samples.csv", heading, lambda place: [f"{t / 10},1,12,{place + t}" for t in range(50)]
    )


def test_power_is_shown_before_all_else_and_raw_counts_never(two_tasks):
    folder = two_tasks()
    power(folder)
    folder.write_samples(
        "PsUtil", "samples.csv", "time_s,cpu_percent,memory_percent,threads", lambda place: ["0,1,2,3", "1,1,2,3"]
    )
    found = sampled_measures(load_results(folder.root))
    assert [(each.label, each.column) for each in found] == [
        ("Power (W)", "power_W"),
        ("CPU (%)", "cpu_percent"),
        ("Memory (%)", "memory_percent"),
    ]


def test_phases_that_differ_between_runs_are_not_drawn_for_all(two_tasks):
    folder = two_tasks()
    power(folder)
    folder.write_samples(
        "Robot", "phases.csv", "number,phase,start_s,end_s", lambda place: [f"1,{'ab'[place % 2]},0,2"]
    )
    material = material_of(folder)
    [measure] = sampled_measures(material.results)
    assert mission_courses(material, measure, material.order).phases == ()


def test_phases_that_go_on_at_once_are_not_drawn_in_turn(two_tasks):
    folder = two_tasks()
    power(folder)
    folder.write_samples("Robot", "phases.csv", "number,phase,start_s,end_s", lambda _: ["1,a,0,3", "2,b,2,4"])
    material = material_of(folder)
    [measure] = sampled_measures(material.results)
    assert mission_courses(material, measure, material.order).phases == ()


def test_times_are_counted_from_the_start_of_measurement(two_tasks):
    folder = two_tasks()
    power(folder)
    material = material_of(folder)
    [measure] = sampled_measures(material.results)
    mission = mission_courses(material, measure, material.order)
    assert dict(mission.events) == {"launch_mission": 5.0, "stop_measurement": 10.0}
    assert {course.runs for course in mission.means} == {5}


def test_a_treatment_has_one_colour_also_where_courses_of_six_of_many_are_shown(make_folder):
    levels = [f"level {number}" for number in range(9)]
    rows = [(level, 1.0 + place) for place, level in enumerate(levels)]
    folder = make_folder(factors={"Speed": levels}, rows=rows, measures={"Energy": "J"})
    power(folder)
    material = material_of(folder)
    [part] = mission_parts(material)
    [chart] = [block for block in part.blocks if isinstance(block, Chart)]
    colours = {name: look.colour for name, look in looks_by(material.order).items()}
    assert {group["name"]: group["colour"] for group in chart.data["groups"]}.items() <= colours.items()
    assert len(chart.data["groups"]) == 6
    (drawn,) = [each for each in document(folder).figures if each.name.endswith("power_W means")]
    lines = {line.get_label(): line.get_color() for line in drawn.draw().axes[-1].lines}
    assert lines["level 8"] == colours["level 8"]


def test_runs_without_samples_leave_no_hole(two_tasks):
    folder = two_tasks(statuses={0: "Failed"})
    power(folder)
    (folder.files.run("r_2") / "Meter" / "samples.csv").write_text("time_s,raw_counts,voltage_V,power_W\n")
    [part] = mission_parts(material_of(folder))
    [chart] = [block for block in part.blocks if isinstance(block, Chart)]
    assert [(group["name"], group["runs"]) for group in chart.data["groups"]] == [("Video", 3), ("Network", 5)]
    lengths = {len(run["values"]) for group in chart.data["groups"] for run in group["each"]}
    assert lengths == {len(chart.data["time"])}


def test_the_mean_over_the_mission_says_that_it_is_of_runs_that_last_so_long(two_tasks):
    folder = two_tasks()
    lasting = [50 if place < 2 else 20 for place in range(10)]
    folder.write_samples(
        "Meter", "samples.csv", "time_s,power_W", lambda place: [f"{t / 10},{place}" for t in range(lasting[place])]
    )
    made = document(folder)
    (mean,) = [each.caption for each in made.figures if each.name.startswith("course") and each.name.endswith("means")]
    assert "Power (W) over the time of the mission, mean of each treatment's runs that last so long (runs: " in mean
    (chart,) = [block for block in made.charts if block.kind == "course"]
    assert chart.caption.startswith("Power (W): mean of each treatment's runs that last so long, with a band of one ")


def test_many_runs_are_thinned_out_in_a_chart(make_folder):
    rows = [("a", 1.0 + place % 7) for place in range(120)]
    folder = make_folder(factors={"T": ["a"]}, rows=rows, measures={"E": "J"})
    power(folder)
    [part] = mission_parts(material_of(folder))
    [chart] = [block for block in part.blocks if isinstance(block, Chart)]
    assert len(chart.data["groups"][0]["each"]) == 40
    assert "one in 3" in chart.caption


@pytest.mark.long
def test_of_very_many_measures_energy_and_the_planned_are_drawn_first(make_folder):
    names = [f"m{number}" for number in range(25)]
    rows = [("ab"[place % 2], *(place * 1.5 + number % 7 for number in range(25))) for place in range(6)]
    plan = {"measures": ["m24"], "alpha": 0.05, "correction": "holm", "hypotheses": []}
    folder = make_folder(
        factors={"Task": ["a", "b"]},
        rows=rows,
        measures=dict.fromkeys(names, "s") | dict.fromkeys(names[20:23], "J"),
        manifest={"analysis": plan},
    )
    made = document(folder)
    drawn = {figure.name.split()[1] for figure in made.figures if figure.name.startswith("distribution")}
    assert drawn == {"m24", *names[20:23], *names[:12]}
    assert "9 more measures are not drawn: name those to draw by --measure." in markdown_of(made, str)
