"""Whoever is killed, nobody goes on beside the next execution; and what may outlive its run does."""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.conftest import HEAD, written_config
from tests.process.conftest import kill_together, wait_until

Start = Callable[..., Any]

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells who is left, and hands over orphans")

#: The second run moves until it is told to stop, the first time that it is executed; each program that it starts is an
#: orphan, as a daemon is: forked twice, with a session of its own, so that no process group reaches it.
BODY = """
grace_in_s = GRACE
def launch_mission(self, context):
    import os, time
    self.note(f"begins {context.run_id}")
    if context.run_id == "r_2" and not self.flag("moving").exists():
        self.orphan()
        self.flag("keeper").write_text(str(os.getppid()))
        self.flag("run").write_text(str(os.getpid()))
        self.flag("moving").write_text("")
        MOVE
def stop_run(self, context):
    import time
    if context.run_id == "r_2" and not self.flag("closed").exists():
        self.flag("closed").write_text("")
        CLOSE
    self.note(f"ends {context.run_id}")
def populate_run_data(self, context): return {"Energy": 1.5}
def orphan(self):
    import os, subprocess
    if (pid := os.fork()) == 0:
        os.setsid()
        program = subprocess.Popen(["sleep", "600"], start_new_session=True)
        self.flag("orphan").write_text(str(program.pid))
        os._exit(0)
    os.waitpid(pid, 0)
def note(self, what):
    with self.flag("story").open("a") as file: print(what, file=file, flush=True)
def flag(self, name): return Path(__file__).parent / name
"""
#: What stands between this and the hang cannot be ended either.
DEAF = "import signal; signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())"
HANG = "import ctypes; m = ctypes.create_string_buffer(64); [ctypes.CDLL(None).pthread_mutex_lock(m) for _ in 'ab']"


def moving(
    start: Start, *, move: str = "time.sleep(600)", close: str = "pass", grace: float = 5.0, more: str = ""
) -> Any:
    body = f"{more}\n{BODY}".replace("MOVE", move).replace("CLOSE", close).replace("GRACE", str(grace))
    experiment = start(body)
    experiment.config.with_name("may close").touch()
    experiment.wait_for("moving")
    return experiment


def number(experiment: Any, name: str) -> int:
    return int(experiment.text_of(name))


def kill(experiment: Any, *names: str) -> None:
    """Kill several processes at one moment: none has the time to do anything about another one's end."""
    pids = [experiment.process.pid if name == "orchestrator" else number(experiment, name) for name in names]
    for sent in (signal.SIGSTOP, signal.SIGKILL):
        for pid in pids:
            os.kill(pid, sent)


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def again(start: Start, experiment: Any) -> Any:
    """Execute it once more, to its end, and return that execution."""
    second = start(config=experiment.config)
    assert second.end() == 0, second.output
    assert second.statuses == ["Done"] * 4
    assert second.nobody_is_left()
    return second


#: Has the run of an earlier execution go on to close once that is waited for.
LETS_IT_CLOSE = """
from robot_runner.core.execution import left_processes
def let_it_close(holds, seconds, wait=left_processes._wait):
    if (closing := Path(__file__).with_name("closing")).exists(): closing.with_name("may close").touch()
    return wait(holds, seconds)
left_processes._wait = let_it_close
"""


@pytest.mark.long
def test_a_restart_waits_for_a_run_that_is_still_closing_and_says_so(start: Start) -> None:
    close = [
        "self.flag('may close').unlink()",
        "self.flag('closing').touch()",
        "while not self.flag('may close').exists(): time.sleep(0.01)",
        "print('closed at last')",
    ]
    first = moving(start, close="\n        ".join(close), grace=60.0, more=LETS_IT_CLOSE)
    kill(first, "orchestrator", "keeper")
    first.wait_for("closing")
    second = again(start, first)
    assert re.search(r"its run was still alive and was waited for \(\d+\.\d s\)", second.output), second.output
    story = first.text_of("story").split("\n")
    assert story[2:6] == ["begins r_2", "ends r_2", "begins r_2", "ends r_2"]
    (kept,) = (first.folder / "earlier_attempts" / "r_2").glob("*/log.txt")
    assert "closed at last" in kept.read_text()


@pytest.mark.long
def test_a_restart_ends_a_run_that_hangs_in_c_and_says_so(start: Start) -> None:
    first = moving(start, move=f"{DEAF}; self.flag('hangs').touch(); {HANG}", grace=1.0)
    first.wait_for("hangs")
    kill(first, "orchestrator", "keeper")
    run = number(first, "run")
    assert is_alive(run)
    second = again(start, first)
    assert re.search(rf"what was left of it was killed: .*\b{run}\b", second.output), second.output
    assert not is_alive(run)
    assert not is_alive(number(first, "orphan"))


def test_killed_with_its_keeper_the_run_ends_its_own_orphans(start: Start) -> None:
    first = moving(start)
    kill(first, "orchestrator", "keeper")
    first.end()
    assert first.nobody_is_left()
    assert again(start, first).output.count("was killed") == 0


@pytest.mark.long
def test_a_run_that_has_left_its_process_group_and_does_not_end_is_killed(start: Start) -> None:
    leave = "import signal; os.setpgid(0, os.getppid()); signal.signal(signal.SIGTERM, signal.SIG_IGN)"
    first = moving(start, move=f"{leave}; self.flag('left').touch(); time.sleep(600)", grace=0.5)
    first.wait_for("left")
    kill(first, "orchestrator")
    assert first.nobody_is_left()
    again(start, first)


