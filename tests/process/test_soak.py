"""Kills at random moments: what was reported done is there, the table parses, resuming completes, nobody is left."""

from __future__ import annotations

import os
import random
import re
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

import pytest

from robot_runner.core.storage.outliving import process_stat

Start = Callable[..., Any]

#: Every eighth run starts an orphan with a session of its own, as a daemon has it.
BODY = """
grace_in_s = 2
def create_run_table(self):
    return RunTableModel([Factor("N", range(RUNS))], data_columns=["Square"], shuffle=True, seed=3)
def launch_mission(self, context):
    (context.raw_data_folder / "raw.txt").write_text(str(context.combination["N"]))
    print("number", context.combination["N"])
    if context.combination["N"] % 8 == 0:
        import subprocess
        subprocess.run(["setsid", "-f", "sleep", "600"], stdin=subprocess.DEVNULL)
def populate_run_data(self, context): return {"Square": context.combination["N"] ** 2}
"""
DONE = re.compile(r"run \d+ of \d+ \((r_\d+)[^)]*\) is done .*?: Square ([\d,.]+)")
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: How long one execution is tortured at most, s: it ends by itself some time afterwards.
LONGEST = 10.0


def keepers_of(experiment: Any, seconds: float) -> list[int]:
    """Wait until a run is being executed, for so long at most; return its keeper, or nobody."""
    deadline = time.monotonic() + seconds
    while experiment.process.poll() is None and time.monotonic() < deadline:
        orchestrator = [str(experiment.process.pid)]
        if found := [pid for pid in experiment.processes() if process_stat(pid)[1:2] == orchestrator]:
            return found
        time.sleep(0.005)
    return []


def victims_of(experiment: Any, chance: random.Random) -> tuple[str, list[int], signal.Signals]:
    """Choose what to send to whom: to the orchestrator, to one of its processes, or to several at one moment."""
    orchestrator, keepers, choice = [experiment.process.pid], keepers_of(experiment, 2.0), chance.random()
    if choice < 0.12:
        return "orchestrator", orchestrator, chance.choice(SIGNALS)
    if choice < 0.27:
        return "orchestrator and keeper", [*orchestrator, *keepers], signal.SIGKILL
    if choice < 0.35:
        return "everybody", [*orchestrator, *keepers, *experiment.processes()], signal.SIGKILL
    if choice < 0.75:  # often: the experiment goes on, and another need not be started
        return "keeper", keepers, signal.SIGKILL
    return "anybody", [chance.choice([*orchestrator, *experiment.processes()])], signal.SIGKILL


def torture_once(experiment: Any, chance: random.Random, killed: Counter[str]) -> None:
    """Inject faults at random moments until the orchestrator is gone; count them by whom they hit."""
    begun = time.monotonic()
    if chance.random() < 0.8:  # else while it starts
        keepers_of(experiment, 30.0)
    while experiment.process.poll() is None and time.monotonic() - begun < LONGEST:
        time.sleep(chance.uniform(0.0, 0.4))
        whom, victims, number = victims_of(experiment, chance)
        hit = send(dict.fromkeys(victims), number)
        killed[whom if len(hit) > 1 or " " not in whom else "orchestrator"] += len(hit)
        if experiment.process.pid in hit:
            break


def send(victims: Iterable[int], number: signal.Signals) -> list[int]:
    """Send a signal to all of them, stopped first, so that none can do anything about another one's end."""
    hit = list(victims)
    for sent in (signal.SIGSTOP, number) if len(hit) > 1 else (number,):
        for pid in list(hit):
            try:
                os.kill(pid, sent)
            except ProcessLookupError:
                hit.remove(pid)
    return hit


def torture(start: Start, write_config: Callable[..., Any], *, kills: int, runs: int, seed: int) -> Counter[str]:
    """Kill until so many processes were killed; return how many it were, by whom a fault hit."""
    chance = random.Random(seed)  # noqa: S311 - kills need no cryptography
    config = write_config(BODY.replace("RUNS", str(runs)), table="")
    reported: set[str] = set()
    earlier: list[Any] = []
    killed: Counter[str] = Counter()
    while killed.total() < kills:
        experiment = start(config=config)
        torture_once(experiment, chance, killed)
        experiment.end()
        if "starts: N=" in experiment.output:
            # Where all were killed at once, nobody was there to end their orphans before this one began.
            assert all(each.nobody_is_left() for each in earlier)
            earlier.clear()
        earlier.append(experiment)
        done = {run_id for run_id, _ in DONE.findall(experiment.output)}
        assert not done & reported, "a run that was reported done was executed again: it had been lost"
        reported |= done
        if not (experiment.folder / "run_table.csv").exists():
            continue
        assert len(experiment.table) == runs
        if experiment.statuses.count("Done") == runs:
            assert start(config=config).end() == 0
            for path in sorted(experiment.folder.rglob("*"), reverse=True):
                path.unlink() if path.is_file() else path.rmdir()
            reported.clear()
    last = start(config=config)
    assert last.end() in {0, 1}, last.output
    again = start(config=config)
    assert again.end() == 0, again.output
    assert all(experiment.nobody_is_left() for experiment in (*earlier, last, again))
    rows = {row["run_id"]: row for row in again.table}
    assert all(row["status"] == "Done" for row in rows.values())
    assert all(int(row["Square"]) == int(row["N"]) ** 2 for row in rows.values())
    assert len({row["N"] for row in rows.values()}) == runs
    done_again = {run_id for run_id, _ in DONE.findall(last.output + again.output)}
    assert not reported & done_again, "a run that was reported done was executed again: it had been lost"
    return killed


@pytest.mark.long
@pytest.mark.timeout(900)  # half a minute on a quiet machine
def test_kills_at_random_moments_lose_nothing(
    start: Start, write_config: Callable[..., Any], request: pytest.FixtureRequest
) -> None:
    killed = torture(start, write_config, kills=16, runs=120, seed=1)
    request.node.user_properties.append(("faults", killed.total() - 1))


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", range(100, 110))
def test_thousands_of_kills_at_random_moments_lose_nothing(
    start: Start, write_config: Callable[..., Any], request: pytest.FixtureRequest, seed: int
) -> None:
    killed = torture(start, write_config, kills=200, runs=400, seed=seed)
    request.node.user_properties.append(("faults", killed.total() - 1))
    request.node.user_properties += [(f"faults to {whom}", count) for whom, count in killed.items()]
    assert set(killed) == {"orchestrator", "orchestrator and keeper", "everybody", "keeper", "anybody"}
