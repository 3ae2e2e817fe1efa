"""Who makes safe late does so with the treatments of its own run, and stops the robot wherever it was commanded."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.core.execution.lamp import HEAD, TABLE, made_safe
from tests.waiting import wait_until

import robot_runner.core.execution.standby as standby_module
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import LinkError
from robot_runner.core.events.resources import Resources
from robot_runner.core.execution import run_events, standby_lock, systems_state
from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.core.execution.progress_manager import ProgressManager
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.execution.run_events import execute_run, made_safe_of_their_own
from robot_runner.core.execution.standby import Standby
from robot_runner.core.execution.systems_state import Care, SystemsState
from robot_runner.core.links import commanded_topics, connect
from robot_runner.core.links.commanded_topics import Commanded
from robot_runner.core.links.kinds import link_key
from robot_runner.core.links.robot import GraphEndpoint, Qos
from robot_runner.core.storage.lock_files import open_to_lock
from robot_runner.core.treatments import bind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from robot_runner.core.config.experiment import Experiment


class Told:
    """A robot that writes down what it is told, and is reached once it was told so many times."""

    def __init__(self, folder: Path, is_reached_after: float = 0) -> None:
        self._told = folder / "told"
        self._told.touch()
        self._is_reached_after = is_reached_after

    def publish(self, topic: str, message_type: str, message: object) -> None:
        with self._told.open("a", encoding="utf-8") as file:
            heard = "" if self._is_reached else " and is not heard"
            file.write(f"{topic} {message_type} {message}{heard}\n")

    def advertise(self, topic: str, message_type: str, *, qos: Qos) -> bool:
        return self._is_reached

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        return [GraphEndpoint("/base", "geometry_msgs/Twist")]

    @property
    def _is_reached(self) -> bool:
        return len(self._told.read_text(encoding="utf-8").splitlines()) >= self._is_reached_after


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_a_robot_is_told_to_stand_still_again_and_again_as_it_may_not_be_discovered_at_first(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    folder = experiment.config_path.parent
    monkeypatch.setattr(standby_module, "connect_robot", lambda _context: Told(folder))
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.5)
    with after_death(experiment, ("/alice/cmd_vel", "geometry_msgs/Twist"), ("/bob/cmd_vel", "geometry_msgs/Twist")):
        told = (folder / "told").read_text(encoding="utf-8").splitlines()
    # The last one first, as a run closes what it opened; and once more at least, however busy the machine is.
    assert sorted(told[:2]) == ["/alice/cmd_vel geometry_msgs/Twist {}", "/bob/cmd_vel geometry_msgs/Twist {}"]
    assert len(told) > 2
    assert set(told) == set(told[:2])


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_a_robot_is_told_so_again_and_again_also_where_a_system_cannot_be_made_safe(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    torn = HEAD.replace('(HERE / "made_safe").write_text', 'raise OSError("the cable is torn")\n        print')
    experiment = prepare_or_refuse(write_config("", head=torn, table=TABLE))
    folder = experiment.config_path.parent
    monkeypatch.setattr(standby_module, "connect_robot", lambda _context: Told(folder))
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.5)
    with after_death(experiment, ("/alice/cmd_vel", "geometry_msgs/Twist"), care=Care.OUT_OF_REACH):
        told = (folder / "told").read_text(encoding="utf-8").splitlines()
    assert len(told) > 2, "it is tried twice, and once each time without saying so again"


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
@pytest.mark.parametrize(("late", "care"), [(5, Care.MADE_SAFE), (math.inf, Care.OUT_OF_REACH)])
def test_a_robot_is_told_until_it_is_reached_and_one_that_never_is_may_be_moving(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, late: float, care: Care
) -> None:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    robot = Told(folder := experiment.config_path.parent, is_reached_after=late)
    monkeypatch.setattr(standby_module, "connect_robot", lambda _context: robot)
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.2)
    monkeypatch.setattr(commanded_topics, "_REACHING", 60.0 if care is Care.MADE_SAFE else 0.5)
    monkeypatch.setattr(standby_module, "RETRYING", 0.0)
    with after_death(experiment, ("/alice/cmd_vel", "geometry_msgs/Twist"), care=care):
        told = (folder / "told").read_text(encoding="utf-8").splitlines()
    assert told[0].endswith("and is not heard")
    assert told[-1].endswith("and is not heard") is (care is Care.OUT_OF_REACH)


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_of_a_robot_whose_driver_has_gone_it_is_told_that_nobody_took_the_command(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    robot = Told(experiment.config_path.parent)
    monkeypatch.setattr(Told, "subscribers", lambda *_: [])
    monkeypatch.setattr(standby_module, "connect_robot", lambda _context: robot)
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.2)
    monkeypatch.setattr(commanded_topics, "_REACHING", 0.5)
    with after_death(experiment, ("/alice/cmd_vel", "geometry_msgs/Twist")) as told:
        assert told.endswith("did it, as far as it could: nobody subscribes to /alice/cmd_vel any more")


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_what_a_system_warns_of_as_it_is_made_safe_is_told(write_config: Callable[..., Path]) -> None:
    """As that parameters of a node out of reach are not put back: it was said that all of it is done."""
    warning = 'context.warn("the lamp is still lit")\n        (HERE / "made_safe").write_text'
    head = HEAD.replace('(HERE / "made_safe").write_text', warning)
    experiment = prepare_or_refuse(write_config("", head=head, table=TABLE))
    with after_death(experiment) as told:
        assert told.endswith("did it, as far as it could: the lamp is still lit")


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_a_robot_whose_server_or_network_is_back_some_seconds_after_the_run_s_death_is_made_safe(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    folder = experiment.config_path.parent
    tries = folder / "tries"

    def connect(_context: object) -> Told:
        with tries.open("a", encoding="utf-8") as file:
            file.write("x")
        if tries.stat().st_size < 10:
            raise LinkError("connection refused", where="robot", fix="Start its server.")
        return Told(folder)

    monkeypatch.setattr(standby_module, "connect_robot", connect)
    monkeypatch.setattr(standby_module, "RETRYING", 60.0)
    monkeypatch.setattr(standby_module, "_AGAIN", 0.01)
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.0)
    with after_death(experiment, ("/alice/cmd_vel", "geometry_msgs/Twist")):
        told = (folder / "told").read_text(encoding="utf-8").splitlines()
    assert set(told) == {"/alice/cmd_vel geometry_msgs/Twist {}"}


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
@pytest.mark.parametrize("silent", ["", "rosbridge://bob"])
def test_no_robot_drives_on_while_another_one_that_the_run_commanded_too_does_not_answer(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, silent: str
) -> None:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    told = (folder := experiment.config_path.parent) / "told"

    def link(graph: str) -> Told:
        if graph != silent:
            return Told(folder)
        wait_until(lambda: told.exists() and told.read_text(encoding="utf-8"), "the other robot is told", seconds=10.0)
        raise LinkError("nothing answers there", where="robot", fix="See whether it is on.")

    monkeypatch.setattr(Told, "close", lambda _: None, raising=False)
    bob = SimpleNamespace(open_robot=lambda _, **__: link("rosbridge://bob"))
    monkeypatch.setattr(standby_module, "resolved_robot", lambda _: (bob, SimpleNamespace(namespace="")))
    monkeypatch.setattr(standby_module, "connect_robot", lambda _context: link(""))
    monkeypatch.setattr(standby_module, "RETRYING", 0.0)
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.2)
    both = ("/alice/cmd_vel", "geometry_msgs/Twist"), ("/bob/cmd_vel", "geometry_msgs/Twist", "rosbridge://bob")
    for commanded in (both, both[::-1]):
        told.unlink(missing_ok=True)
        with after_death(experiment, *commanded, care=Care.OUT_OF_REACH) as problem:
            assert "nothing answers there" in problem
        assert len(told.read_text(encoding="utf-8").splitlines()) > 2, "again and again"


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_robots_on_two_graphs_are_told_to_stand_still_also_where_no_thread_may_be_had_any_more(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    told = (folder := experiment.config_path.parent) / "told"

    def refused(*_: Any) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(Told, "close", lambda _: None, raising=False)
    bob = SimpleNamespace(open_robot=lambda _, **__: Told(folder))
    monkeypatch.setattr(standby_module, "resolved_robot", lambda _: (bob, SimpleNamespace(namespace="")))
    monkeypatch.setattr(standby_module, "connect_robot", lambda _: Told(folder))
    monkeypatch.setattr(standby_module, "RETRYING", 0.0)
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.2)
    monkeypatch.setattr(ThreadPoolExecutor, "submit", refused)
    both = ("/alice/cmd_vel", "geometry_msgs/Twist"), ("/bob/cmd_vel", "geometry_msgs/Twist", "rosbridge://bob")
    with after_death(experiment, *both):
        commanded = told.read_text(encoding="utf-8")
    assert "/alice/cmd_vel" in commanded
    assert "/bob/cmd_vel" in commanded


def test_a_robot_that_has_not_answered_is_not_waited_for_again_for_each_system(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each waited for 5 s, so that a network that was away for 7 s was tried again after 20 s only."""
    tries: list[str] = []
    now = 0.0

    def opener(name: str, seconds: float) -> Any:
        nonlocal now
        tries.append(name)
        now += seconds
        raise LinkError(f"nothing answers there: {name}", where="robot", fix="See whether it is on.")

    monkeypatch.setattr(connect, "time", SimpleNamespace(monotonic=lambda: now))
    with closing(connect.RobotTriedOnce()) as resources:
        for name, seconds in (("a wrong namespace", 0.0), ("alice", 5.0), ("bob", 5.0)):
            with pytest.raises(LinkError, match=r"a wrong namespace|alice"):
                resources.open(link_key("robot", name), partial(opener, name, seconds))
        assert tries == ["a wrong namespace", "alice"]
        assert resources.open(link_key("serial", ""), Resources) is not None


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_a_system_is_made_safe_with_the_treatments_of_its_own_run(write_config: Callable[..., Path]) -> None:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    with after_death(experiment):
        pass
    assert made_safe(experiment) == "kitchen kitchen r_1 None"


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_systems_are_made_safe_although_the_folder_of_the_experiment_was_removed(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    monkeypatch.setattr(standby_lock, "open_to_lock", lambda path, _root: open_to_lock(gone / path.name, gone))
    gone = experiment.config_path.parent / "gone"
    with after_death(experiment):
        pass
    assert made_safe(experiment) == "kitchen kitchen r_1 None"


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_where_the_standby_was_killed_while_it_made_a_system_safe_its_work_is_done_again(
    write_config: Callable[..., Path],
) -> None:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    began = time.monotonic()
    with after_death(experiment, began=Care.STANDBY):  # nobody holds its lock
        assert time.monotonic() - began < standby_module.LONGEST
    assert made_safe(experiment) == "kitchen kitchen r_1 None"


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("__import__('time').sleep(60)", "that took longer than 0.5 s"),
        (r"raise OSError('caf\udce9 is torn')", r"OSError: caf\udce9 is torn"),
    ],
    ids=["hangs", "names a file that is not in UTF-8"],
)
def test_why_a_system_could_not_be_made_safe_is_told(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, fault: str, reason: str
) -> None:
    head = HEAD.replace('(HERE / "made_safe").write_text', f"{fault}\n        print")
    experiment = prepare_or_refuse(write_config("", head=head, table=TABLE))
    if "took longer" in reason:
        begin = Standby.begin

        def begin_and_hang(standby: Standby, *given: Any) -> None:
            begin(standby, *given)
            wait_until(lambda: standby.state.care is Care.STANDBY)

        monkeypatch.setattr(standby_module, "LONGEST", 0.5)
        monkeypatch.setattr(Standby, "begin", begin_and_hang)
    with after_death(experiment, care=Care.OUT_OF_REACH) as told:
        assert told == f"THE ROBOT MAY BE MOVING: Lamp could not be made safe: {reason}"