@pytest.mark.long
def test_orphans_of_a_run_that_was_killed_with_everybody_end_at_the_restart(start: Start) -> None:
    first = moving(start)
    kill(first, "orchestrator", "keeper", "run")
    orphan = number(first, "orphan")
    wait_until(lambda: first.processes() == [orphan], "only the orphan is left")
    second = again(start, first)
    assert f"its run had ended; what was left of it was killed: {orphan}" in second.output


@pytest.mark.long
def test_orphans_of_a_run_whose_keeper_was_killed_are_ended(start: Start) -> None:
    experiment = moving(start)
    kill(experiment, "keeper")
    assert experiment.end() == 1, experiment.output
    assert experiment.statuses == ["Done", "Failed", "Done", "Done"]
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_what_outlives_its_run_is_there_in_the_next_and_nothing_else_is(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            import os, subprocess
            mark = f"{os.getpid()}"
            flag = Path(__file__).parent / "outliving"
            if context.run_id == "r_1":
                program = subprocess.Popen(["sh", "-c", "sleep 600 & echo $! > child; wait"], cwd=flag.parent)
                context.outlives(program)
                subprocess.Popen(["sleep", "600"])
                subprocess.Popen(["sleep", "600"], start_new_session=True)
                flag.write_text(str(program.pid))
            else:
                os.kill(int(flag.read_text()), 0)
        """
    )
    assert experiment.end() == 0, experiment.output
    pids = [number(experiment, "outliving"), number(experiment, "child")]
    wait_until(lambda: sorted(experiment.processes()) == sorted(pids), "the program and its child alone are left")
    second = start("", "--redo", "r_1,r_2", config=experiment.config)
    assert second.end() == 0, second.output
    assert "earlier execution" not in second.output
    assert all(map(is_alive, pids))
    assert '"kind":"outlives"' in (experiment.folder / "journal.jsonl").read_text()
    for pid in pids:
        os.kill(pid, signal.SIGKILL)


@pytest.mark.long
def test_a_program_that_is_dead_cannot_outlive_its_run(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            import subprocess
            program = subprocess.Popen(["true"])
            program.wait()
            context.outlives(program)
        """
    )
    assert experiment.end() == 1
    assert "cannot outlive the run: it is not alive" in experiment.output


@pytest.mark.long
def test_who_claims_the_same_robot_waits_for_what_a_killed_experiment_has_left_and_is_refused_meanwhile(
    start: Start,
) -> None:
    claims = 'claims = ["robot:alice"]'
    close = "while not self.flag('may close').exists(): time.sleep(0.01)"
    first = moving(
        start,
        move="self.flag('may close').unlink(); self.flag('left').touch(); time.sleep(600)",
        close=close,
        grace=60.0,
        more=claims,
    )
    first.wait_for("left")
    kill(first, "orchestrator")
    first.wait_for("closed")
    note = "with Path(__file__).with_name('story').open('a') as file: print('begins other', file=file)"
    body = f"{claims}\ndef launch_mission(self, context):\n    {note}"
    other = first.config.with_name("other.py")
    written_config(first.config.parent, body, head=HEAD.replace("trial", "other"), name="other.py")
    refused = start(config=other)
    assert refused.end() == 2
    assert "robot:alice is in use by the remaining processes of the experiment 'trial'" in refused.output
    waiting = start("", "--wait", config=other)
    assert any("Waiting for claims" in line for line in waiting.process.stdout)
    first.config.with_name("may close").touch()
    assert waiting.end() == 0
    story = first.text_of("story").splitlines()
    assert story.index("ends r_2") < story.index("begins other")


GATE = """
class Hanging(Condition):
    def __str__(self): return "it does not hang"
    def watch(self, context, opened):
        def look():
            if not (flag := Path(__file__).with_name("hangs")).exists():
                DEAF
                flag.touch()
                HANG
            return Look(True, "it does not")
        return look
""".replace("HANG", HANG).replace("DEAF", DEAF)


@pytest.mark.long
def test_a_restart_ends_a_gate_that_hangs_in_c_and_says_so(start: Start, write_config: Callable[..., Path]) -> None:
    head = HEAD.replace("import *\n", f"import *\n{GATE}", 1)
    experiment = start(config=write_config("gates = [Gate(Hanging())]\ngrace_in_s = 0.5", head=head))
    experiment.wait_for("hangs")
    kill_together([experiment.keeper(), experiment.process.pid])
    assert experiment.processes(), "the gate goes on"
    again = start(config=experiment.config)
    assert again.end() == 0, again.output
    said = "an earlier execution was killed; its work beside runs was still going on and was waited for"
    assert said in " ".join(again.output.split())
    assert experiment.nobody_is_left()
    assert not list(again.folder.glob(".aside-*"))


@pytest.mark.long
def test_a_restart_beside_a_live_experiment_leaves_it_alone(start: Start) -> None:
    first = moving(start, close="print('closed')")
    second = start(config=first.config)
    assert second.end() == 2
    assert is_alive(number(first, "run"))
    assert is_alive(number(first, "orphan"))
    first.send(signal.SIGINT)
    assert first.end() == 130
    assert first.nobody_is_left()
