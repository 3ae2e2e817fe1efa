"""Experiments whose features are drawn: killed, robbed of their tables and extended, they end as if undisturbed."""

from __future__ import annotations

import csv
import os
import random
import signal
import subprocess
import sys
import uuid
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from tests.process.conftest import MARK, PATIENCE, Experiment

CONFIG = """
import random, time
from robot_runner import (
    BadValuePolicy, ExperimentConfig, Factor, Gate, Measure, Precision, Robots, RunProcess, RunTableModel, WarmUp,
    not_, process_running,
)
from robot_runner.plugins.systems import Program


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    claims = []
    {attributes}

    def create_run_table(self):
        columns = [Measure("Energy", "J", "Drawn."), Measure("Reached", "", "Drawn.")]
        columns += [Measure("Heat", "°C", "Drawn.", high=60)]
        return RunTableModel([{factors}], data_columns=columns, seed=7, {arguments})

    def launch_mission(self, context):
        if {failing} and context.run_seed % {failing} == 0:
            raise ValueError("as drawn")
        context.clock.sleep(1) if self.robot else time.sleep({seconds})

    def populate_run_data(self, context):
        drawn = random.Random(f"{{context.combination}} {{context.run_seed}}")
        energy = None if {missing} and context.run_seed % {missing} == 1 else drawn.gauss(100, 3)
        return {{"Energy": energy, "Reached": drawn.random() < 0.7, "Heat": drawn.uniform(20, 65)}}
"""
GATES = '[Gate(not_(process_running("no_such_program")), timeout_s=60)]'
SUBJECT = """Program(
        ["sh", "-c", "{orphan}echo ready; exec sleep 600"], name="Subject", ready="ready", grace_s=2, per="{per}"
    )"""
#: What a journal cannot have lost: all but times, and which robot was free.
COMPARED = (
    "run_id",
    "status",
    "Task",
    "Größe",
    "Repetition",
    "batch",
    "warm_up",
    "excluded",
    "Energy",
    "Reached",
    "Heat",
)
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)


@dataclass
class Drawn:
    """An experiment, and what users do with it, drawn from a seed."""

    chance: random.Random
    attributes: list[str] = field(default_factory=list)
    steps: list[list[str]] = field(default_factory=list)
    has_one_worker: bool = False

    def config(self) -> str:
        """Return the text of its config."""
        draw = self.chance.choice
        nested = draw(["", "", ', when={"Task": "a,b"}'])
        factors = 'Factor("Task", ["a,b", "c\\\\nd", "é%"]), Factor("Größe", [True, 0.1]' + nested + ")"
        repetitions = draw([2, 3, 4])
        arguments = [f"repetitions={repetitions}"]
        if draw([True, False]):
            arguments += ["shuffle=True", draw(['blocks="Repetition"', 'blocks="Task"', "blocks=()"])]
        warm_up = draw(["", "", "2", 'WarmUp(1, per="Task")', "WarmUp(1, each_session=True)"])
        arguments += [f"warm_up={warm_up}"] if warm_up else []
        process = draw(["FORK", "FORK", "FORK", "SPAWN", "IN_PROCESS"])
        self.has_one_worker = process == "IN_PROCESS"
        self.attributes.append(f"run_process = RunProcess.{process}")
        robots = ["None", "None", "'simulated'"] + ["Robots('simulated://alice', 'simulated://bob')"] * (
            process != "IN_PROCESS"
        )
        self.attributes.append(f"robot = {draw(robots)}")
        self.attributes.append(f"on_bad_value = BadValuePolicy.{draw(['KEEP', 'FAIL', 'TRY_AGAIN'])}")
        self.attributes.append(f"attempts = {draw([1, 2])}")
        self.attributes.append(f"quality_columns = {draw([True, False])}")
        self.attributes.append(f"gates = {draw(['[]', GATES])}")
        subject = draw(["", "", "run", "mission", "experiment"]) if process != "IN_PROCESS" else ""
        orphan = draw(["", "(setsid sleep 600 &); ", "sleep 600 & "])
        self.attributes.append(f"plugins = [{SUBJECT.format(orphan=orphan, per=subject) if subject else ''}]")
        is_precise = repetitions > 2 and not nested and draw([True, False, False])
        if is_precise:
            self.attributes.append(f'repeat_until = Precision("Energy", half_width="2 %", at_most={repetitions + 2})')
        elif draw([True, False]):
            self.steps.append(["extend", "--repetitions", str(repetitions + 1), "--seed", "3"])
        self.steps += draw([[], [["exclude", "r_1", "--reason", "as drawn"]]])
        self.steps += draw([[], [["run", "--redo", "r_2"]]])
        return CONFIG.format(
            attributes="\n    ".join(self.attributes),
            factors=factors,
            arguments=", ".join(each for each in arguments if each != "blocks=()"),
            failing=draw([0, 0, 5, 9]),
            missing=draw([0, 0, 4]),
            seconds=draw([0, 0.01, 0.1]),
        )

    def workers(self) -> list[str]:
        """Return how many runs are executed at once."""
        return [] if self.has_one_worker else ["--workers", self.chance.choice(["1", "2", "3"])]


