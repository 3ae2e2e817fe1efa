from __future__ import annotations

import pytest

from robot_runner.core.errors import PluginError
from robot_runner.core.events.window import MissionTimes, Window
from robot_runner.testing import FakeClock


@pytest.fixture
def clock():
    return FakeClock(start=100.0)


@pytest.fixture
def records():
    return []


@pytest.fixture
def times(clock, records):
    return MissionTimes(clock, lambda kind, fields: records.append((kind, fields)))


def test_the_window_is_the_mission_and_is_reported_once(times, clock, records):
    assert times.window() is None
    times.begin()
    clock.sleep(10.0)
    assert times.window() is None
    times.end()
    clock.sleep(5.0)
    times.end()
    assert times.window() == Window(100.0, 110.0)
    assert records == [("window", {"start": 100.0, "end": 110.0})]


def test_it_is_narrowed_by_who_knows_better(times, clock):
    times.begin()
    clock.sleep(1.0)
    times.begin_window()
    clock.sleep(2.0)
    times.end_window()
    clock.sleep(4.0)
    times.end()
    assert times.window() == Window(101.0, 103.0)


@pytest.mark.parametrize(
    ("calls", "is_narrowed"), [([], False), (["begin_window"], True), (["stop"], False), (["end_window"], True)]
)
def test_a_window_is_narrowed_by_a_call_and_not_by_the_end_of_the_mission(times, clock, calls, is_narrowed):
    times.begin()
    clock.sleep(1.0)
    for call in calls:
        getattr(times, call)()
    clock.sleep(1.0)
    times.end()
    assert times.is_narrowed == is_narrowed


def test_phases_are_kept_also_where_they_raise(times, clock, records):
    times.begin()
    with times.phase("navigate"):
        clock.sleep(2.0)
    clock.at(103.0, lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError), times.phase("grasp"):
        clock.sleep(1.0)
    with times.phase("navigate"):
        clock.sleep(3.0)
    times.end()
    assert [(phase.name, phase.window) for phase in times.phases()] == [
        ("navigate", Window(100.0, 102.0)),
        ("grasp", Window(102.0, 103.0)),
        ("navigate", Window(103.0, 106.0)),
    ]
    assert records[0] == ("phase", {"name": "navigate", "start": 100.0, "end": 102.0})


def test_another_clock_stands_for_this_machine_s(times, clock):
    times.begin()
    clock.sleep(1000.0)
    times.end()
    assert times.window(clock) == Window(100.0, 1100.0)
    assert times.window(FakeClock()).duration < 100.0


@pytest.mark.parametrize("name", ["", "two words", "a.b", None])
def test_a_name_that_no_column_could_have_is_refused(times, name):
    times.begin()
    with pytest.raises(PluginError, match="cannot be named"), times.phase(name):
        pass


def test_outside_a_mission_there_is_nothing_to_narrow_and_no_phase(times):
    for act in (times.begin_window, times.end_window, lambda: times.phase("drive").__enter__()):
        with pytest.raises(PluginError, match="no mission going on"):
            act()


def test_a_window_that_has_ended_does_not_begin(times):
    times.begin()
    times.end_window()
    with pytest.raises(PluginError, match="A mission has one window"):
        times.begin_window()


def test_a_window_ends_where_it_was_ended_first(times, clock):
    times.begin()
    clock.sleep(3.0)
    times.end_window()
    clock.sleep(4.0)
    times.end_window()  # as in a `finally`
    times.end()
    assert times.window() == Window(100.0, 103.0)


def test_the_next_mission_begins_with_nothing(times, clock):
    times.begin()
    with times.phase("drive"):
        clock.sleep(1.0)
    times.end_window()
    times.end()
    times.begin()
    clock.sleep(7.0)
    times.end()
    assert times.window() == Window(101.0, 108.0)
    assert times.phases() == ()


def test_readings_at_the_end_hold_up_nobody_after_a_mission_that_failed(times):
    looks = []
    times.at_edges(lambda: looks.append("look"))
    times.begin()
    times.end(has_failed=True)
    assert looks == ["look"]
    assert times.window() is not None


def test_phases_of_one_name_that_overlap_are_one_so_that_nothing_is_counted_twice(times, clock, records):
    times.begin()
    with times.phase("navigate"):
        clock.sleep(1.0)
        with times.phase("dock"), times.phase("navigate"):
            clock.sleep(2.0)
    first, second = times.phase("navigate"), times.phase("navigate")  # as of two robots that go on together
    first.__enter__()
    clock.sleep(1.0)
    second.__enter__()
    first.__exit__(None, None, None)
    clock.sleep(4.0)
    second.__exit__(None, None, None)
    times.end()
    assert [(phase.name, phase.window) for phase in times.phases()] == [
        ("dock", Window(101.0, 103.0)),
        ("navigate", Window(100.0, 103.0)),
        ("navigate", Window(103.0, 108.0)),
    ]
    assert [fields["name"] for kind, fields in records if kind == "phase"] == ["dock", "navigate", "navigate"]


def test_a_phase_that_an_earlier_mission_left_open_is_none_of_the_next(times, clock):
    times.begin()
    left = times.phase("navigate")
    left.__enter__()
    clock.sleep(1.0)
    times.begin()
    clock.sleep(1.0)
    with times.phase("navigate"):
        clock.sleep(1.0)
    assert [phase.window for phase in times.phases()] == [Window(102.0, 103.0)]
