"""Every fault in the list is told, each by what it is, and nothing is said where there is none."""

from __future__ import annotations

import pytest
from benchmarks.meter_faults import FAULTS, answer


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.way}: {fault.name}")
def test_a_fault_of_the_meter_is_told_and_a_sound_meter_is_not_doubted(fault, tmp_path):
    assert answer(fault, tmp_path).is_right, answer
