"""The queue: what is added is executed once, one after another, whoever is killed and whatever is damaged."""

from __future__ import annotations

import errno
import json
import os
import random
import signal
import stat
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.forked_program import RUNS, ForkedProgram

from robot_runner.cli import queueing
from robot_runner.cli.queued_experiments import ExperimentQueue
from robot_runner.core.errors import StorageError
from robot_runner.core.storage.outliving import process_stat

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PATIENCE = 60.0
#: Its runs tell where two of one claim overlap.
CONFIG = """
import fcntl, time
from pathlib import Path
from robot_runner import ExperimentConfig, Factor, RunTableModel

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = {name!r}
    results_output_path = "results"
    claims = [{claim!r}]
    grace_in_s = 2

    def launch_mission(self, context):
        here = Path(__file__).parent
        with (here / {claim!r}).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                (here / "overlapped").touch()
            (here / (self.experiment_name + ".begun")).touch()
            time.sleep({seconds} * context.combination["N"])
            {mission}

    def create_run_table(self):
        return RunTableModel([Factor("N", [1, 1.1, 1.2])])
"""
HOLDING = """
import sys
from pathlib import Path
from robot_runner.core.storage.claim_locks import HeldClaims
with HeldClaims(["alice"], "by hand", Path("/results/by_hand")):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def _own_state(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def config(tmp_path: Path) -> Callable[..., Path]:
    def write(name: str, claim: str = "alice", seconds: float = 0.05, mission: str = "pass") -> Path:
        path = tmp_path / f"{name}.py"
        path.write_text(CONFIG.format(name=name, claim=claim, seconds=seconds, mission=mission))
        return path

    return write


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []

    def begin(*words: object) -> subprocess.Popen[str]:
        process = ForkedProgram(
            "robot_runner",
            [*map(str, words)],
            RUNS,
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        for pid in (*children_of(process.pid), process.pid):
            with suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)
        process.communicate()


@pytest.fixture
def holder() -> Iterator[subprocess.Popen[str]]:
    """A process that holds a claim, as an experiment does that somebody executes by hand."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDING], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def children_of(parent: int) -> list[int]:
    numbers = [int(each.name) for each in Path("/proc").iterdir() if each.name.isdigit()]
    return [number for number in numbers if process_stat(number)[1:2] == [str(parent)]]


def until(condition: Callable[[], Any], what: str) -> Any:
    deadline = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < deadline, what
        time.sleep(0.02)
    return found


def line_with(process: subprocess.Popen[str], text: str) -> str:
    assert process.stdout is not None
    return next(line for line in process.stdout if text in line)


def done_runs(folder: Path) -> Counter[str]:
    records = map(json.loads, (folder / "journal.jsonl").read_text().splitlines())
    return Counter(each["run"] for each in records if each["kind"] == "attempt_finished" and each["status"] == "done")


@pytest.mark.long
def test_who_wants_a_claimed_robot_is_refused_with_a_name_or_waits_and_ctrl_c_leaves_it_in_the_queue(
    robot_runner: Callable[..., Any],
    config: Callable[..., Path],
    start: Callable[..., subprocess.Popen[str]],
    holder: subprocess.Popen[str],
    tmp_path: Path,
) -> None:
    path = config("first", seconds=0, mission='while not (here / "may_end").exists(): time.sleep(0.01)')
    refused = robot_runner("run", path)
    assert refused.code == 2
    assert "alice is in use by the experiment 'by hand' in /results/by_hand" in refused.err
    assert "robot-runner queue add" in refused.err

    waiting = start("run", path, "--wait", "--plain")
    assert "the experiment 'by hand'" in line_with(waiting, "Waiting for claims")
    waiting.send_signal(signal.SIGINT)
    assert waiting.wait(PATIENCE) == 130

    added = robot_runner("queue", "add", path, "--workers", "1")
    assert added.code == 0
    assert "in use by the experiment 'by hand'" in added.out
    assert "robot-runner queue run" in added.out
    runner = start("queue", "run")
    assert "1 (first) waits for alice, in use by the experiment 'by hand'" in line_with(runner, "waits for")
    listed = robot_runner("queue", "list", "--json").json
    assert listed["is_attended"]
    assert listed["experiments"][0]["state"] == "waits"
    assert "'by hand'" in listed["experiments"][0]["in_words"]
    assert listed["experiments"][0]["options"] == ["--set=workers=1"]

    holder.kill()
    until((tmp_path / "first.begun").exists, "the experiment begins once the claim is free")
    assert "executed since" in robot_runner("queue").out
    assert "is being executed" in robot_runner("queue", "drop", 1).err
    runner.send_signal(signal.SIGINT)
    output, _ = runner.communicate(timeout=PATIENCE)
    assert runner.returncode == 130, output
    assert "1 (first) stays in the queue" in output
    assert "waits for its turn" in robot_runner("queue").out
    (tmp_path / "may_end").touch()
    last = start("queue", "run")
    assert last.wait(PATIENCE) == 0
    assert set(done_runs(tmp_path / "results" / "first").values()) == {1}
    assert robot_runner("queue", "list", "--json").json["experiments"][0]["state"] == "done"
    assert robot_runner("queue", "drop", "--ended").code == 0
    assert "is empty" in robot_runner("queue").out
    assert "the queue is empty" in robot_runner("queue", "drop", 1).err


