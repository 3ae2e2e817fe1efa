"""The manifest sums up how the clocks of hosts stood."""

from __future__ import annotations

from pathlib import Path

from robot_runner.core.execution.run_facts import ReportedFacts
from robot_runner.core.storage.layout import ExperimentFolder


def note_clock(manifest, reported):
    ReportedFacts(ExperimentFolder(Path("nowhere")), manifest).take("r_1", "clock", reported)


def facts(host, before, after, *, uncertainty=0.001, drift=1e-5):
    def offset(ahead):
        return None if ahead is None else {"wall_offset": ahead, "round_trip": 2 * uncertainty}

    return {
        "host": host,
        "before": offset(before),
        "after": offset(after),
        "uncertainty": uncertainty,
        "drift": None if after is None else drift,
    }


def test_the_manifest_sums_up_the_runs_of_each_host():
    manifest = {}
    note_clock(manifest, facts("pi", 1.0, 1.25))
    note_clock(manifest, facts("pi", 0.5, None, uncertainty=0.01))
    note_clock(manifest, facts("nuc", -3.0, -3.0))
    assert manifest["clocks"]["pi"] == {
        "runs": 2,
        "first_offset_s": 1.0,
        "smallest_offset_s": 0.5,
        "largest_offset_s": 1.25,
        "last_offset_s": 0.5,
        "largest_round_trip_s": 0.02,
        "largest_uncertainty_s": 0.01,
        "last_drift": 1e-5,
    }
    assert manifest["clocks"]["nuc"]["runs"] == 1


def test_a_resumed_experiment_goes_on_with_what_its_manifest_says():
    manifest = {}
    note_clock(manifest, facts("pi", 1.0, 1.0))
    resumed = {"clocks": {"pi": dict(manifest["clocks"]["pi"])}}
    note_clock(resumed, facts("pi", 2.0, 2.0))
    assert (resumed["clocks"]["pi"]["runs"], resumed["clocks"]["pi"]["first_offset_s"]) == (2, 1.0)
