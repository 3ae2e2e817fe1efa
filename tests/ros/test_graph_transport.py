"""By which time a graph link stamps what it receives."""

from __future__ import annotations

import time

import pytest

from robot_runner.core.events.context import SystemClock
from robot_runner.ros.graph_clock import GraphClock
from robot_runner.ros.graph_transport import is_simulated_time, receive_clock
from robot_runner.ros.missions.joint_missions import SharedClock
from robot_runner.testing import FakeClock, FakeRobotLink


@pytest.mark.parametrize("clock", [SystemClock(), SharedClock(SystemClock())])
def test_messages_are_stamped_with_the_time_of_the_day_also_for_missions_that_share_a_clock(clock):
    assert not is_simulated_time(clock)
    assert abs(receive_clock(clock)() - time.time_ns()) < 60e9


def test_messages_of_a_simulation_are_stamped_with_its_own_time_also_after_it_was_reset():
    link = FakeRobotLink(FakeClock())
    clock = GraphClock(link)
    stamp = receive_clock(SharedClock(clock))
    for seconds in (120, 0, 3):
        link.deliver("/clock", {"clock": {"sec": seconds, "nanosec": 0}})
    assert is_simulated_time(SharedClock(clock))
    assert clock.now() == 123.0
    assert stamp() == 3_000_000_000
