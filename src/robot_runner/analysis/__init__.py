"""Data frames, statistics, figures and a report from an experiment's folder.

Nothing else is needed: no robot, no plugin and no config. Begin with `load_results`:

```python
from robot_runner.analysis import load_results

results = load_results("experiments/basic_experiment")
results.runs.groupby("Task", observed=True)["Energy"].mean()
```
"""

from __future__ import annotations

from robot_runner.analysis.libraries import require_libraries
from robot_runner.core.doors import open_door

TYPE_CHECKING = False
if TYPE_CHECKING:
    from robot_runner.analysis.alignment import AlignedSamples as AlignedSamples
    from robot_runner.analysis.alignment import Resampling as Resampling
    from robot_runner.analysis.comparison.averaging import meta_analyse as meta_analyse
    from robot_runner.analysis.comparison.combined import MetaAnalysis as MetaAnalysis
    from robot_runner.analysis.comparison.compared import Comparison as Comparison
    from robot_runner.analysis.comparison.comparing import compare as compare
    from robot_runner.analysis.declared_design import DeclaredDesign as DeclaredDesign
    from robot_runner.analysis.declared_design import with_declared_design as with_declared_design
    from robot_runner.analysis.lazy_samples import LazySamples as LazySamples
    from robot_runner.analysis.report.writing import ReportFormat as ReportFormat
    from robot_runner.analysis.report.writing import write_report as write_report
    from robot_runner.analysis.results import Results as Results
    from robot_runner.analysis.results import load_results as load_results
    from robot_runner.analysis.statistics.experiment_statistics import analyse as analyse
    from robot_runner.analysis.statistics.outcome import ExperimentStatistics as ExperimentStatistics
else:
    __getattr__, __dir__ = open_door(__name__, require_libraries)
