"""Hosts over ssh, against a real sshd on loopback; skipped where OpenSSH's server is not installed."""

from __future__ import annotations

import os
import statistics
import subprocess
import textwrap
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.core.links.ssh_server import SshServer, server_of_own_files
from tests.measuring.busy_core import wait_for_samples
from tests.python_program import first_lines

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.links.ssh_command import ssh_command, ssh_findings
from robot_runner.measuring import on_board_session
from robot_runner.measuring.host import FileHost, HostLink, ProcessHost
from robot_runner.measuring.on_board_session import OnBoardSession
from robot_runner.measuring.ssh_host import SshHost
from robot_runner.ros.ros_environment import ros_of_host

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: How far the clock of the shifted host is ahead, s; how much faster it goes; where its steady clock begins.
AHEAD, DRIFT, STEADY = 120.0, 0.05, 1e6

#: Stands for python3 on the shifted host: the same Python, with clocks that are ahead and fast.
SHIFTED_PYTHON = f"""{first_lines("-IS")}
import sys, time
begun, wall, steady = time.monotonic(), time.time, time.monotonic
time.time = lambda: wall() + {AHEAD} + (steady() - begun) * {DRIFT}
time.monotonic = lambda: {STEADY} + steady() + (steady() - begun) * {DRIFT}
program = sys.argv[sys.argv.index("-c") + 1]
exec(compile(program, "on board", "exec"), {{"__name__": "__main__"}})
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SshServer]:
    with server_of_own_files(tmp_path_factory.mktemp("sshd")) as started:
        yield started


@pytest.fixture
def connect(server: SshServer) -> Iterator[Callable[..., SshHost]]:
    made: list[SshHost] = []

    def make(form: str | None = None) -> SshHost:
        made.append(SshHost("robot", SystemClock(), config=server.config, form=form))
        return made[-1]

    yield make
    for each in made:
        each.close()
    assert list((server.folder / "tmp").iterdir()) == []


def test_it_is_a_host_that_tells_of_processes_and_files(connect: Callable[..., SshHost]) -> None:
    for protocol in (HostLink, ProcessHost, FileHost):
        assert isinstance(connect(), protocol)


@pytest.mark.parametrize("form", ["python3", "sh"])
@pytest.mark.parametrize("is_streamed", [False, True], ids=["fetched", "streamed"])
def test_samples_arrive_over_one_session(connect: Callable[..., SshHost], form: str, is_streamed: bool) -> None:
    link = connect(form)
    begun = time.monotonic()
    sampler = link.sample_processes(20.0, ["pid:1"], is_streamed=is_streamed)
    wait_for_samples(5, sampler)
    samples = sampler.stop()
    assert len(samples) >= 5
    assert begun - 0.05 < samples[0].time < samples[-1].time < time.monotonic() + 0.05
    assert samples[-1].processes[0].count == 1
    assert sampler.report().problems == ()
    link.sample_utilisation(10.0).stop()
    assert len(link._sessions) == 1


def test_the_samples_of_a_lost_connection_are_recovered_from_on_board(
    connect: Callable[..., SshHost], server: SshServer
) -> None:
    sampler = connect().sample_utilisation(50.0)
    wait_for_samples(25, sampler)
    server.cut()
    samples = sampler.stop()
    lost, recovered = sampler.report().problems
    assert "the connection is lost: the loop ended with code 255" in lost
    assert recovered == f"{len(samples)} samples were recovered over a second connection"
    assert len(samples) >= 25
    assert sampler.report().clock.after is not None


@pytest.mark.parametrize("form", ["python3", "sh"])
def test_the_loop_goes_on_after_the_connection_was_cut(
    connect: Callable[..., SshHost], server: SshServer, form: str
) -> None:
    clock = SystemClock()
    sampler = connect(form).sample_utilisation(20.0)
    kept = wait_for_samples(2, sampler)
    cut_at = clock.now()
    server.cut()
    wait_for_samples(kept + 60, sampler)  # of which some may be older: they are written once a second
    samples = sampler.stop()
    assert samples[-1].time > cut_at + 1.5
    after = [sample for sample in samples if sample.time > cut_at]
    assert len(after) >= 15
    assert "samples were recovered over a second connection" in sampler.report().problems[-1]


def test_the_samples_that_had_arrived_before_the_connection_was_lost_are_kept(
    connect: Callable[..., SshHost], server: SshServer
) -> None:
    sampler = connect("sh").sample_processes(50.0, (), is_streamed=True)
    wait_for_samples(5, sampler)
    server.cut()
    samples = sampler.stop()
    lost, kept = sampler.report().problems
    assert "the connection is lost" in lost
    assert kept == f"the {len(samples)} samples that had arrived by then are kept"
    assert len(samples) >= 5


def test_a_robot_that_does_not_come_back_leaves_word_where_the_samples_are(tmp_path: Path) -> None:
    (tmp_path / "tmp").mkdir()
    server = SshServer(tmp_path, environment={"TMPDIR": str(tmp_path / "tmp")})
    link = SshHost("robot", SystemClock(), config=server.config)
    try:
        sampler = link.sample_utilisation(20.0)
    finally:
        server.stop()
    assert sampler.stop() == []
    lost, left = sampler.report().problems
    assert "the connection is lost" in lost
    path = left.partition("the samples are still on board, in ")[2].partition(":")[0]
    assert Path(path).parent == tmp_path / "tmp"
    assert Path(path).exists()
    link.close()
    Path(path).unlink()  # the loop on board goes on for as long as it keeps samples: not beyond this test


def test_a_robot_that_falls_silent_is_told_of(
    connect: Callable[..., SshHost], server: SshServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    sampler = connect().sample_processes(20.0, (), is_streamed=True)
    wait_for_samples(1, sampler)
    monkeypatch.setattr(on_board_session, "_PATIENCE", 1.0)
    client = sampler._session._process.pid
    os.kill(client, 19)  # SIGSTOP: the network holds everything back
    try:
        samples = sampler.stop()
    finally:
        os.kill(client, 18)
    assert sampler.report().problems[0] == "the computer did not answer within 1 s"
    assert samples


def test_a_host_whose_key_has_changed_is_refused_as_what_may_be_an_attack(tmp_path: Path) -> None:
    server = SshServer(tmp_path)
    try:
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", tmp_path / "other"], check=True)
        server.know((tmp_path / "other.pub").read_text())
        with pytest.raises(LinkError, match="Host key verification failed") as raised:
            SshHost("robot", SystemClock(), config=server.config).sample_utilisation(10.0)
        (finding,) = ssh_findings("plugin PsUtil", "robot", config=server.config)
        for told in (raised.value, finding):
            assert "the key of the host is not the one that is known" in told.problem
            assert "attack" in told.fix
            assert f'ssh-keygen -f "{tmp_path}/known_hosts" -R "[127.0.0.1]:{server.port}"' in told.fix
            assert "say yes" not in told.fix
        with pytest.raises(LinkError, match="may be an attack"):
            ros_of_host("robot", config=server.config)
    finally:
        server.stop()


def test_a_host_whose_key_is_not_known_is_refused_with_a_remedy(tmp_path: Path) -> None:
    server = SshServer(tmp_path)
    try:
        (tmp_path / "known_hosts").write_text("")
        with pytest.raises(LinkError, match="the loop ended with code 255: Host key verification failed"):
            SshHost("robot", SystemClock(), config=server.config).sample_utilisation(10.0)
        (finding,) = ssh_findings("plugin PsUtil", "robot", config=server.config)
        assert "Host key verification failed" in finding.problem
        assert f"ssh -F {server.config} robot" in finding.fix
    finally:
        server.stop()


def test_a_key_that_the_host_does_not_take_is_refused_with_a_remedy(server: SshServer, tmp_path: Path) -> None:
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", tmp_path / "stranger"], check=True)
    config = tmp_path / "config"
    config.write_text(server.config.read_text().replace(f"{server.folder}/user_key", f"{tmp_path}/stranger"))
    with pytest.raises(LinkError, match="Permission denied") as raised:
        SshHost("robot", SystemClock(), config=config).sample_utilisation(10.0)
    assert raised.value.fix.startswith(f"Give it this machine's key, ssh-copy-id -F {config} robot, or ")


def test_the_connection_of_a_run_that_is_interrupted_while_the_host_greets_is_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    greeting: list[OnBoardSession] = []

    def interrupt(session: OnBoardSession, _form: str | None) -> str:
        greeting.append(session)
        raise RunInterrupted

    monkeypatch.setattr(OnBoardSession, "_agree", interrupt)
    with pytest.raises(RunInterrupted):
        OnBoardSession(["sh"], where="here", clock=SystemClock())
    assert not greeting[0].is_alive


def test_a_host_that_can_be_reached_gives_no_finding(server: SshServer) -> None:
    assert ssh_findings("plugin PsUtil", "robot", config=server.config) == []


@pytest.fixture
def shifted(tmp_path: Path) -> Iterator[SshHost]:
    """A host whose clocks are ahead by a known amount and go too fast, over a real sshd."""
    python = tmp_path / "bin" / "python3"
    python.parent.mkdir()
    python.write_text(textwrap.dedent(SHIFTED_PYTHON))
    python.chmod(0o755)
    server = SshServer(tmp_path)
    remote = f'PATH={python.parent}:"$PATH"; export PATH; {on_board_session.REMOTE_COMMAND}'
    command = ssh_command("robot", remote, config=server.config)
    link = SshHost("robot", SystemClock(), form="python3", command=command)
    yield link
    link.close()
    server.stop()


@pytest.mark.long
@pytest.mark.parametrize("is_streamed", [False, True], ids=["fetched", "streamed"])
def test_samples_of_a_host_with_a_shifted_and_drifting_clock_stand_at_their_true_time(
    shifted: SshHost, is_streamed: bool
) -> None:
    sampler = shifted.sample_files(50.0, ["/proc/uptime"], is_streamed=is_streamed)
    wait_for_samples(100, sampler)
    samples = sampler.stop()
    booted = SystemClock().now() - time.clock_gettime(time.CLOCK_BOOTTIME)
    record = sampler.report().clock
    assert record.before.wall_offset == pytest.approx(AHEAD, abs=0.05 * 2.0 + record.before.uncertainty)
    assert record.after.wall_offset > record.before.wall_offset
    assert record.before.steady - record.before.at == pytest.approx(STEADY, abs=1.0)
    assert record.drift == pytest.approx(DRIFT, abs=0.005)
    # The file tells the true time at which it was read, however busy the machine is.
    late = [sample.time - booted - float(sample.lines[0].split()[0]) for sample in samples if sample.lines[0]]
    assert len(late) >= 40
    first, last = late[: len(late) // 3], late[-len(late) // 3 :]
    assert abs(statistics.median(late)) < 0.03 + record.uncertainty
    # Without the drift's correction the last third would stand some 80 ms further off than the first.
    assert statistics.median(last) - statistics.median(first) == pytest.approx(0.0, abs=0.03 + record.uncertainty)
