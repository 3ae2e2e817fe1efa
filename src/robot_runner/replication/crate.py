"""The package as an RO-Crate (1.1) of the profile Process Run Crate (0.5).

https://www.researchobject.org/ro-crate/specification/1.1/ and https://www.researchobject.org/workflow-run-crate/. The
experiment is one action: Robot Runner executed a config, with the results as its outcome.
"""

from __future__ import annotations

import json
import re
from importlib.metadata import PackageNotFoundError, metadata
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import PackageError
from robot_runner.core.storage.table_columns import ColumnRole
from robot_runner.core.words import shown_commit
from robot_runner.replication.contents import CRATE, DESCRIBED, REQUIREMENTS, SUMS, media_type_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from robot_runner.core.storage.table_schema import ColumnDescription
    from robot_runner.replication.about import About
    from robot_runner.replication.plain_zip import StoredFile

__all__ = ["crate_text", "require_rocrate"]

_PROFILE = "https://w3id.org/ro/wfrun/process/0.5"

_PAPER = "https://doi.org/10.1109/ICSE-Companion52605.2021.00029"
_SHA256 = "https://w3id.org/ro/terms/workflow-run#sha256"
_EXPERIMENT = "#experiment"


def require_rocrate() -> Any:
    """Return the library that knows RO-Crates.

    Raises:
        PackageError: it is not installed.
    """
    try:
        from rocrate import rocrate  # noqa: PLC0415 - slow, and an extra
    except ImportError as error:
        fix = "Install it: pip install 'robot-runner[replication]'"
        raise PackageError("the package rocrate is not installed", where="robot-runner pack", fix=fix) from error
    return rocrate


def crate_text(
    about: About,
    manifest: Mapping[str, Any],
    columns: Sequence[ColumnDescription],
    files: Iterable[StoredFile],
    *,
    failed: int,
) -> str:
    """Return the text of `ro-crate-metadata.json`.

    Args:
        about: who made the experiment, and under which terms.
        manifest: the experiment's.
        columns: the run table's.
        files: everything else in the package, in order.
        failed: how many runs failed.
    """
    return _Crate(about, manifest).text(columns, list(files), failed=failed)


