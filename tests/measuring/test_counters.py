from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.measuring.cpu_counters import CoreCounters, CounterSample, ProcessCounters, utilisation_of
from robot_runner.measuring.device_clock import ClockMap


def sample(time, total, idle, *, cores=(), processes=(), memory=(1000.0, 750.0)):
    return CounterSample(time, CoreCounters(total, idle), cores, *memory, processes)


def process(pid, cpu, *, started="5", memory=100.0, selector=0, parent=1, children=0.0):
    return ProcessCounters(selector, pid, started, cpu, memory, parent, children)


def test_utilisation_is_what_was_busy_since_the_look_before():
    found = utilisation_of([sample(0, 0, 0), sample(1, 100, 80), sample(2, 200, 80)], cores=1)
    assert [one.cpu for one in found] == [None, pytest.approx(20.0), 100.0]
    assert [one.memory for one in found] == [25.0, 25.0, 25.0]


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 50)), min_size=1, max_size=30))
def test_utilisation_stays_between_0_and_100_and_adds_up_to_the_whole(steps):
    total = idle = 0
    samples = [sample(0.0, 0, 0)]
    for place, (busy, idled) in enumerate(steps, start=1):
        total, idle = total + busy + idled, idle + idled
        samples.append(sample(float(place), total, idle))
    told = [(one.cpu, one.time) for one in utilisation_of(samples, cores=1) if one.cpu is not None]
    assert all(0.0 <= cpu <= 100.0 for cpu, _ in told)
    if total:
        ticks = [late.whole.total - soon.whole.total for soon, late in pairwise(samples)]
        moved = [count for count in ticks if count]
        weighted = sum(cpu * count for (cpu, _), count in zip(told, moved, strict=True)) / total
        assert weighted == pytest.approx(100.0 * (total - idle) / total)


def test_a_counter_that_did_not_move_leaves_its_time_to_the_next_look():
    found = utilisation_of([sample(0, 0, 0), sample(1, 0, 0), sample(2, 20, 10)], cores=1)
    assert [one.cpu for one in found] == [None, None, 50.0]


def test_a_counter_that_goes_back_is_not_below_nothing():
    assert utilisation_of([sample(0, 0, 0), sample(1, 10, 12)], cores=1)[1].cpu == 0.0


def test_each_core_is_told_by_itself():
    before = sample(0, 0, 0, cores=(CoreCounters(0, 0), CoreCounters(0, 0)))
    after = sample(1, 200, 100, cores=(CoreCounters(100, 100), CoreCounters(100, 0)))
    assert utilisation_of([before, after], cores=2)[1].cores == (0.0, 100.0)


def test_a_core_that_is_switched_on_tells_from_its_second_look_on():
    # Its counters go on from where they stood when it was switched off, as Linux keeps them.
    looks = [
        sample(0, 1000, 500, cores=(CoreCounters(1000, 500), None)),
        sample(1, 1100, 600, cores=(CoreCounters(1100, 600), CoreCounters(90_000, 10_000))),
        sample(2, 1300, 700, cores=(CoreCounters(1200, 700), CoreCounters(90_100, 10_025))),
    ]
    assert [one.cores for one in utilisation_of(looks, cores=2)] == [(None, None), (0.0, None), (0.0, 75.0)]


def test_counters_of_all_cores_that_fall_cost_one_look_only():
    looks = [sample(0, 90_000, 10_000), sample(1, 1000, 500), sample(2, 1100, 550)]
    assert [one.cpu for one in utilisation_of(looks, cores=1)] == [None, None, 50.0]


def test_a_process_counts_by_its_share_of_all_cores():
    looks = [
        sample(0.0, 0, 0, processes=(process(7, 50.0),)),
        sample(1.0, 400, 300, processes=(process(7, 51.0),)),
    ]
    (told,) = utilisation_of(looks, cores=4, selectors=1)[1].processes
    assert (told.count, told.cpu, told.memory) == (1, 25.0, 10.0)


def test_processes_that_come_and_go_are_added_up():
    looks = [
        sample(0.0, 0, 0, processes=(process(7, 50.0),)),
        sample(1.0, 100, 0, processes=(process(7, 50.5), process(8, 0.25, started="9"))),
        sample(2.0, 200, 0, processes=(process(8, 0.5, started="9"),)),
        sample(3.0, 300, 0, processes=(process(8, 0.75, started="11"),)),  # another one with the same number
    ]
    told = [one.processes[0] for one in utilisation_of(looks, cores=1, selectors=1)]
    assert [one.cpu for one in told] == [None, pytest.approx(75.0), pytest.approx(25.0), pytest.approx(75.0)]
    assert [one.count for one in told] == [1, 2, 1, 1]


