"""What a run does on its hosts: one contract, held by this machine and by a real sshd on loopback."""

from __future__ import annotations

import getpass
import os
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.core.links.ssh_server import SshServer
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import CommandError, ConfigError, LinkError
from robot_runner.core.links import host_commands
from robot_runner.core.links.declared_host import Host, Reboot, are_hosts
from robot_runner.core.links.host_commands import opened_host
from robot_runner.core.links.ssh_command import KeptConnection, ssh_findings
from robot_runner.testing import FakeClock, make_context

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from robot_runner.core.events.context import RobotRunnerContext
    from robot_runner.core.links.host_commands import HostCommands


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SshServer]:
    started = SshServer(tmp_path_factory.mktemp("sshd"))
    yield started
    started.stop()


@pytest.fixture(params=["local", "ssh"])
def declare(request: pytest.FixtureRequest) -> Callable[..., Host]:
    """Return what declares the host, once as this machine and once over ssh."""
    if request.param == "local":
        return lambda **facts: Host(address="local", **facts)
    server: SshServer = request.getfixturevalue("server")
    return lambda **facts: Host(address="robot", ssh_config=server.config, **facts)


@pytest.fixture
def context(tmp_path: Path) -> Iterator[RobotRunnerContext]:
    made = make_context(tmp_path / "experiment", robot=None, clock=FakeClock())
    yield made
    made.resources.close()


@pytest.fixture
def host(declare: Callable[..., Host], context: RobotRunnerContext) -> HostCommands:
    return opened_host({"robot": declare()}, "robot", context)


def warned(context: RobotRunnerContext) -> str:
    return "\n".join(finding.problem for finding in context.broker.findings)


def sleep(number: int) -> str:
    """Return a command line that takes for ever, and that no other process which executes tests has."""
    return f"sleep {4710 + number}.{os.getpid()}"


def is_alive(command: str) -> bool:
    """Whether a process with this command line is there."""
    return command.encode() in {b" ".join(words) for words in command_lines()}


def command_lines() -> Iterator[list[bytes]]:
    """Yield the words of each process's command line, which need not be text."""
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            yield (folder / "cmdline").read_bytes().rstrip(b"\0").split(b"\0")


def test_a_command_tells_what_it_wrote_and_how_it_ended(host: HostCommands, context: RobotRunnerContext) -> None:
    result = host.run("echo here; echo there >&2; pwd")
    assert result.exit_status == 0
    assert result.output == f"here\n{Path.home()}\n"
    assert result.errors == "there\n"
    assert host.run(["printf", "%s|", "two words", "$HOME", "it's"]).output == "two words|$HOME|it's|"
    assert host.run("exit 3", check=False).exit_status == 3
    log = (context.run_folder / "robot" / "commands.log").read_text()
    assert "$ echo here; echo there >&2; pwd\nhere\n" in log
    assert "[exit status 3, " in log


def test_a_command_that_fails_tells_its_last_lines(host: HostCommands) -> None:
    with pytest.raises(CommandError) as raised:
        host.run("for i in 1 2 3 4 5 6 7; do echo line $i >&2; done; exit 4")
    assert "ended with exit status 4: line 3 / line 4 / line 5 / line 6 / line 7" in raised.value.problem
    assert raised.value.where == "robot"


def test_a_command_is_ended_at_its_deadline_with_all_that_it_started(
    host: HostCommands, context: RobotRunnerContext
) -> None:
    host.run("true")
    started = time.monotonic()
    with pytest.raises(CommandError, match=r"did not end within 3 s: begun"):
        host.run(f"echo begun; {sleep(1)} & {sleep(2)}; echo never", timeout_s=3.0)
    assert time.monotonic() - started < 15
    wait_until(lambda: not is_alive(sleep(1)) and not is_alive(sleep(2)))
    assert "begun\n[it did not end in time, and was ended" in (context.run_folder / "robot/commands.log").read_text()
    assert host.run("echo again").output == "again\n"


def test_words_of_a_command_may_be_numbers_and_paths(host: HostCommands) -> None:
    assert host.run(["printf", "%s|", 5, 0.5, Path("/a b")]).output == "5|0.5|/a b|"  # type: ignore[list-item]


