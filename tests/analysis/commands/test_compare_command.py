"""`robot-runner compare` says whether two experiments are equivalent."""

from __future__ import annotations

import shutil

import pytest
from tests.analysis.comparison.combined_agreement import disagreements_of_combined
from tests.analysis.experiment_folders import Folder, two_tasks

VIDEO = (870.1, 872.4, 869.0, 874.2, 871.3)
NETWORK = (834.0, 836.1, 833.2, 838.0, 835.5)


@pytest.fixture
def experiments(tmp_path):
    two_tasks(tmp_path / "original", VIDEO, NETWORK, name="original")
    two_tasks(tmp_path / "replica", tuple(value + 0.5 for value in VIDEO), NETWORK, name="replica", origin="simulated")
    two_tasks(tmp_path / "other", tuple(value + 40 for value in VIDEO), NETWORK, name="other")


@pytest.mark.usefixtures("experiments")
class TestCompare:
    def test_equivalence_is_told_with_its_numbers(self, robot_runner):
        answer = robot_runner("compare", "original", "replica", "--bound", "1%")
        assert answer.code == 0
        assert "Energy (J)  equivalent" in answer.out
        assert "measured; simulated" in answer.out
        assert "relative error" in answer.out
        assert "Video" in answer.out

    def test_a_difference_is_no_failure(self, robot_runner):
        answer = robot_runner("compare", "original", "other", "--bound", "1%")
        assert answer.code == 0
        assert "Energy (J)  different" in answer.out
        assert "Different for Video" in answer.out

    def test_a_copy_is_told_to_prove_nothing(self, robot_runner, tmp_path):
        shutil.copytree(tmp_path / "original", tmp_path / "moved")
        answer = robot_runner("compare", "original", "moved", "--bound", "1%")
        assert answer.code == 0
        assert "moved is original again" in answer.out
        assert "proves nothing" in answer.out

    def test_long_names_that_differ_at_their_end_are_told_apart(self, robot_runner, tmp_path):
        floors = {"Task": ["planner with a long recovery, on carpet", "planner with a long recovery, on tiles"]}
        rows = [(floors["Task"][place % 2], value) for place, value in enumerate(VIDEO)]
        names = [f"energy_of_long_missions_in_the_lab_of_{each}" for each in ("ada", "bob")]
        for name, day in zip(names, ("2026-01-30", "2026-01-31"), strict=True):
            Folder(tmp_path / name, floors, rows, {"Energy": "J"}, name=name, day=day).write()
        answer = robot_runner("compare", *names)
        lines = answer.out.splitlines()
        (heading,) = (line for line in lines if "Verdict" in line)
        assert all(name in heading for name in names)
        assert all(any(line.startswith(f"  {floor}  ") for line in lines) for floor in floors["Task"])

    def test_without_a_bound_it_asks_for_one(self, robot_runner):
        answer = robot_runner("compare", "original", "replica")
        assert "undecided" in answer.out
        assert "--bound 5%" in answer.out

    def test_json_is_all_that_is_printed(self, robot_runner):
        facts = robot_runner("compare", "original", "replica", "--bound", "Energy=10", "--json").json
        assert facts["verdict"] == "equivalent"
        assert facts["measures"][0]["bound"] == {"value": 10.0, "is_relative": False}

    def test_a_page_is_written_beside_what_is_printed(self, robot_runner, tmp_path):
        answer = robot_runner("compare", "original", "replica", "--html", "page.html", "--measure", "Energy")
        assert "page.html" in answer.out
        assert "<h1>original and replica</h1>" in (tmp_path / "page.html").read_text(encoding="utf-8")

    def test_a_page_is_written_over_no_file_that_is_none(self, robot_runner, tmp_path):
        table = tmp_path / "original" / "run_table.csv"
        before = table.read_bytes()
        answer = robot_runner("compare", "original", "replica", "--html", "original/run_table.csv")
        assert (answer.code, table.read_bytes()) == (2, before)
        assert "the file is no page, and would be lost" in answer.err
        (tmp_path / "page.HTML").write_text("an earlier page")
        assert robot_runner("compare", "original", "replica", "--html", "page.HTML").code == 0

    def test_pairs_are_made_when_asked_for(self, robot_runner):
        facts = robot_runner("compare", "original", "replica", "--paired", "--alpha", "0.1", "--json").json
        assert facts["is_paired"] is True
        assert facts["alpha"] == 0.1

    @pytest.mark.parametrize(
        ("words", "problem", "fix"),
        [
            (["original", "replica", "--bound", "five"], "'five'", "--bound 5%"),
            (["original", "replica", "--measure", "Enery"], "'Enery'", "'Energy'"),
            (["original", "replic"], "no such file or folder", "'replica'"),
            (["original", "replica", "--alpha", "0.7"], "alpha is 0.7", "between 0 and 0.5"),
            (["original"], "SECOND is missing", "compare --help"),
        ],
    )
    def test_what_cannot_be_is_refused_with_a_way_out(self, robot_runner, words, problem, fix):
        answer = robot_runner("compare", *words)
        assert answer.code == 2
        assert problem in answer.err
        assert fix in answer.err

    def test_a_region_of_practical_equivalence_is_told_with_probabilities(self, robot_runner):
        answer = robot_runner("compare", "original", "replica", "--rope", "5 J")
        assert "P, within" in answer.out
        assert "With the reference prior, the probability that the difference is within 5.000 J is" in answer.out

    def test_names_may_be_joined_in_a_meta_analysis_only(self, robot_runner):
        answer = robot_runner("compare", "original", "replica", "--same", "Task=Job")
        assert answer.code == 2
        assert "--same" in answer.err
        assert "Add --meta" in answer.err


