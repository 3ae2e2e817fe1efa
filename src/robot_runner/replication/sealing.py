"""Sealing an experiment's folder as one file: read, cleaned of secrets, hashed and written as it comes."""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.storage.safe_write import storage_error
from robot_runner.core.storage.table_schema import data_package, table_resource
from robot_runner.replication import contents
from robot_runner.replication.about import containerfile, readme
from robot_runner.replication.contents import Contents, LeftOut, PackedFile
from robot_runner.replication.crate import crate_text
from robot_runner.replication.distributions import canonical, wheel_name, wheel_of, write_wheel
from robot_runner.replication.redaction import Redactor, is_binary

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.core.storage.table_schema import ColumnDescription
    from robot_runner.replication.about import About
    from robot_runner.replication.distributions import InstalledDistribution
    from robot_runner.replication.environment import RecordedEnvironment
    from robot_runner.replication.plain_zip import PlainZip

__all__ = ["PackingPlan", "Progress", "Replaced", "Sealing"]

#: Is told how many bytes are packed, of how many in all.
Progress = Callable[[int, int], None]

_BLOCK = 1 << 20
_TABLE, _SCHEMA = "run_table.csv", "run_table.schema.json"


@dataclass(frozen=True, slots=True)
class Replaced:
    """Secrets that were replaced in a file: of which kind, and how many."""

    name: str
    what: str
    count: int


@dataclass(frozen=True, slots=True)
class PackingPlan:
    """Everything that is known before the first byte is packed.

    Attributes:
        contents: which files go in.
        raw: whose raw data were asked for.
        redactor: what replaces secrets.
        keep: says whether a file is packed as it is, by its name.
        failed: how many runs failed.
        with_wheels: whether distributions that only this machine has go in as wheels.
    """

    about: About
    manifest: dict[str, Any]
    columns: Sequence[ColumnDescription]
    contents: Contents
    raw: tuple[str, ...]
    environment: RecordedEnvironment
    redactor: Redactor
    keep: Callable[[str], bool]
    failed: int
    with_wheels: bool


