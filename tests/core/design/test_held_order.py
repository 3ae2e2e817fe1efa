from __future__ import annotations

from robot_runner.core.design.design import HeldOrder

HELD = HeldOrder(one_by_one="Robot", rest_between="Period", rest_in_s=60.0)


def test_what_a_design_says_in_its_facts_is_what_is_held() -> None:
    assert HeldOrder.of_facts({"held_order": HELD.as_mapping()}) == HELD
    assert HeldOrder.of_facts({"kind": "full_factorial"}).is_open
    assert not HELD.is_open


def test_runs_of_one_unit_wait_for_each_other_and_whole_plots_for_all_before() -> None:
    assert HELD.waits_for({"Robot": "A", "Period": 2}, {"Robot": "A", "Period": 1})
    assert not HELD.waits_for({"Robot": "B", "Period": 1}, {"Robot": "A", "Period": 1})
    plots = HeldOrder(one_after_another="Plot")
    assert plots.waits_for({"Plot": 2}, {"Plot": 1})
    assert not plots.waits_for({"Plot": 1}, {"Plot": 1})


def test_a_unit_rests_between_its_periods_and_at_no_other_time() -> None:
    first, second = {"Robot": "A", "Period": 1}, {"Robot": "A", "Period": 2}
    assert HELD.rest_before(first, None) == 0.0, "it has had no run"
    assert HELD.rest_before(first, first) == 0.0
    assert HELD.rest_before(second, first) == HELD.rest_before(first, second) == 60.0
    assert HELD.rest_before(second, {"Robot": "A", "Period": "2"}) == 0.0, "as the journal has it"
    assert HeldOrder(one_by_one="Robot").rest_before(second, first) == 0.0