def test_what_no_command_can_be_is_refused_with_a_fix(host: HostCommands, tmp_path: Path) -> None:
    for refused in (
        lambda: host.run("echo a\0b"),
        lambda: host.run(["echo", "a\0b"]),
        lambda: host.copy_to(__file__, f"{tmp_path}/a\0b"),
    ):
        with pytest.raises(LinkError, match="NUL") as raised:
            refused()
        assert raised.value.where == "robot"
    for timeout in (float("nan"), "5", True, None):
        for tried in (host.run, host.fetch):
            with pytest.raises(LinkError, match=f"timeout_s is {timeout!r}"):
                tried("/nothing", timeout_s=timeout)  # type: ignore[operator]
    with pytest.raises(LinkError, match="Shorten the command"):
        host.run("echo " + "x" * 200_000)


def test_output_that_is_not_kept_whole_is_a_warning(host: HostCommands, context: RobotRunnerContext) -> None:
    assert host.run("head -c 16000000 /dev/zero | tr '\\0' a").output == "a" * 16_000_000
    assert not warned(context)
    assert host.run("head -c 16000001 /dev/zero | tr '\\0' a").output == "a" * 16_000_000
    assert "wrote more than 16 MB, of which the rest is not kept" in warned(context)


def test_what_cannot_be_a_path_there_is_not_fetched_and_the_rest_is(
    host: HostCommands, context: RobotRunnerContext, tmp_path: Path
) -> None:
    (tmp_path / "there").write_text("kept")
    came = host.fetch("relative.csv", "/a\0b", tmp_path / "there")  # type: ignore[arg-type]
    assert [each.read_text() for each in came] == ["kept"]
    assert warned(context).splitlines() == [
        "host robot: 'relative.csv' was not fetched: it is not a whole path there",
        "host robot: '/a\\x00b' was not fetched: it is not a whole path there",
    ]


def test_odd_files_are_fetched_or_told_and_none_keeps_the_others_from_coming(
    host: HostCommands, context: RobotRunnerContext, tmp_path: Path
) -> None:
    there = tmp_path / "there"
    there.mkdir()
    (there / "a link").symlink_to("/etc/passwd")
    os.link(there / "a link", there / "another name of it", follow_symlinks=False)
    (there / "b").write_text("twice")
    os.link(there / "b", there / "b again")
    (there / ("漢" * 85)).write_text("the longest name")
    (there / "zz").write_text("the last")
    came = host.fetch(str(there))
    assert {each.name: each.read_text() for each in came} == {
        "b": "twice",
        "b again": "twice",
        "漢" * 85: "the longest name",
        "zz": "the last",
    }
    assert warned(context).count("is a link to /etc/passwd, which is not followed") == 2


def test_files_and_folders_are_copied_whole(host: HostCommands, tmp_path: Path) -> None:
    there = tmp_path / "there dir"
    (tmp_path / "map.yaml").write_text("resolution: 0.05\n")
    host.copy_to(tmp_path / "map.yaml", f"{there}/deep/er/my map.yaml")
    assert (there / "deep/er/my map.yaml").read_text() == "resolution: 0.05\n"
    source = tmp_path / "bundle"
    (source / "sub").mkdir(parents=True)
    (source / "sub" / "data.bin").write_bytes(os.urandom(300_000))
    (source / "run.sh").write_text("#!/bin/sh\necho runs\n")
    (source / "run.sh").chmod(0o755)
    for _ in range(2):  # what stands there is replaced
        host.copy_to(source, f"{there}/bundle")
        assert (there / "bundle/sub/data.bin").read_bytes() == (source / "sub/data.bin").read_bytes()
    assert host.run([f"{there}/bundle/run.sh"]).output == "runs\n"
    (there / "file").write_text("")
    with pytest.raises(LinkError, match=r"was not copied to .*file/x"):
        host.copy_to(source, f"{there}/file/x")
    for wrong in ("relative", "/", "~/"):
        with pytest.raises(LinkError, match="names no file"):
            host.copy_to(source, wrong)
    with pytest.raises(LinkError, match=r"there is no .*nothing to copy"):
        host.copy_to(tmp_path / "nothing", f"{tmp_path}/x")