DRIVEN = """\
    from robot_runner.core.links.commanded_topics import tell_commanded
    def {event}(self, context):
        from contextlib import nullcontext
        from robot_runner.core.events.resources import opened_here
        class Link:
            def close(self): {close}
        with {opened} as resources:
            resources.open("link", Link)
            {command}
            raise RuntimeError("a bump")
"""


@pytest.mark.parametrize(
    ("close", "care"), [("pass", Care.SAFE), ("raise OSError('the network is gone')", Care.RUN)], ids=["closed", "not"]
)
@pytest.mark.parametrize(
    "opened",
    ["nullcontext(context.resources)", "opened_here()"],
    ids=["the run's link", "a callback's own, as open_robot"],
)
@pytest.mark.parametrize(
    ("event", "command"),
    [("launch_mission", "pass"), ("start_run", "RobotRunnerConfig.tell_commanded('/cmd_vel', 'Twist')")],
)
def test_a_failed_run_without_systems_leaves_a_safe_robot_only_where_its_links_could_be_closed(
    write_config: Callable[..., Path],
    monkeypatch: pytest.MonkeyPatch,
    close: str,
    care: Care,
    event: str,
    command: str,
    opened: str,
) -> None:
    monkeypatch.setattr(commanded_topics, "_listeners", [])  # the process of a run has its own
    monkeypatch.setattr(run_events, "has_standby", lambda _: True)  # as where the config names a robot
    body = DRIVEN.format(event=event, close=close, command=command, opened=opened)
    experiment = prepare_or_refuse(write_config(body, table=TABLE))
    state = SystemsState()
    with ProgressManager(experiment, Resumption()) as progress, closing(state):
        task = replace(progress.task_of(next(iter(progress.pending()))), attempt=1)
        execute_run(experiment, task, lambda _kind, _fields: None, InterruptGate(), state)
        assert state.care is care


