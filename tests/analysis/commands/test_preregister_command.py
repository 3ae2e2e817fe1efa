"""`robot-runner preregister` writes what is fixed before the first run; the report says where it was not followed."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from tests.analysis.report.agreement import disagreements

from robot_runner.core.storage.registration import read_registration, write_registration

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.command_line import Answer

CONFIG = """
from robot_runner import AnalysisPlan, ExperimentConfig, Factor, Hypothesis, RunTableModel


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "two_tasks"
    analysis = AnalysisPlan(
        "Energy", alpha=0.05, hypotheses=[Hypothesis("Video costs more.", measure="Energy", factors="Task")]
    )

    def create_run_table(self):
        return RunTableModel(
            [Factor("Task", ["Idle", "Video"])], repetitions=3, data_columns=["Energy", "CPU"], shuffle=True
        )

    def populate_run_data(self, context):
        extra = 10 if context.combination["Task"] == "Video" else 0
        return {"Energy": 100 + extra + context.run_number, "CPU": 50 + context.run_number % 3}
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    config = tmp_path / "study.py"
    config.write_text(CONFIG, encoding="utf-8")
    return config


def report_of(robot_runner: Callable[..., Answer], folder: Path) -> dict[str, Any]:
    assert robot_runner("report", "experiments/two_tasks", "--format", "json", "--output", folder).code == 0
    found = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert disagreements(found) == []
    assert isinstance(found, dict)
    return found


@pytest.mark.long
def test_a_registered_study_is_cited_by_its_report_and_its_package(
    robot_runner: Callable[..., Answer], study: Path, tmp_path: Path
) -> None:
    answer = robot_runner("preregister", study)
    assert answer.code == 0, answer.err
    registration = json.loads((tmp_path / "study.registration.json").read_text(encoding="utf-8"))
    assert registration["sha256"] in answer.out
    assert registration["design"]["factors"] == {"Task": ["Idle", "Video"]}
    assert registration["analysis"]["hypotheses"][0]["statement"] == "Video costs more."
    assert registration["power"] is None
    assert "no power analysis was registered" in answer.out
    # The config gives no seed: the one that is drawn now is the one that the experiment uses.
    assert f"from seed {registration['seed']}" in robot_runner("plan", study).out
    assert registration["sha256"] in robot_runner("check", study).out
    assert robot_runner("run", study, "--plain").code == 0
    folder = tmp_path / "experiments" / "two_tasks"
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["seed"] == registration["seed"]
    assert manifest["registration"]["sha256"] == registration["sha256"]
    report = report_of(robot_runner, tmp_path / "report")
    # The CPU was measured, as registered, and is no measure of the plan.
    assert report["registration"]["deviations"] == ["measures tested that were not planned: CPU"]
    assert registration["sha256"] in report["registration"]["sentence"]
    assert registration["sha256"] in robot_runner("explain", folder, "r_1").out
    assert robot_runner("pack", folder, "--no-hashes", "--to", "one.zip").code == 0
    assert robot_runner("verify", "one.zip").code == 0
    assert robot_runner("replicate", "one.zip", "--to", "again", "--yes", "--plain").code == 0
    again = json.loads((tmp_path / "again" / "two_tasks" / "manifest.json").read_text(encoding="utf-8"))
    assert again["registration"]["sha256"] == registration["sha256"]
    assert again["executions"][0]["deviations"] == {}
    # Whoever changes the file that was kept is found out, in the report, in the package and by `explain`.
    registration["analysis"]["alpha"] = 0.1
    (folder / "registration.json").write_text(json.dumps(registration), encoding="utf-8")
    changed = report_of(robot_runner, tmp_path / "report")
    assert "checksum differs" in changed["registration"]["problem"]
    assert any(each["title"] == "The registration cannot be trusted" for each in changed["threats"])
    assert "was changed since" in robot_runner("explain", folder, "r_1").out
    assert robot_runner("pack", folder, "--no-hashes", "--to", "two.zip").code == 0
    refused = robot_runner("verify", "two.zip")
    assert refused.code == 2
    assert "not the one that the experiment began with" in refused.out + refused.err


