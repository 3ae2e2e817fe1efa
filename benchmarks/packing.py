"""What packing an experiment's folder costs in time and memory, beside zipping and hashing the same bytes.

The time of a file must follow neither the size of the others nor their number.
"""

from __future__ import annotations

import hashlib
import random
import resource
import tempfile
import time
import zipfile
from pathlib import Path

from benchmarks.table import Row, print_table
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import describe_host, describe_software, write_manifest
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole
from robot_runner.core.storage.table_schema import write_schema
from robot_runner.replication.packing import pack
from robot_runner.replication.sealing import Packing

_MEBIBYTE = 1 << 20
_RUNS = 8
_SIZES = (8, 64)  # MiB of raw samples a run: memory must not follow
_FEW, _MANY = 1_000, 16_000  # runs with a small file each
_MOST_TIMES = 1.2  # how much longer a file may take among many
_MOST_MEMORY = 150.0  # MiB, the interpreter and all libraries included


def make_folder(root: Path, size: int, *, runs: int = _RUNS) -> ExperimentFolder:
    """Make an experiment's folder with raw samples of this size for each run, bytes."""
    files = ExperimentFolder(root)
    draw = random.Random(1)
    block = "".join(
        f"{place / 200:.6f},{draw.randrange(8000)},{draw.random():.6f},{12 + draw.random():.3f}\n"
        for place in range(30000)
    ).encode()
    for number in range(1, runs + 1):
        folder = files.run(f"r_{number}") / "Meter"
        folder.mkdir(parents=True)
        with (folder / "samples.csv").open("wb") as file:
            for _ in range(size // len(block)):
                file.write(block)
            file.write(block[: size % len(block)])
    lines = ["run_id,status,Task", *(f"r_{number},Done,Video" for number in range(1, runs + 1))]
    files.run_table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    roles = {"run_id": ColumnRole.PROGRESS, "status": ColumnRole.PROGRESS, "Task": ColumnRole.FACTOR}
    write_schema(files.schema, [ColumnDescription(name=name, role=role) for name, role in roles.items()])
    software = describe_software()
    write_manifest(files.manifest, {"experiment_name": "packing", "software": software, "host": describe_host()})
    with Journal(files.journal) as journal:
        journal.append("table_written")
    return files


def zipped(files: ExperimentFolder, target: Path) -> float:
    """Return how long zipping and hashing take without looking for secrets, in seconds."""
    begun = time.perf_counter()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(files.root.rglob("*.csv")):
            with (
                path.open("rb") as file,
                archive.open(str(path.relative_to(files.root)), "w", force_zip64=True) as inside,
            ):
                digest = hashlib.sha256()
                while block := file.read(_MEBIBYTE):
                    digest.update(block)
                    inside.write(block)
    return time.perf_counter() - begun


def packed(files: ExperimentFolder, target: Path) -> float:
    """Return how long packing takes, in seconds."""
    begun = time.perf_counter()
    pack(files.root, target, Packing(with_wheels=False))
    return time.perf_counter() - begun


def seconds_a_file(runs: int) -> float:
    """Return how long packing takes for each of so many small files."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return packed(make_folder(folder / "packing", 1_000, runs=runs), folder / "packed.zip") / runs


def main() -> None:
    """Pack small and large raw data, and compare time with zipping and memory with each other."""
    rows = []
    for mebibytes in _SIZES:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            files = make_folder(folder / "packing", mebibytes * _MEBIBYTE)
            total = mebibytes * _RUNS
            seconds = packed(files, folder / "packed.zip")
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            floor = zipped(files, folder / "zipped.zip")
        rate, zip_rate = total / seconds, total / floor
        rows += [
            Row(
                f"{total} MiB packed",
                f"{rate:.1f} MiB/s",
                f"{zip_rate:.1f} MiB/s (zip, SHA-256)",
                f"{floor / seconds:.2f}",
            ),
            Row("  memory, at most", f"{memory:.0f} MiB", bound=f"{_MOST_MEMORY:.0f} MiB"),
        ]
    few, many = seconds_a_file(_FEW), seconds_a_file(_MANY)
    rows.append(
        Row(
            f"a file of {_MANY:,}",
            f"{many * 1e3:.2f} ms",
            f"{few * 1e3:.2f} ms (of {_FEW:,})",
            f"{many / few:.2f}",
            f"{_MOST_TIMES:.1f} x",
        )
    )
    print_table("Packing: raw samples as CSV, cleaned of secrets, hashed, compressed", rows)


if __name__ == "__main__":
    main()
