"""Make a replication package from an experiment's folder alone."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection, Container, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robot_runner.core.errors import Finding, PackageError
from robot_runner.core.secret_names import forms_of, is_secret_name, secrets_of_environment
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.executed_runs import done_before, edited_findings, ended_runs, unrecorded_findings
from robot_runner.core.storage.guarded_files import read_text, sha256_of
from robot_runner.core.storage.input_files import read_index
from robot_runner.core.storage.layout import ExperimentFolder, home_folder
from robot_runner.core.storage.lock import holder_of
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.core.words import listed
from robot_runner.replication.about import About, imported_facts, missing_text
from robot_runner.replication.cleaning import Replaced
from robot_runner.replication.code_secrets import secrets_in_code
from robot_runner.replication.contents import LICENCE, Contents, LeftOut, choose_contents, folders_of
from robot_runner.replication.crate import require_rocrate
from robot_runner.replication.environment import record_environment
from robot_runner.replication.index_hashes import findings_of_hashes, with_known_hashes
from robot_runner.replication.opening import is_package
from robot_runner.replication.plain_zip import LARGEST_DIRECTORY, Progress, directory_size, written_beside
from robot_runner.replication.redaction import Redactor
from robot_runner.replication.run_by_run import statuses_that_count
from robot_runner.replication.sealing import Packing, Sealing
from robot_runner.replication.unkept_files import unkept_files, unkept_modules

#: Bytes of the directory that are left for the files that packing adds.
_ADDED = 1 << 16


@dataclass(frozen=True, slots=True)
class Packed:
    """A finished package.

    Attributes:
        sha256: of the whole file.
        file_count: the number of its files.
        left_out: the files that are not in it, and why.
        replaced: the replaced secrets, by file.
        doubtful: possible secrets that were packed unchanged.
        not_searched: files that could not be searched, and why.
        wheels: distributions that were packed as wheels.
        package_count: the number of Python packages that the experiment needs.
        without_hash: those packages without a known hash; pip demands hashes only if there are none.
        findings: facts that others will miss.
    """

    path: Path
    size: int
    sha256: str
    file_count: int
    left_out: tuple[LeftOut, ...]
    replaced: tuple[Replaced, ...]
    doubtful: tuple[Replaced, ...]
    not_searched: tuple[LeftOut, ...]
    wheels: tuple[str, ...]
    package_count: int
    without_hash: tuple[str, ...]
    findings: tuple[Finding, ...] = field(default=())


def pack(
    folder: Path,
    target: Path,
    packing: Packing | None = None,
    progress: Progress = lambda _, __: None,
    asking: Callable[[int], None] = lambda _: None,
) -> Packed:
    """Seal an experiment's folder as one file. Doing it twice gives the same bytes.

    Args:
        folder: the experiment's folder; nothing in it is changed.
        target: the file to write; an earlier package is replaced.
        packing: the options.
        progress: called with the number of packed bytes and the total.
        asking: called before the package index is asked for hashes, with the number of packages.

    Raises:
        PackageError: the experiment cannot be packed as it is, or holds a possible secret.
        StorageError: a file cannot be read or written.
    """
    require_rocrate()
    asked = packing or Packing()
    files = ExperimentFolder.found_at(folder)
    manifest = read_manifest(files.manifest)
    _refuse(files, target)
    columns = read_schema(files.schema)
    rows = read_run_table(files.run_table, TableLayout.of_schema(columns))
    run_ids = [rows.run_id(place) for place in range(len(rows))]
    runs_folder = f"{files.runs_name}/" if files.runs_name else ""
    about = About.of_manifest(manifest, authors=asked.authors, licence=asked.licence, citation=asked.citation)
    recorded = record_environment(manifest, files.config)
    run_folders = {f"{runs_folder}{each}/": each for each in run_ids}
    chosen, secrets = choose_contents(files, run_ids, asked.raw), _known_secrets(files, manifest)
    _refuse_too_many(files.root, chosen, run_folders)
    with written_beside(target) as archive:
        sealing = Sealing(
            asked=asked,
            about=about,
            manifest=manifest,
            columns=columns,
            rows=rows,
            elsewhere=done_before(manifest, ended_runs(files.journal)),
            run_folders=run_folders,
            chosen=chosen,
            programs={f"config/{name}" for each in read_index(files.config) for name in each.get("programs", ())},
            environment=recorded,
            redactor=Redactor.knowing(secrets, home=home_folder(), replaces_doubtful=asked.doubtful == "replace"),
            archive=archive,
            progress=progress,
        )
        sealing.write_files()
        # Last, as it may take minutes: everything that is refused has been refused before.
        environment, lacking = with_known_hashes(recorded, asking if asked.with_hashes else None)
        sealing.describe(environment)
    unknown = environment.without_hash(sealing.wheels)
    about_hashes = findings_of_hashes(unknown, lacking) if asked.with_hashes else ()
    terms = () if LICENCE in archive.stored else (missing_text(about),)
    return Packed(
        target,
        target.stat().st_size,
        sha256_of(target),
        len(archive.stored),
        tuple(sealing.left_out),
        tuple(sealing.cleaning.replaced),
        tuple(sealing.cleaning.doubtful),
        tuple(sealing.cleaning.unread),
        tuple(sorted(sealing.wheels)),
        len(environment.needed),
        tuple(each.name for each in unknown),
        (
            *about.findings(),
            *terms,
            *environment.findings,
            *about_hashes,
            *unkept_modules(files, environment),
            *_findings(files, manifest, rows, archive.stored),
        ),
    )


def _refuse(files: ExperimentFolder, target: Path) -> None:
    holder = holder_of(files.lock)
    if holder is not None:
        problem = f"the experiment is being executed by process {holder.pid} on {holder.host}"
        raise PackageError(problem, where=str(files.root), fix="Pack it once it has ended.")
    if files.root in target.resolve().parents:
        fix = "Name a file outside the experiment's folder."
        raise PackageError("a package cannot be part of what it holds", where=str(target), fix=fix)
    if target.is_dir():
        fix = f"Name a file in it: {target / files.root.name}.zip"
        raise PackageError("this is a folder, and a package is a file", where=str(target), fix=fix)
    if target.exists() and not is_package(target):
        fix = "Name another file, or remove that one."
        raise PackageError("a file of this name exists, and is not a package", where=str(target), fix=fix)


def _refuse_too_many(root: Path, chosen: Contents, run_folders: Container[str]) -> None:
    """Refuse more files than `verify` and `replicate` read."""
    names = {file.name for file in chosen.files}
    entries = names | folders_of(names, run_folders)
    if directory_size(entries, sum(file.size for file in chosen.files)) > LARGEST_DIRECTORY - _ADDED:
        problem = f"the package would have {len(entries):,} files and folders, more than verify and replicate read"
        fix = "Leave raw data out, --raw none, or name the plugins whose raw data others need, and archive the rest."
        raise PackageError(problem, where=str(root), fix=fix)


def _known_secrets(files: ExperimentFolder, manifest: Mapping[str, Any]) -> set[str]:
    """Return the secrets in environment variables, configs and settings, to find them in other files, too."""
    found = set(secrets_of_environment())
    for folder in (files.config, files.earlier_configs):
        for path in sorted(folder.rglob("*.py")):
            found |= secrets_in_code(read_text(path, files.root, errors="replace"))
    for execution in (manifest, *(manifest.get("executions") or ())):
        settings = execution.get("deviations") or {}
        found |= {str(text) for name, text in settings.items() if text and is_secret_name(str(name))}
    return {form for secret in found for form in forms_of(secret)}


def _findings(
    files: ExperimentFolder, manifest: Mapping[str, Any], rows: RunTableRows, stored: Collection[str]
) -> Iterator[Finding]:
    where = str(files.root)
    for factor, revisions in (manifest.get("revisions") or {}).items():
        absent = [name for name, facts in revisions.items() if not _is_whole(files, facts, stored)]
        if absent:
            why = "too large, with submodules, with a secret, or older than such copies"
            problem = f"the package has no copy of {listed(absent)}: {why}"
            fix = "Say in the package where the repository can be had, or give its public URL in the config."
            yield Finding.warning(f"revisions of factor {factor!r}", problem, fix)
    if not any(files.config.glob("*.py")):
        yield Finding.warning(where, "there is no config: nobody can execute it again", "Add it to the folder config.")
    yield from unkept_files(files, stored)
    if not files.report.exists():
        fix = f"Make one first: robot-runner report {shlex.quote(where)}"
        yield Finding.warning(where, "there is no report in it", fix)
    statuses = statuses_that_count(rows)
    if undone := sum(each is not RunStatus.DONE for each in statuses):
        is_ours = imported_facts(manifest) is None
        fix = "Resume the experiment first." if is_ours else "Say why where you publish it."
        yield Finding.warning(where, f"{undone} of {len(statuses)} runs are not done", fix)
    yield from unrecorded_findings(files.journal, rows.done_runs, ended_runs(files.journal), manifest)
    yield from edited_findings(files.journal, files.run_table, rows)


def _is_whole(files: ExperimentFolder, facts: Mapping[str, Any], stored: Container[str]) -> bool:
    """Whether the package has all files of the kept copy of a revision's repository."""
    copy = files.revisions / facts["kept"] if facts.get("kept") else None
    if copy is None or not copy.is_dir():
        return False
    return all(path.relative_to(files.root).as_posix() in stored for path in copy.rglob("*") if path.is_file())
