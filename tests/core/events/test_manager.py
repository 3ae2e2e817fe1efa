from __future__ import annotations

import os
import sys
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import ConfigError
from robot_runner.core.events.manager import CLOSED_BY, EventManager, OwnerKind, RobotRunnerEvents, _leave_forked

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator

KINDS = {"robot": OwnerKind.SYSTEM, "meter": OwnerKind.PROFILER, "config": OwnerKind.CONFIG}


def manager_with(calls: list[str], owners: list[str], event: RobotRunnerEvents) -> EventManager:
    manager = EventManager()
    for owner in owners:
        manager.subscribe(event, calls.append, owner=owner, kind=KINDS[owner])
    return manager


@given(st.permutations(["robot", "meter", "config"]), st.sampled_from(list(RobotRunnerEvents)))
def test_systems_hear_first_then_profilers_then_the_config_and_closing_events_go_in_reverse(
    owners: list[str], event: RobotRunnerEvents
) -> None:
    calls: list[str] = []
    emission = manager_with(calls, owners, event).emit(event, lambda owner: owner)
    expected = ["robot", "meter", "config"]
    assert calls == (expected[::-1] if event in CLOSED_BY.values() else expected)
    assert list(emission.reached) == calls


def test_several_callbacks_of_one_owner_are_called_in_the_order_of_subscribing() -> None:
    calls: list[str] = []
    manager = EventManager()
    for name in ("first", "second"):
        manager.subscribe(
            RobotRunnerEvents.START_RUN,
            lambda context, name=name: calls.append(name),
            owner="config",
            kind=OwnerKind.CONFIG,
        )
    manager.emit(RobotRunnerEvents.START_RUN, lambda owner: owner)
    assert calls == ["first", "second"]


def test_the_same_callback_subscribed_twice_is_heard_once() -> None:
    class Config:
        heard = 0

        def launch_mission(self, context: object) -> None:
            Config.heard += 1

    config = Config()
    manager = EventManager()
    manager.subscribe(RobotRunnerEvents.LAUNCH_MISSION, config.launch_mission, owner="config", kind=OwnerKind.CONFIG)
    manager.subscribe_methods(config, owner="config", kind=OwnerKind.CONFIG)
    manager.emit(RobotRunnerEvents.LAUNCH_MISSION, lambda owner: owner)
    assert Config.heard == 1


def test_a_callback_may_leave_out_the_context() -> None:
    calls = []
    manager = EventManager()
    manager.subscribe(
        RobotRunnerEvents.BEFORE_RUN, lambda: calls.append("called"), owner="config", kind=OwnerKind.CONFIG
    )
    manager.emit(RobotRunnerEvents.BEFORE_RUN, lambda owner: owner)
    assert calls == ["called"]


def test_the_first_failure_ends_an_opening_event() -> None:
    calls: list[str] = []
    manager = manager_with(calls, ["meter", "config"], RobotRunnerEvents.START_RUN)
    manager.subscribe(RobotRunnerEvents.START_RUN, lambda: 1 / 0, owner="robot", kind=OwnerKind.SYSTEM)
    emission = manager.emit(RobotRunnerEvents.START_RUN, lambda owner: owner)
    assert calls == []
    assert emission.reached == ("robot",)
    assert [failure.owner for failure in emission.failures] == ["robot"]


def test_a_closing_event_reaches_everybody_whatever_fails() -> None:
    calls: list[str] = []
    manager = manager_with(calls, ["robot", "meter"], RobotRunnerEvents.STOP_RUN)
    manager.subscribe(RobotRunnerEvents.STOP_RUN, lambda: sys.exit(3), owner="config", kind=OwnerKind.CONFIG)
    emission = manager.emit(RobotRunnerEvents.STOP_RUN, lambda owner: owner)
    assert calls == ["meter", "robot"]
    assert [type(failure.error) for failure in emission.failures] == [SystemExit]


def test_an_emission_can_be_kept_to_some_owners() -> None:
    calls: list[str] = []
    manager = manager_with(calls, ["robot", "meter", "config"], RobotRunnerEvents.STOP_RUN)
    manager.emit(RobotRunnerEvents.STOP_RUN, lambda owner: owner, but_not={"meter"})
    assert calls == ["config", "robot"]


def test_a_callback_with_too_many_parameters_is_refused_when_subscribed() -> None:
    def start_run(context: object, speed: float) -> None:
        del context, speed

    with pytest.raises(ConfigError) as refused:
        EventManager().subscribe(RobotRunnerEvents.START_RUN, start_run, owner="meter", kind=OwnerKind.PROFILER)
    assert "speed" in refused.value.problem
    assert "test_manager.py:" in refused.value.where
    assert refused.value.fix == "Write def start_run(self, context)."


