"""What it costs to load 10 million raw samples of 500 runs, beside pandas alone, and to stream 100 million of 5,000."""

from __future__ import annotations

import multiprocessing
import os
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.table import Row, print_table
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import write_manifest
from robot_runner.core.storage.run_table_rows import RunTableRows, write_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import describe_columns, write_schema

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_RUNS = 500
_TASKS = ["Computation", "Video", "Network"]
_SAMPLES = 20_000  # 100 s at 200 Hz
_SECONDS_BOUND = 5.0
_BYTES_BOUND = 1e9
_STREAMED_RUNS = 5_000
_STREAM_BOUND = 300e6  # bytes


def make_experiment(root: Path, *, runs: int = _RUNS) -> None:
    """Make an experiment of so many runs, each with the samples of an INA219 and the phases of a mission."""
    folder = ExperimentFolder(root)
    factors = [Factor("Task", _TASKS), Factor("Repetition", range(1, runs // 3 + 2))]
    model = RunTableModel(factors, data_columns=["Energy"])
    rows = RunTableRows.of_plan(model.plan(), TableLayout.of_model(model, ["Energy"]))
    folder.runs.mkdir(parents=True)
    template = root / "samples.csv"
    _write_samples(template)
    for place in range(runs):
        run_id = rows.run_id(place)
        rows.record(run_id, status=RunStatus.DONE, measures={"Energy": 870.0})
        _fill(folder.run(run_id), template)
    write_run_table(folder.run_table, rows)
    write_schema(folder.schema, describe_columns(rows))
    write_manifest(folder.manifest, {"experiment_name": "loading", "design": {}, "seed": 1})


def _write_samples(path: Path) -> None:
    with path.open("w", encoding="ascii") as file:
        file.write("time_s,shunt_raw,bus_raw,current_A,voltage_V,power_W\n")
        for place in range(_SAMPLES):
            shunt, bus = 6000 + place % 991, 24900 + place % 83
            current, voltage = shunt * 1e-4, bus * 5e-4
            line = f"{place * 0.005:.6f},{shunt},{bus},{current:.6f},{voltage:.3f},{current * voltage:.6f}\n"
            file.write(line)


def _fill(run: Path, samples: Path) -> None:
    (run / "Ina219").mkdir(parents=True)
    os.link(samples, run / "Ina219" / "samples.csv")  # 5,000 files of 1 MB each would be most of the work
    (run / "BasicTurtlebot3").mkdir()
    lines = [f"{number},sleep,{number * 10.0},{number * 10.0 + 10.0}" for number in range(10)]
    text = "\n".join(["number,phase,start_s,end_s", *lines]) + "\n"
    (run / "BasicTurtlebot3" / "phases.csv").write_text(text, encoding="ascii")


def load(root: str, columns: Sequence[str] | None) -> tuple[float, int]:
    """Load the samples; return seconds, the libraries' import included, and the peak of memory in bytes."""
    begun = time.perf_counter()
    from robot_runner.analysis import load_results  # noqa: PLC0415 - what it costs is to be measured

    frame = load_results(root).samples("Ina219", columns=columns)
    seconds = time.perf_counter() - begun
    if len(frame) != _RUNS * _SAMPLES or frame["power_W"].isna().any():
        raise SystemExit("What was read is not what was written.")
    return seconds, _peak()


def load_with_pandas(root: str, columns: Sequence[str] | None) -> tuple[float, int]:
    """Load the same with `pandas.read_csv` and `concat`; without treatments, phases and the start of measurement."""
    begun = time.perf_counter()
    import pandas as pd  # noqa: PLC0415 - as above

    paths = sorted(Path(root).glob("runs/*/Ina219/samples.csv"))
    wanted = None if columns is None else ["time_s", *columns]
    frame = pd.concat([pd.read_csv(path, usecols=wanted).assign(run_id=path.parent.parent.name) for path in paths])
    return time.perf_counter() - begun, _peak() if len(frame) else 0


def stream(root: str, columns: Sequence[str] | None) -> tuple[float, int]:
    """Compute the mean of each treatment from batches; return seconds, the libraries' import included, and the peak."""
    begun = time.perf_counter()
    from robot_runner.analysis import load_results  # noqa: PLC0415 - as above

    sums: dict[str, float] = {}
    count = 0
    for batch in load_results(root).lazy_samples("Ina219", columns=columns).reader():
        table = batch.select(["Task", "power_W"]).to_pandas()
        for task, total in table.groupby("Task", observed=True)["power_W"].sum().items():
            sums[str(task)] = sums.get(str(task), 0.0) + total
        count += len(batch)
    if count != _STREAMED_RUNS * _SAMPLES or len(sums) != len(_TASKS):
        raise SystemExit("What was read is not what was written.")
    return time.perf_counter() - begun, _peak()


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _measured(
    measure: Callable[[str, Sequence[str] | None], tuple[float, int]], root: Path, columns: Sequence[str] | None
) -> tuple[float, int]:
    # A process of its own: the peak of memory is that of this one thing.
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(measure, str(root), columns).result()


def main() -> None:
    """Print the figures."""
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch) / "loading"
        make_experiment(root)
        rows = []
        for columns, what in ((None, "all 6 columns"), (["power_W"], "time and power")):
            seconds, peak = _measured(load, root, columns)
            plain_seconds, plain_peak = _measured(load_with_pandas, root, columns)
            rows += [
                Row(
                    f"load 10 M samples, {what}",
                    f"{seconds:.1f} s",
                    f"{plain_seconds:.1f} s (pandas)",
                    f"{seconds / plain_seconds:.2f}",
                    f"{_SECONDS_BOUND:.0f} s",
                ),
                Row(
                    f"peak memory, {what}",
                    f"{peak / 1e9:.2f} GB",
                    f"{plain_peak / 1e9:.2f} GB (pandas)",
                    f"{peak / plain_peak:.2f}",
                    f"{_BYTES_BOUND / 1e9:.0f} GB",
                ),
            ]
        many = Path(scratch) / "streaming"
        make_experiment(many, runs=_STREAMED_RUNS)
        seconds, peak = _measured(stream, many, ["power_W"])
        rows.append(
            Row(
                f"peak memory, {_STREAMED_RUNS * _SAMPLES / 1e6:.0f} M samples as a stream ({seconds:.0f} s)",
                f"{peak / 1e6:.0f} MB",
                bound=f"{_STREAM_BOUND / 1e6:.0f} MB",
            )
        )
        print_table("Loading raw samples", rows)


if __name__ == "__main__":
    main()
