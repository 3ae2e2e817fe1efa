"""Whoever dies while a system is operated, somebody who is left makes it safe, or says that nobody could."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import HEAD
from tests.process.conftest import kill_together, wait_until

from robot_runner.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path

Start = Callable[..., Any]

#: A lamp is on for as long as its file is there; each who makes it safe adds a line to another.
LAMP = """
import os, time
from robot_runner.plugins import System
HERE = Path(__file__).parent

class Lamp(System):
    def start_run(self, context):
        (HERE / "on").touch()
    def launch_mission(self, context):
        (HERE / "launched").touch()
        {mission}
    def stop_run(self, context):
        (HERE / "on").unlink()
    def make_safe(self, context):
        with (HERE / "made_safe").open("a") as file:
            file.write(f"{{os.getpid()}} {{context.run_id}} {{context.combination['Task']}}\\n")
        {make_safe}
        (HERE / "on").unlink(missing_ok=True)
"""
BODY = """
    plugins = [Lamp()]
    grace_in_s = 5
    def create_run_table(self):
        return RunTableModel([Factor("Task", [TASKS])])
"""
LONG = "time.sleep(60)"


@pytest.fixture
def lamp(start: Start, write_config: Callable[..., Path]) -> Callable[..., Any]:
    def light(
        *,
        mission: str = LONG,
        make_safe: str = "pass",
        more: str = "",
        tasks: str = '"Video"',
        waits_for: str = "launched",
    ) -> Any:
        lamp = LAMP.format(mission=mission, make_safe=make_safe)
        head = HEAD.replace("import *\n", f"import *\n{lamp}", 1)
        experiment = start(config=write_config(BODY.replace("TASKS", tasks) + more, head=head, table=""))
        experiment.wait_for(waits_for)
        return experiment

    return light


def calls(experiment: Any) -> list[list[str]]:
    path = experiment.config.parent / "made_safe"
    return [line.split() for line in path.read_text().splitlines()] if path.exists() else []


def is_on(experiment: Any) -> bool:
    return (experiment.config.parent / "on").exists()


def kill(*pids: int) -> None:
    kill_together(pids)


@pytest.mark.parametrize("process", ["FORK", "SPAWN"])
def test_a_run_that_is_killed_has_its_systems_made_safe_by_the_process_that_stands_by(
    lamp: Callable[..., Any], process: str
) -> None:
    experiment = lamp(more=f"    run_process = RunProcess.{process}\n")
    standby = experiment.standby()
    kill(experiment.run_process())
    assert experiment.end() == 1
    assert not is_on(experiment)
    assert calls(experiment) == [[str(standby), "r_1", "Video"]]
    assert "the run died before it had made Lamp safe; the process that stood by for this did it" in experiment.output


@pytest.mark.long
@pytest.mark.parametrize("with_keeper", [True, False], ids=["and the keeper", "and not the keeper"])
def test_where_the_standby_is_killed_with_the_run_the_orchestrator_has_the_systems_made_safe(
    lamp: Callable[..., Any], with_keeper: bool
) -> None:
    experiment = lamp()
    standby, run, keeper = experiment.standby(), experiment.run_process(), experiment.keeper()
    kill(*([keeper] if with_keeper else []), standby, run)
    assert experiment.end() == 1
    assert not is_on(experiment)
    assert len(calls(experiment)) == 1


@pytest.mark.parametrize("process", ["FORK", pytest.param("SPAWN", marks=pytest.mark.long)])
def test_where_everybody_was_killed_the_next_execution_makes_the_systems_safe_before_anything_else(
    lamp: Callable[..., Any], start: Start, process: str, capsys: pytest.CaptureFixture[str]
) -> None:
    more = f"    run_process = RunProcess.{process}\n" + LOOKED_AT_FIRST
    experiment = lamp(tasks='"Video", "Network"', mission=f"(HERE / 'killed').exists() or {LONG}", more=more)
    kill(experiment.standby(), experiment.run_process(), experiment.keeper(), experiment.process.pid)
    (experiment.config.parent / "killed").touch()
    experiment.end()
    assert experiment.nobody_is_left()
    assert is_on(experiment)
    assert main(["status", str(experiment.config)]) == 0
    assert f"THE ROBOT MAY BE MOVING: {LEFT}" in " ".join(capsys.readouterr().out.split())
    again = start("", "--only", "r_2", config=experiment.config)  # the run that was killed is not executed now
    assert again.end() == 0, again.output
    assert again.text_of("at_first") == "off"
    assert [call[1:] for call in calls(again)] == [["r_1", "Video"]]
    assert f"{LEFT}; that was done now" in " ".join(again.output.split())
    assert main(["status", str(experiment.config)]) == 0
    assert "MAY BE MOVING" not in capsys.readouterr().out


@pytest.mark.long
def test_an_answer_after_one_run_leaves_what_is_to_be_made_safe_after_another_that_is_in_flight(
    lamp: Callable[..., Any], start: Start
) -> None:
    more = """    workers = 2
    Lamp.claims = lambda self, robot: []
    operator_steps = [
        OperatorStep("rate it", after={"Task": "Network"}, ask=[Question("trust", int)]),
        OperatorStep("wait", after={"Task": "Network"}),
    ]
