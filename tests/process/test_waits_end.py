"""A wait at a gate ends with its experiment, however that ends, and is waited anew by the one that resumes."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Callable
from typing import Any

import pytest
from tests.process.conftest import wait_until

Start = Callable[..., Any]

BODY = """
grace_in_s = 2
gates = [Gate(all_of(text_in(HERE / "state", "cool"), not_(process_running("no such program"))), timeout_s=120)]
guards = [Guard(text_in(HERE / "state", "on fire"), GuardAction.STOP)]
def launch_mission(self, context):
    context.combination["Task"]
    if (HERE / "burns").exists() and context.run_id == "r_2":
        (HERE / "state").write_text("on fire")
        context.clock.sleep(60)
def populate_run_data(self, context):
    (HERE / "state").write_text("warm" if context.run_id == "r_1" else "cool")
    return {"Energy": 1.5}
"""
HEAD = """\
from pathlib import Path
from robot_runner import *

HERE = Path(__file__).parent


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
"""


def states(experiment: Any) -> list[str]:
    """Return the states of the gates in the journal, and which runs were begun."""
    journal = experiment.folder / "journal.jsonl"
    if not journal.exists():
        return []
    told = []
    for line in journal.read_text().splitlines():
        record = json.loads(line)
        if record["kind"] == "gate":
            told.append(f"{record['run']} {record['state']}")
        elif record["kind"] == "attempt_started":
            told.append(f"{record['run']} {record['attempt']}")
    return told


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_wait_ends_with_its_experiment_and_the_next_one_resumes(
    start: Start, write_config: Callable, robot_runner: Callable, number: signal.Signals
) -> None:
    config = write_config(BODY, head=HEAD)
    (config.parent / "state").write_text("cool")
    experiment = start(config=config)
    wait_until(lambda: "r_2 waiting" in states(experiment), "the second run waits")
    status = robot_runner("status", experiment.folder)
    assert "r_2 waits until ('cool' is in" in status.out
    assert "last line: 'warm'" in status.out

    experiment.send(number)
    code = experiment.end()
    assert code == (-9 if number is signal.SIGKILL else 130)
    assert experiment.nobody_is_left()
    if number is not signal.SIGKILL:
        assert re.search(
            r"r_2 waited .* until \('cool' is in .*, in vain: the experiment was interrupted", experiment.output
        )
    assert experiment.statuses == ["Done", "-", "-", "-"]
    assert not any(path.stat().st_size for path in experiment.folder.glob("current_log.txt"))
    before = states(experiment)
    assert before[-1] == ("r_2 waiting" if number is signal.SIGKILL else "r_2 interrupted")

    (config.parent / "state").write_text("cool")
    (config.parent / "burns").touch()
    resumed = start(config=config)
    assert resumed.end() == 1
    assert resumed.nobody_is_left()
    assert states(resumed)[len(before) :] == ["r_2 open", "r_2 1"]
    assert resumed.statuses == ["Done", "Failed", "-", "-"]
    assert "Stopped by a guard: 1 of 4 runs done, 1 failed, 2 to do" in resumed.output
    assert "'on fire' is in" in resumed.output