@pytest.fixture
def replications(tmp_path):
    for place, shift in enumerate((0.0, 0.37, -0.61)):
        video = tuple(value + shift * (-1) ** run for run, value in enumerate(VIDEO))
        name = f"lab_{'abc'[place]}"
        two_tasks(tmp_path / name, video, NETWORK, name=name, day=f"2026-02-0{place + 1}")


@pytest.mark.usefixtures("replications")
class TestMetaAnalysis:
    def test_three_experiments_are_combined(self, robot_runner):
        answer = robot_runner("compare", "lab_a", "lab_b", "lab_c")
        assert answer.code == 0
        for told in ("3 experiments combined: lab_a, lab_b, lab_c", "Video less Network", "Average (random effects)"):
            assert told in answer.out
        assert "the Energy of Video is higher than that of Network on average" in answer.out

    def test_two_are_combined_when_asked_for(self, robot_runner):
        facts = robot_runner("compare", "lab_a", "lab_b", "--meta", "--json").json
        assert facts["measures"][0]["effects"][0]["difference"]["prediction"] is None
        assert disagreements_of_combined(facts) == []

    def test_json_is_all_that_is_printed_and_agrees_with_itself(self, robot_runner):
        facts = robot_runner("compare", "lab_a", "lab_b", "lab_c", "--json", "--alpha", "0.1").json
        assert facts["alpha"] == 0.1
        assert [each["name"] for each in facts["experiments"]] == ["lab_a", "lab_b", "lab_c"]
        assert disagreements_of_combined(facts) == []

    @pytest.mark.long
    @pytest.mark.parametrize(
        ("words", "name"), [([], "difference_Energy"), (["--meta"], "forest_Energy_Video_less_Network")]
    )
    def test_figures_and_tables_are_files_where_asked_for(self, robot_runner, tmp_path, words, name):
        answer = robot_runner("compare", "lab_a", "lab_b", "--files", "paper", *words)
        assert "Files  paper" in answer.out
        assert {f"{name}.{kind}" for kind in ("svg", "pdf", "png")} <= {
            each.name for each in (tmp_path / "paper" / "figures").iterdir()
        }
        tables = [each.suffix for each in (tmp_path / "paper" / "tables").iterdir()]
        assert tables.count(".csv") == tables.count(".tex") > 1

    @pytest.mark.long
    def test_a_page_with_forest_plots_is_written(self, robot_runner, tmp_path):
        answer = robot_runner("compare", "lab_a", "lab_b", "lab_c", "--html", "combined.html")
        assert "combined.html" in answer.out
        page = (tmp_path / "combined.html").read_text(encoding="utf-8")
        assert "<h1>lab_a, lab_b and lab_c</h1>" in page
        assert "Forest plot of Video less Network" in page

    @pytest.mark.long
    def test_results_of_another_tool_are_combined_with_ours(self, robot_runner, tmp_path):
        for name, shift in (("theirs", 0.11), ("again", 0.11), ("third", 0.53)):
            (tmp_path / name).mkdir()
            rows = [f"Video,{value + place * shift}" for place, value in enumerate(VIDEO)]
            rows += [f"Network,{value - place * shift}" for place, value in enumerate(NETWORK)]
            lines = ["__run_id,job,energy_J", *(f"run_{place},{row}" for place, row in enumerate(rows))]
            (tmp_path / name / "run_table.csv").write_text("\n".join(lines) + "\n")
            assert robot_runner("import", name, "--to", f"{name}_imported", "--yes").code == 0
        joined = ["--measure", "Energy=energy_J", "--same", "Task=job", "--json"]
        facts = robot_runner("compare", "lab_a", "theirs_imported", "third_imported", *joined).json
        (effect,) = facts["measures"][0]["effects"]
        assert [each["experiment"] for each in effect["experiments"]] == ["lab_a", "theirs", "third"]
        assert facts["findings"] == []
        assert disagreements_of_combined(facts) == []
        answer = robot_runner("compare", "lab_a", "theirs_imported", "again_imported", *joined)
        assert "this is theirs again: every value is the same to the last digit" in answer.err

    @pytest.mark.parametrize(
        ("words", "told"),
        [
            (
                ["lab_b", "lab_c", "--bound", "5%", "--paired"],
                ["--bound: this option is not for", "--paired", "2 errors"],
            ),
            (["lab_d", "lab_e"], ["lab_d: there is no such file", "lab_e: there is no such file"]),
            (["lab_b", "lab_a"], ["this is", "same folder", "count twice"]),
            (["lab_b", "lab_c", "--measure", "Enery"], ["'Enery'", "'Energy'"]),
            (["lab_b", "lab_c", "--same", "Task=Jobs"], ["'Jobs'", "Choose one of"]),
        ],
    )
    def test_what_cannot_be_is_refused_with_a_way_out(self, robot_runner, words, told):
        answer = robot_runner("compare", "lab_a", *words)
        assert answer.code == 2
        for each in told:
            assert each in answer.err
