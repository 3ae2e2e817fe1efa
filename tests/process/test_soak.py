"""Kills at random moments: what was reported done is there, the table parses, resuming completes, nobody is left."""

from __future__ import annotations

import os
import random
import re
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest

Start = Callable[..., Any]

BODY = """
grace_in_s = 2
def create_run_table(self):
    return RunTableModel([Factor("N", range(RUNS))], data_columns=["Square"], shuffle=True, seed=3)
def launch_mission(self, context):
    (context.raw_data_folder / "raw.txt").write_text(str(context.combination["N"]))
    print("number", context.combination["N"])
def populate_run_data(self, context): return {"Square": context.combination["N"] ** 2}
"""
DONE = re.compile(r"run \d+ of \d+ \((r_\d+)\) is done .*?: Square ([\d,.]+)")
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def inject(experiment: Any, chance: random.Random) -> None:
    """Send something to the orchestrator, or kill one of its processes, at a random moment."""
    time.sleep(chance.uniform(0.15, 0.9))
    victims = experiment.processes()
    if not victims:
        return
    is_orchestrator = chance.random() < 0.6
    victim = experiment.process.pid if is_orchestrator else chance.choice(victims)
    try:
        os.kill(victim, chance.choice(SIGNALS) if is_orchestrator else signal.SIGKILL)
    except ProcessLookupError:
        return


def torture(start: Start, write_config: Callable[..., Any], *, kills: int, runs: int, seed: int) -> None:
    chance = random.Random(seed)  # noqa: S311 - kills need no cryptography
    config = write_config(BODY.replace("RUNS", str(runs)), table="")
    reported: set[str] = set()
    for _ in range(kills):
        experiment = start(config=config)
        inject(experiment, chance)
        experiment.end()
        assert experiment.nobody_is_left()
        done = {run_id for run_id, _ in DONE.findall(experiment.output)}
        assert not done & reported, "a run that was reported done was executed again: it had been lost"
        reported |= done
        if not (experiment.folder / "run_table.csv").exists():
            continue
        assert len(experiment.table) == runs
        if experiment.statuses.count("Done") == runs:
            for path in sorted(experiment.folder.rglob("*"), reverse=True):
                path.unlink() if path.is_file() else path.rmdir()
            reported.clear()
    last = start(config=config)
    assert last.end() in {0, 1}, last.output
    again = start(config=config)
    assert again.end() == 0, again.output
    rows = {row["run_id"]: row for row in again.table}
    assert all(row["status"] == "Done" for row in rows.values())
    assert all(int(row["Square"]) == int(row["N"]) ** 2 for row in rows.values())
    assert len({row["N"] for row in rows.values()}) == runs
    done_again = {run_id for run_id, _ in DONE.findall(last.output + again.output)}
    assert not reported & done_again, "a run that was reported done was executed again: it had been lost"


def test_kills_at_random_moments_lose_nothing(
    start: Start, write_config: Callable[..., Any], request: pytest.FixtureRequest
) -> None:
    request.node.user_properties.append(("faults", 11))
    torture(start, write_config, kills=12, runs=200, seed=1)


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", range(100, 140))
def test_thousands_of_kills_at_random_moments_lose_nothing(
    start: Start, write_config: Callable[..., Any], request: pytest.FixtureRequest, seed: int
) -> None:
    request.node.user_properties.append(("faults", 49))
    torture(start, write_config, kills=50, runs=400, seed=seed)
