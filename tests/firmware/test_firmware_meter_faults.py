"""Every fault that the virtual board takes is told, each by what it is."""

from __future__ import annotations

import pytest
from benchmarks.meter_faults import answer, board_faults


@pytest.mark.long
def test_each_fault_of_the_board_is_told_and_a_sound_board_is_not_doubted(built, tmp_path):
    answers = {}
    for number, fault in enumerate(board_faults(built)):
        (folder := tmp_path / str(number)).mkdir()
        answers[fault.name] = answer(fault, folder)
    assert {name: one.said for name, one in answers.items() if not one.is_right} == {}
    assert len(answers) >= 11
