from __future__ import annotations

import pytest

from robot_runner.core.errors import ConfigError
from robot_runner.core.events.manager import EventSubscriptionController, RobotRunnerEvents, recorded_subscriptions


def test_subscriptions_are_recorded_while_a_config_is_loaded() -> None:
    subscriptions = [(RobotRunnerEvents.LAUNCH_MISSION, print), (RobotRunnerEvents.STOP_RUN, repr)]
    with recorded_subscriptions() as requests:
        EventSubscriptionController.subscribe_to_multiple_events(subscriptions)
    assert requests == subscriptions


def test_subscribing_at_another_time_is_refused_and_says_when_to() -> None:
    with pytest.raises(ConfigError) as refused:
        EventSubscriptionController.subscribe_to_single_event(RobotRunnerEvents.START_RUN, print)
    assert "__init__" in refused.value.fix


def test_a_recording_ends_with_the_loading() -> None:
    with recorded_subscriptions():
        pass
    with pytest.raises(ConfigError):
        EventSubscriptionController.subscribe_to_single_event(RobotRunnerEvents.START_RUN, print)


def test_what_is_no_pair_is_refused_with_an_example() -> None:
    with recorded_subscriptions(), pytest.raises(ConfigError, match="not a pair") as refused:
        EventSubscriptionController.subscribe_to_multiple_events([RobotRunnerEvents.START_RUN])  # type: ignore[list-item]
    assert "RobotRunnerEvents.LAUNCH_MISSION" in refused.value.fix


def test_a_bad_signature_is_refused_at_once() -> None:
    with recorded_subscriptions() as requests, pytest.raises(ConfigError, match="cannot be called with a context"):
        EventSubscriptionController.subscribe_to_single_event(RobotRunnerEvents.START_RUN, lambda a, b: None)
    assert requests == []
