"""The run table's model, as the config makes it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.config.loader import raised_in
from robot_runner.design.run_table import RunTable
from robot_runner.design.run_table_model import RunTableModel
from robot_runner.errors import ConfigError, Finding

if TYPE_CHECKING:
    from robot_runner.config.loader import LoadedConfig

__all__ = ["create_model"]


def create_model(loaded: LoadedConfig) -> tuple[RunTableModel | None, list[Finding]]:
    """Have the config create its run table; returns the model, or None and the findings that refuse it."""
    create = getattr(loaded.config, "create_run_table", None)
    where = f"{loaded.where}.create_run_table"
    if not callable(create):
        fix = "Define create_run_table(self) and return a RunTableModel."
        return None, [Finding.error(where, "the config does not define it", fix)]
    try:
        with raised_in(loaded.source.path, "in create_run_table"):
            created = create()
    except ConfigError as error:
        return None, list(error.findings)
    model = created.model if isinstance(created, RunTable) else created
    if isinstance(model, RunTableModel):
        return model, list(model.warnings)
    problem = f"it returned {_shown(created)}"
    return None, [Finding.error(where, problem, "Return the RunTableModel (`return run_table`).")]


def _shown(created: object) -> str:
    text = repr(created)
    return text if len(text) <= 60 else f"{text[:57]}..."  # noqa: PLR2004 - one line of a terminal
