"""The programs that are sent on board, executed here by the shells that are here."""

from __future__ import annotations

import ast
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.measuring.busy_core import (
    FAMILY,
    ZOMBIE,
    busy_core,
    busy_family,
    counted_seconds,
    late_program,
    needs_affinity,
    wait,
    wait_for_samples,
)
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.window import Window
from robot_runner.measuring import on_board_session
from robot_runner.measuring.on_board import loop
from robot_runner.measuring.on_board_session import FORMS, REMOTE_COMMAND, OnBoardSession, new_token
from robot_runner.measuring.ssh_host import SshHost
from robot_runner.measuring.utilisation import Selection, Utilisation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PROGRAMS = Path(__file__).parents[2] / "src" / "robot_runner" / "measuring" / "on_board"
SHELLS = [shell for shell in ("dash", "bash", "busybox", "sh") if shutil.which(shell)]
PYTHON_AND_SHELL = ["python3", "sh"]
EVERY_FORM = [*PYTHON_AND_SHELL, "ps"]

pytestmark = pytest.mark.skipif(not Path("/proc/uptime").exists(), reason="these loops read Linux's /proc")


@pytest.fixture
def host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., SshHost]]:
    """Return what makes a host that is this machine, reached through a shell instead of ssh."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    made: list[SshHost] = []

    def make(form: str | None = None, *, command: list[str] | None = None) -> SshHost:
        made.append(SshHost("here", SystemClock(), form=form, command=command or ["sh", "-c", REMOTE_COMMAND]))
        return made[-1]

    yield make
    for each in made:
        each.close()
    assert list(tmp_path.glob("robot-runner-samples-*")) == []


def test_the_loop_keeps_to_an_old_python() -> None:
    ast.parse((PROGRAMS / "loop.py").read_text(), feature_version=(3, 6))


def test_the_loop_needs_no_clock_that_an_old_python_has_no_name_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("time.CLOCK_BOOTTIME", raising=False)  # Python has it from 3.7 on
    processes = loop.Processes([f"pid:{os.getpid()}"])
    assert f"0:{os.getpid()}:" in " ".join(processes.counters(0.0))


def test_the_best_way_is_chosen() -> None:
    session = OnBoardSession(["sh", "-c", REMOTE_COMMAND], where="here", clock=SystemClock())
    assert session.form == "python3"
    session.close()


def test_a_process_that_is_new_is_seen_by_the_next_sample_of_the_loop_in_python() -> None:
    processes = loop.Processes([f"subject:{FAMILY}"])
    assert processes.counters(0.0) == []
    with busy_family() as busy:
        assert f"0:{busy.pid}:" in " ".join(processes.counters(0.05))


def test_a_script_that_turns_into_a_program_is_seen_by_the_next_sample_of_the_loop_in_python(tmp_path: Path) -> None:
    with late_program(tmp_path) as (name, pid, turn):
        processes = loop.Processes([f"name:{name}"])
        for look in range(6):
            assert processes.counters(look * 0.05) == []
        turn()
        assert f"0:{pid}:" in " ".join(processes.counters(0.3))


@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_samples_come_at_the_rate_and_are_placed_on_the_runs_clock(host: Callable[..., SshHost], form: str) -> None:
    clock = SystemClock()
    link = host(form)
    begun = clock.now()
    sampler = link.sample_utilisation(20.0)
    wait_for_samples(15, sampler)
    samples = sampler.stop()
    ended = clock.now()
    report = sampler.report()
    assert report.problems == ()
    assert report.rate == 20.0
    assert FORMS[form].description == report.form
    assert begun - 0.05 <= samples[0].time <= samples[-1].time <= ended + 0.05
    assert 15 < len(samples) <= 20.0 * (ended - begun) + 3
    assert samples[0].cpu is None
    told = [sample for sample in samples[1:] if sample.cpu is not None]
    assert all(0.0 <= sample.cpu <= 100.0 and 0.0 < sample.memory < 100.0 for sample in told)
    assert len(samples[0].cores) == os.cpu_count()
    assert sampler.stop() is samples


@pytest.mark.long
@needs_affinity
@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_a_busy_core_reads_100_percent_and_its_process_what_the_kernel_says(
    host: Callable[..., SshHost], form: str
) -> None:
    with busy_core() as busy:
        begun = time.monotonic()
        sampler = host(form).sample_processes(10.0, [f"pid:{busy.pid}"])
        spent = -busy.cpu_seconds
        wait(1.5)
        samples = sampler.stop()
        spent += busy.cpu_seconds
        unseen = time.monotonic() - begun - (samples[-1].time - samples[0].time)  # before and after the samples
    spans = [(late.time - soon.time, late) for soon, late in pairwise(samples) if late.cores[busy.core] is not None]
    mean = sum(span * late.cores[busy.core] for span, late in spans) / sum(span for span, _ in spans)
    assert mean == pytest.approx(100.0, abs=2.0)
    assert spent - unseen - 0.12 <= counted_seconds(samples) <= spent + 0.12


@pytest.mark.long
@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_children_of_a_subject_that_come_and_go_between_two_looks_are_counted(
    host: Callable[..., SshHost], form: str
) -> None:
    with busy_family() as busy:
        begun = time.monotonic()
        sampler = host(form).sample_processes(10.0, ["name:nobody", f"subject:{FAMILY}"])
        spent = -busy.cpu_seconds
        wait(1.2)
        samples = sampler.stop()
        spent += busy.cpu_seconds
        unseen = time.monotonic() - begun - (samples[-1].time - samples[0].time)  # before and after the samples
    assert spent - unseen - 0.2 <= counted_seconds(samples, 1) <= spent + 0.2


@pytest.mark.long
@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_a_child_that_is_awaited_long_after_it_has_ended_counts_once(host: Callable[..., SshHost], form: str) -> None:
    with busy_family(program=ZOMBIE) as busy:
        sampler = host(form).sample_processes(20.0, [f"subject:{FAMILY}"])
        busy.wait_for_children(0.3)
        wait(0.2)
        samples = sampler.stop()
        spent = busy.cpu_seconds
    assert counted_seconds(samples) == pytest.approx(spent, abs=0.2)


@pytest.mark.long
def test_what_a_subject_has_started_belongs_to_it_where_its_mark_was_taken_away(host: Callable[..., SshHost]) -> None:
    with busy_family("sh", "-c", 'env -i "$@"; true', "sh"):
        sampler = host("python3").sample_processes(10.0, ["name:nobody", f"subject:{FAMILY}"])
        wait(0.5)
        assert sampler.stop()[-1].processes[1].count >= 2  # the shell, and what sudo would have started


@pytest.mark.long
@needs_affinity
def test_ps_is_asked_for_cpu_time_and_not_for_the_share_of_a_lifetime(host: Callable[..., SshHost]) -> None:
    with busy_core() as busy:
        sampler = host("ps").sample_processes(10.0, [f"pid:{busy.pid}"])
        spent, looked = -busy.cpu_seconds, -time.monotonic()
        wait(3.3)
        wait_for_samples(2, sampler)
        samples = sampler.stop()
        spent, looked = spent + busy.cpu_seconds, looked + time.monotonic()
    assert sampler.report().rate == 1.0
    assert 3 <= len(samples) <= looked + 2
    seconds = samples[-1].time - samples[0].time
    counted = [(late.time - soon.time) * late.processes[0].cpu for soon, late in pairwise(samples)]
    # ps tells whole seconds, so that each end may be wrong by one.
    assert sum(counted) / 100 * os.cpu_count() == pytest.approx(spent * seconds / looked, abs=1.1)
    assert samples[-1].cores == ()


@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_streamed_samples_are_there_before_the_stop(host: Callable[..., SshHost], form: str) -> None:
    link = host(form)
    sampler = link.sample_processes(20.0, (), is_streamed=True)
    arrived = wait_for_samples(4, sampler)
    assert len(sampler.stop()) > arrived
    assert sampler.report().problems == ()


@pytest.mark.parametrize("form", EVERY_FORM)
def test_processes_are_found_by_name_and_by_node(host: Callable[..., SshHost], form: str, tmp_path: Path) -> None:
    program = tmp_path / "a_long_name_for_a_node"
    shutil.copy(shutil.which("sleep") or "/bin/sleep", program)
    pid = os.posix_spawn(program, [str(program), "30"], dict(os.environ))
    node = os.posix_spawn(
        "/bin/sh",
        ["sh", "-c", "sleep 30; :", "--ros-args", "-r", "__node:=talker", "-r", "__ns:=/alice"],
        {**os.environ},
    )
    starter = tmp_path / "ros2"  # waits for the node that it started, with all of its arguments
    starter.write_text("sleep 30; :")
    starting = os.posix_spawn("/bin/sh", ["sh", str(starter), "run", "nav", "talker", "__node:=talker"], {**os.environ})
    nodes = ["node:/talker", "node:/alice/talker", "node:/bob/talker", "node:/alice/talk", "node:/talk"]
    try:
        sampler = host(form).sample_processes(10.0, [f"name:{program.name}", *nodes, "name:nobody"])
        wait(0.3)
        last = sampler.stop()[-1]
    finally:
        for child in (pid, node, starting):
            os.kill(child, 9)
            os.waitpid(child, 0)
    assert [one.count for one in last.processes] == [1, 1, 1, 0, 0, 0, 0]
    assert last.processes[0].memory > 0.0


@pytest.mark.skipif(shutil.which("busybox") is None, reason="needs busybox")
def test_nodes_and_subjects_are_found_on_a_computer_that_has_busybox_alone(
    host: Callable[..., SshHost], tmp_path: Path
) -> None:
    subprocess.run(["busybox", "--install", "-s", str(tmp_path)], check=True)
    command = ["env", "-i", f"PATH={tmp_path}", f"TMPDIR={tmp_path}", "sh", "-c", REMOTE_COMMAND]
    words = ["sh", "-c", "read line # a", "--ros-args", "-r", "__node:=ear"]
    environment = {**os.environ, "ROBOT_RUNNER_SUBJECT": "Nav"}
    with subprocess.Popen(words, stdin=subprocess.PIPE, env=environment) as process:
        sampler = host("sh", command=command).sample_processes(20.0, ["node:/ear", "subject:Nav", "node:/ea"])
        wait_for_samples(1, sampler)
        counts = [each.count for each in sampler.stop()[-1].processes]
        assert process.stdin is not None
        process.stdin.close()
    assert counts == [1, 1, 0]


@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_files_are_read_at_the_rate(host: Callable[..., SshHost], form: str, tmp_path: Path) -> None:
    (tmp_path / "power").write_text("7500\nmore\n")
    (tmp_path / "empty").write_text("")
    paths = [str(tmp_path / name) for name in ("power", "empty", "nothing")]
    link = host(form)
    sampler = link.sample_files(20.0, paths)
    wait_for_samples(4, sampler)
    samples = sampler.stop()
    assert len(samples) >= 4
    assert samples[0].lines[0] == "7500"
    assert samples[0].lines[2] is None
    assert link.read_files(paths)[0] == "7500"
    assert link.list_files(f"{tmp_path}/*e*") == [str(tmp_path / name) for name in ("empty", "power")]


@pytest.mark.parametrize("shell", SHELLS)
def test_the_shell_loop_works_in_every_shell_that_is_here(host: Callable[..., SshHost], shell: str) -> None:
    words = ["busybox", "sh"] if shell == "busybox" else [shell]
    command = [*words, "-c", REMOTE_COMMAND.replace("exec sh", f"exec {' '.join(words)}")]
    link = host("sh", command=command)
    sampler = link.sample_processes(20.0, ["pid:1"])
    wait_for_samples(5, sampler)
    samples = sampler.stop()
    assert sampler.report().problems == ()
    assert len(samples) >= 5
    assert samples[-1].processes[0].count == 1


@pytest.mark.parametrize("chatter", ["echo Welcome; echo 'robot-runner says hello'", r"printf '\033]0;pi@robot\007'"])
def test_a_login_that_chatters_does_no_harm(host: Callable[..., SshHost], chatter: str) -> None:
    link = host(command=["sh", "-c", f"{chatter}; {REMOTE_COMMAND}"])
    assert link.read_files(["/dev/null"]) == [""]


@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_the_words_of_command_lines_are_told_apart(host: Callable[..., SshHost], form: str) -> None:
    words = ["sh", "-c", "read line # a\tb", "--ros-args", "__node:=ear"]
    with subprocess.Popen(words, stdin=subprocess.PIPE) as process:
        (told,) = host(form).read_files([f"/proc/{process.pid}/cmdline"])
        assert process.stdin is not None
        process.stdin.close()
    assert told.rstrip("\0").split("\0") == [word.replace("\t", " ") for word in words]


@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_a_line_with_tabs_is_read_as_one(host: Callable[..., SshHost], form: str, tmp_path: Path) -> None:
    (tmp_path / "tabs").write_text("a\tb\t\n")
    paths = [str(tmp_path / "tabs"), "/proc/sys/kernel/ostype"]
    assert host(form).read_files(paths) == ["a b ", "Linux"]
    sampler = host(form).sample_files(20.0, paths)
    wait_for_samples(1, sampler)
    assert {sample.lines for sample in sampler.stop()} == {("a b ", "Linux")}


@pytest.mark.long
@pytest.mark.skipif(shutil.which("localedef") is None, reason="needs localedef")
def test_ps_is_understood_where_numbers_have_a_decimal_comma(host: Callable[..., SshHost], tmp_path: Path) -> None:
    german = tmp_path / "de_DE.UTF-8"
    subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", str(german)], capture_output=True, check=False)
    if not german.is_dir():
        pytest.skip("the sources of this locale are not installed")
    settings = f"LOCPATH={tmp_path} LC_ALL=de_DE.UTF-8; export LOCPATH LC_ALL"
    sampler = host("ps", command=["sh", "-c", f"{settings}; {REMOTE_COMMAND}"]).sample_utilisation(10.0)
    wait_for_samples(1, sampler)
    assert sampler.stop()
    assert sampler.report().problems == ()


def test_a_way_that_the_computer_does_not_have_is_refused(host: Callable[..., SshHost], tmp_path: Path) -> None:
    for tool in ("sh", "cat", "printf", "ps", "awk"):
        if found := shutil.which(tool):
            (tmp_path / tool).symlink_to(found)
    link = host("python3", command=["env", f"PATH={tmp_path}", "sh", "-c", REMOTE_COMMAND])
    with pytest.raises(LinkError, match="cannot be sampled by python3") as raised:
        link.sample_utilisation(10.0)
    assert raised.value.fix == "Choose among what it can: sh, ps."


def test_without_python_the_shell_samples(host: Callable[..., SshHost], tmp_path: Path) -> None:
    for tool in ("sh", "cat", "ps", "awk", "sleep", "date", "getconf", "grep", "rm", "tr", "sed"):
        if found := shutil.which(tool):
            (tmp_path / tool).symlink_to(found)
    sampler = host(command=["env", f"PATH={tmp_path}", "sh", "-c", REMOTE_COMMAND]).sample_utilisation(10.0)
    wait(0.3)
    assert len(sampler.stop()) >= 2
    assert sampler.report().form == FORMS["sh"].description


def test_without_getconf_sysctl_and_nproc_the_cores_are_counted(host: Callable[..., SshHost], tmp_path: Path) -> None:
    for tool in ("sh", "cat", "ps", "awk", "sleep", "date", "grep", "rm", "tr", "sed"):
        if found := shutil.which(tool):
            (tmp_path / tool).symlink_to(found)
    command = ["env", f"PATH={tmp_path}", "sh", "-c", REMOTE_COMMAND]
    for form in ("sh", "ps"):
        sampler = host(form, command=command).sample_utilisation(10.0)
        wait(0.2)
        sampler.stop()
        assert sampler._cores == os.cpu_count()


def test_cores_are_those_of_the_computer_and_not_those_that_the_session_may_use(
    host: Callable[..., SshHost], tmp_path: Path
) -> None:
    # Without getconf, nproc tells how many the session may use: fewer where some are isolated (isolcpus).
    for tool in ("sh", "awk", "sleep", "date", "grep", "rm", "tr", "sed"):
        (tmp_path / tool).symlink_to(shutil.which(tool) or tool)
    (tmp_path / "nproc").write_text("#!/bin/sh\necho 77\n")
    (tmp_path / "nproc").chmod(0o755)
    sampler = host("sh", command=["env", f"PATH={tmp_path}", "sh", "-c", REMOTE_COMMAND]).sample_utilisation(10.0)
    sampler.stop()
    assert sampler._cores == os.cpu_count()


def test_a_form_that_counts_in_whole_seconds_is_doubted_with_how_far_it_may_be_off(
    host: Callable[..., SshHost],
) -> None:
    clock = SystemClock()
    start = clock.now()
    sampler = host("ps").sample_utilisation(1.0)
    wait(2.2)
    samples = sampler.stop()
    window = Window(start, start + 2.0)
    measured = Utilisation(samples, window, Selection(), sampler.report(), is_simulated=False)
    processor, memory = (each for each in measured.doubted() if each.problem.startswith("ps reports"))
    assert "may be off by 50 % of a core" in processor.problem
    assert memory.measures == ("Memory",)


@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_samples_that_a_killed_run_left_on_board_are_removed_by_the_next_session(
    host: Callable[..., SshHost], tmp_path: Path, form: str
) -> None:
    killed = f"""