def test_what_cannot_be_called_is_refused() -> None:
    with pytest.raises(ConfigError, match="cannot be called"):
        EventManager().subscribe(RobotRunnerEvents.START_RUN, "start", owner="config", kind=OwnerKind.CONFIG)  # type: ignore[arg-type]


def test_an_unknown_event_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(ConfigError, match="LAUNCH_MISSION"):
        EventManager().subscribe("LAUNCH_MISION", print, owner="config", kind=OwnerKind.CONFIG)  # type: ignore[arg-type]


def test_what_callbacks_return_comes_back_with_their_owners() -> None:
    manager = EventManager()
    manager.subscribe(RobotRunnerEvents.POPULATE_RUN_DATA, lambda: {"Energy": 1}, owner="config", kind=OwnerKind.CONFIG)
    assert manager.emit(RobotRunnerEvents.POPULATE_RUN_DATA, str).returned == (("config", {"Energy": 1}),)


class _Waiting:
    async def launch_mission(self, context: object) -> None: ...


class _Yielding:
    def launch_mission(self, context: object) -> Iterator[int]:
        yield 1


class _YieldingAsync:
    async def launch_mission(self, context: object) -> AsyncIterator[int]:
        yield 1


@pytest.mark.parametrize("config", [_Waiting(), _Yielding(), _YieldingAsync()], ids=lambda each: type(each).__name__)
def test_a_callback_whose_body_would_never_be_executed_is_refused(config: object) -> None:
    with pytest.raises(ConfigError, match=r"launch_mission is .*: its body would never be executed") as refused:
        EventManager().subscribe_methods(config, owner="config", kind=OwnerKind.CONFIG)
    assert "test_manager.py:" in refused.value.where
    assert refused.value.fix


def test_what_is_named_like_an_event_and_cannot_be_called_is_refused_and_none_is_no_callback() -> None:
    manager = EventManager()
    with pytest.raises(ConfigError, match="LAUNCH_MISSION is 'roslaunch a b', which cannot be called"):
        manager.subscribe_methods(
            SimpleNamespace(launch_mission="roslaunch a b"), owner="config", kind=OwnerKind.CONFIG
        )
    manager.subscribe_methods(SimpleNamespace(launch_mission=None), owner="config", kind=OwnerKind.CONFIG)
    assert manager.subscribers(RobotRunnerEvents.LAUNCH_MISSION) == []


@pytest.mark.parametrize("error", [None, FileNotFoundError("no such program")])
def test_a_process_that_a_callback_forks_does_not_go_on_as_the_experiment(error: Exception | None) -> None:
    children = []

    def fork(context: object) -> None:
        if child := os.fork():
            children.append(child)
        elif error is not None:
            raise error

    manager = EventManager()
    manager.subscribe(RobotRunnerEvents.BEFORE_RUN, fork, owner="config", kind=OwnerKind.CONFIG)
    test = os.getpid()
    try:
        emission = manager.emit(RobotRunnerEvents.BEFORE_RUN, lambda owner: owner)
    finally:
        if os.getpid() != test:
            os._exit(99)  # it came back: no second pytest
    assert not emission.failures
    assert os.waitstatus_to_exitcode(os.waitpid(children[0], 0)[1]) == (0 if error is None else 1)


def test_a_process_that_a_callback_forks_ends_also_where_its_streams_were_taken_away() -> None:
    child = os.fork()
    if child == 0:
        try:
            sys.stdout = None  # type: ignore[assignment]
            _leave_forked([])
        finally:
            os._exit(99)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


async def _coroutine() -> None:
    raise AssertionError


def _generator() -> Iterator[None]:
    yield


async def _async_generator() -> AsyncIterator[None]:
    yield


@pytest.mark.parametrize("made", [_coroutine, _generator, _async_generator])
@pytest.mark.parametrize("event", [RobotRunnerEvents.LAUNCH_MISSION, RobotRunnerEvents.STOP_RUN])
@pytest.mark.filterwarnings("error")
def test_a_callback_whose_decorator_hides_that_its_body_is_never_executed_fails(
    made: Callable[[], object], event: RobotRunnerEvents
) -> None:
    manager = EventManager()
    manager.subscribe(event, lambda: made(), owner="config", kind=OwnerKind.CONFIG)  # noqa: PLW0108 - as a decorator is
    (failure,) = manager.emit(event, lambda owner: owner).failures
    assert isinstance(failure.error, ConfigError)
    assert "its body was never executed" in failure.error.problem
    assert failure.error.where.startswith(f"config, {__file__}:")