def execute(folder: Path, command: str, *arguments: str, after: float | None = None, number: int = 0) -> Experiment:
    """Execute a command in a process; send it a signal after some time, s, where it has not ended by then."""
    words = [sys.executable, "-m", "robot_runner", command, "study.py", *arguments]
    mark = uuid.uuid4().hex
    process = subprocess.Popen(
        words,
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, MARK: mark},
    )
    experiment = Experiment(folder / "study.py", process, mark)
    try:
        experiment.output = process.communicate(timeout=after or 5 * PATIENCE)[0]
    except subprocess.TimeoutExpired:
        assert after is not None, f"{words} does not end"
        process.send_signal(number)
        experiment.end()
    assert "Traceback" not in experiment.output.replace("ValueError: as drawn", ""), experiment.output
    return experiment


def disturb(folder: Path, drawn: Drawn, command: str, *arguments: str) -> None:
    """Begin a command some times, and kill it; take away the table, or tear the journal's last line, now and then."""
    chance, files = drawn.chance, folder / "results" / "trial"
    for _ in range(chance.randint(0, 4)):
        after = chance.uniform(0.3, 0.8 if command != "run" else 2.5)
        experiment = execute(folder, command, *arguments, after=after, number=chance.choice(SIGNALS))
        if chance.random() < 0.2 and (files / "run_table.csv").exists():
            (files / "run_table.csv").unlink()
        if chance.random() < 0.1 and (files / "journal.jsonl").exists():
            with (files / "journal.jsonl").open("a") as journal:
                journal.write('{"kind":"attempt_fin')
        assert experiment.nobody_is_left()


def follow(folder: Path, drawn: Drawn, *, is_disturbed: bool) -> list[dict[str, str]]:
    """Execute the experiment and what follows, and return what its table says in the end."""
    for step in [["run"], *drawn.steps]:
        command, *arguments = step
        if is_disturbed:
            disturb(folder, drawn, command, *arguments, *(drawn.workers() if command == "run" else []))
        done = execute(folder, command, *arguments)
        allowed = {0, 1} if command == "run" else {0, 2}  # 2: what was killed had done it already
        assert done.process.returncode in allowed, done.output
        if command == "extend":
            follow_up = execute(folder, "run")
            assert follow_up.process.returncode in {0, 1}, follow_up.output
    with (folder / "results" / "trial" / "run_table.csv").open(encoding="utf-8", newline="") as file:
        return [{name: row[name] for name in COMPARED if name in row} for row in csv.DictReader(file)]


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", range(30))
def test_an_experiment_of_drawn_features_ends_as_if_nobody_had_disturbed_it(tmp_path: Path, seed: int) -> None:
    drawn = Drawn(random.Random(seed))  # noqa: S311 - draws need no cryptography
    config = drawn.config()
    tables = []
    for is_disturbed in (False, True):
        folder = tmp_path / str(is_disturbed)
        folder.mkdir()
        (folder / "study.py").write_text(config, encoding="utf-8")
        tables.append(follow(folder, drawn, is_disturbed=is_disturbed))
    assert tables[0] == tables[1], config
