"""Who a writer or reader has found, while others come and go."""

from __future__ import annotations

import pytest

from robot_runner.ros.dds_graph import matched_publications, matched_subscriptions


class Moving:
    """A writer whose readers come between two questions of cyclonedds, so many times."""

    def __init__(self, times):
        self.times = times

    def get_matched_subscriptions(self):
        self.times -= 1
        if self.times >= 0:
            raise IndexError("invalid index")
        return [7]

    get_matched_publications = get_matched_subscriptions


def test_readers_that_come_while_they_are_counted_are_counted_again():
    assert matched_subscriptions(Moving(3)) == [7]
    assert matched_publications(Moving(0)) == [7]


def test_a_fault_that_stays_is_raised():
    with pytest.raises(IndexError):
        matched_subscriptions(Moving(100))
