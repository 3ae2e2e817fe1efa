from __future__ import annotations

import json
from subprocess import CompletedProcess
from types import SimpleNamespace

import pytest

from robot_runner.adaptive import optimise
from robot_runner.adaptive.optuna_program import candidates


@pytest.fixture
def optuna_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have Optuna answer in this process, for tests whose subject is not the program that asks it."""

    def answered(command: list[str], *, input: str, **_: object) -> CompletedProcess[str]:  # noqa: A002 - as of run
        return CompletedProcess(command, 0, json.dumps(candidates(json.loads(input))), "")

    monkeypatch.setattr(optimise, "subprocess", SimpleNamespace(run=answered))
