"""Topics: who hears them and for how long."""

from __future__ import annotations

import pytest

from robot_runner.simulator.sensors import PublishedTopic
from robot_runner.simulator.simulated_clock import SimulatedClock


@pytest.fixture
def clock():
    return SimulatedClock()


@pytest.fixture
def topic(clock):
    return PublishedTopic(clock, "std_msgs/Header", 10, lambda: {"time": clock.now()})


def test_every_listener_hears_every_message(clock, topic):
    one, other = [], []
    topic.listen(one.append)
    topic.listen(other.append)
    clock.sleep(0.3)
    assert one == other
    assert len(one) == 3


def test_who_has_closed_hears_no_more(clock, topic):
    one, other = [], []
    listening = topic.listen(one.append)
    topic.listen(other.append)
    clock.sleep(0.2)
    listening.close()
    listening.close()
    clock.sleep(0.2)
    assert (len(one), len(other)) == (2, 4)


def test_a_listener_may_close_itself_or_another_while_it_is_called(clock, topic):
    heard = []
    first = topic.listen(lambda message: (heard.append("first"), first.close(), second.close()))
    second = topic.listen(lambda message: heard.append("second"))
    clock.sleep(0.5)
    assert heard == ["first"]


def test_a_message_that_nobody_wants_is_not_made_and_what_is_wanted_comes_at_the_same_moments(clock):
    made, heard, wanted = [], [], [False]
    topic = PublishedTopic(clock, "std_msgs/Header", 10, lambda: made.append(clock.now()) or {"time": clock.now()})
    topic.listen(heard.append, lambda: wanted[0])
    clock.sleep(0.25)
    assert made == []
    wanted[0] = True
    clock.sleep(0.2)
    assert [message["time"] for message in heard] == made == [0.3, 0.4]


def test_who_listens_again_hears_at_the_same_moments(clock, topic):
    topic.listen(lambda message: None).close()
    clock.sleep(0.05)
    heard = []
    topic.listen(heard.append)
    clock.sleep(0.15)
    assert [message["time"] for message in heard] == [0.1, 0.2]