def test_what_a_new_process_computed_before_it_was_found_is_not_lost():
    looks = [sample(0.0, 0, 0), sample(1.0, 100, 0), sample(1.1, 110, 0, processes=(process(7, 0.9),))]
    told = [one.processes[0].cpu for one in utilisation_of(looks, cores=1, selectors=1)]
    assert (told[1] * 1.0 + told[2] * 0.1) / 1.1 == pytest.approx(100.0 * 0.9 / 1.1)


def shares(*looks):
    samples = [sample(float(at), 100 * at, 0, processes=processes) for at, processes in enumerate(looks)]
    return [pytest.approx(one.processes[0].cpu) for one in utilisation_of(samples, cores=1, selectors=1)[1:]]


def test_a_child_that_nobody_saw_counts_when_it_is_reaped_and_one_that_was_seen_counts_once():
    parent, child = process(7, 1.0, children=4.0), process(8, 0.5, parent=7)
    # The first child came and went; of the second, 0.5 s were seen, and it used another 0.25 s.
    looks = [(parent,), (process(7, 1.0, children=4.3), child), (process(7, 1.0, children=5.05),)]
    assert shares(*looks) == [80.0, 25.0]


def test_children_that_ended_with_their_parent_count_once_for_who_reaped_it():
    looks = [
        (process(7, 1.0), process(8, 0.5, parent=7), process(9, 20.0, parent=8)),
        (process(7, 1.0, children=20.75),),
    ]
    assert shares(*looks) == [25.0]


def test_a_child_that_is_reaped_between_the_looks_at_its_parent_and_at_itself_counts_once():
    looks = [(process(7, 1.0), process(8, 50.0, parent=7)), (process(7, 1.0),), (process(7, 1.0, children=50.5),)]
    assert shares(*looks) == [0.0, 50.0]


def test_a_child_that_somebody_else_reaped_takes_nothing_from_later_ones():
    seen = (process(7, 1.0), process(8, 50.0, parent=7))
    looks = [seen, (process(7, 1.0),), (process(7, 1.0),), (process(7, 1.0, children=0.5),)]
    assert shares(*looks) == [0.0, 0.0, 50.0]


def endings(*looks):
    samples = [sample(float(at), 100 * at, 0, processes=processes) for at, processes in enumerate(looks)]
    found = [one.processes[0] for one in utilisation_of(samples, cores=1, selectors=1)]
    return [(one.ended, one.reaped, one.brief) for one in found]


def test_parents_that_have_ended_are_told_as_children_of_theirs_may_have_ended_unseen():
    looks = [(process(7, 1.0, children=0.5), process(8, 0.1)), ()]
    samples = [sample(float(at), 100 * at, 0, processes=processes) for at, processes in enumerate(looks)]
    assert [one.processes[0].parents for one in utilisation_of(samples, cores=1, selectors=1)] == [0, 1]


def test_processes_that_have_ended_are_told_and_whether_they_lasted_for_less_than_two_seconds():
    old, new, nothing = process(7, 1.0), process(8, 0.5), (0, 0, 0)
    assert endings((old,), (old, new), (old,), ()) == [nothing, nothing, (1, 0, 1), (1, 0, 0)]
    assert endings((), (new,), (new,), (new,), ()) == [nothing, nothing, nothing, nothing, (1, 0, 0)]
    assert endings((), (new,), (process(8, 0.1, started="9"),)) == [nothing, nothing, (1, 0, 1)]


def test_processes_that_others_have_reaped_are_told_apart():
    looks = [(process(7, 1.0), process(8, 0.5, parent=7), process(9, 20.0, parent=8)), (process(7, 1.0),)]
    assert endings(*looks) == [(0, 0, 0), (2, 2, 0)]


def test_samples_are_placed_on_the_runs_clock_and_keep_their_own():
    (only,) = utilisation_of([sample(500.0, 0, 0)], cores=1, to_run=ClockMap(-490.0))
    assert (only.time, only.host_time) == (10.0, 500.0)


def test_a_computer_that_does_not_tell_its_memory_has_none():
    (only,) = utilisation_of([sample(0.0, 0, 0, memory=(0.0, 0.0))], cores=1)
    assert only.memory is None


def test_the_last_core_that_is_switched_off_leaves_the_others_alone():
    first, second = CoreCounters(0, 0), CoreCounters(10, 5)
    found = utilisation_of([sample(0, 0, 0, cores=(first, first)), sample(1, 10, 5, cores=(second,))], cores=2)
    assert found[1].cores == (50.0,)