def test_a_list_of_topics_that_was_cut_tells_of_those_that_are_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(SystemsState()) as state:
        told = [Commanded(f"/{name}/cmd_vel", "geometry_msgs/Twist", "dds:types=my types") for name in ("alice", "bob")]
        for each in told:
            state.add_commanded(each)
        assert state.commanded == told
        monkeypatch.setattr(systems_state, "_LONGEST_LIST", len(" ".join(told[0])) + 6)
        assert state.commanded == told[:1]


@pytest.mark.parametrize("own", ["simulated", None])
def test_of_a_robot_that_is_simulated_in_the_run_s_own_process_nobody_is_told(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, own: str | None
) -> None:
    """It ends with its process: a run that was killed counted as one that had left a robot moving."""
    monkeypatch.setattr(commanded_topics, "_listeners", [])
    body = f"""\
    robot = {own!r}
    def launch_mission(self, context):
        from robot_runner.plugins import open_robot
        with open_robot("simulated") as (link, _):
            link.publish("cmd_vel", "geometry_msgs/Twist", {{"linear": {{"x": 0.1}}}})
        raise RuntimeError("a bump")
"""
    experiment = prepare_or_refuse(write_config(body, table=TABLE))
    state = SystemsState()
    with ProgressManager(experiment, Resumption()) as progress, closing(state):
        task = replace(progress.task_of(next(iter(progress.pending()))), attempt=1)
        execute_run(experiment, task, lambda _kind, _fields: None, InterruptGate(), state)
        assert state.commanded == []


@contextmanager
def after_death(
    experiment: Experiment, *commanded: tuple[str, ...], began: Care = Care.RUN, care: Care = Care.MADE_SAFE
) -> Iterator[str]:
    """Have the systems of a first run made safe that has died, while a second one has begun beside it.

    Yields what is told of it.
    """
    with ProgressManager(experiment, Resumption()) as progress:
        first, second = (progress.task_of(run) for run in progress.pending())
        (lamp,) = experiment.systems
        bind(lamp, first.combination)
        standby = Standby(made_safe_of_their_own(experiment), experiment, replace(first, attempt=1))
        bind(lamp, second.combination)  # the next run begins beside it
        standby.state.set(began)
        for each in commanded:
            standby.state.add_commanded(Commanded(*each))
        dead = subprocess.Popen([sys.executable, "-c", ""])
        dead.wait()
        for seconds in standby.looked_after(dead.pid):
            time.sleep(seconds)
        assert standby.state.care is care
        told = standby.finding()
        standby.state.close()
        assert told is not None
        yield told["problem"]
