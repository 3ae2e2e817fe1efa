"""What users write with results is checked by their type checker: the package says that it is typed, and is."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path

SCRIPT = """
from robot_runner.analysis import analyse, load_results

results = load_results("experiments/basic_experiment")
reveal_type(results)
reveal_type(results.factors)
reveal_type(analyse(results).measure("Energy").test)
results.factor
"""


@pytest.mark.long
def test_results_are_no_unknown_for_a_type_checker(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    words = ["--strict", "--cache-dir", "cache", "script.py"]
    told = subprocess.run(
        [sys.executable, "-m", "mypy", *words], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=200
    ).stdout
    assert 'Revealed type is "robot_runner.analysis.results.Results"' in told
    assert 'Revealed type is "tuple[str, ...]"' in told
    assert 'Revealed type is "robot_runner.analysis.statistics.tested.MeasureTest | None"' in told
    assert 'has no attribute "factor"' in told
    assert "Found 1 error in 1 file" in told
