"""Experiments with hosts, against a real sshd on loopback."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import written_config
from tests.core.execution.conftest import Executed, execute_in
from tests.core.links.ssh_server import SshServer
from tests.event_deadline import enforce_deadline_in

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import ConfigError, ExecutionError
from robot_runner.core.execution import between_runs
from robot_runner.core.execution.notices import FindingsNoticed, HostRestarts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

HEAD = """\
import os
import time
from pathlib import Path
from robot_runner import *

HERE = Path(__file__).parent


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
    watch_machines = False
"""
ONE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])], data_columns=["Energy"])
"""
BLOCKS = """\
    def create_run_table(self):
        return RunTableModel([Factor("Room", ["lab", "hall"])], repetitions=2, blocks="Room", seed=1)
"""
DESIGNED = """\
    def create_run_table(self):
        from robot_runner.designs import Blocks
        factors = [Factor("Room", ["lab", "hall"]), Factor("Task", ["Video", "Network"])]
        return RunTableModel(factors, repetitions=2, design=Blocks("Room"), seed=1)
"""
WARMED_UP = """\
    def create_run_table(self):
        factors = [Factor("Task", ["Video", "Network"])]
        return RunTableModel(factors, repetitions=2, blocks="Repetition", warm_up=1, seed=1)
"""
RESULTS = """
hosts = {"robot": Host(address="robot", ssh_config=HERE / "ssh_config", fetch=[str(HERE / "on board/*.log")]),
         "base": Host(address="local", fetch=[str(HERE / "here.txt")])}
grace_in_s = 20.0

def before_run(self, context):
    context.host("robot").run(["mkdir", "-p", str(HERE / "on board")])
    context.host("base").copy_to(HERE / "config.py", str(HERE / "here.txt"))

def start_run(self, context):
    context.host("robot").run(f"echo driving > '{HERE}/on board/nav.log'")
"""

IN_TURN = "Robots('simulated://alice', 'simulated://bob')"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[SshServer]:
    started = SshServer(tmp_path)
    yield started
    started.stop()


def fetched(executed: Executed) -> str:
    run = executed.folder / "runs" / "r_1"
    inner = str(executed.config.parent).lstrip("/")
    assert (run / "base" / inner / "here.txt").read_bytes() == executed.config.read_bytes()
    assert (run / "robot" / "commands.log").exists()
    return (run / "robot" / inner / "on board" / "nav.log").read_text()


