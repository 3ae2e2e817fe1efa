"""The watchdog of the simulated robot and that of real robots decide alike."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from robot_runner_onboard import watchdog as on_board

from robot_runner.core.errors import LinkError
from robot_runner.ros import watchdog as simulated

ROBOT = Path(__file__).parents[2] / "robot"
each_watchdog = pytest.mark.parametrize("watchdog", [simulated.Watchdog, on_board.Watchdog], ids=["simulated", "robot"])


@each_watchdog
def test_who_has_never_been_heard_stops_nobody(watchdog):
    assert not watchdog().must_stop(1e9)


@each_watchdog
def test_silence_stops_the_robot_until_it_is_over(watchdog):
    dog = watchdog(heartbeat_timeout=0.5)
    dog.hear_heartbeat(1, 10.0)
    dog.hear_heartbeat(2, 10.3)
    assert [dog.must_stop(now) for now in (10.4, 10.75, 10.85, 1e9)] == [False, False, True, True]
    dog.hear_heartbeat(3, 20.0)
    assert not dog.must_stop(20.1)


@each_watchdog
def test_after_a_farewell_silence_means_nothing(watchdog):
    dog = watchdog(heartbeat_timeout=0.5)
    dog.hear_heartbeat(7, 10.0)
    dog.hear_heartbeat(0, 10.1)
    assert not dog.must_stop(100.0)


@each_watchdog
def test_a_person_can_take_the_robot_over(watchdog):
    dog = watchdog(heartbeat_timeout=0.5, command_timeout=0.5)
    dog.hear_heartbeat(1, 10.0)
    dog.hear_command(is_moving=True, now=10.0)
    assert dog.must_stop(11.0)
    dog.release()
    assert not dog.must_stop(11.0)
    dog.hear_heartbeat(2, 12.0)
    assert dog.must_stop(13.0)


@each_watchdog
def test_commands_that_cease_while_the_robot_moves_stop_it_where_that_is_asked_for(watchdog):
    dog = watchdog(command_timeout=0.3)
    dog.hear_command(is_moving=True, now=10.0)
    assert [dog.must_stop(now) for now in (10.2, 10.4)] == [False, True]
    dog.hear_command(is_moving=False, now=10.5)
    assert not dog.must_stop(20.0)
    patient = watchdog()
    patient.hear_command(is_moving=True, now=10.0)
    assert not patient.must_stop(100.0)


@each_watchdog
def test_a_time_out_of_nothing_watches_nothing(watchdog):
    dog = watchdog(heartbeat_timeout=0.0)
    dog.hear_heartbeat(1, 10.0)
    assert not dog.must_stop(100.0)


@each_watchdog
def test_a_negative_time_out_is_refused(watchdog):
    with pytest.raises((LinkError, ValueError), match=r"-1"):
        watchdog(heartbeat_timeout=-1.0)


@each_watchdog
def test_the_robot_stands_still_in_well_under_a_second_by_default(watchdog):
    dog = watchdog()
    dog.hear_heartbeat(1, 10.0)
    assert dog.must_stop(10.5)


def test_both_listen_to_the_same_names():
    names = ("HEARTBEAT_TOPIC", "HEARTBEAT_TYPE", "RELEASE_SERVICE")
    assert [getattr(on_board, name) for name in names] == [getattr(simulated, name) for name in names]


@pytest.mark.parametrize("path", sorted(ROBOT.rglob("*.py")), ids=lambda path: path.relative_to(ROBOT).as_posix())
def test_what_runs_on_the_robot_keeps_to_its_python(path):
    ast.parse(path.read_text(encoding="utf-8"), feature_version=(3, 8))