def test_what_is_added_is_told_to_a_program_and_what_is_to_be_dropped_is_named(
    robot_runner: Callable[..., Any], config: Callable[..., Path]
) -> None:
    added = robot_runner("queue", "add", config("first"), "--json").json
    assert (added["number"], added["experiment"], added["in_words"]) == (1, "first", "waits for its turn")
    assert "environment" not in added
    refused = robot_runner("queue", "drop")
    assert refused.code == 2
    assert "NUMBER is missing" in refused.err
    assert "--ended names all that have ended" in robot_runner("queue", "drop", 2, "--ended").err
    assert [each.number for each in ExperimentQueue().read()[0]] == [1]
    timed = config("timed")
    timed.write_text(timed.read_text().replace("'timed'", 'f"timed_{time.time_ns()}"'))  # its name is kept
    added = robot_runner("queue", "add", timed, "--json").json
    assert added["options"] == [f"--set=experiment_name={added['experiment']}"]


@pytest.mark.long
def test_two_runners_that_are_killed_at_random_execute_everything_once_and_lose_nothing(
    robot_runner: Callable[..., Any],
    config: Callable[..., Path],
    start: Callable[..., subprocess.Popen[str]],
    tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:
    chance = random.Random(7)  # noqa: S311 - kills need no cryptography
    for name, claim, mission in (
        ("first", "alice", "pass"),
        ("broken", "alice", "raise ValueError('out of tune')"),
        ("second", "alice", "pass"),
        ("other", "bob", "pass"),
    ):
        assert robot_runner("queue", "add", config(name, claim, 0.15, mission)).code == 0
    queue = ExperimentQueue()
    kills = 0
    while kills < 6 and any(not each.has_ended for each in queue.read()[0]):
        runners = [start("queue", "run") for _ in range(2)]
        while kills < 6 and all(each.poll() is None for each in runners):
            time.sleep(chance.uniform(0.2, 1.0))
            runner = chance.choice(runners).pid
            for victim in chance.choice([[runner], children_of(runner), [*children_of(runner), runner]]):
                with suppress(ProcessLookupError):
                    os.kill(victim, signal.SIGKILL)
                    kills += 1
    last = start("queue", "run")
    output, _ = last.communicate(timeout=2 * PATIENCE)
    until(lambda: all(each.has_ended for each in queue.read()[0]), "what others had begun ends")

    known, findings = queue.read()
    assert not findings
    assert [(each.experiment, each.exit_code) for each in known] == [
        ("first", 0),
        ("broken", 1),
        ("second", 0),
        ("other", 0),
    ], output
    assert "some run failed: robot-runner status" in known[1].problem
    for name in ("first", "second", "other"):
        assert list(done_runs(tmp_path / "results" / name).values()) == [1, 1, 1]
    assert not (tmp_path / "overlapped").exists()
    request.node.user_properties.append(("faults", kills))


@pytest.mark.long
def test_an_experiment_whose_process_is_killed_twice_is_begun_again_after_a_rest_and_a_longer_one(
    robot_runner: Callable[..., Any], config: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(queueing, "_REST", 0.01)
    assert robot_runner("queue", "add", config("first", seconds=0)).code == 0
    begun, python = tmp_path / "begun", tmp_path / "python"
    python.write_text(
        f'#!/bin/sh\necho begun >>"{begun}"\n[ $(wc -l <"{begun}") -gt 2 ] || kill -KILL $$\n'
        f'exec "{sys.executable}" "$@"\n'
    )
    python.chmod(0o700)
    queue = ExperimentQueue()
    (added,), _ = queue.read()
    queue.write(replace(added, python=str(python)))
    answer = robot_runner("queue", "run")
    told = [line for line in answer.out.splitlines() if line.startswith("the process of")]
    assert told == [
        f"the process of 1 (first) was killed by signal 9; it is begun again in {rest} s" for rest in ("0.01", "0.02")
    ]
    assert answer.code == 0
    assert list(done_runs(tmp_path / "results" / "first").values()) == [1, 1, 1]


def test_a_runner_that_is_slower_than_another_tells_no_error(
    robot_runner: Callable[..., Any], config: Callable[..., Path]
) -> None:
    assert robot_runner("queue", "add", config("first", seconds=0)).code == 0
    with ExperimentQueue().taken(1):  # by another runner, between the look of this one and the start of its process
        program = [sys.executable, "-m", "robot_runner", "queue", "run", "1"]
        by_user, of_runner = (
            subprocess.run(program, env={**os.environ, **more}, capture_output=True, text=True, check=False)
            for more in ({}, {queueing._BY_RUNNER: "1"})
        )
    assert "experiment 1 is being executed" in by_user.stderr
    assert (of_runner.stdout, of_runner.stderr, of_runner.returncode) == ("", "", 2)


def test_an_experiment_for_which_there_is_no_process_at_first_is_begun_again_after_a_rest(
    robot_runner: Callable[..., Any], config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(queueing, "_REST", 0.01)
    assert robot_runner("queue", "add", config("first", seconds=0)).code == 0
    started, refusals = subprocess.Popen, [errno.EAGAIN, errno.ENOMEM]

    def start(*words: Any, **options: Any) -> subprocess.Popen[Any]:
        if refusals:
            number = refusals.pop(0)
            raise OSError(number, os.strerror(number))
        return started(*words, **options)

    monkeypatch.setattr(subprocess, "Popen", start)
    answer = robot_runner("queue", "run")
    told = [line for line in answer.out.splitlines() if line.startswith("the process of")]
    assert told == [
        f"the process of 1 (first) cannot be started: {os.strerror(number)}; it is begun again in {rest} s"
        for number, rest in ((errno.EAGAIN, "0.01"), (errno.ENOMEM, "0.02"))
    ]
    assert answer.code == 0


@pytest.mark.long
def test_what_is_damaged_changed_gone_or_not_to_be_kept_is_told_and_holds_up_nobody(
    robot_runner: Callable[..., Any], config: Callable[..., Path], start: Callable[..., subprocess.Popen[str]]
) -> None:
    changed, gone, whole = config("changed", seconds=0), config("gone", seconds=0), config("whole", "bob", seconds=0)
    refused = robot_runner("queue", "add", whole, "--set", "db_password=swordfish", "--redo", "r_1")
    assert refused.code == 2
    assert "is a secret, which is not kept in the queue" in refused.err
    assert "--redo would execute these runs once more" in refused.err
    assert f"robot-runner run {whole} --redo r_1 --wait" in refused.err
    assert "swordfish" not in refused.err
    for path in (changed, gone, whole):
        assert robot_runner("queue", "add", path).code == 0
    folder = ExperimentQueue().folder
    assert folder.stat().st_mode & 0o777 == 0o700
    assert all(each.stat().st_mode & 0o777 == 0o600 for each in folder.iterdir())
    (folder / "4.json").write_text('{"config": 7, "claims": [[[]]]}')
    (folder / "5.json").symlink_to(whole)
    (folder / "6.json").write_bytes(b"\xff\x00")
    changed.write_text(changed.read_text() + "# changed\n")
    gone.unlink()

    listed = robot_runner("queue")
    assert listed.code == 0
    assert "the config has changed since then" in listed.out
    assert "the config cannot be read" in listed.out
    for number, problem in ((4, "config is 7, not a text"), (5, "a symbolic link"), (6, "not text in UTF-8")):
        assert problem in listed.err.replace("not valid JSON", "not text in UTF-8")
        assert f"robot-runner queue drop {number}" in listed.err
    runner = start("queue", "run")
    output, _ = runner.communicate(timeout=PATIENCE)
    assert runner.returncode == 1, output
    known, findings = ExperimentQueue().read()
    assert [each.exit_code for each in known] == [0, 2, 0], output
    assert "it is executed as it is now" in known[0].problem
    assert "the config cannot be read" in known[1].problem
    assert len({finding.where for finding in findings}) == 3
    assert robot_runner("queue", "drop", 4, 5, 6).code == 0
    assert whole.exists()
    assert "There are: " in robot_runner("queue", "drop", 9).err
    assert "'list'" in robot_runner("queue", "lst").err
    folder.chmod(0o777)
    assert "others may write in the folder of the queue" in robot_runner("queue").err


@pytest.mark.long
def test_what_wants_a_robot_that_may_be_moving_waits_until_somebody_has_looked(
    robot_runner: Callable[..., Any],
    config: Callable[..., Path],
    start: Callable[..., subprocess.Popen[str]],
    tmp_path: Path,
) -> None:
    moving, same, other = (config(name, claim, 0) for name, claim in (("moving", "a"), ("same", "a"), ("other", "b")))
    said = "    def before_run(self, context): raise OSError('THE ROBOT MAY BE MOVING: the cable is out')\n"
    moving.write_text(moving.read_text().replace("    def launch_mission", f"{said}    def launch_mission"))
    for path in (moving, same, other):
        assert robot_runner("queue", "add", path).code == 0
    runner = start("queue", "run")
    until((tmp_path / "other.begun").exists, "what wants another robot is executed")
    assert "take it out: robot-runner queue drop 1" in line_with(runner, "2 (same) waits for")
    assert "1 (moving), after which THE ROBOT MAY BE MOVING" in robot_runner("queue").out
    assert not (tmp_path / "same.begun").exists()
    assert "waits for 1 (moving)" in robot_runner("queue", "add", same).out
    assert robot_runner("queue", "drop", 1, 4).code == 0
    runner.communicate(timeout=PATIENCE)
    assert runner.returncode == 1
    assert set(done_runs(tmp_path / "results" / "same").values()) == {1}


FACTS: dict[str, Any] = {
    "config": "/e.py", "options": [], "started_in": "/", "experiment": "e", "results": "/e", "claims": [],
    "python": "python", "environment": {}, "config_sha256": "",
}  # fmt: skip


def test_who_takes_out_all_that_have_ended_leaves_one_whose_robot_nobody_has_looked_at(
    robot_runner: Callable[..., Any],
) -> None:
    queue = ExperimentQueue()
    for problem in ("some run failed", "THE ROBOT MAY BE MOVING; some run failed"):
        queue.write(replace(queue.add(**FACTS), ended_at="2026-01-01T00:00:00.000Z", exit_code=1, problem=problem))
    dropped = robot_runner("queue", "drop", "--ended")
    assert "1 is out of the queue" in dropped.out
    assert "2 stays in the queue: THE ROBOT MAY BE MOVING; look at it, then name it: " in dropped.out
    assert [each.number for each in queue.read()[0]] == [2]
    assert "2 is out of the queue" in robot_runner("queue", "drop", 2).out
    assert queue.read() == ([], [])


def test_the_number_of_an_experiment_that_was_dropped_is_given_to_no_other() -> None:
    queue, facts = ExperimentQueue(), FACTS
    assert [queue.add(**facts).number for _ in range(11)] == list(range(1, 12))
    for number in (11, 10, 2):
        queue.drop(number)
    assert queue.add(**facts).number == 12
    (queue.folder / "adding.lock").write_text("what is it")
    assert queue.add(**facts).number == 13


@pytest.mark.parametrize("fails", ["pwrite", "fsync"])
def test_an_experiment_that_is_refused_as_the_disk_fails_is_not_in_the_queue(
    monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    queue = ExperimentQueue()
    kept = queue.add(**FACTS)
    real = getattr(os, fails)

    def failing(descriptor: int, *words: Any) -> Any:
        # The last step of each: the folder is flushed after the file in it was renamed, and the number is written.
        if fails == "fsync" and not stat.S_ISDIR(os.fstat(descriptor).st_mode):
            return real(descriptor, *words)
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as disk:
        disk.setattr(os, fails, failing)
        with pytest.raises(StorageError, match=os.strerror(errno.EIO)):
            queue.add(**FACTS)
    assert queue.read() == ([kept], [])
    assert queue.add(**FACTS).number > kept.number


def test_an_experiment_is_not_in_the_queue_where_ctrl_c_ended_adding_it(monkeypatch: pytest.MonkeyPatch) -> None:
    queue, write = ExperimentQueue(), ExperimentQueue.write

    def write_and_interrupt(*words: Any) -> None:
        write(*words)
        raise KeyboardInterrupt

    monkeypatch.setattr(ExperimentQueue, "write", write_and_interrupt)
    with pytest.raises(KeyboardInterrupt):
        queue.add(**FACTS)
    assert queue.read() == ([], [])