import os, sys, time
from robot_runner.core.events.context import SystemClock
from robot_runner.measuring.on_board_session import REMOTE_COMMAND
from robot_runner.measuring.ssh_host import SshHost
host = SshHost("here", SystemClock(), form={form!r}, command=["sh", "-c", REMOTE_COMMAND])
sampler = host.sample_utilisation(20.0)
while open(sampler._path).read().count("\\n") < 2:  # whose they are, and a first sample
    time.sleep(0.01)
os.kill(os.getpid(), 9)
"""
    assert subprocess.run([sys.executable, "-c", killed], check=False, timeout=60).returncode == -9
    (left,) = tmp_path.glob("robot-runner-samples-*")
    holder = int(re.search(r"pid\t(\d+)", left.read_text()).group(1))
    assert _is_alive(holder)  # it goes on for a while, should the connection come back
    link = host(form)
    link.connect()
    assert not left.exists()
    wait_until(lambda: not _is_alive(holder))


@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_a_pipe_in_the_place_of_samples_that_were_left_holds_nothing_up(
    host: Callable[..., SshHost], tmp_path: Path, form: str
) -> None:
    """Another user of the computer may make it, and so kept it from being sampled."""
    pipe = tmp_path / f"{loop.PREFIX}{new_token().partition('-')[0]}-999999999-ab"
    os.mkfifo(pipe)
    link = host(form)
    link.connect()
    assert link.list_files(str(pipe)) == [str(pipe)]
    pipe.unlink()


def test_samples_of_a_run_that_goes_on_are_left_alone(host: Callable[..., SshHost], tmp_path: Path) -> None:
    first = host().sample_utilisation(20.0)
    foreign = tmp_path / "robot-runner-samples-0123456789abcdef-1-0123456789abcdef"
    foreign.write_text("pid\t999999999\n")
    host().connect()
    wait_for_samples(3, first)
    assert foreign.exists()  # somebody else's, who may want them
    foreign.unlink()
    assert len(first.stop()) >= 3


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_a_sample_that_was_not_kept_whole_is_left_out_of_what_is_recovered(
    host: Callable[..., SshHost], tmp_path: Path, form: str
) -> None:
    kept = tmp_path / "robot-runner-samples-0123456789abcdef-1-0123456789abcdef"
    kept.write_text("pid\t999999999\nf\t1.0\t=7500000\nf\t2.0\t=75")  # the disk was full
    session = host(form)._session()
    session.recover(str(kept))
    assert session.samples == [["f", "1.0", "=7500000"]]
    assert not kept.exists()


@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_a_loop_that_is_told_to_leave_ends_at_once(
    host: Callable[..., SshHost], form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(on_board_session, "_LAST_WORDS", PATIENCE)  # and no signal ends it
    link = host(form)
    sampler = link.sample_utilisation(20.0)
    wait_for_samples(2, sampler)
    session = sampler._session
    session.close()
    assert session._process.returncode == 0
    sampler.stop()  # recovers what was kept


@pytest.mark.parametrize("lease", [2, 600])
@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_a_loop_without_its_connection_ends_after_its_lease_and_not_before(
    host: Callable[..., SshHost], form: str, lease: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(on_board_session, "_LEASE", lease)
    link = host(form)
    sampler = link.sample_utilisation(20.0)
    wait_for_samples(2, sampler)
    sampler._session._process.stdin.close()  # as where a connection is cut
    holder = int(re.search(r"pid\t(\d+)", Path(sampler._path).read_text()).group(1))
    if lease > PATIENCE:
        wait_for_samples(20, sampler)
        assert _is_alive(holder)
        os.killpg(sampler._session._process.pid, signal.SIGKILL)
    wait_until(lambda: not _is_alive(holder))
    assert len(sampler.stop()) >= 2  # what it had kept by then


def test_a_computer_on_which_nobody_answers_is_an_error(host: Callable[..., SshHost]) -> None:
    with pytest.raises(LinkError, match="the connection is lost: the loop ended with code 3: no shell here"):
        host(command=["sh", "-c", "echo no shell here >&2; exit 3"]).sample_utilisation(10.0)


def test_a_program_that_is_not_there_is_an_error(host: Callable[..., SshHost]) -> None:
    with pytest.raises(LinkError, match="cannot be started"):
        host(command=["/no/such/ssh"]).sample_utilisation(10.0)


@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_two_samplers_do_not_disturb_each_other(host: Callable[..., SshHost], form: str) -> None:
    link = host(form)
    first, second = link.sample_utilisation(10.0), link.sample_files(10.0, ["/proc/uptime"])
    wait(0.3)
    assert len(first.stop()) >= 2
    assert len(second.stop()) >= 2
    third = link.sample_utilisation(10.0)  # over a session that is free again
    assert len(link._sessions) == 2
    third.stop()


@pytest.mark.parametrize("form", PYTHON_AND_SHELL)
def test_a_link_that_is_closed_leaves_nothing_behind(host: Callable[..., SshHost], form: str) -> None:
    link = host(form)
    sampler = link.sample_utilisation(10.0)
    process = sampler._session._process
    link.close()
    link.close()
    assert process.returncode is not None
    with pytest.raises(LinkError, match="was closed"):
        link.sample_utilisation(10.0)


@pytest.mark.parametrize("rate", [0.0, -1.0])
def test_a_rate_that_cannot_be_is_refused(host: Callable[..., SshHost], rate: float) -> None:
    with pytest.raises(LinkError, match="sample rate"):
        host().sample_utilisation(rate)