def test_a_source_that_cannot_be_read_whole_is_told_and_what_stands_there_stays(
    context: RobotRunnerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def shrinks(*_: object) -> None:
        raise OSError("unexpected end of data")  # as of a log that is rotated meanwhile

    monkeypatch.setattr(host_commands, "pack", shrinks)
    (tmp_path / "new.log").write_text("new")
    (tmp_path / "old.log").write_text("old")
    local = opened_host({"here": Host(address="local")}, "here", context)
    with pytest.raises(LinkError, match=r"new\.log was not copied to .*old\.log: unexpected end of data"):
        local.copy_to(tmp_path / "new.log", f"{tmp_path}/old.log")
    assert (tmp_path / "old.log").read_text() == "old"


def test_files_are_fetched_under_their_own_paths(
    host: HostCommands, context: RobotRunnerContext, tmp_path: Path
) -> None:
    there = tmp_path / "on board"
    (there / "logs" / "deep").mkdir(parents=True)
    for name in ("nav.log", "map [1].log", "-odd", "deep/inner.txt"):
        (there / "logs" / name).write_text(f"this is {name}")
    (there / "logs" / "secret").symlink_to("/etc/hostname")
    (there / "logs" / "deep" / "out").symlink_to("/etc")
    os.mkfifo(there / "logs" / "pipe")
    files = host.fetch(f"{there}/logs/*.log", f"{there}/logs", f"{there}/nothing*", timeout_s=20)
    kept = context.run_folder / "robot"
    inner = str(there).lstrip("/")
    assert (kept / inner / "logs/nav.log").read_text() == "this is nav.log"
    assert (kept / inner / "logs/-odd").read_text() == "this is -odd"
    assert kept / inner / "logs/map [1].log" in files
    assert kept / inner / "logs/deep/inner.txt" in files
    assert not list(kept.rglob("secret"))
    assert not list(kept.rglob("out"))
    said = warned(context)
    assert "/logs/secret is a link to /etc/hostname, which is not followed" in said
    assert "/logs/pipe is not a file" in said
    assert f"there is no {there}/nothing* to fetch" in said
    assert host.fetch(f"{there}/logs/secret") == [], "a link is not followed when it is named, either"


def test_no_more_is_fetched_than_may_be(
    declare: Callable[..., Host], context: RobotRunnerContext, tmp_path: Path
) -> None:
    (tmp_path / "small").write_bytes(b"x" * 100_000)
    (tmp_path / "large").write_bytes(b"x" * 1_000_000)
    (tmp_path / "last").write_bytes(b"x" * 100_000)
    host = opened_host({"robot": declare(largest_fetch_mb=0.5)}, "robot", context)
    files = host.fetch(*(f"{tmp_path}/{name}" for name in ("small", "large", "last")))
    assert [path.name for path in files] == ["small", "last"]
    assert f"{tmp_path}/large was not fetched whole: no more than 0.5 MB come of a run" in warned(context)
    again = opened_host({"robot": declare(largest_fetch_mb=0.5)}, "robot", context)
    (tmp_path / "more").write_bytes(b"x" * 450_000)
    assert again.fetch(f"{tmp_path}/more") == []
    assert f"{tmp_path}/more was not fetched whole: no more than 0.5 MB come of a run" in warned(context)


def test_what_has_not_come_in_time_is_told_and_what_came_is_whole(
    host: HostCommands, context: RobotRunnerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "log").write_text("x")
    assert [path.name for path in host.fetch(f"{tmp_path}/log", timeout_s=20)] == ["log"]
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(900_000_000)  # tar reads and sends every byte of it
    moments = iter([0.0, 0.0, 0.06])  # the fetch begins at once, also on a busy machine
    monkeypatch.setattr(host_commands, "time", SimpleNamespace(monotonic=moments.__next__))
    assert host.fetch(f"{tmp_path}/huge", f"{tmp_path}/log", timeout_s=0.05) == []
    assert f"{tmp_path}/huge was not fetched whole within" in warned(context)
    assert f"{tmp_path}/log was not fetched: 0.05 s were over" in warned(context)
    assert not list(context.run_folder.rglob("*.part"))


def test_the_nearest_name_is_offered(context: RobotRunnerContext) -> None:
    with pytest.raises(LinkError) as raised:
        opened_host({"robot": Host(address="local")}, "robto", context)
    assert "Did you mean 'robot'?" in raised.value.fix
    with pytest.raises(LinkError, match="there is no host 'robot'"):
        context.host("robot")
    named = make_context(Path("unused"), robot=None, clock=FakeClock(), hosts={"base": "local"})
    assert named.host("base")


def test_all_commands_of_a_run_share_one_connection(server: SshServer, context: RobotRunnerContext) -> None:
    host = opened_host({"robot": Host(address="robot", ssh_config=server.config)}, "robot", context)
    host.run("true")
    before = (server.folder / "sshd.log").read_text().count("Accepted publickey")
    for _ in range(3):
        host.run("true")
    assert (server.folder / "sshd.log").read_text().count("Accepted publickey") == before


@pytest.fixture
def configured(tmp_path: Path) -> Iterator[Callable[[str], Host]]:
    """Return what starts an sshd with one more line in its configuration, and declares it as a host."""
    with ExitStack() as stopping:

        def start(line: str) -> Host:
            (tmp_path / "own_sshd").mkdir()
            started = SshServer(tmp_path / "own_sshd", line=line)
            stopping.callback(started.stop)
            return Host(address="robot", ssh_config=started.config)

        yield start


@pytest.mark.long  # an sshd of its own, and three sessions
def test_what_a_login_writes_is_not_taken_for_what_a_command_wrote(
    configured: Callable[[str], Host], context: RobotRunnerContext, tmp_path: Path
) -> None:
    (tmp_path / "nav.log").write_text("42")
    login = """ForceCommand printf 'Welcome to the robot\\nROS '; sh -c "$SSH_ORIGINAL_COMMAND\""""
    host = opened_host({"robot": configured(login)}, "robot", context)
    assert host.run("echo 5").output == "5\n"
    host.copy_to(tmp_path / "nav.log", f"{tmp_path}/copied.log")
    (fetched,) = host.fetch(f"{tmp_path}/copied.log")
    assert fetched.read_text() == "42"
    assert warned(context) == ""


@pytest.mark.long  # an sshd of its own, and three sessions
def test_a_login_that_executes_something_else_than_the_command_is_told(
    configured: Callable[[str], Host], context: RobotRunnerContext, tmp_path: Path
) -> None:
    (tmp_path / "nav.log").write_text("42")
    # The kept connection holds.
    login = """ForceCommand case "$SSH_ORIGINAL_COMMAND" in *"cat >"*) cat ;; *) echo 'It is for backups.' ;; esac"""
    declared = configured(login)
    instead = "did not execute the command: It is for backups."
    (finding,) = ssh_findings("hosts", "robot", config=declared.ssh_config)
    assert instead in finding.problem
    host = opened_host({"robot": declared}, "robot", context)
    with pytest.raises(LinkError, match=instead):
        host.run("echo 5", check=False, timeout_s=10)
    with pytest.raises(LinkError, match=instead):
        host.copy_to(tmp_path / "nav.log", f"{tmp_path}/copied.log")
    with pytest.raises(LinkError, match=instead):
        host.fetch(f"{tmp_path}/nav.log")


def test_a_connection_that_is_lost_fails_the_command_and_is_made_again(
    server: SshServer, context: RobotRunnerContext
) -> None:
    host = opened_host({"robot": Host(address="robot", ssh_config=server.config)}, "robot", context)
    host.run("true")
    cutting = threading.Thread(target=lambda: wait_until(lambda: is_alive(sleep(3))) and server.cut())
    cutting.start()
    with pytest.raises(LinkError, match=rf"the connection was lost while '{sleep(3)}' was executed"):
        host.run(sleep(3), timeout_s=PATIENCE)
    cutting.join()
    assert host.run("echo back").output == "back\n"
    wait_until(lambda: not is_alive(sleep(3)))


def test_a_connection_whose_master_is_still_ending_counts_as_lost(server: SshServer) -> None:
    connection = KeptConnection("robot", server.config)
    line = connection.command("true")
    try:
        assert connection.is_connected()
        Path(line[line.index("-S") + 1]).unlink()  # what a master that ends does first: its process is still there
        assert not connection.is_connected()
    finally:
        connection.close()


def test_a_command_may_end_as_ssh_does_where_the_connection_fails(
    server: SshServer, context: RobotRunnerContext
) -> None:
    host = opened_host({"robot": Host(address="robot", ssh_config=server.config)}, "robot", context)
    assert host.run("exit 255", check=False).exit_status == 255


def test_a_host_that_cannot_be_reached_says_why(context: RobotRunnerContext, tmp_path: Path) -> None:
    config = tmp_path / "ssh_config"
    config.write_text(f"Host gone\n  HostName 127.0.0.1\n  Port 1\n  User {getpass.getuser()}\n")
    host = opened_host({"gone": Host(address="gone", ssh_config=config)}, "gone", context)
    with pytest.raises(LinkError, match=r"gone cannot be reached: .*Connection refused") as raised:
        host.run("true")
    assert "Start the SSH server there" in raised.value.fix


KILLED = """
import sys
from pathlib import Path
from robot_runner import Host
from robot_runner.testing import FakeClock, make_context

address, config, command = sys.argv[1:]
host = Host(address=address, ssh_config=config or None)
context = make_context(Path("experiment"), robot=None, clock=FakeClock(), hosts={"robot": host})
context.host("robot").run("true", timeout_s=30)
print("ready", flush=True)
context.host("robot").run(command, timeout_s=600)
"""


def test_a_run_that_is_killed_leaves_neither_command_nor_connection(
    declare: Callable[..., Host], tmp_path: Path
) -> None:
    host = declare()
    line = [sys.executable, "-c", KILLED, host.address, str(host.ssh_config or ""), f"{sleep(4)} & {sleep(5)}"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, cwd=tmp_path) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        wait_until(lambda: is_alive(sleep(5)))
        process.kill()
    wait_until(lambda: not is_alive(sleep(4)) and not is_alive(sleep(5)))
    config = str(host.ssh_config).encode()
    wait_until(lambda: not [words for words in command_lines() if words[0] == b"ssh" and config in words])


def test_the_socket_of_a_run_that_was_killed_is_removed_by_the_next_connection_and_none_in_use(
    server: SshServer, tmp_path: Path
) -> None:
    with ExitStack() as closing:
        in_use, following = KeptConnection("robot", server.config), KeptConnection("robot", server.config)
        closing.callback(in_use.close)
        closing.callback(following.close)
        ours, others = _socket_folder(in_use.command("true")), _socket_folders(server)
        line = [sys.executable, "-c", KILLED, "robot", str(server.config), sleep(6)]
        with subprocess.Popen(line, stdout=subprocess.PIPE, cwd=tmp_path) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            (left,) = _socket_folders(server) - others
            assert left.is_dir()
            wait_until(lambda: is_alive(sleep(6)))  # while a program is started, its process has the lock, too
            process.kill()
        its_own = _socket_folder(following.command("true"))
        wait_until(lambda: not left.exists())  # another process of this machine may be about to remove it
        assert in_use.is_connected()
        assert following.is_connected()
    assert not ours.exists()
    assert not its_own.exists()


def test_a_socket_that_its_ssh_removes_at_the_same_time_is_no_reason_to_leave_its_folder(
    server: SshServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = Path(tempfile.mkdtemp(prefix="robot-runner-ssh-", dir="/tmp"))
    (left / "ssh").touch()
    unlink = os.unlink

    def removed_by_somebody_else(path: Any, **options: Any) -> None:
        unlink(path, **options)
        raise FileNotFoundError(path)

    with monkeypatch.context() as patched:
        patched.setattr(os, "unlink", removed_by_somebody_else)
        following = KeptConnection("robot", server.config)
        following.command("true")
    following.close()
    assert not left.exists()


def _socket_folders(server: SshServer) -> set[Path]:
    masters = [list(map(os.fsdecode, words)) for words in command_lines() if b"-M" in words]
    return {_socket_folder(words) for words in masters if str(server.config) in words}


def _socket_folder(line: Sequence[str]) -> Path:
    return Path(line[line.index("-S") + 1]).parent


@pytest.mark.parametrize(
    ("facts", "problem"),
    [
        ({"address": "a b"}, "'a b' is not a host"),
        ({"address": "pi@robot", "fetch": ["nav.log"]}, "fetch names 'nav.log'"),
        ({"address": "pi@robot", "fetch": 5}, "fetch names 5"),
        ({"address": "pi@robot", "fetch": None}, "fetch names None"),
        ({"address": "pi@robot", "ssh_config": 5}, "ssh_config is 5"),
        ({"address": "pi@robot", "ready": "up"}, "ready is 'up'"),
        ({"address": "pi@robot", "reboot": Reboot.ONCE, "reboot_command": None}, "reboot_command is None"),
        ({"address": "pi@robot", "reboot": Reboot.ONCE, "reboot_command": ""}, "reboot_command is ''"),
        ({"address": "pi@robot", "back_within_s": 0}, "back_within_s is 0"),
        ({"address": "local", "reboot": Reboot.PER_RUN}, "reboot is Reboot.PER_RUN for this machine"),
        ({"address": "pi@robot", "reboot": "per_run"}, "reboot is 'per_run'"),
    ],
)
def test_a_host_that_cannot_be_is_refused(facts: dict[str, Any], problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        Host(**facts)


def test_names_with_addresses_are_hosts() -> None:
    assert are_hosts({"robot": "ssh://pi@robot:2222", "base": "local", "server": Host(address="x")})
    for odd in (["robot"], {"a b": "x"}, {"robot": 1}, {"robot": "-oProxyCommand=x"}, "robot"):
        assert not are_hosts(odd)


@pytest.mark.long
def test_paths_of_a_host_may_be_paths() -> None:
    assert Host(address="pi@robot", fetch=Path("/var/nav.log")).fetch == ("/var/nav.log",)
    assert Host(address="pi@robot", fetch=[Path("/a"), "~/b"]).fetch == ("/a", "~/b")
    assert Host(address="pi@robot", ssh_config="~nobody-of-this-name/config").ssh_config == Path(
        "~nobody-of-this-name/config"
    )
