"""Which runs of two experiments belong together; where that is not known, none are paired."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis.comparison.comparing import compare
from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import AnalysisError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

TASK, SPEED = Factor("Task", ["Video", "Network"]), Factor("Speed", ["low", "high"])


def made(folder: Path, factors: list[Factor], values: Sequence[float] = (10.0, 10.4, 11.1)) -> Path:
    return make_experiment(
        folder,
        factors,
        lambda of, repetition: {"Energy": values[repetition - 1] + 3.0 * (of.get("Speed") == "high")},
        repetitions=len(values),
    ).root


@pytest.mark.parametrize("is_turned", [False, True])
def test_several_runs_of_one_repetition_are_not_paired(tmp_path: Path, *, is_turned: bool) -> None:
    folders = [made(tmp_path / "two", [TASK, SPEED]), made(tmp_path / "one", [TASK])]
    with pytest.raises(AnalysisError, match="several runs of one repetition") as refused:
        compare(*(folders[::-1] if is_turned else folders), is_paired=True)
    assert "without --paired" in refused.value.fix
    assert compare(*folders).measure("Energy").differences[0].first_n == 6


def test_a_bound_in_percent_of_a_mean_of_0_is_said_to_be_none(tmp_path: Path) -> None:
    folders = [made(tmp_path / "zero", [TASK], (-1.0, 0.0, 1.0)), made(tmp_path / "other", [TASK], (-1.0, 0.0, 1.1))]
    found = compare(*folders, bound="5%").measure("Energy")
    assert "which is 0 for Video, Network" in found.conclusion
    assert "The largest difference is 0.03333 (Video)." in found.conclusion
    assert [each.what for each in found.not_computed] == ["equivalence of Video", "equivalence of Network"]


def test_a_treatment_that_is_written_as_a_fraction_beside_others_is_the_same_one(tmp_path: Path) -> None:
    original = made(tmp_path / "original", [Factor("Speed", [1, 2])])
    replication = made(tmp_path / "replication", [Factor("Speed", [0.5, 1, 2])])
    found = compare(original, replication)
    assert [each.label for each in found.measure("Energy").differences] == ["1", "2"]
    assert found.notes == ("Only replication has 0.5.",)


def test_a_number_is_the_same_treatment_where_the_other_experiment_has_a_word_beside_it(tmp_path: Path) -> None:
    original = made(tmp_path / "original", [Factor("Speed", [0.1, 0.5, 1.0])])
    replication = made(tmp_path / "replication", [Factor("Speed", [0.1, 0.5, 1, "auto"])])
    for folders in ((original, replication), (replication, original)):
        found = compare(*folders)
        assert [each.label for each in found.measure("Energy").differences][:2] == ["0.1", "0.5"]
        assert len(found.measure("Energy").differences) == 3
        assert found.notes == ("Only replication has auto.",)


def test_texts_that_are_written_otherwise_are_other_treatments(tmp_path: Path) -> None:
    original = made(tmp_path / "original", [Factor("Version", ["1", "1.0", "1.1", "dev"])])
    replication = made(tmp_path / "replication", [Factor("Version", ["1.0", "1.10", "dev"])])
    found = compare(original, replication)
    assert [each.label for each in found.measure("Energy").differences] == ["1.0", "dev"]
    assert found.notes == ("Only original has 1, 1.1.", "Only replication has 1.10.")