class _Crate:
    def __init__(self, about: About, manifest: Mapping[str, Any]) -> None:
        self._library = require_rocrate()
        self._crate = self._library.ROCrate(version="1.1")
        self._crate.metadata.extra_terms["sha256"] = _SHA256
        self._about = about
        self._manifest = manifest
        self._pages: dict[str, Any] = {}

    def text(self, columns: Sequence[ColumnDescription], files: Sequence[StoredFile], *, failed: int) -> str:
        root = self._crate.root_dataset
        parts = {file.name: self._file(file) for file in files}
        # The checksums are written last, as they cover this text, too: their own size and checksum are not known yet.
        parts[SUMS] = self._entity(SUMS, "File", **self._format(SUMS), name=SUMS, description=_described(SUMS))
        folders = self._folders(parts)
        # Set at once: appending one by one takes a time that grows with the square of their number.
        root["hasPart"] = [part for name, part in parts.items() if "/" not in name] + list(folders.values())
        authors = [self._author(each, place) for place, each in enumerate(self._about.authors)]
        self._describe_root(columns, authors)
        root["mentions"] = [self._action(parts, folders, authors, failed=failed)]
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
        return self._entity(
            file.name,
            "File",
            name=file.name,
            description=_described(file.name),
            contentSize=str(file.size),
            sha256=file.sha256,
            **self._format(file.name),
        )

    def _format(self, name: str) -> dict[str, Any]:
        kind = media_type_of(name)
        if kind.page not in self._pages:
            self._pages[kind.page] = self._entity(kind.page, "WebSite", name=kind.title)
        return {"encodingFormat": [kind.name, self._pages[kind.page]]}

    def _folders(self, parts: Mapping[str, Any]) -> dict[str, Any]:
        below: dict[str, list[Any]] = {}
        for name, part in parts.items():
            if "/" in name:
                below.setdefault(f"{name.partition('/')[0]}/", []).append(part)
        return {name: self._entity(name, "Dataset", name=name[:-1], hasPart=inner) for name, inner in below.items()}

    def _describe_root(self, columns: Sequence[ColumnDescription], authors: Sequence[Any]) -> None:
        root, about = self._crate.root_dataset, self._about
        software = self._manifest.get("software", {})
        root["name"] = about.name
        root["description"] = (
            f"Replication package of the experiment {about.name}, executed with Robot Runner "
            f"{software.get('robot_runner', '')}: config, run table, raw data, circumstances."
        )
        root["datePublished"] = _iso(about.date)
        root["conformsTo"] = [self._entity(_PROFILE, "CreativeWork", name="Process Run Crate", version="0.5")]
        root["keywords"] = "robotics, experiment, replication"
        if about.licence_url:
            text = f"The licence of this package: {about.licence}"
            root["license"] = self._entity(about.licence_url, "CreativeWork", name=about.licence, description=text)
        if about.citation:
            root["citation"] = self._citation(about.citation)
        if authors:
            root["author"] = list(authors)
        if organisations := [each["affiliation"] for each in authors if each.get("affiliation")]:
            root["publisher"] = organisations[0]
        root["variableMeasured"] = [
            self._entity(
                f"#measure-{_slug(column.name)}",
                "PropertyValue",
                name=column.name,
                unitText=column.unit,
                description=column.description,
                measurementTechnique=column.origin,
            )
            for column in columns
            if column.role is ColumnRole.MEASURE
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
            identifier = url or f"#organisation-{_slug(organisation)}"
            affiliation = self._crate.dereference(identifier) or self._entity(
                identifier, "Organization", name=organisation, url=url
            )
        person = f"https://orcid.org/{orcid}" if orcid else f"#author-{place + 1}"
        return self._entity(person, "Person", name=author.get("name"), affiliation=affiliation)

    def _action(
        self, parts: Mapping[str, Any], folders: Mapping[str, Any], authors: Sequence[Any], *, failed: int
    ) -> Any:
        executions = self._manifest.get("executions") or [{}]
        ended = executions[-1].get("finished_at")
        inputs = [name for name in parts if name.startswith("config/") or name == REQUIREMENTS]
        results = [name for name in ("run_table.csv", "journal.jsonl", "manifest.json") if name in parts]
        status = "CompletedActionStatus" if ended and not failed else "FailedActionStatus"
        error = f"{failed} runs failed." if failed else None if ended else "The experiment did not come to its end."
        return self._entity(
            _EXPERIMENT,
            "CreateAction",
            name=f"Execution of {self._about.name}",
            description=f"Robot Runner executed the runs of {self._about.name}.",
            startTime=_iso(executions[0].get("started_at")),
            endTime=_iso(ended or executions[-1].get("started_at")),
            agent=list(authors),
            instrument=self._robot_runner(),
            object=[*(parts[name] for name in inputs), *self._sources()],
            result=[
                *(parts[name] for name in results),
                *(folders[name] for name in ("runs/", "report/") if name in folders),
            ],
            actionStatus=f"http://schema.org/{status}",
            error=error,
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
                f"{page}#plugin-{_slug(name)}",
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
    """Return the page that a plugin's package names as its own; the paper's where it names none."""
    try:
        pages = metadata(package).get_all("Project-URL") if package else None
    except PackageNotFoundError:
        pages = None
    urls = [each.partition(",")[2].strip() for each in pages or ()]
    return next((each for each in urls if each.startswith("https://")), _PAPER)


def _compact(entity: dict[str, Any]) -> dict[str, Any]:
    """Return an entity whose lists of one are that one, as RO-Crate recommends."""
    return {name: value[0] if isinstance(value, list) and len(value) == 1 else value for name, value in entity.items()}


def _iso(stamp: str | None) -> str | None:
    return stamp.replace("Z", "+00:00") if stamp else None


def _slug(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "-", text).strip("-") or "unnamed"
