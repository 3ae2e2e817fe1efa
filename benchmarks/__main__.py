"""Execute benchmarks, each in a fresh process, one after another: `python -m benchmarks [name ...]`.

It exits with 1 where one breaks off, or where a figure of one that judges them is not as it is expected to be.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

_FOLDER = Path(__file__).parent
_HARNESS = {
    "__init__",
    "__main__",
    "interval_coverage",
    "null_designs",
    "odometry_types",
    "power_comparison",
    "precise_stopping",
    "proportion_nulls",
    "table",
}
_DEADLINE = 1800.0  # seconds a benchmark


def main(chosen: list[str]) -> int:
    """Execute the chosen benchmarks, or all of them; return 0 if all held, 2 for an unknown name."""
    known = sorted(path.stem for path in _FOLDER.glob("*.py") if path.stem not in _HARNESS)
    unknown = [name for name in chosen if name not in known]
    if unknown:
        print(f"There is no benchmark {unknown[0]!r}. Choose among: {', '.join(known)}.", file=sys.stderr)
        return 2
    print(f"Python {platform.python_version()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}", flush=True)
    broken = [name for name in chosen or known if not _came_to_its_end(name)]
    if broken:
        print(f"Broke off, or not as expected: {', '.join(broken)}.", file=sys.stderr)
    return 1 if broken else 0


def _came_to_its_end(name: str) -> bool:
    command = [sys.executable, "-c", f"import sys; from benchmarks.{name} import main; sys.exit(main())"]
    try:
        return subprocess.run(command, cwd=_FOLDER.parent, timeout=_DEADLINE, check=False).returncode == 0
    except subprocess.TimeoutExpired:
        print(f"{name} was not done after {_DEADLINE:.0f} s.", file=sys.stderr)
        return False


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