"""
    moves = "(HERE / context.run_id).touch()"
    mission = f"{moves}; context.combination['Task'] == 'Network' or (HERE / 'killed').exists() or {LONG}"
    experiment = lamp(mission=mission, more=more, tasks='"Video", "Network"', waits_for="r_1")
    journal = experiment.folder / "journal.jsonl"
    wait_until(lambda: '"step":"rate it"' in journal.read_text(), "the first step is asked for")
    assert main(["continue", str(experiment.folder), "--answer", "trust=5"]) == 0
    wait_until(lambda: '"step":"wait"' in journal.read_text(), "the answer is kept, and the next step is asked for")
    kill(*experiment.processes())
    (experiment.config.parent / "killed").touch()
    experiment.end()
    again = start("", "--only", "r_2", config=experiment.config)
    again.text_of("made_safe")
    assert [call[1:] for call in calls(again)] == [["r_1", "Video"]]


@pytest.mark.long
@pytest.mark.parametrize("with_keeper", [True, False], ids=["and the keeper killed", "and not the keeper"])
@pytest.mark.parametrize("when", ["before", "as it makes them safe"])
def test_where_the_standby_is_stopped_the_systems_are_made_safe_by_who_is_left(
    lamp: Callable[..., Any], when: str, with_keeper: bool
) -> None:
    lasting = "not (HERE / 'stopped').exists() and time.sleep(60)"
    experiment = lamp(make_safe=lasting)
    standby, run, keeper = experiment.standby(), experiment.run_process(), experiment.keeper()
    if when == "before":
        os.kill(standby, signal.SIGSTOP)
    kill(*([keeper] if with_keeper else []), run)
    if when != "before":
        experiment.wait_for("made_safe")
        os.kill(standby, signal.SIGSTOP)
    (experiment.config.parent / "stopped").touch()
    assert experiment.end() == 1
    assert not is_on(experiment)
    assert "MAY BE MOVING" not in experiment.output
    assert calls(experiment)[-1][0] != str(standby)
    assert experiment.nobody_is_left(), "nobody goes on with it once it is continued, in the midst of another run"


@pytest.mark.long
@pytest.mark.parametrize("stopped", ["keeper", "keeper and standby"])
def test_where_the_keeper_is_stopped_and_the_run_is_killed_its_systems_are_made_safe_and_the_experiment_goes_on(
    lamp: Callable[..., Any], stopped: str
) -> None:
    experiment = lamp(tasks='"Video", "Network"', mission=f"context.combination['Task'] == 'Network' or {LONG}")
    processes = {"keeper": experiment.keeper(), "standby": experiment.standby()}
    run = experiment.run_process()
    for name in stopped.split(" and "):
        os.kill(processes[name], signal.SIGSTOP)
    kill(run)
    assert experiment.end() == 1
    assert experiment.statuses == ["Failed", "Done"]
    assert not is_on(experiment)
    assert [call[1:] for call in calls(experiment)] == [["r_1", "Video"]]
    assert "MAY BE MOVING" not in experiment.output
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_where_the_standby_is_stopped_and_the_keeper_killed_neither_is_left_once_the_run_has_closed(
    lamp: Callable[..., Any], start: Start
) -> None:
    mission = f"context.combination['Task'] == 'Network' or (HERE / 'killed').exists() or {LONG}"
    experiment = lamp(tasks='"Video", "Network"', mission=mission)
    keeper, standby = experiment.keeper(), experiment.standby()
    os.kill(standby, signal.SIGSTOP)
    kill(keeper)
    (experiment.config.parent / "killed").touch()  # not before: the first mission may have begun after that
    assert experiment.end() == 1
    assert experiment.statuses == ["Failed", "Done"]
    assert experiment.nobody_is_left()
    again = start(config=experiment.config)
    assert again.end() == 0, again.output
    assert "still being made safe" not in again.output


@pytest.mark.long
def test_a_run_whose_keeper_is_stopped_is_done_when_it_ends(lamp: Callable[..., Any]) -> None:
    experiment = lamp(mission="[time.sleep(0.02) for _ in range(3000) if not (HERE / 'stopped').exists()]")
    os.kill(experiment.keeper(), signal.SIGSTOP)
    (experiment.config.parent / "stopped").touch()
    assert experiment.end() == 0, experiment.output
    assert experiment.statuses == ["Done"]
    assert experiment.nobody_is_left()


@pytest.mark.long
@pytest.mark.parametrize("stopped", ["standby", "keeper", "both"])
def test_what_a_killed_execution_has_left_stopped_is_not_waited_for_by_the_next(
    lamp: Callable[..., Any], start: Start, stopped: str
) -> None:
    experiment = lamp(tasks='"Video", "Network"', mission=f"(HERE / 'killed').exists() or {LONG}")
    processes = {"standby": experiment.standby(), "keeper": experiment.keeper()}
    left = [pid for name, pid in processes.items() if stopped in {name, "both"}]
    for pid in left:
        os.kill(pid, signal.SIGSTOP)
    kill(*(pid for pid in experiment.processes() if pid not in left))
    (experiment.config.parent / "killed").touch()
    experiment.end()
    again = start("", "--only", "r_2", config=experiment.config)
    assert again.end() == 0, again.output
    assert "waited for" not in again.output
    assert "were still being made safe" not in again.output
    assert not is_on(again)
    assert experiment.nobody_is_left()


@pytest.mark.long
@pytest.mark.parametrize("is_hanging", [True, False], ids=["hangs in C", "goes on"])
@pytest.mark.parametrize("keeper_is", ["stopped", "killed"])
def test_a_run_is_ended_and_its_systems_made_safe_where_neither_orchestrator_nor_keeper_can(
    lamp: Callable[..., Any], keeper_is: str, is_hanging: bool
) -> None:
    hang = f"signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGTERM,)); {LONG}"
    experiment = lamp(mission=f"import signal; {hang}" if is_hanging else LONG, more="    grace_in_s = 1\n")
    keeper, run = experiment.keeper(), experiment.run_process()
    if keeper_is == "stopped":
        os.kill(keeper, signal.SIGSTOP)
        kill(experiment.process.pid)
    else:
        kill(experiment.process.pid, keeper)
    experiment.end()
    wait_until(lambda: not is_on(experiment), "the lamp is off")
    wait_until(lambda: run not in experiment.processes(), "the run has ended")
    if keeper_is == "killed":
        assert experiment.nobody_is_left()


#: What comes before any run, and even before the experiment.
LOOKED_AT_FIRST = """
    def before_experiment(self):
        (HERE / "at_first").write_text("on" if (HERE / "on").exists() else "off")
