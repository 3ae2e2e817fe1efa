"""From an experiment's folder to data frames, statistics, figures and a report; the folder is all that is needed.

It reads, and needs neither a robot nor a plugin nor the config. `load_results` is where everything begins:

```python
from robot_runner.analysis import load_results

results = load_results("experiments/basic_experiment")
results.runs.groupby("Task", observed=True)["Energy"].mean()
```
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.libraries import require_libraries

if TYPE_CHECKING:
    from robot_runner.analysis.comparison.compared import Comparison
    from robot_runner.analysis.comparison.comparing import compare
    from robot_runner.analysis.report.writing import write_report
    from robot_runner.analysis.results import Results, load_results
    from robot_runner.analysis.statistics.experiment import analyse
    from robot_runner.analysis.statistics.outcome import ExperimentStatistics

__all__ = ["Comparison", "ExperimentStatistics", "Results", "analyse", "compare", "load_results", "write_report"]

_HOMES = {
    "Comparison": "robot_runner.analysis.comparison.compared",
    "ExperimentStatistics": "robot_runner.analysis.statistics.outcome",
    "Results": "robot_runner.analysis.results",
    "analyse": "robot_runner.analysis.statistics.experiment",
    "compare": "robot_runner.analysis.comparison.comparing",
    "load_results": "robot_runner.analysis.results",
    "write_report": "robot_runner.analysis.report.writing",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    require_libraries()  # or the name would fail with a bare ModuleNotFoundError
    found = getattr(import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