@pytest.mark.long
def test_results_are_fetched_when_a_run_stops_well_or_not(
    server: SshServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    well = execute_in(tmp_path, RESULTS, head=HEAD, table=ONE)
    assert well.finished.done_count == 1
    assert fetched(well) == "driving\n"
    raising = 'def launch_mission(self): raise ValueError("bumped")'
    failed = execute_in(tmp_path, RESULTS + raising, head=HEAD, table=ONE, experiment_name="failed")
    assert failed.finished.failures == ("r_1: launch_mission of config: ValueError: bumped",)
    assert fetched(failed) == "driving\n"
    enforce_deadline_in("launch_mission", monkeypatch)  # connections take long on a busy machine
    endless = "event_deadline_in_s = 1.0\ndef launch_mission(self): time.sleep(600)"
    late = execute_in(tmp_path, RESULTS + endless, head=HEAD, table=ONE, experiment_name="late")
    assert "took longer than event_deadline_in_s = 1 s" in late.finished.failures[0]
    assert fetched(late) == "driving\n"


def test_results_that_an_earlier_run_has_left_are_told(server: SshServer, tmp_path: Path) -> None:
    left = tmp_path / "on board" / "nav.log"
    left.parent.mkdir()
    left.write_text("of yesterday")
    os.utime(left, (time.time() - 90_000, time.time() - 90_000))
    body = RESULTS.replace("echo driving > '{HERE}/on board/nav.log'", "true")
    said = [str(finding) for finding in execute_in(tmp_path, body, head=HEAD, table=ONE).finished.findings]
    (told,) = [each for each in said if "fetched from robot" in each]
    assert "on board/*.log were written 25 h" in told


@pytest.mark.long
def test_a_host_that_goes_away_fails_its_run_and_is_told_where_nothing_was_fetched(
    server: SshServer, tmp_path: Path
) -> None:
    pid = server._process.pid
    going = f"""
def launch_mission(self, context):
    # The listener goes last: it is what its connections are found by.
    for pid in (*tests.core.links.ssh_server._descendants({pid}), {pid}):
        try:
            os.kill(pid, 9)
        except ProcessLookupError:
            pass
    context.host("robot").run("sleep 60", timeout_s=20)
"""
    body = RESULTS + going
    head = HEAD.replace("import os\n", "import os\nimport tests.core.links.ssh_server\n")
    gone = execute_in(tmp_path, body, head=head, table=ONE)
    (failure,) = gone.finished.failures
    assert "launch_mission of config: robot" in failure
    assert "cannot be reached" in failure or "the connection was lost" in failure
    findings = [str(finding) for finding in gone.finished.findings]
    assert any("nothing was fetched from robot: robot cannot be reached" in each for each in findings)
    run = gone.folder / "runs" / "r_1" / "base"
    assert list(run.rglob("here.txt")), "the other host is fetched from"


def test_hosts_are_checked_before_anything_is_executed(tmp_path: Path) -> None:
    body = 'hosts = {"robot": Host(address="nowhere", ssh_config=HERE / "none"), "INA": "local"}'
    preparation = prepare(written_config(tmp_path, body, head=HEAD, table=ONE))
    assert preparation.experiment is None
    assert "there is no ssh config" in str(preparation.findings[0])
    odd = prepare(written_config(tmp_path, 'hosts = {"robot": 5}', head=HEAD, table=ONE))
    assert "the value is {'robot': 5}" in odd.findings[0].problem
    assert "It must be names with addresses" in odd.findings[0].fix
    blank = prepare(written_config(tmp_path, 'hosts = {"my robot": "local"}', head=HEAD, table=ONE))
    assert "a name is of letters, digits, '_' and '-'" in blank.findings[0].fix
    with pytest.raises(ConfigError, match="fetch names"):
        raise ConfigError.of_findings(
            prepare(written_config(tmp_path, 'hosts = {"a": Host(address="local", fetch="x")}', head=HEAD)).findings
        )


@pytest.mark.long
@pytest.mark.parametrize(
    ("policy", "before", "robot", "table"),
    [
        ("ONCE", ["r_1"], "None", BLOCKS),
        pytest.param("ONCE", ["r_1"], IN_TURN, BLOCKS, marks=pytest.mark.soak),
        pytest.param("PER_BLOCK", ["r_1", "r_3"], "None", BLOCKS, marks=pytest.mark.soak),
        ("PER_BLOCK", ["r_1", "r_3"], IN_TURN, BLOCKS),
        pytest.param("PER_BLOCK", ["r_1", "r_3"], "None", DESIGNED, id="the blocks are those of a design"),
        pytest.param("PER_BLOCK", ["w_1", "r_3"], "None", WARMED_UP, id="a warm-up run is of the block that it warms"),
    ],
)
def test_hosts_are_started_anew_and_awaited(
    server: SshServer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    policy: str,
    before: list[str],
    robot: str,
    table: str,
) -> None:
    script, await_end = server.reboot_script(), between_runs._await_end

    def await_end_and_tell(*given: Any) -> None:
        await_end(*given)
        server.miss()

    monkeypatch.setattr(between_runs, "_await_end", await_end_and_tell)
    body = f"""
robot = {robot}
hosts = {{"robot": Host(address="robot", ssh_config=HERE / "ssh_config", reboot=Reboot.{policy},
                        reboot_command={str(script)!r}, back_within_s=40, ready=FileThere())}}
def launch_mission(self, context):
    context.host("robot").run("true")
"""
    ready = """

class FileThere(Condition):
    def __str__(self): return "the host was started anew"
    def watch(self, context, opened): return lambda: Look((HERE / "reboots").exists(), "no file")


class RobotRunnerConfig("""
    executed = execute_in(tmp_path, body, head=HEAD.replace("\n\nclass RobotRunnerConfig(", ready), table=table)
    assert executed.finished.failed_count == 0
    assert [each.next_run for each in executed.notices if isinstance(each, HostRestarts)] == before
    assert len((tmp_path / "reboots").read_text().split()) == len(before)
    records = executed.journal("host_restarted")
    assert [record["next_run"] for record in records] == before
    for record in records:
        assert (record["host"], record["failure"]) == ("robot", "")
        assert record["away_s"] > 0.5
        assert record["is_new_kernel"] is False, "only sshd was started anew here"
    assert any(
        "its kernel was not restarted" in str(each) for each in executed.notices if isinstance(each, FindingsNoticed)
    )
    assert [record["condition"] for record in executed.journal("waited")] == ["the host was started anew"] * len(before)


@pytest.mark.parametrize(("table", "is_warned_of"), [(ONE, True), (BLOCKS, False), (DESIGNED, False)])
def test_restarting_per_block_is_warned_of_where_the_runs_have_no_blocks(
    tmp_path: Path, table: str, *, is_warned_of: bool
) -> None:
    host = 'Host(address="r", ssh_config=HERE / "none", reboot=Reboot.PER_BLOCK, reboot_command="sudo -n reboot")'
    findings = prepare(written_config(tmp_path, f'hosts = {{"robot": {host}}}', head=HEAD, table=table)).findings
    told = [str(each) for each in findings if "the runs have no blocks" in each.problem]
    assert len(told) == is_warned_of, findings


@pytest.mark.parametrize(
    ("command", "problem"),
    [
        ("echo not allowed >&2; exit 1", "the host cannot be restarted: .* ended with exit status 1: not allowed"),
        pytest.param("true", "the host was told to restart .* and was still there after 4 s", marks=pytest.mark.long),
    ],
)
def test_a_host_that_does_not_start_anew_ends_the_experiment(
    server: SshServer, tmp_path: Path, command: str, problem: str
) -> None:
    body = f"""
hosts = {{"robot": Host(address="robot", ssh_config=HERE / "ssh_config", reboot=Reboot.PER_RUN,
                        reboot_command={command!r}, back_within_s=4)}}
"""
    with pytest.raises(ExecutionError, match=problem) as raised:
        execute_in(tmp_path, body, head=HEAD, table=ONE)
    assert "r_1" in raised.value.problem
