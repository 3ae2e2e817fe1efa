from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import PluginError
from robot_runner.core.events.window import Window
from robot_runner.measuring.series import Series, cut

RAMP = Series([0.0, 1.0, 2.0, 3.0], [0.0, 10.0, 20.0, 30.0])


def test_edges_between_samples_are_interpolated():
    within = cut(RAMP, Window(0.25, 2.5))
    assert list(within.times) == [0.25, 1.0, 2.0, 2.5]
    assert list(within.values) == [2.5, 10.0, 20.0, 25.0]


def test_a_sample_on_an_edge_is_taken_as_it_is():
    assert list(cut(RAMP, Window(1.0, 2.0)).times) == [1.0, 2.0]


def test_a_window_between_two_samples_has_two_interpolated_edges():
    assert list(cut(RAMP, Window(1.2, 1.4)).values) == pytest.approx([12.0, 14.0])


def test_without_reach_nothing_is_made_up_beyond_the_first_and_last_sample():
    assert list(cut(RAMP, Window(-0.1, 3.1)).times) == [0.0, 1.0, 2.0, 3.0]


def test_the_nearest_sample_stands_for_an_edge_within_reach():
    within = cut(RAMP, Window(-0.1, 3.3), reach=0.2)
    assert (within.times[0], within.values[0]) == (-0.1, 0.0)
    assert within.times[-1] == 3.0
    assert list(cut(RAMP, Window(2.5, 3.1), reach=0.2).values) == [25.0, 30.0, 30.0]


def test_no_samples_give_no_edges():
    assert len(cut(Series([], []), Window(0.0, 1.0), reach=9.0)) == 0


@pytest.mark.parametrize(("start", "end"), [(1.0, 0.5), (float("nan"), 1.0), (0.0, float("inf"))])
def test_a_window_that_cannot_be_is_refused(start, end):
    with pytest.raises(PluginError, match="cannot reach"):
        Window(start, end)


@pytest.mark.parametrize(
    ("times", "values", "problem"),
    [([0.0, 1.0], [1.0], "2 times and 1 values"), ([1.0, 0.0], [1.0, 2.0], "not in order")],
)
def test_a_series_that_cannot_be_is_refused(times, values, problem):
    with pytest.raises(PluginError, match=problem):
        Series(times, values)


@given(
    steps=st.lists(st.floats(0.001, 10.0), min_size=2, max_size=30),
    edges=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
    slope=st.floats(-100.0, 100.0),
)
def test_cutting_a_straight_line_leaves_a_straight_line(steps, edges, slope):
    times = [sum(steps[:count]) for count in range(len(steps))]
    start, end = (share * times[-1] for share in sorted(edges))
    within = cut(Series(times, [slope * time for time in times]), Window(start, end))
    assert within.times[0] == start
    assert within.times[-1] == end
    assert list(within.values) == pytest.approx([slope * time for time in within.times], abs=1e-6)