@pytest.mark.long
def test_every_deviation_is_listed(robot_runner: Callable[..., Answer], study: Path, tmp_path: Path) -> None:
    assert robot_runner("preregister", study).code == 0
    changed = CONFIG.replace("alpha=0.05", "alpha=0.01").replace('["Energy", "CPU"]', '["Energy"]')
    study.write_text(changed.replace(', "CPU": 50 + context.run_number % 3', ""), encoding="utf-8")
    warned = robot_runner("check", study)
    assert warned.code == 0
    assert "alpha of the analysis plan: 0.01, and 0.05 was registered" in " ".join(
        warned.out.split() + warned.err.split()
    )
    assert robot_runner("run", study, "--plain", "--set", "attempts=2").code == 0
    assert robot_runner("exclude", "experiments/two_tasks", "r_2", "--reason", "the battery was swapped").code == 0
    assert robot_runner("extend", study, "--repetitions", "4", "--set", "attempts=2").code == 0
    report = report_of(robot_runner, tmp_path / "report")
    told = report["registration"]["deviations"]
    expected = (
        "alpha of the analysis plan: 0.01, and 0.05 was registered",
        "the measure CPU was registered, and the run table has no column for it",
        "the file study.py was changed after the registration",
        "set from outside on",
        "extended beyond what was registered: batch 2, 2 runs",
        "1 run excluded: r_2",
        "2 runs not done",
    )
    for each in expected:
        assert any(line.startswith(each) for line in told), (each, told)
    assert len(told) == len(expected)
    assert any(each["title"] == "Deviations from the registration" for each in report["threats"])


@pytest.mark.long
def test_a_clock_that_is_behind_the_registration_is_told_before_the_first_run_and_in_the_report(
    robot_runner: Callable[..., Answer], study: Path, tmp_path: Path
) -> None:
    assert robot_runner("preregister", study).code == 0
    path = tmp_path / "study.registration.json"
    write_registration(path, {**read_registration(path).content, "registered_at": "2099-01-01T00:00:00.000Z"})
    executed = robot_runner(study)
    assert "and the study was registered at 2099-01-01T00:00:00.000Z already" in executed.out + executed.err
    (told,) = [each for each in report_of(robot_runner, tmp_path)["registration"]["deviations"] if "first run" in each]
    assert (
        told
        == "by its time it was registered after the first run, which had it: a clock was wrong, or a file was edited"
    )


def test_a_registration_is_compared_with_a_config(
    robot_runner: Callable[..., Answer], study: Path, tmp_path: Path
) -> None:
    assert robot_runner("preregister", study, "--output", "deposited.json").code == 0
    same = robot_runner("preregister", "--check", "deposited.json", study)
    assert (same.code, "none" in same.out) == (0, True)
    study.write_text(CONFIG.replace("repetitions=3", "repetitions=5"), encoding="utf-8")
    other = robot_runner("preregister", "--check", "deposited.json", study)
    assert other.code == 1
    assert "repetitions: 5, and 3 was registered" in other.out
    assert "study.py" in other.out
    content = json.loads((tmp_path / "deposited.json").read_text(encoding="utf-8"))
    content["design"]["repetitions"] = 5
    (tmp_path / "deposited.json").write_text(json.dumps(content), encoding="utf-8")
    assert "changed after it was made" in robot_runner("preregister", "--check", "deposited.json", study).err


@pytest.mark.long
def test_warm_up_runs_are_told_apart_from_those_of_the_design(robot_runner: Callable[..., Answer], study: Path) -> None:
    study.write_text(CONFIG.replace("shuffle=True", "shuffle=True, warm_up=2"), encoding="utf-8")
    said = robot_runner("preregister", study).out
    assert "Design      Task (Idle, Video); 3 repetitions, 8 runs, those that only warm up among them" in said


@pytest.mark.long
def test_a_registration_that_was_changed_or_is_missing_keeps_the_experiment_from_starting(
    robot_runner: Callable[..., Answer], study: Path, tmp_path: Path
) -> None:
    study.write_text(CONFIG.replace('"two_tasks"', '"two_tasks"\n    registration = "plans/it.json"'), encoding="utf-8")
    missing = robot_runner("check", study)
    assert missing.code == 2
    assert "there is no registration" in missing.out
    assert "robot-runner preregister" in missing.out
    (tmp_path / "plans").mkdir()
    assert robot_runner("preregister", study).code == 0
    assert robot_runner("check", study).code == 0
    path = tmp_path / "plans" / "it.json"
    path.write_text(
        path.read_text(encoding="utf-8").replace("Video costs more.", "Video costs less."), encoding="utf-8"
    )
    changed = robot_runner("check", study)
    assert changed.code == 2
    assert "changed after it was made" in changed.out
    assert robot_runner("run", study, "--plain").code == 2
    assert not (tmp_path / "experiments").exists()
    for damaged in ("", "[]", '{"format": 99}', '{"format": 1}', "\x00"):
        path.write_text(damaged, encoding="utf-8")
        answer = robot_runner("check", study)
        assert answer.code == 2
        assert "Traceback" not in answer.out + answer.err


@pytest.mark.long
def test_a_study_is_registered_once_and_before_its_first_run(
    robot_runner: Callable[..., Answer], study: Path, tmp_path: Path
) -> None:
    assert robot_runner("preregister", study).code == 0
    first = json.loads((tmp_path / "study.registration.json").read_text(encoding="utf-8"))
    again = robot_runner("preregister", study)
    assert again.code == 2
    assert "--replace" in again.err
    assert robot_runner("preregister", study, "--replace").code == 0
    second = json.loads((tmp_path / "study.registration.json").read_text(encoding="utf-8"))
    assert second["replaces"]["sha256"] == first["sha256"]
    assert robot_runner("run", study, "--plain").code == 0
    late = robot_runner("preregister", study, "--replace")
    assert late.code == 2
    assert "has begun" in late.err