"""
LEFT = "an earlier execution was killed in r_1, and no process was left to make its systems safe"


@pytest.mark.long
def test_what_the_next_execution_cannot_make_safe_either_is_told_once_and_no_run_begins(
    lamp: Callable[..., Any], start: Start
) -> None:
    torn = "if (HERE / 'killed').exists(): raise OSError('the cable is torn')"
    experiment = lamp(mission=f"(HERE / 'killed').exists() or {LONG}", make_safe=torn)
    kill(experiment.standby(), experiment.run_process(), experiment.keeper(), experiment.process.pid)
    (experiment.config.parent / "killed").touch()
    experiment.end()
    again = start(config=experiment.config)
    assert again.end() == 2
    told = " ".join(again.output.split())
    assert f"THE ROBOT MAY BE MOVING: {LEFT}; it cannot be done now either: OSError: the cable is torn" in told
    assert (again.folder / "journal.jsonl").read_text().count('"attempt_started"') == 1, "that of the killed execution"
    stopped_by_hand = start(config=experiment.config)
    assert stopped_by_hand.end() == 0, stopped_by_hand.output


@pytest.mark.long
def test_of_a_run_that_was_made_safe_after_the_death_of_its_execution_the_next_one_says_nothing(
    lamp: Callable[..., Any], start: Start
) -> None:
    experiment = lamp(mission=f"(HERE / 'killed').exists() or {LONG}")
    kill(experiment.run_process(), experiment.keeper(), experiment.process.pid)
    (experiment.config.parent / "killed").touch()  # not before: the mission may have begun after that
    experiment.end()
    assert experiment.nobody_is_left()
    again = start(config=experiment.config)
    assert again.end() == 0, again.output
    assert "make its systems safe" not in again.output
    assert len(calls(again)) == 1


SLOW_TO_STAND_BY = """
    from robot_runner.core.execution.standby import Standby
    def begin_late(self, *arguments, begin=Standby.begin, **more):
        (HERE / "keeper").write_text(str(os.getpid()))
        time.sleep(1)
        begin(self, *arguments, **more)
    Standby.begin = begin_late
