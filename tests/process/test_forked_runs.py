"""A forked run finds done what can be done once: it imports nothing, and touches little of what it is forked from."""

from __future__ import annotations

import csv
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from tests.conftest import HEAD

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_BODY = """
def before_run(self, context):
    self.imported = set(sys.modules)

def start_run(self, context):
    print("as most runs do")

def populate_run_data(self, context):
    anew = [name for name in sys.modules if name not in self.imported]
    return {"Anew": " ".join(anew), "Pages": resource.getrusage(resource.RUSAGE_SELF).ru_minflt}
"""
_TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("N", [1, 2])], data_columns=["Anew", "Pages"])
"""
#: It touches some 1,100. A look at all objects of the orchestrator, as by a garbage collection, touches 3,000 more.
_MOST_PAGES = 2_000


@pytest.mark.skipif(sys.platform != "linux", reason="other systems count pages otherwise")
def test_a_forked_run_imports_nothing_and_touches_few_pages(
    program: str, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    config = write_config(_BODY, head=f"import resource\nimport sys\n{HEAD}", table=_TABLE)
    subprocess.run([program, "run", str(config), "--plain"], cwd=tmp_path, check=True, timeout=60)
    with (tmp_path / "results" / "trial" / "run_table.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["Anew"] for row in rows] == [""] * 2
    assert max(int(row["Pages"]) for row in rows) < _MOST_PAGES
