"""Our conditions keep to the contract, and one that breaks it fails."""

from __future__ import annotations

import threading
from itertools import count

import pytest
from tests.loopback_port import claim_port
from tests.waiting import PATIENCE

from robot_runner import Condition, Look, all_of, battery_above, file_complete, message_on, port_open, text_in
from robot_runner.core.events.context import SystemClock
from robot_runner.testing import ConditionContract, FakeLinks, FakeRobotLink


class TestTextIn(ConditionContract):
    robot = None

    def make_condition(self):
        return text_in("server.txt", "ready")

    def make_it_hold(self, context):
        (context.run_folder / "server.txt").write_text("ready")


class TestFileComplete(ConditionContract):
    robot = None

    def make_condition(self):
        return file_complete("map.pgm", steady_s=0.05)

    def make_it_hold(self, context):
        (context.run_folder / "map.pgm").write_text("P5")


class TestBattery(ConditionContract):
    def make_condition(self):
        return all_of(battery_above(40), message_on("battery_state", "sensor_msgs/BatteryState")).held_for(1.0)

    def make_links(self, clock):
        self.link = FakeRobotLink(clock)
        return FakeLinks(robot=self.link)

    def make_it_hold(self, context):
        context.clock.every(0.1, lambda: self.link.deliver("battery_state", {"percentage": 0.5}))


class TestPort(ConditionContract):
    robot = None

    def make_condition(self):
        self.port = getattr(self, "port", None) or claim_port()
        return port_open(self.port)

    def make_it_hold(self, context):
        import socket

        listener = socket.create_server(("127.0.0.1", self.port))
        closing = type("Closing", (), {"close": staticmethod(listener.close)})
        context.resources.open("listener", lambda: closing)


class Sound(Condition):
    """Keeps to the contract."""

    def __init__(self, folders=()):
        self.folders = folders

    def __str__(self):
        return "the flag is up"

    def watch(self, context, opened):
        del opened
        return lambda: Look((context.run_path / "flag").exists(), "no flag")


class Speechless(Sound):
    def __str__(self):
        return ""


class Rash(Sound):
    def watch(self, context, opened):
        return lambda: Look(holds=True)


class Shared(Sound):
    looks = 0

    def watch(self, context, opened):
        self.looks += 1
        return super().watch(context, opened)


class Leaking(Sound):
    release = threading.Event()

    def watch(self, context, opened):
        threading.Thread(target=self.release.wait, name="left behind").start()
        return super().watch(context, opened)


class Fixless(Sound):
    def check(self, robot):
        from robot_runner.core.errors import Finding

        return [Finding.error("flag", "there is none", "")] if robot is None else []


class Blind(Sound):
    def watch(self, context, opened):
        return lambda: False


BREACHES = [
    (Speechless, "test_it_says_what_is_to_hold_in_one_line", "write __str__"),
    (Rash, "test_it_holds_once_what_it_asks_for_is_there", "before it was made to"),
    (Rash, "test_a_wait_in_vain_tells_what_was_awaited", "although nothing made it hold"),
    (Shared, "test_two_watches_know_nothing_of_each_other", "watching changed the condition"),
    (Leaking, "test_what_was_opened_is_closed", "left behind"),
    (Fixless, "test_its_check_speaks_in_findings", "offers no fix"),
    (Blind, "test_it_holds_once_what_it_asks_for_is_there", "which is not a Look"),
]


def contract_of(kind):
    class Contract(ConditionContract):
        robot = None if kind is not Fixless else "simulated"

        def make_condition(self):
            return kind()

        def make_it_hold(self, context):
            (context.run_folder / "flag").touch()

    return Contract()


@pytest.mark.parametrize(("kind", "fact", "said"), BREACHES)
def test_a_condition_that_breaks_the_contract_fails(tmp_path, monkeypatch, kind, fact, said) -> None:
    monkeypatch.setattr("robot_runner.testing.condition_contract._SOON", 0.3)
    Leaking.release.clear()
    check = getattr(contract_of(kind), fact)
    arguments = {"tmp_path": tmp_path} if "tmp_path" in check.__code__.co_varnames else {}
    try:
        with pytest.raises(AssertionError, match=said):
            check(**arguments)
        getattr(contract_of(Sound), fact)(**arguments)
    finally:
        Leaking.release.set()


def test_a_condition_may_be_awaited_on_the_clock_of_the_machine(tmp_path) -> None:
    from robot_runner.testing import make_context

    class Third(Sound):
        def watch(self, context, opened):
            looks = count(1)
            return lambda: Look(next(looks) == 3)

    assert Third().wait(make_context(tmp_path, clock=SystemClock(), robot=None), timeout_s=PATIENCE).holds


@pytest.mark.parametrize("method", ["make_condition", "make_it_hold"])
def test_what_the_author_has_to_write_is_named(tmp_path, method):
    class TestNothing(ConditionContract):
        robot = None
        make_condition = ConditionContract.make_condition if method == "make_condition" else TestTextIn.make_condition

    with pytest.raises(NotImplementedError, match=f"write {method}"):
        TestNothing().test_it_holds_once_what_it_asks_for_is_there(tmp_path)