class Sealing:
    """One package being written.

    Attributes:
        left_out: what does not go in, and why.
        replaced: which secrets were replaced.
        wheels: the hash of each wheel, by the canonical name of its distribution.
    """

    def __init__(self, plan: PackingPlan, archive: PlainZip, progress: Progress) -> None:
        self._plan = plan
        self._archive = archive
        self._progress = progress
        self._total = sum(file.size for file in plan.contents.files)
        self._done = 0
        self.left_out: list[LeftOut] = list(plan.contents.left_out)
        self.replaced: list[Replaced] = []
        self.wheels: dict[str, str] = {}

    def write(self) -> None:
        """Write everything.

        Raises:
            StorageError: a file cannot be read.
            OSError: the package cannot be written.
        """
        for file in self._plan.contents.files:
            self._add(file)
        if self._plan.with_wheels:
            for distribution in self._plan.environment.local:
                self._add_wheel(distribution)
        self._add_descriptions()

    def _add(self, file: PackedFile) -> None:
        end = self._done + file.size
        self._write(file)
        self._advance(end - self._done)  # what was replaced may be longer than what stood there

    def _write(self, file: PackedFile) -> None:
        if self._plan.keep(file.name):
            self._archive.add(file.name, self._as_it_is(file), size=file.size)
        elif _of(file.path, is_binary):
            found = _of(file.path, self._plan.redactor.secrets_in)
            if found:
                why = f"it holds {_in_words(found)}, and nothing in it can be replaced (--keep packs it as it is)"
                self.left_out.append(LeftOut(file.name, why))
            else:
                self._archive.add(file.name, self._as_it_is(file), size=file.size)
        else:
            counted: Counter[str] = Counter()
            self._archive.add(file.name, self._cleaned(file, counted), size=file.size)
            self.replaced += [Replaced(file.name, what, count) for what, count in sorted(counted.items())]

    def _as_it_is(self, file: PackedFile) -> Iterator[bytes]:
        try:
            with file.path.open("rb") as opened:
                while block := opened.read(_BLOCK):
                    yield block
                    self._advance(len(block))
        except OSError as error:
            raise storage_error(file.path, "read", error) from error

    def _cleaned(self, file: PackedFile, counted: Counter[str]) -> Iterator[bytes]:
        try:
            for block in self._plan.redactor.blocks(file.path, counted):
                yield block
                self._advance(len(block))
        except OSError as error:
            raise storage_error(file.path, "read", error) from error

    def _advance(self, count: int) -> None:
        self._done = min(self._total, self._done + count)
        self._progress(self._done, self._total)

    def _add_wheel(self, distribution: InstalledDistribution) -> None:
        try:
            files = wheel_of(distribution)
            name = f"{contents.WHEELS}/{wheel_name(distribution)}"
            secrets: Counter[str] = Counter()
            for path in files.values():
                secrets += self._plan.redactor.own.secrets_in(path)
        except OSError as error:
            raise storage_error(Path(distribution.name), "read", error) from error
        if not files or secrets:
            why = f"it holds {_in_words(secrets)}" if secrets else "its files cannot be told"
            self.left_out.append(LeftOut(f"wheel of {distribution.name}", why))
            return
        with tempfile.TemporaryDirectory() as folder:
            wheel = Path(folder) / "wheel"
            write_wheel(files, wheel)
            stored = self._archive.add(name, [wheel.read_bytes()])
        self.wheels[canonical(distribution.name)] = stored.sha256

    def _add_descriptions(self) -> None:
        plan, stored = self._plan, self._archive.stored
        if _TABLE in stored:
            table = stored[_TABLE]
            schema = _SCHEMA if _SCHEMA in stored else None
            resource = table_resource(_TABLE, table.size, table.sha256, schema=schema)
            self._add_json(contents.DATA_PACKAGE, data_package(plan.about.name, [resource]))
        self._add_text(contents.REQUIREMENTS, plan.environment.requirements(self.wheels))
        self._add_json(contents.ENVIRONMENT, plan.environment.as_mapping(self.wheels))
        self._add_text(contents.CONTAINERFILE, containerfile(plan.manifest, has_wheels=bool(self.wheels)))
        self._add_json(contents.DESCRIPTION, self._description())
        listed = [*stored, contents.README]
        self._add_text(contents.README, readme(plan.about, plan.manifest, listed, self.left_out))
        files = sorted(stored.values(), key=lambda file: file.name)
        crate = crate_text(plan.about, plan.manifest, plan.columns, files, failed=plan.failed)
        self._add_text(contents.CRATE, crate)
        sums = "".join(f"{file.sha256}  {file.name}\n" for _, file in sorted(stored.items()))
        self._archive.add(contents.SUMS, [sums.encode()])
        self._archive.add_folders()

    def _description(self) -> dict[str, Any]:
        return {
            "format": contents.FORMAT,
            "made_by": f"robot-runner {version('robot-runner')}",
            "experiment": self._plan.about.name,
            "config": self._plan.manifest.get("config"),
            "raw": list(self._plan.raw),
            "left_out": [asdict(each) for each in self.left_out],
            "replaced": [asdict(each) for each in self.replaced],
        }

    def _add_json(self, name: str, facts: Any) -> None:
        self._add_text(name, json.dumps(facts, indent=2, ensure_ascii=False, default=str) + "\n")

    def _add_text(self, name: str, text: str) -> None:
        """What is made from the manifest may hold what the manifest holds."""
        self._archive.add(name, [self._plan.redactor.redacted(text.encode(), Counter(), loose=False)])


def _of(path: Path, question: Callable[[Path], Any]) -> Any:
    try:
        return question(path)
    except OSError as error:
        raise storage_error(path, "read", error) from error


def _in_words(found: Counter[str]) -> str:
    return ", ".join(f"{what} ({count})" for what, count in sorted(found.items()))
