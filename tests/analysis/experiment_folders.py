"""Experiment folders as they lie on disk, made in a moment instead of being executed."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from robot_runner.core.storage.guarded_files import sha256_of
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import write_manifest
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole
from robot_runner.core.storage.table_schema import read_schema, write_schema

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

_STAMPS = ("start_measurement", "launch_mission", "stop_measurement")


@dataclass
class Folder:
    """An experiment folder that is written.

    Attributes:
        factors: treatments by factor.
        rows: one a run: treatments in the order of the factors, then measures in their order.
        measures: unit by measure.
        statuses: of runs that are not done, by place from 0.
        day: on which it was executed; experiments that were executed at the same moments are copies.
    """

    root: Path
    factors: Mapping[str, Sequence[str]]
    rows: Sequence[Sequence[Any]]
    measures: Mapping[str, str]
    name: str = "trial"
    types: Mapping[str, str] = field(default_factory=dict)
    origin: str | None = "measured"
    statuses: Mapping[int, str] = field(default_factory=dict)
    manifest: Mapping[str, Any] = field(default_factory=dict)
    failure: str = "the robot fell over"
    day: str = "2026-01-31"

    @property
    def files(self) -> ExperimentFolder:
        return ExperimentFolder(self.root)

    def run_id(self, place: int) -> str:
        return f"r_{place + 1}"

    def write(self) -> Path:
        self.root.mkdir(parents=True)
        self._write_table()
        self._write_schema()
        self._write_journal()
        write_manifest(self.files.manifest, self._manifest() | dict(self.manifest))
        return self.root

    def write_samples(self, plugin: str, name: str, heading: str, rows_of: Callable[[int], Sequence[str]]) -> None:
        for place in range(len(self.rows)):
            folder = self.files.run(self.run_id(place)) / plugin
            folder.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text("\n".join([heading, *rows_of(place)]) + "\n", encoding="utf-8")

    def write_quality(self, plugin: str, facts: Mapping[str, Any]) -> None:
        for place in range(len(self.rows)):
            folder = self.files.run(self.run_id(place)) / plugin
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "quality.json").write_text(json.dumps(facts), encoding="utf-8")

    def status(self, place: int) -> str:
        return self.statuses.get(place, "Done")

    def _write_table(self) -> None:
        with self.files.run_table.open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["run_id", "status", *self.factors, *self.measures])
            for place, row in enumerate(self.rows):
                cells = ["" if cell is None else cell for cell in row]
                rows.writerow([self.run_id(place), self.status(place), *cells])

    def _write_schema(self) -> None:
        fields = [
            ColumnDescription(name="run_id", role=ColumnRole.PROGRESS, type="string"),
            ColumnDescription(name="status", role=ColumnRole.PROGRESS, type="string"),
            *(ColumnDescription(name=name, role=ColumnRole.FACTOR, type="string") for name in self.factors),
            *(
                ColumnDescription(
                    name=name,
                    role=ColumnRole.MEASURE,
                    type=self.types.get(name, "number"),
                    unit=unit,
                    owner="Meter",
                    origin=self.origin,
                )
                for name, unit in self.measures.items()
            ),
        ]
        write_schema(self.files.schema, fields)

    def _write_journal(self) -> None:
        stamps = (f"{self.day}T12:{minute:02}:{second:02}.000Z" for minute in range(60) for second in range(60))
        with Journal(self.files.journal) as journal:
            for place, row in enumerate(self.rows):
                run, status = self.run_id(place), self.status(place)
                if status == "-":
                    continue
                journal.append("attempt_started", at=next(stamps), run=run, attempt=1)
                for clock, event in enumerate(_STAMPS):
                    journal.append("event", at=next(stamps), run=run, attempt=1, event=event, clock=float(clock * 5))
                is_done = status == "Done"
                journal.append(
                    "attempt_finished",
                    at=next(stamps),
                    run=run,
                    attempt=1,
                    is_last=True,
                    status="done" if is_done else "failed",
                    seconds=3.0,
                    stamps={},
                    measures=dict(zip(self.measures, map(self._published, row[len(self.factors) :]), strict=False)),
                    failure=None if is_done else self.failure,
                )
            journal.append("table_written", sha256=sha256_of(self.files.run_table))

    def _published(self, value: object) -> dict[str, Any]:
        return {"value": value, "owner": "Meter", "origin": self.origin or "measured"}

    def _manifest(self) -> dict[str, Any]:
        return {
            "experiment_name": self.name,
            "config": {"file": "config.py", "class": "RobotRunnerConfig"},
            "deviations": {},
            "robot": "ros1",
            "design": {
                "source": "config",
                "factors": {name: list(texts) for name, texts in self.factors.items()},
                "repetitions": 1,
                "shuffle": True,
                "blocks": None,
            },
            "seed": 7,
            "seed_is_given": True,
            "plugins": [],
            "host": {"system": "Linux"},
            "software": {"robot_runner": "0.1.0", "python": "3.12.1"},
            "executions": [{"started_at": "2026-01-31T12:00:00.000Z", "finished_at": "2026-01-31T13:00:00.000Z"}],
        }


def two_tasks(root: Path, video: Sequence[Any], network: Sequence[Any], **settings: Any) -> Folder:
    """Write an experiment of one factor with two treatments."""
    rows = [("Video", value) for value in video] + [("Network", value) for value in network]
    folder = Folder(root, {"Task": ["Video", "Network"]}, rows, {"Energy": "J"}, **settings)
    folder.write()
    return folder


def searched(root: Path, rows: Sequence[tuple[str, int, float]], *, is_confirmed: bool) -> Path:
    """Write an experiment of a search: treatment, batch and energy; the second batch may confirm what it found."""
    treatments = sorted({row[0] for row in rows})
    batches = [{"batch": 1}, {"batch": 2, "role": "confirmation"}] if is_confirmed else [{"batch": 1}]
    design = {"source": "config", "factors": {"T": treatments}, "facts": {"decides": "Race"}, "batches": batches}
    folder = Folder(root, {"T": treatments, "batch": []}, rows, {"E": "J"}, manifest={"design": design})
    folder.write()
    columns = [
        replace(each, role=ColumnRole.BATCH, type="integer") if each.name == "batch" else each
        for each in read_schema(folder.files.schema)
    ]
    write_schema(folder.files.schema, columns)
    return root