"""


@pytest.mark.long
def test_a_run_begins_once_somebody_stands_by_so_that_no_moment_is_without(lamp: Callable[..., Any]) -> None:
    experiment = lamp(more=SLOW_TO_STAND_BY)
    kill(experiment.run_process(), experiment.keeper(), experiment.process.pid)
    assert experiment.nobody_is_left()
    assert not is_on(experiment)
    assert len(calls(experiment)) == 1


@pytest.mark.long
def test_a_run_whose_keeper_is_killed_before_anybody_stands_by_never_begins(lamp: Callable[..., Any]) -> None:
    again = "    attempts = 2\n" + SLOW_TO_STAND_BY.replace("time.sleep(1)", "time.sleep(60)").replace(
        "        time.sleep(60)\n", "        not (HERE / 'killed').exists() and time.sleep(60)\n"
    )
    experiment = lamp(mission="(HERE / 'twice').touch(exist_ok=False)", more=again, waits_for="keeper")
    (experiment.config.parent / "killed").touch()
    kill(int(experiment.text_of("keeper")))
    assert experiment.end() == 0, experiment.output
    assert "the run's keeper was killed by SIGKILL; it is tried again" in experiment.output
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_where_the_run_and_all_who_watch_over_it_are_killed_the_process_that_stands_by_makes_its_systems_safe(
    lamp: Callable[..., Any],
) -> None:
    experiment = lamp()
    standby = experiment.standby()
    kill(experiment.run_process(), experiment.keeper(), experiment.process.pid)
    assert experiment.nobody_is_left()
    assert not is_on(experiment)
    assert calls(experiment) == [[str(standby), "r_1", "Video"]]


#: Tells that an execution has found somebody who stands by for an earlier one, for whom it waits then.
TELLS_THAT_IT_WAITS = """
    from robot_runner.core.execution import standby_lock
    def tell(folder, found=standby_lock.kill_if_stopped):
        (HERE / "waits").touch()
        return found(folder)
    standby_lock.kill_if_stopped = tell
