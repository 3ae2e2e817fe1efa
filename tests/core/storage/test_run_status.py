"""The words for how far a run has come."""

from __future__ import annotations

import pytest

from robot_runner.core.storage.cells import RunStatus, status_of_word


@pytest.mark.parametrize("status", list(RunStatus))
def test_each_status_is_known_by_the_word_that_is_written(status: RunStatus) -> None:
    assert status_of_word(status.value) is status


@pytest.mark.parametrize("word", ["", " ", "-", "–", "—", "todo", "TODO", "To do"])  # noqa: RUF001 - dashes are meant
def test_many_words_say_that_a_run_is_to_do(word: str) -> None:
    assert status_of_word(word) is RunStatus.TODO


def test_the_case_of_letters_does_not_matter() -> None:
    assert [status_of_word(word) for word in ("DONE", "done", " Failed ")] == [
        RunStatus.DONE,
        RunStatus.DONE,
        RunStatus.FAILED,
    ]


def test_other_words_say_nothing() -> None:
    assert status_of_word("dnoe") is None
