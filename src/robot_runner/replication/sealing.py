"""Seal an experiment's folder as one file: read, redact, hash and write it block by block."""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal
from urllib.parse import unquote

from robot_runner.core.config.authors import Author
from robot_runner.core.errors import Finding, PackageError
from robot_runner.core.storage.guarded_files import open_to_read
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.storage.table_columns import ColumnDescription
from robot_runner.core.storage.table_schema import data_package, table_resource
from robot_runner.replication import contents
from robot_runner.replication.about import About, citation_text, licence_text, readme, zenodo_text
from robot_runner.replication.badges import BadgeFacts, badges_text
from robot_runner.replication.cleaning import Cleaning, in_words
from robot_runner.replication.container import containerfile
from robot_runner.replication.contents import ALL, CRATE, Contents, LeftOut, PackedFile
from robot_runner.replication.crate import crate_text
from robot_runner.replication.crate_actions import executed_runs
from robot_runner.replication.distributions import (
    InstalledDistribution,
    canonical,
    packages_of_extra,
    wheel_name,
    wheel_of,
    write_wheel,
)
from robot_runner.replication.environment import RecordedEnvironment
from robot_runner.replication.named_secrets import Grammar
from robot_runner.replication.plain_zip import PlainZip, Progress, looks_like_a_bomb
from robot_runner.replication.redaction import Redactor, chunks_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Packing:
    """Options for packing.

    Attributes:
        raw: the plugins whose raw data is packed: `all`, `none`, or their names.
        keep: patterns of the names of files to pack unchanged, although they seem to hold secrets.
        doubtful: how to treat a possible secret: refuse to pack, pack it unchanged, or replace it.
        authors, licence, citation: override those of the config.
        with_wheels: whether to pack distributions that exist only on this machine as wheels.
        with_hashes: whether to ask the package index of pip's settings for hashes that are not in Robot Runner's lock.

    Example:
        >>> Packing(raw=("Ina219",)).licence is None
        True
    """

    raw: tuple[str, ...] = (ALL,)
    keep: tuple[str, ...] = ()
    doubtful: Literal["refuse", "keep", "replace"] = "refuse"
    authors: tuple[Author, ...] = ()
    licence: str | None = None
    citation: str | None = None
    with_wheels: bool = True
    with_hashes: bool = False
    base_image: str | None = None


