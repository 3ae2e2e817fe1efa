"""What tests of several floors share: config files, written to a folder of the test's own."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

HEAD = """\
from pathlib import Path
from robot_runner import *


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
"""

TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=2, data_columns=["Energy"], seed=1)
"""


@pytest.fixture
def write_config(tmp_path: Path) -> Callable[..., Path]:
    """Return what writes a config: `body` goes into its class, `table` (a whole method) replaces the run table."""

    def write(body: str = "", *, table: str = TABLE, head: str = HEAD, name: str = "config.py") -> Path:
        parts = [head.rstrip(), textwrap.indent(textwrap.dedent(body).strip(), "    "), table.rstrip()]
        path = tmp_path / name
        path.write_text("\n\n".join(part for part in parts if part.strip()) + "\n", encoding="utf-8")
        return path

    return write
