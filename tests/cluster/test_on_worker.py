"""The part that a worker takes in an experiment, without a cluster."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("distributed")

from tests.cluster.conftest import until

from robot_runner.cluster import on_worker

if TYPE_CHECKING:
    from pathlib import Path

LEASE = 0.05


def _facts(tmp_path: Path) -> dict[str, Any]:
    probe = {"path": str(tmp_path / "no_probe"), "digest": ""}
    facts = {"session": "0123", "id": "4567", "snapshot": {}, "probe": probe, "grace": 1.0, "lease": LEASE}
    return facts | {"root": str(tmp_path / "root"), "runs": str(tmp_path / "root" / "runs")}


def test_what_a_killed_orchestrator_left_on_a_worker_is_removed_long_after_its_lease(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody says goodbye: a process of each of its threads would wait there, beside what it has written."""
    monkeypatch.setattr(on_worker, "_ABANDONED", 6)
    on_worker.join(_facts(tmp_path), SimpleNamespace(local_directory=str(tmp_path)))
    folder = tmp_path / "robot-runner-4567"
    on_worker.settle("0123", is_shared=False)
    renewed = time.monotonic()
    while time.monotonic() < renewed + LEASE * 10:
        on_worker.renew("0123")
        time.sleep(LEASE / 4)
    assert (folder / "snapshot.json").exists(), "as long as it is renewed"
    until(lambda: not folder.exists(), "it is removed", 10)
    with pytest.raises(KeyError):
        on_worker.renew("0123")