def test_a_design_that_is_too_large_to_be_listed_is_refused_at_once(
    robot_runner: Callable[..., Answer], study: Path
) -> None:
    many = 'Factor("Task", ["Idle", "Video"]), Factor("A", range(3000)), Factor("B", range(3000))'
    study.write_text(CONFIG.replace('Factor("Task", ["Idle", "Video"])', many), encoding="utf-8")
    for words in (("preregister",), ("power", "--sd", "1", "--difference", "Task=1")):
        answer = robot_runner(*words, study)
        assert answer.code == 2
        assert "54,000,000" in answer.err + answer.out
        assert "Traceback" not in answer.err


@pytest.mark.long
def test_the_power_of_the_same_study_is_registered_with_it(
    robot_runner: Callable[..., Answer], study: Path, tmp_path: Path
) -> None:
    words = ("--sd", "10", "--difference", "Task=12", "--simulations", "100", "--repetitions", "2..30")
    assert robot_runner("power", study, *words, "--output", "power").code == 0
    answer = robot_runner("preregister", study, "--power", "power/power.json")
    assert answer.code == 0, answer.err
    content = json.loads((tmp_path / "study.registration.json").read_text(encoding="utf-8"))
    assert content["power"]["answers"][0] in answer.out
    assert "The config plans 3 repetitions" in answer.out
    study.write_text(CONFIG.replace('"Video"]', '"Video", "Network"]'), encoding="utf-8")
    refused = robot_runner("preregister", study, "--power", "power/power.json", "--replace")
    assert refused.code == 2
    assert "the factors differ" in refused.err


@pytest.mark.long
def test_the_power_of_people_who_have_each_treatment_is_registered_with_them(
    robot_runner: Callable[..., Answer], study: Path
) -> None:
    def write(people: int) -> None:
        study.write_text(
            CONFIG.replace("RunTableModel\n", "RunTableModel\nfrom robot_runner.designs import Crossover\n")
            .replace(
                '[Factor("Task", ["Idle", "Video"])], repetitions=3,',
                f'[Factor("Person", range({people})), Factor("Turn", [1, 2]), Factor("Task", ["Idle", "Video"])],',
            )
            .replace("shuffle=True", 'shuffle=True, design=Crossover(unit="Person", period="Turn")'),
            encoding="utf-8",
        )

    write(8)
    words = ("--sd", "10", "--difference", "Task=30", "--simulations", "100", "--repetitions", "1..2")
    assert robot_runner("power", study, *words, "--output", "power").code == 0
    answer = robot_runner("preregister", study, "--power", "power/power.json")
    assert answer.code == 0, answer.err
    write(10)
    refused = robot_runner("preregister", study, "--power", "power/power.json", "--replace")
    assert refused.code == 2
    assert "the factors differ" in refused.err


@pytest.mark.long
def test_a_factor_that_counts_repetitions_is_registered_with_the_power_of_others(
    robot_runner: Callable[..., Answer], study: Path
) -> None:
    def write(repetitions: int) -> None:
        counted = f'Factor("Task", ["Idle", "Video"]), Factor("Repetition", range({repetitions}))], data'
        study.write_text(
            CONFIG.replace('Factor("Task", ["Idle", "Video"])], repetitions=3, data', counted), encoding="utf-8"
        )

    write(3)
    words = ("--sd", "10", "--difference", "Task=12", "--simulations", "100", "--repetitions", "2..30")
    assert robot_runner("power", study, *words, "--output", "power").code == 0
    assert "The config plans 3 repetitions" in robot_runner("preregister", study, "--power", "power/power.json").out
    write(30)
    answer = robot_runner("preregister", study, "--power", "power/power.json", "--replace")
    assert answer.code == 0, answer.err
    assert "The config plans" not in answer.out


@pytest.mark.long
@pytest.mark.parametrize("where", ["the model", "the plan"])
def test_the_power_within_blocks_of_a_factor_that_counts_is_registered_however_it_is_written(
    robot_runner: Callable[..., Answer], study: Path, where: str
) -> None:
    counted = CONFIG.replace('"Video"])], repetitions=3,', '"Video"]), Factor("repetition", range(3))],')
    model, plan = (
        ('shuffle=True, blocks="repetition"', "alpha=0.05")
        if where == "the model"
        else ("shuffle=True", 'alpha=0.05, blocks="repetition"')
    )
    study.write_text(counted.replace("shuffle=True", model).replace("alpha=0.05", plan), encoding="utf-8")
    words = ("--sd", "10", "--difference", "Task=30", "--simulations", "100", "--repetitions", "3..9")
    assert robot_runner("power", study, *words, "--output", "power").code == 0
    answer = robot_runner("preregister", study, "--power", "power/power.json")
    assert answer.code == 0, answer.err


