"""The package as an RO-Crate (1.1) of the profiles Process Run Crate and Workflow Run Crate (0.5).

https://www.researchobject.org/ro-crate/specification/1.1/ and https://www.researchobject.org/workflow-run-crate/. The
experiment is one action: Robot Runner executed a config, with the results as its outcome. The config is the workflow,
and each run is an action that executed it (`crate_actions`).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import quote

from robot_runner.core.errors import PackageError
from robot_runner.core.storage.manifest import last_execution
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole
from robot_runner.core.words import counted, shown_commit
from robot_runner.replication.about import NO_LICENCE, About, imported_facts
from robot_runner.replication.contents import (
    CRATE,
    DESCRIBED,
    LICENCE,
    README,
    REQUIREMENTS,
    SUMS,
    TABLE,
    config_of,
    folder_of,
    media_type_of,
)
from robot_runner.replication.crate_actions import ExecutedRun, RunActions, action_outcome, iso_stamp
from robot_runner.replication.plain_zip import StoredFile

_PROCESS = ("https://w3id.org/ro/wfrun/process/0.5", "Process Run Crate", "0.5")
_WORKFLOW = (
    ("https://w3id.org/ro/wfrun/workflow/0.5", "Workflow Run Crate", "0.5"),
    ("https://w3id.org/workflowhub/workflow-ro-crate/1.0", "Workflow RO-Crate", "1.0"),
)
_BIOSCHEMAS_WORKFLOW = "https://bioschemas.org/profiles/ComputationalWorkflow/1.0-RELEASE"
_PYTHON = "https://www.python.org"
_PAPER = "https://doi.org/10.1109/ICSE-Companion52605.2021.00029"
_SHA256 = "https://w3id.org/ro/terms/workflow-run#sha256"
_EXPERIMENT = "#experiment"


def require_rocrate() -> Any:
    """Return the library for RO-Crates.

    Raises:
        PackageError: the library is not installed.
    """
    try:
        import spdx  # noqa: F401, PLC0415 - an extra; packing needs it, too
        from rocrate import rocrate  # noqa: PLC0415 - slow, and an extra
    except ImportError as error:
        fix = "Install it: pip install 'robot-runner[replication]'"
        raise PackageError(f"the package {error.name} is not installed", where="robot-runner pack", fix=fix) from error
    return rocrate


def crate_text(
    about: About,
    manifest: Mapping[str, Any],
    files: Sequence[StoredFile],
    *,
    columns: Sequence[ColumnDescription],
    runs: Sequence[ExecutedRun],
    run_folders: Mapping[str, str],
) -> str:
    """Return the text of `ro-crate-metadata.json`.

    Args:
        about: authors, licence and citation.
        manifest: the experiment's.
        files: all other files of the package, in order.
        columns: the run table's.
        runs: the executed runs.
        run_folders: the run of each run folder in the package, by the folder's name, which ends with `/`.
    """
    crate = _Crate(about, manifest, runs, run_folders)
    return crate.text(files, [each for each in columns if each.role is ColumnRole.MEASURE])


class _Crate:
    def __init__(
        self, about: About, manifest: Mapping[str, Any], runs: Sequence[ExecutedRun], run_folders: Mapping[str, str]
    ) -> None:
        self._crate = require_rocrate().ROCrate(version="1.1")
        self._crate.metadata.extra_terms["sha256"] = _SHA256
        self._about, self._manifest = about, manifest
        self._executed, self._run_folders = runs, run_folders
        # Where no run has ended there is no action, which a Workflow Run Crate must have: the config is a file then.
        self._workflow = config_of(manifest) if runs else ""
        self._pages: dict[str, Any] = {}

    def text(self, files: Sequence[StoredFile], measures: Sequence[ColumnDescription]) -> str:
        root = self._crate.root_dataset
        parts = {file.name: self._file(file) for file in files}
        # The checksums are written last, as they cover this text, too: their size and SHA-256 are still unknown.
        parts[SUMS] = self._entity(SUMS, "File", **self._format(SUMS), name=SUMS, description=_described(SUMS))
        folders = self._folders(parts)
        # Set at once: appending one by one takes quadratic time.
        root["hasPart"] = [part for name, part in parts.items() if "/" not in name] + list(folders.values())
        authors = [self._author(each, place) for place, each in enumerate(self._about.authors)]
        self._describe_root(parts, authors, measures)
        root["mentions"] = [self._action(parts, folders, authors), *self._runs(parts, authors)]
        return json.dumps(self._generated(), indent=1, ensure_ascii=False, sort_keys=True) + "\n"

    def _generated(self) -> Any:
        metadata = self._crate.metadata.generate()
        metadata["@graph"] = [_compact(entity) for entity in metadata["@graph"]]
        metadata["@graph"].sort(key=lambda entity: (entity["@id"] != CRATE, entity["@id"] != "./", entity["@id"]))
        return metadata

    def _entity(self, identifier: str, kind: str, **properties: Any) -> Any:
        from rocrate.model import ContextEntity, Dataset, File  # noqa: PLC0415 - slow, and an extra

        known = {name: value for name, value in properties.items() if value not in (None, "", [])}
        if kind in {"File", "Dataset"}:
            entity = (File if kind == "File" else Dataset)(self._crate, dest_path=identifier, properties=known)
        else:
            entity = ContextEntity(self._crate, identifier, properties={"@type": kind, **known})
        self._crate.add(entity)
        return entity

    def _file(self, file: StoredFile) -> Any:
        facts = {"name": file.name, "contentSize": str(file.size), "sha256": file.sha256, **self._format(file.name)}
        if file.name == self._workflow:
            return self._main_workflow(facts)
        if re.fullmatch(rf"earlier_configs/\d+/{re.escape(PurePosixPath(self._workflow).name)}", file.name):
            facts["@type"] = ["File", "SoftwareSourceCode"]  # what executed a run must be such
        about = self._crate.root_dataset if file.name == README else None
        return self._entity(file.name, "File", description=_described(file.name), about=about, **facts)

    def _main_workflow(self, facts: dict[str, Any]) -> Any:
        from rocrate.model import ComputerLanguage  # noqa: PLC0415 - slow, and an extra

        python = str(self._manifest.get("software", {}).get("python") or "")
        known = {"name": "Python", "url": {"@id": _PYTHON}, **({"version": python} if python else {})}
        language = self._crate.add(ComputerLanguage(self._crate, _PYTHON, properties=known))
        repository = last_execution(self._manifest).get("repository") or {}
        origin, file_id = str(repository.get("origin") or ""), quote(self._workflow)
        facts |= {
            "conformsTo": {"@id": _BIOSCHEMAS_WORKFLOW},
            "description": f"The config of {self._about.name}.",
            "url": origin if origin.startswith("https://") else {"@id": file_id},
            "version": repository.get("commit") or facts["sha256"],
        }
        return self._crate.add_workflow(dest_path=self._workflow, properties=facts, main=True, lang=language)

    def _format(self, name: str) -> dict[str, Any]:
        kind = media_type_of(name)
        if kind.page not in self._pages:
            self._pages[kind.page] = self._entity(kind.page, "WebSite", name=kind.title)
        return {"encodingFormat": [kind.name, self._pages[kind.page]]}

    def _folders(self, parts: Mapping[str, Any]) -> dict[str, Any]:
        """Describe each top-level folder, and the run folders in it."""
        below: dict[str, list[Any]] = {}
        for name, part in parts.items():
            if "/" in name:
                below.setdefault(folder_of(name, self._run_folders), []).append(part)
        for name in [name for name in below if name.count("/") > 1]:
            run = self._entity(name, "Dataset", name=name[:-1], hasPart=below.pop(name))
            below.setdefault(f"{name.partition('/')[0]}/", []).append(run)
        return {name: self._entity(name, "Dataset", name=name[:-1], hasPart=inner) for name, inner in below.items()}

    def _describe_root(
        self, parts: Mapping[str, Any], authors: Sequence[Any], measures: Sequence[ColumnDescription]
    ) -> None:
        root, about = self._crate.root_dataset, self._about
        root["name"] = about.name
        root["description"] = about.described(self._manifest)
        root["datePublished"] = iso_stamp(about.date)
        profiles = (_PROCESS, *_WORKFLOW) if self._workflow in parts else (_PROCESS,)
        root["conformsTo"] = [
            self._entity(url, "CreativeWork", name=name, version=release) for url, name, release in profiles
        ]
        root["keywords"] = "robotics, experiment, replication"
        root["license"] = self._entity(
            about.licence_url or "#no-licence",
            "CreativeWork",
            name=about.licence or "No licence was given",
            description=f"The licence of this package: {about.licence}" if about.licence else NO_LICENCE,
            subjectOf=parts.get(LICENCE),
        )
        if about.citation:
            root["citation"] = self._citation(about.citation)
        if authors:
            root["author"] = list(authors)
        if organisations := [each["affiliation"] for each in authors if each.get("affiliation")]:
            root["publisher"] = organisations[0]
        root["variableMeasured"] = [
            self._entity(
                f"#measure-{_fragment(column.name)}",
                "PropertyValue",
                name=column.name,
                unitText=column.unit,
                description=column.description,
                measurementTechnique=column.origin,
            )
            for column in measures
        ]

    def _citation(self, text: str) -> Any:
        address = re.search(r"https?://\S+|\b10\.\d{4,9}/\S+", text)
        url = address[0].rstrip(".,;)") if address else ""
        identifier = f"https://doi.org/{url}" if url.startswith("10.") else url
        return self._entity(identifier or "#citation", "CreativeWork", name=text)

    def _author(self, author: Mapping[str, str | None], place: int) -> Any:
        orcid, organisation = author.get("orcid"), author.get("affiliation")
        affiliation = None
        if organisation:
            url = author.get("affiliation_url")
            identifier = url or f"#organisation-{_fragment(organisation)}"
            affiliation = self._crate.dereference(identifier)
            affiliation = affiliation or self._entity(identifier, "Organization", name=organisation, url=url)
        person = f"https://orcid.org/{orcid}" if orcid else f"#author-{place + 1}"
        return self._entity(person, "Person", name=author.get("name"), affiliation=affiliation)

    def _runs(self, parts: Mapping[str, Any], authors: Sequence[Any]) -> list[Any]:
        """Return the actions of the runs, if the package has the config that they executed."""
        if self._workflow not in parts:
            return []
        folders = {run: self._crate.dereference(name) for name, run in self._run_folders.items()}
        actions = RunActions(self._entity, parts[self._workflow], parts.get(TABLE), self._earlier_configs(parts))
        return actions.describe(self._executed, folders, authors)

    def _earlier_configs(self, parts: Mapping[str, Any]) -> dict[str, Any]:
        """Return the config that executed a run, by the run's id, where it was changed since."""
        executions, found = self._manifest.get("executions") or (), {}
        for run in self._executed:
            begun = [each for each in executions if str(each.get("started_at", "")) <= str(run.started_at)]
            number = begun[-1].get("config_number") if begun else None
            part = parts.get(f"earlier_configs/{number}/{PurePosixPath(self._workflow).name}")
            if part is not None:
                found[run.run_id] = part
        # A workflow that executed nothing is not allowed.
        return found if len(found) < len(self._executed) else {}

    def _action(self, parts: Mapping[str, Any], folders: Mapping[str, Any], authors: Sequence[Any]) -> Any:
        executions = self._manifest.get("executions") or [{}]
        ended = executions[-1].get("finished_at")
        inputs = [name for name in parts if name.startswith("config/") or name == REQUIREMENTS]
        results = [name for name in ("run_table.csv", "journal.jsonl", "manifest.json") if name in parts]
        failed = sum(run.has_failed for run in self._executed)
        imported, name = imported_facts(self._manifest), self._about.name
        error = None if ended or imported is not None else "The experiment did not come to its end."
        error = f"{counted(failed, 'run')} failed." if failed else error
        last = max((run.ended_at for run in self._executed if run.ended_at), default=None)
        return self._entity(
            _EXPERIMENT,
            "CreateAction",
            name=f"{'Execution' if imported is None else 'Import'} of {name}",
            description=f"Robot Runner {'executed' if imported is None else 'imported'} the runs of {name}.",
            startTime=iso_stamp(executions[0].get("started_at")),
            endTime=iso_stamp(ended or last),  # if it was killed, the end of its last run
            agent=list(authors),
            instrument=self._robot_runner(),
            object=[*(parts[name] for name in inputs), *self._sources()],
            result=[
                *(parts[name] for name in results),
                *(folders[name] for name in ("runs/", "report/") if name in folders),
            ],
            **action_outcome(error),
        )

    def _sources(self) -> Iterator[Any]:
        """Yield the commits that were executed: of the config's repository, and of the software under test."""
        executions = [each.get("repository") for each in self._manifest.get("executions") or ()]
        revisions = (self._manifest.get("revisions") or {}).values()
        found = [*filter(None, executions), *(facts for factor in revisions for facts in factor.values())]
        for facts in {each["commit"]: each for each in found}.values():
            yield self._entity(
                f"#commit-{facts['commit']}",
                "SoftwareSourceCode",
                name=shown_commit(facts),
                version=facts["commit"],
                codeRepository=facts.get("origin") or facts.get("repository"),
            )

    def _robot_runner(self) -> Any:
        return self._entity(
            f"{_PAPER}#robot-runner",
            "SoftwareApplication",
            name="Robot Runner",
            url=_PAPER,
            softwareVersion=str(self._manifest.get("software", {}).get("robot_runner", "unknown")),
            softwareRequirements=list(self._plugins()),
        )

    def _plugins(self) -> Iterator[Any]:
        for plugin in self._manifest.get("plugins", ()):
            kind, name = str(plugin.get("class", "")).rpartition(":")[2], str(plugin.get("name"))
            package = plugin.get("package")
            page = _page_of(package)
            yield self._entity(
                f"{page}#plugin-{_fragment(name)}",
                "SoftwareApplication",
                name=kind if kind == name else f"{kind} {name}",
                url=page,
                softwareVersion=f"{package} {plugin.get('version')}" if package else "a local module of the config",
                description=f"Yields {', '.join(plugin.get('measures') or ()) or 'no measures'}.",
            )


def _described(name: str) -> str:
    text = DESCRIBED.get(name, "")
    return f"{text[0].upper()}{text[1:]}." if text else ""


def _page_of(package: str | None) -> str:
    """Return the page of a plugin's package; the paper's if the package names none."""
    try:
        pages = metadata(package).get_all("Project-URL") if package else None
    except PackageNotFoundError:
        pages = None
    urls = [each.partition(",")[2].strip() for each in pages or ()]
    return next((each for each in urls if each.startswith("https://")), _PAPER)


def _compact(entity: dict[str, Any]) -> dict[str, Any]:
    """Return an entity with lists of one replaced by their element, as RO-Crate recommends."""
    return {name: value[0] if isinstance(value, list) and len(value) == 1 else value for name, value in entity.items()}


def _fragment(text: str) -> str:
    """Return a text quoted for an identifier; different texts stay different."""
    return quote(text, safe="") or "unnamed"
