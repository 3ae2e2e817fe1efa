"""The fault table names tests that exist, and every test of a fault stands in it."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
NAMED = set(re.findall(r"`(test_\w+)`", (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")))


def names_of_tests_in(*folders: str) -> set[str]:
    files = [path for folder in folders for path in (ROOT / "tests" / folder).rglob("test_*.py")]
    return {name for path in files for name in re.findall(r"^def (test_\w+)", path.read_text("utf-8"), re.MULTILINE)}


def test_every_test_that_the_table_names_exists() -> None:
    folders = (
        "process",
        "cli",
        "core/execution",
        "core/config",
        "core/links",
        "subjects",
        "cluster",
        "ros",
        "analysis",
    )
    assert NAMED - names_of_tests_in(*folders) == set()


def test_every_injected_fault_stands_in_the_table() -> None:
    told_elsewhere = {
        "test_a_folder_that_may_not_be_written_is_refused_before_anything_is_executed",
        "test_the_experiment_of_the_paper_is_executed_on_a_real_graph",
        "test_the_mission_of_the_paper_is_driven_and_measured_over_fast_dds",
        "test_two_robots_of_one_graph_take_turns_and_each_drives_its_own_runs",
        "test_both_implementations_hear_the_same_bag_and_latency_and_cpu_are_measured",
        "test_both_planners_arrive_and_success_and_path_length_are_measured",
        "test_each_run_begins_where_the_first_did_and_the_simulator_is_left_going_on",
        "test_an_experiment_lives_by_the_time_of_a_graph_that_goes_by_faster",
        "test_the_number_of_an_experiment_that_was_dropped_is_given_to_no_other",
        "test_what_is_added_is_told_to_a_program_and_what_is_to_be_dropped_is_named",
        "test_a_forked_run_imports_nothing_and_touches_few_pages",
    }
    assert names_of_tests_in("process") - told_elsewhere - NAMED == set()