def test_what_is_left_out_and_adjusted_for_is_registered(
    robot_runner: Callable[..., Answer], study: Path, tmp_path: Path
) -> None:
    ruled = CONFIG.replace("AnalysisPlan, ", "AnalysisPlan, Doubtful, Outliers, ").replace(
        'AnalysisPlan(\n        "Energy",',
        'AnalysisPlan(\n        "Energy", outliers=Outliers(median_deviations=3, bounds={"Energy": (0, 900)}),'
        ' doubtful=Doubtful.REFUSE, covariates=["CPU"],',
    )
    study.write_text(ruled, encoding="utf-8")
    answer = robot_runner("preregister", study)
    assert answer.code == 0, answer.err
    said = " ".join(answer.out.split())
    assert "values of Energy more than 3 median absolute deviations from the median of its combination" in said
    assert "no conclusion on measures with doubtful values" in said
    assert "adjusted for CPU" in said
    registered = json.loads((tmp_path / "study.registration.json").read_text(encoding="utf-8"))["analysis"]
    assert registered["outliers"] == {"median_deviations": 3.0, "bounds": {"Energy": [0.0, 900.0]}}
    study.write_text(CONFIG, encoding="utf-8")
    answer = robot_runner("preregister", "--check", tmp_path / "study.registration.json", study)
    assert answer.code == 1
    assert "covariates of the analysis plan" in answer.out
    assert "outliers of the analysis plan" in answer.out


@pytest.mark.long
def test_repetitions_that_the_registered_rule_adds_are_no_deviation_and_another_rule_is_one(
    robot_runner: Callable[..., Answer], study: Path, tmp_path: Path
) -> None:
    precise = 'experiment_name = "two_tasks"\n    repeat_until = Precision("Energy", half_width=4, at_most=6)'
    config = CONFIG.replace("import AnalysisPlan,", "import AnalysisPlan, Precision,")
    study.write_text(config.replace('experiment_name = "two_tasks"', precise), encoding="utf-8")
    answer = robot_runner("preregister", study)
    assert answer.code == 0, answer.err
    registration = json.loads((tmp_path / "study.registration.json").read_text(encoding="utf-8"))
    assert registration["repeat_until"]["rules"][0]["half_width"] == "4"
    assert robot_runner("run", study, "--plain").code == 0
    report = report_of(robot_runner, tmp_path / "report")
    assert report["precision"][0]["repetitions"] == 6
    assert report["registration"]["deviations"] == ["measures tested that were not planned: CPU"]
    study.write_text(study.read_text(encoding="utf-8").replace("at_most=6", "at_most=7"), encoding="utf-8")
    assert robot_runner("run", study, "--plain", "--accept-changes").code == 0
    told = report_of(robot_runner, tmp_path / "report")["registration"]["deviations"]
    until = "until the mean of Energy in each combination is known to ± 4; at least 3, at most"
    expected = (
        f"combinations are repeated {until} 7 repetitions, and {until} 6 repetitions was registered",
        "the file study.py was changed after the registration",
        "how precisely measures are to be known was changed after runs had been executed",
        "measures tested that were not planned: CPU",
    )
    assert sorted(told) == sorted(expected)


@pytest.mark.long
def test_names_with_line_breaks_do_not_make_lines_of_their_own(
    robot_runner: Callable[..., Answer], study: Path, tmp_path: Path
) -> None:
    study.write_text(CONFIG.replace('"Video costs more."', '"Video\\n  Differences  none"'), encoding="utf-8")
    lines = robot_runner("preregister", study).out.splitlines()
    assert [line for line in lines if "Differences" in line] == ["  Hypothesis  Video\\n  Differences  none"]
    study.write_text(CONFIG, encoding="utf-8")
    lines = robot_runner("preregister", "--check", tmp_path / "study.registration.json", study).out.splitlines()
    assert [line.split() for line in lines if line.startswith("  Differences")] == [["Differences", "2"]]


@pytest.mark.long
def test_a_factor_that_applies_in_part_of_the_combinations_has_no_treatment_more_and_its_unit(
    robot_runner: Callable[..., Answer], study: Path
) -> None:
    nested = """["Idle", "Video"]), Factor("Width", [720, 1080], unit="px", when={"Task": "Video"})]"""
    study.write_text(CONFIG.replace("""["Idle", "Video"])]""", nested), encoding="utf-8")
    said = robot_runner("preregister", study).out
    assert "Design      Task (Idle, Video) x Width (720, 1080 px; where it applies); 3 repetitions, 9 runs" in said
