"""How long the demo's report takes, beside the imports that it cannot do without."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.table import Row, print_table

_PROGRAM = str(Path(sys.executable).with_name("robot-runner"))
_IMPORTS = "import pandas, scipy.stats, statsmodels.api, matplotlib.figure, jinja2"
_TIMES = 3
_REPORT_BOUND = 8.0


def main() -> None:
    """Time the command as a user calls it, the start of the interpreter included; the best of three counts."""
    with tempfile.TemporaryDirectory() as scratch:
        subprocess.run([_PROGRAM, "demo", "--folder", scratch], stdout=subprocess.DEVNULL, timeout=300, check=True)
        experiment = str(Path(scratch) / "basic_experiment")
        imports = _seconds([sys.executable, "-c", _IMPORTS])
        page = _seconds([_PROGRAM, "report", experiment])
        alone = _seconds([_PROGRAM, "report", experiment, "--figures", "none"])
        plain = _seconds([_PROGRAM, "report", experiment, "--format", "json"])
        compared = _seconds([_PROGRAM, "compare", experiment, experiment, "--bound", "5%"])
        size = (Path(experiment) / "report" / "report.html").stat().st_size
    floor = f"{imports:.1f} s (imports)"
    print_table(
        "Report of the demo (15 runs, 285,000 samples of power)",
        [
            Row(
                "page, tables, figures as SVG, PDF, PNG",
                f"{page:.1f} s",
                floor,
                f"{page / imports:.1f}",
                f"{_REPORT_BOUND:.0f} s",
            ),
            Row("page and tables", f"{alone:.1f} s", floor, f"{alone / imports:.1f}"),
            Row("JSON", f"{plain:.1f} s", floor, f"{plain / imports:.1f}"),
            Row("comparison with itself", f"{compared:.1f} s", floor, f"{compared / imports:.1f}"),
            Row("size of the page", f"{size / 1e6:.1f} MB"),
        ],
    )


def _seconds(command: list[str]) -> float:
    times = []
    for _ in range(_TIMES):
        begun = time.perf_counter()
        subprocess.run(command, stdout=subprocess.DEVNULL, timeout=300, check=True)
        times.append(time.perf_counter() - begun)
    return min(times)


if __name__ == "__main__":
    main()
