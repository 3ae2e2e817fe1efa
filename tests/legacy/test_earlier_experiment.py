"""What is known of a config before its first run is forked is not found out again in each run."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.legacy.earlier_configs import Executed


@pytest.mark.long
def test_no_run_looks_at_the_signature_of_a_callback(
    config: Callable[..., Path], execute: Callable[..., Executed], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inspect, "signature", inspect.signature)  # as it was, afterwards
    methods = """
    def before_run(self):
        import inspect
        inspect.signature = None

    def start_run(self): pass
    def interact(self, context): pass
    def populate_run_data(self, context): return {"seconds": 1}
    """
    executed = execute(config(methods))
    assert not executed.finished.failures
    assert {row["seconds"] for row in executed.table} == {"1"}
