"""`robot-runner compare` says whether two experiments are equivalent."""

from __future__ import annotations

import pytest
from tests.analysis.experiment_folders import two_tasks

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
