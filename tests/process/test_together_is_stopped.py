"""Missions that go on together in one run end with it, whichever way it ends."""

from __future__ import annotations

import json
import signal
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import HEAD
from tests.processor_wait import OWN_WAITS, ProcessorWait

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

#: Neither mission is over before the other one was ended, too.
SYSTEMS = """
import json, threading, time
from robot_runner.plugins import System
from robot_runner.plugins.systems import Together
HERE = Path(__file__).parent

def await_both(what):
    while not all((HERE / f"{name}_{what}").exists() for name in ("alice", "bob")):
        time.sleep(0.01)

class Mover(System):
    def launch_mission(self, context):
        try:
            (HERE / f"{self.name}_moves").touch()
            context.clock.sleep(3600)
        finally:
            (HERE / f"{self.name}_ends").touch()
            await_both("ends")
            (HERE / f"{self.name}.new").write_text(json.dumps([time.time(), WAITS]))
            (HERE / f"{self.name}.new").rename(HERE / f"{self.name}_ended")
    def make_safe(self, context):
        (HERE / f"{self.name}_safe").touch()

class Guard(System):
    def start_run(self, context):
        def end():
            while not (HERE / "watched").exists():
                time.sleep(0.01)
            (HERE / "ends").write_text(str(time.time()))
            getattr(context, how)("the door is open")
        threading.Thread(target=end, daemon=True).start()

how = "HOW"
""".replace("WAITS", " ".join(OWN_WAITS.split()))
BODY = """
    plugins = [Together(Mover(name="alice"), Mover(name="bob")), GUARD]
    grace_in_s = 20
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])])
"""


@pytest.mark.long
@pytest.mark.parametrize(("how", "code"), [("SIGINT", 130), ("fail", 1), ("stop_mission", 0)])
def test_whatever_ends_the_run_ends_all_missions_at_once(
    start: Callable[..., Any], write_config: Callable[..., Path], how: str, code: int
) -> None:
    is_signal = how.startswith("SIG")
    systems = SYSTEMS.replace("HOW", how)
    body = BODY.replace(", GUARD", "" if is_signal else ", Guard()")
    experiment = start(config=write_config(body, head=HEAD.replace("import *\n", f"import *\n{systems}", 1), table=""))
    for name in ("alice", "bob"):
        experiment.wait_for(f"{name}_moves")
    wait = ProcessorWait(experiment.processes())
    (experiment.config.parent / "watched").touch()
    began = experiment.send(signal.Signals[how]) if is_signal else float(experiment.text_of("ends"))
    for name in ("alice", "bob"):
        ended, waits = json.loads(experiment.text_of(f"{name}_ended", meanwhile=wait.look))
        wait.add(waits)
        assert ended - began - wait.seconds < 3.0
    assert experiment.end() == code, experiment.output
    for name in ("alice", "bob"):
        assert (experiment.config.parent / f"{name}_safe").exists()
