"""Profilers that measure a subject: with all that it has started, here and on another computer."""

from __future__ import annotations

import json
from functools import partial
from typing import TYPE_CHECKING

import pytest
from tests.conftest import HEAD, written_config
from tests.core.execution.conftest import Executed, execute_in
from tests.core.links.ssh_server import SshServer, server_of_own_files

from robot_runner.core.config.preparation import prepare

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

IMPORTS = """\
from robot_runner.plugins.profilers import PsUtil
from robot_runner.plugins.systems import Program
"""
OURS = HEAD.replace("import *\n", f"import *\n{IMPORTS}", 1)
ONE_RUN = "    def create_run_table(self):\n        return RunTableModel([Factor('Task', ['Video'])], seed=1)"
#: A program that does nothing itself; a child of its child, in a session of its own, keeps a core busy.
BUSY = ["sh", "-c", "echo up; (setsid sh -c 'while :; do :; done' &); exec sleep 100"]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SshServer]:
    """Yield a real sshd on loopback whose programs keep their files in a folder of their own: samples are counted."""
    with server_of_own_files(tmp_path_factory.mktemp("sshd")) as started:
        yield started


@pytest.fixture
def execute(tmp_path: Path) -> Callable[..., Executed]:
    return partial(execute_in, tmp_path, head=OURS, table=ONE_RUN)


def body_of(where: str, form: str = "", mission: str = "context.clock.sleep(2)") -> str:
    return f"""
    plugins = [
        Program({BUSY!r}, name="Busy", ready="up" {where}),
        PsUtil(processes=["subject:Busy"] {where or ", host='localhost'"} {form}),
    ]

    def launch_mission(self, context):
        {mission}
    """


def measured(done: Executed) -> tuple[float, float]:
    assert done.finished.failures == ()
    return float(done.table[0]["CPU_Busy"]), float(done.table[0]["CPU"])


@pytest.mark.long
def test_a_subject_is_measured_with_all_that_it_started(execute: Callable[..., Executed]) -> None:
    subject, computer = measured(execute(body_of("")))
    assert 0 < subject <= computer + 5


@pytest.mark.long
@pytest.mark.parametrize("form", ["python3", "sh"])
def test_a_subject_over_there_is_measured_and_is_no_disturbance(
    execute: Callable[..., Executed], server: SshServer, form: str
) -> None:
    over_there = f", host='robot', ssh_config={str(server.config)!r}"
    # A shell that looks starts dozens of programs: on a busy machine, each look takes seconds.
    samples = f"next(Path({str(server.folder / 'tmp')!r}).glob('robot-runner-samples-*'))"
    mission = f"while {samples}.read_text().count('\\n') < 15: context.clock.sleep(0.1)"
    done = execute(body_of(over_there, f", form={form!r}", mission))
    subject, computer = measured(done)
    assert 0 < subject <= computer + 5
    facts = json.loads((done.folder / "runs/r_1/machine/robot.json").read_text())
    (started,) = [record for record in done.journal("subject") if "pid" in record]
    # It was busy for seconds, which is more than anything that is not told.
    assert facts["percent_of_a_core"]["experiment"] > 10
    assert started["pid"] not in [each["pid"] for each in facts["others"]]


def test_a_subject_that_there_is_not_is_found(tmp_path: Path) -> None:
    body = "plugins = [Program(['true'], name='Nav'), PsUtil(host='localhost', processes=['subject:Nva'])]"
    (finding,) = prepare(written_config(tmp_path, body, head=OURS, table=ONE_RUN)).findings
    assert finding.problem == "no plugin is named 'Nva', whose processes are to be measured"
    assert finding.fix == "Did you mean 'Nav'?"


@pytest.mark.parametrize("table", ["    def create_run_table(self):\n        raise ValueError('no')", ONE_RUN])
def test_a_subject_that_cannot_be_built_is_not_said_to_be_missing(tmp_path: Path, table: str) -> None:
    subject = "Program(treatment('Task'), name='Nav')"  # of which a text is no command
    body = f"plugins = [{subject}, PsUtil(host='localhost', processes=['subject:Nav'])]"
    findings = prepare(written_config(tmp_path, body, head=OURS, table=table)).findings
    assert len(findings) == 1
    assert "no plugin is named" not in findings[0].problem


@pytest.mark.long
def test_a_subject_that_no_probe_starts_is_neither_missed_nor_doubted_there(execute: Callable[..., Executed]) -> None:
    alone = ONE_RUN.replace("seed=1", "seed=1, data_columns=['CPU_Busy']")
    done = execute(body_of("", mission="context.clock.sleep(1)"), table=alone, probe=True)
    assert float(done.table[0]["CPU_Busy"]) > 0
    (probed,) = done.journal("probe")
    assert not any("no process subject:Busy was seen" in each for each in probed["profilers"]["PsUtil"]["reasons"])