@dataclass(slots=True, kw_only=True)
class Sealing:
    """One package being written.

    Attributes:
        asked: the options.
        columns, rows: the run table's.
        elsewhere: the runs that another tool executed, by the run table.
        run_folders: the run of each run folder in the package, by the folder's name, which ends with `/`.
        chosen: the files to pack.
        programs: the names of those that are executable.
        redactor: replaces secrets.
        archive: the zip file.
        progress: called with the number of packed bytes and the total.
        left_out: the files that are not packed, and why.
        cleaning: replaced and possible secrets.
        wheels: the hash of each wheel, by the canonical name of its distribution.
    """

    asked: Packing
    about: About
    manifest: Mapping[str, Any]
    columns: Sequence[ColumnDescription]
    rows: RunTableRows
    elsewhere: Collection[str]
    run_folders: Mapping[str, str]
    chosen: Contents
    programs: Collection[str]
    environment: RecordedEnvironment
    redactor: Redactor
    archive: PlainZip
    progress: Progress
    left_out: list[LeftOut] = field(init=False)
    cleaning: Cleaning = field(init=False)
    wheels: dict[str, str] = field(init=False, default_factory=dict)
    _total: int = field(init=False)
    _done: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._total = sum(file.size for file in self.chosen.files)
        self.left_out = list(self.chosen.left_out)
        self.cleaning = Cleaning(self.redactor, self.asked.keep, self.left_out)

    def write_files(self) -> None:
        """Write the files of the experiment, and wheels of distributions installed from local folders.

        Raises:
            StorageError: a file cannot be read.
            PackageError: a file holds a possible secret, and the options refuse it.
            OSError: the package cannot be written.
        """
        for file in self.chosen.files:
            end = self._done + file.size
            if (blocks := self.cleaning.blocks_of(file)) is not None:
                self.archive.add(
                    file.name,
                    self._blocks(file, blocks),
                    size=file.size,
                    is_stored=looks_like_a_bomb(file.path, file.size),
                    is_program=file.name in self.programs,
                )
            self._advance(end - self._done)  # a replacement may be longer or shorter than the secret
        for distribution in self.environment.local if self.asked.with_wheels else ():
            self._add_wheel(distribution)
        if self.asked.doubtful == "refuse":
            PackageError.refuse(self.cleaning.refusals())

    def _blocks(self, file: PackedFile, blocks: Iterator[bytes]) -> Iterator[bytes]:
        with storage_errors(file.path, "read"):
            for block in blocks:
                yield block
                self._advance(len(block))

    def _advance(self, count: int) -> None:
        self._done = min(self._total, self._done + count)
        self.progress(self._done, self._total)

    def _add_wheel(self, distribution: InstalledDistribution) -> None:
        secrets, wheel = Counter[str](), io.BytesIO()
        with storage_errors(Path(distribution.name), "read"):
            files = wheel_of(distribution)
            for path in files.values():
                with open_to_read(path) as file:
                    secrets += self.redactor.own.secrets_in(chunks_of(file), Grammar.MARKUP)
            if files and not secrets:
                write_wheel(files, wheel)
        if not files or secrets:
            why = f"the package holds {in_words(secrets)}" if secrets else "the package's code cannot be found"
            self.left_out.append(LeftOut(f"wheel of {distribution.name}", why))
            return
        stored = self.archive.add(f"{contents.WHEELS}/{wheel_name(distribution)}", [wheel.getvalue()])
        self.wheels[canonical(distribution.name)] = stored.sha256

    def describe(self, environment: RecordedEnvironment) -> None:
        """Add the descriptions of the files and of the environment, with the known hashes.

        Raises:
            PackageError: the crate would not be valid.
            OSError: the package cannot be written.
        """
        self.environment = environment
        stored = self.archive.stored
        if table := stored.get(contents.TABLE):
            schema = contents.SCHEMA if contents.SCHEMA in stored else None
            resource = table_resource(table.name, table.size, table.sha256, schema=schema)
            self._add_json(contents.DATA_PACKAGE, data_package(self.about.name, [resource]))
        self._add_text(contents.REQUIREMENTS, self.environment.requirements(self.wheels))
        self._add_json(contents.ENVIRONMENT, self.environment.as_mapping(self.wheels))
        self._add_text(contents.CONTAINERFILE, self._containerfile())
        self._add_json(contents.DESCRIPTION, self._description())
        self._add_terms()
        names = [*stored, contents.BADGES, contents.README]
        self._add_text(contents.BADGES, badges_text(self._badge_facts({*names, contents.CRATE, contents.SUMS})))
        self._add_text(contents.README, readme(self.about, self.manifest, names, self.left_out))
        crate = crate_text(
            self.about,
            self.manifest,
            [stored[name] for name in sorted(stored)],
            columns=self.columns,
            runs=[run for run in executed_runs(self.rows, self.columns) if run.run_id not in self.elsewhere],
            run_folders=self.run_folders,
        )
        folders = contents.folders_of(stored, self.run_folders)
        PackageError.refuse(crate_faults(crate, {*stored, *folders, contents.SUMS}))
        self._add_text(contents.CRATE, crate)
        sums = "".join(f"{file.sha256}  {name}\n" for name, file in sorted(stored.items()))
        self.archive.add(contents.SUMS, [sums.encode()])
        self.archive.add_folders(folders)

    def _add_terms(self) -> None:
        """Add the licence's text, unless the folder has one, and the citation files."""
        about = self.about
        if contents.LICENCE not in self.archive.stored and (text := licence_text(about)):
            self._add_text(contents.LICENCE, text)
        self._add_text(contents.CITATION, citation_text(about, about.described(self.manifest)))
        self._add_text(contents.ZENODO, zenodo_text(about, about.described(self.manifest)))

    def _badge_facts(self, names: set[str]) -> BadgeFacts:
        return BadgeFacts(
            self.about,
            self.manifest,
            self.columns,
            names,
            self.rows,
            tuple(each.name for each in self.left_out),
            len(self.environment.needed),
            len(self.environment.without_hash(self.wheels)),
        )

    def _containerfile(self) -> str:
        needed = {canonical(each.name) for each in self.environment.needed}
        return containerfile(
            self.manifest,
            has_wheels=bool(self.wheels),
            demands_hashes=not self.environment.without_hash(self.wheels),
            has_comparison=packages_of_extra("robot-runner", "analysis") <= needed,
            image=self.asked.base_image,
        )

    def _description(self) -> dict[str, Any]:
        return {
            "format": contents.FORMAT,
            "made_by": f"robot-runner {version('robot-runner')}",
            "experiment": self.about.name,
            "config": self.manifest.get("config"),
            "raw": list(self.asked.raw),
            "base_image": self.asked.base_image,
            "left_out": [asdict(each) for each in self.left_out],
            "replaced": [asdict(each) for each in self.cleaning.replaced],
            "doubtful": [asdict(each) for each in self.cleaning.doubtful],
            "not_searched": [asdict(each) for each in self.cleaning.unread],
        }

    def _add_json(self, name: str, facts: Any) -> None:
        self._add_text(name, json.dumps(facts, indent=2, ensure_ascii=False, default=str) + "\n")

    def _add_text(self, name: str, text: str) -> None:
        """Write a text that was generated from the manifest, redacted: the manifest may hold secrets."""
        self.archive.add(name, [self.redactor.redacted(text.encode())])