"""


@pytest.mark.long
def test_a_restart_waits_for_the_process_that_makes_the_systems_of_the_killed_run_safe(
    lamp: Callable[..., Any], start: Start
) -> None:
    lasting = "[time.sleep(0.05) for _ in range(1200) if not (HERE / 'waits').exists()]; (HERE / 'done').touch()"
    mission = "assert (HERE / 'done').exists() or time.sleep(60)"
    experiment = lamp(make_safe=lasting, mission=mission, more=TELLS_THAT_IT_WAITS)
    kill(experiment.run_process(), experiment.keeper(), experiment.process.pid)
    experiment.wait_for("made_safe")
    again = start(config=experiment.config)
    assert again.end() == 0, again.output
    assert "its systems were still being made safe" in again.output


@pytest.mark.long
def test_a_system_that_nobody_could_make_safe_is_told_in_capitals_and_no_further_run_begins(
    lamp: Callable[..., Any],
) -> None:
    experiment = lamp(
        make_safe="raise OSError('the cable is out')", more="    attempts = 2\n", tasks='"Video", "Network"'
    )
    kill(experiment.run_process())
    assert experiment.end() == 1
    assert experiment.statuses == ["Failed", "-"]
    assert "Stopped by a robot that may be moving: 0 of 2 runs done, 1 failed, 1 to do" in experiment.output
    output = " ".join(experiment.output.split())
    assert "THE ROBOT MAY BE MOVING: Lamp could not be made safe: OSError: the cable is out" in output
    assert "Stop it by hand" in output


@pytest.mark.long
@pytest.mark.parametrize(
    ("mission", "code", "count"), [("pass", 0, 0), ("raise RuntimeError('a bump')", 1, 1)], ids=["done", "failed"]
)
def test_a_run_that_ends_by_itself_makes_its_systems_safe_itself_and_nothing_is_said(
    lamp: Callable[..., Any], mission: str, code: int, count: int
) -> None:
    experiment = lamp(mission=mission)
    assert experiment.end() == code
    assert len(calls(experiment)) == count
    assert "stood by" not in experiment.output
    assert "MOVING" not in experiment.output
    assert experiment.nobody_is_left()


CABLE = """
class Cable:
    def __init__(self):
        with (HERE / "plugged").open("a") as file:
            file.write(f"{os.getpid()}\\n")
    def switch_off(self):
        if (HERE / "torn").exists():
            (HERE / "torn").unlink()
            raise OSError("the cable is torn")
    def close(self):
        pass

class Lamp(Lamp):
    def stand_by(self, context):
        context.resources.open("cable", Cable)
        (HERE / "ready").touch()
        raise RuntimeError("whatever it says here")
    def make_safe(self, context):
        context.resources.open("cable", Cable).switch_off()
        super().make_safe(context)
"""


@pytest.mark.long
@pytest.mark.parametrize("is_torn", [False, True], ids=["still stands", "was lost"])
def test_what_the_standby_has_opened_beforehand_makes_safe_and_is_opened_anew_where_it_was_lost(
    start: Start, write_config: Callable[..., Path], is_torn: bool
) -> None:
    systems = LAMP.format(mission=LONG, make_safe="pass") + CABLE
    experiment = start(
        config=write_config(
            BODY.replace("TASKS", '"Video"'), head=HEAD.replace("import *\n", f"import *\n{systems}", 1), table=""
        )
    )
    for name in ("launched", "ready"):
        experiment.wait_for(name)
    standby = experiment.standby()
    if is_torn:
        (experiment.config.parent / "torn").touch()
    kill(experiment.run_process())
    assert experiment.end() == 1
    assert not is_on(experiment)
    assert calls(experiment) == [[str(standby), "r_1", "Video"]]
    plugged = (experiment.config.parent / "plugged").read_text().split()
    assert plugged == [str(standby)] * (2 if is_torn else 1)
    assert "the process that stood by for this did it" in experiment.output