_FIX = "Report this: what packing writes is not what RO-Crate asks for."
_ACTIONS = frozenset({"CreateAction", "ActivateAction", "UpdateAction"})
_WORKFLOW = frozenset({"File", "SoftwareSourceCode", "ComputationalWorkflow"})


def crate_faults(text: str, names: Collection[str]) -> Iterator[Finding]:
    """Yield an error finding for each violated rule of the crate formats; packing is refused then.

    Checked are those REQUIRED rules of RO-Crate 1.1, Process Run Crate and Workflow Run Crate (0.5) that an experiment
    could violate. The project's tests check all of them with the validator by the authors of the formats.

    Args:
        text: of `ro-crate-metadata.json`.
        names: the files and folders of the package; those of folders end with `/`.

    Example:
        >>> text = '{"@graph": [{"@id": "./", "@type": "Dataset", "name": "naps"}]}'
        >>> [finding.problem for finding in crate_faults(text, [])][0]
        'the package has no description'
    """
    graph: dict[str, Mapping[str, Any]] = {str(each["@id"]): each for each in json.loads(text)["@graph"]}
    problems = (
        *_root_problems(graph),
        *_file_problems(graph, set(names)),
        *_reference_problems(graph),
        *_action_problems(graph),
    )
    yield from (Finding.error(CRATE, problem, _FIX) for problem in problems)


def _root_problems(graph: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    root = graph["./"]
    for name in ("name", "description", "datePublished", "license"):
        if not root.get(name):
            yield f"the package has no {name}"
    try:
        datetime.fromisoformat(str(root.get("datePublished")))
    except ValueError:
        yield f"datePublished is {root.get('datePublished')!r}, no date of ISO 8601"


def _file_problems(graph: Mapping[str, Mapping[str, Any]], names: set[str]) -> Iterator[str]:
    described = {unquote(key) for key, each in graph.items() if {"File", "Dataset"} & _types(each)} - {"./"}
    for name in sorted(described - names):
        yield f"{name} is described, and is not in the package"
    for name in sorted(each for each in names - described - {CRATE} if not each.endswith("/")):
        yield f"{name} is in the package, and is not described"


def _reference_problems(graph: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    for key, each in graph.items():
        for name, value in each.items():
            for part in value if isinstance(value, list) else [value]:
                other = part.get("@id") if isinstance(part, dict) else None
                if other and "://" not in other and other not in graph:
                    yield f"{name} of {key} names {other}, which nothing describes"


def _action_problems(graph: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    actions = [each for each in graph.values() if _ACTIONS & _types(each)]
    instruments = {(each.get("instrument") or {}).get("@id") for each in actions}
    if not actions or None in instruments:
        yield "an action has no instrument" if actions else "nothing says what was executed"
    main = graph["./"].get("mainEntity")
    if main and not (main["@id"] in instruments and _types(graph.get(main["@id"], {})) >= _WORKFLOW):
        yield f"no action says that {main['@id']} was executed as a workflow"


def _types(entity: Mapping[str, Any]) -> set[str]:
    kinds = entity.get("@type", [])
    return {kinds} if isinstance(kinds, str) else set(kinds)
