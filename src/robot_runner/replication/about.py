"""The documents of a package: authors, licence, README, citation."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from robot_runner.core.config.authors import Author
from robot_runner.core.errors import Finding, nearest
from robot_runner.core.storage.manifest import last_execution
from robot_runner.core.words import listed, shown_commit
from robot_runner.replication.container import container_commands
from robot_runner.replication.contents import CRATE, DESCRIBED, LICENCE, SUMS, WHEELS, LeftOut


@dataclass(frozen=True, slots=True)
class About:
    """Facts that others need before they use a package.

    Attributes:
        name: the experiment's.
        authors: each a mapping with `name`, `orcid`, `affiliation`, `affiliation_url`.
        licence: an SPDX identifier or a URL.
        date: the end of the last execution, or its beginning if it did not end, or the time of the import (UTC).

    Example:
        >>> about = About("naps", ({"name": "Ada Lovelace"},), "CC-BY-4.0", None, "2026-01-31T12:00:00Z")
        >>> about.licence_url
        'https://spdx.org/licenses/CC-BY-4.0'
    """

    name: str
    authors: tuple[Mapping[str, str | None], ...]
    licence: str | None
    citation: str | None
    date: str

    @classmethod
    def of_manifest(
        cls,
        manifest: Mapping[str, Any],
        *,
        authors: Sequence[Author] = (),
        licence: str | None = None,
        citation: str | None = None,
    ) -> Self:
        """Return the facts of the manifest, which has them from the config; arguments override them."""
        last, imported = last_execution(manifest), imported_facts(manifest) or {}
        return cls(
            str(manifest.get("experiment_name", "experiment")),
            tuple(author.as_mapping() for author in authors) or tuple(manifest.get("authors") or ()),
            licence or manifest.get("licence"),
            citation or manifest.get("citation"),
            str(last.get("finished_at") or last.get("started_at") or imported.get("at") or "1980-01-01T00:00:00Z"),
        )

    @property
    def licence_url(self) -> str | None:
        """A page about the licence."""
        if self.licence is None or self.licence.startswith(("http://", "https://")):
            return self.licence
        return f"https://spdx.org/licenses/{self.licence}"

    @property
    def authors_in_words(self) -> str:
        """The authors in one line."""
        return "; ".join(
            f"{each['name']} (https://orcid.org/{each['orcid']})" if each.get("orcid") else str(each["name"])
            for each in self.authors
        )

    def described(self, manifest: Mapping[str, Any]) -> str:
        """Return a description of the package in one sentence."""
        is_executed = imported_facts(manifest) is None
        holds = "config, run table, raw data, circumstances" if is_executed else "run table, raw data"
        return f"Replication package of the experiment {self.name}, {_came_about(manifest)}: {holds}."

    def findings(self) -> Iterator[Finding]:
        """Yield a warning for each missing fact, with the attribute of the config or the option that gives it."""
        if not self.authors:
            fix = "Give authors=[Author(...)] in the config, or --author."
            yield Finding.warning("authors", "nobody is named", fix)
        for each in self.authors:
            missing = [part for part in ("orcid", "affiliation", "affiliation_url") if not each.get(part)]
            if missing:
                problem = f"{each['name']} has no {', '.join(missing)}, which RO-Crate recommends"
                yield Finding.warning("authors", problem, "Give it in Author(...), or to --author.")
        if not self.licence:
            problem = (
                "no licence is given: the package says that all rights are reserved, and nobody may use the results"
            )
            yield Finding.warning("licence", problem, 'Give licence="CC-BY-4.0" in the config, or --licence.')
        if not self.citation:
            fix = "Give citation in the config, or --citation."
            yield Finding.warning("citation", "nothing says what to cite", fix)


_README = """\
# {name}

A replication package of an experiment {came_about}.

{facts}

## Replicate it

{replicating}

## What is in it

| file | holds |
|---|---|
{rows}
"""
_REPLICATING = """\
Where `robot-runner` is missing, install it from the folder that the package was unpacked to:

```console
$ python3 -m venv "$HOME/robot-runner"
$ "$HOME/robot-runner/bin/pip" install {ours}
$ export PATH="$HOME/robot-runner/bin:$PATH"
```

Nothing of the package is executed before it has been verified and you have said yes.

```console
$ robot-runner verify PACKAGE.zip
$ robot-runner replicate PACKAGE.zip --environment venv
```

`PACKAGE.zip` is this package, or the folder it was unpacked to. The last command makes the environment,
executes the same runs in the same order from the same seed, and says whether the results agree: exit code 0 where
they are identical or equivalent, 3 where they are different, 4 where that could not be decided.

Or in a container:

```console
{commands}
```"""
_NO_CONFIG = (
    "It has no config: nobody can execute it again. `robot-runner verify PACKAGE.zip` says whether it is whole."
)
_NOT_IN_IT = """
## What is not in it

{items}
"""


def imported_facts(manifest: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return when and from where results were imported; None if Robot Runner executed the runs."""
    if manifest.get("origin") != "imported":
        return None
    facts = manifest.get("imported")
    return facts if isinstance(facts, dict) else {}


def _came_about(manifest: Mapping[str, Any]) -> str:
    done = "executed with" if imported_facts(manifest) is None else "imported into"
    return f"{done} Robot Runner {manifest.get('software', {}).get('robot_runner', '')}"


def readme(about: About, manifest: Mapping[str, Any], names: Sequence[str], left_out: Sequence[LeftOut]) -> str:
    """Return the README, in Markdown.

    Args:
        about: authors, licence and citation.
        manifest: the experiment's.
        names: the files of the package.
        left_out: the files that were left out.
    """
    imported = imported_facts(manifest)
    facts = {
        "Authors": about.authors_in_words,
        "Licence": about.licence,
        "Cite": about.citation,
        "Robot": imported is None and (manifest.get("robot") or "none, or as the config says"),
        "Seed": imported is None and str(manifest.get("seed")),
        "Imported": imported and f"{imported.get('at')} from {imported.get('table')} of {imported.get('from')}",
        "Commit of the config": shown_commit(last_execution(manifest).get("repository")),
    }
    present = {*names, *(f"{name.partition('/')[0]}/" for name in names if "/" in name), CRATE, SUMS}
    commands = "\n".join(f"$ {command}" for command in container_commands(about.name, "."))
    text = _README.format(
        name=about.name,
        came_about=_came_about(manifest),
        facts="\n".join(f"- {what}: {text}" for what, text in facts.items() if text),
        replicating=_REPLICATING.format(commands=commands, ours=_ours(manifest, names))
        if "config/" in present
        else _NO_CONFIG,
        rows="\n".join(_inventory(present)),
    )
    items = "\n".join(f"- `{each.name}`: {each.why}" for each in left_out)
    return text + (_NOT_IN_IT.format(items=items) if items else "")


def _ours(manifest: Mapping[str, Any], names: Sequence[str]) -> str:
    """Return what pip installs Robot Runner from: the wheel in the package, or else the executed version's name."""
    version = (manifest.get("software") or {}).get("robot_runner")
    named = f"robot-runner=={version}" if version else "robot-runner"
    return next((name for name in names if name.startswith(f"{WHEELS}/robot_runner-")), named)


def _inventory(present: Collection[str]) -> Iterator[str]:
    """Yield a row for each described file and folder, and one for all others in the experiment's folder."""
    yield from (f"| `{name}` | {holds} |" for name, holds in DESCRIBED.items() if name in present)
    others = sorted({name for name in present if "/" not in name.removesuffix("/")} - {*DESCRIBED, "environment/"})
    if others:
        named = listed(f"`{name}`" for name in others).replace("|", "\\|")
        yield f"| {named} | runs of an earlier tool, and what else stood in the experiment's folder |"


#: Stands in the place of a licence.
NO_LICENCE = (
    "No licence was given: all rights are reserved by the authors. Ask them before you use or share the package."
)

_FORMAT = "1.2.0"
_KEYWORDS = ("robotics", "experiment", "replication")
_DOI = re.compile(r"10\.\d{4,9}/[^\s\"<>]+")
#: Variables in the templates of SPDX: `original` is the default text.
_VARIABLE = re.compile(r"<<var;[^>]*?original=((?:<[^>]*>|[^;>])*);.*?>>")
_OPTIONAL = re.compile(r"<<(?:begin|end)Optional[^>]*>>")
_YEAR = re.compile(r"<year>|\[yyyy\]")
_OWNER = re.compile(r"<(?:copyright holders?|owner|organization)>|\[name of copyright owner\]")


def licence_text(about: About) -> str | None:
    """Return the text of the licence from the licence list of SPDX; None if the list does not have it.

    Year and owner are filled in if the text has placeholders for them.
    """
    if about.licence is None:
        return f"{NO_LICENCE}\n"
    if (record := _known_licences().get(about.licence)) is None:
        return None
    import spdx  # noqa: PLC0415 - an extra

    owners = "; ".join(str(each["name"]) for each in about.authors) or "the authors"
    # Functions, since in a replacement text a backslash of a name would be an escape.
    text = _VARIABLE.sub(lambda found: found[1].strip(), _OPTIONAL.sub("", str(spdx.License(record).template)))
    text = _OWNER.sub(lambda _: owners, _YEAR.sub(about.date[:4], text))
    return "\n".join(line.rstrip() for line in text.strip().splitlines()) + "\n"


def missing_text(about: About) -> Finding:
    """Return the finding that the licence's text is not in the package."""
    problem = (
        f"the text of {about.licence} is not in the package: SPDX's list, as it is installed here, does not have it"
    )
    near = nearest(str(about.licence), _known_licences())
    otherwise = f"; or is it {near}?" if near else "."
    fix = f"Put its text into the experiment's folder as {LICENCE}, then pack again{otherwise}"
    return Finding.warning("licence", problem, fix)


def citation_text(about: About, description: str) -> str:
    """Return `CITATION.cff`, with one sentence on the package (https://citation-file-format.github.io, 1.2.0)."""
    cite = f" Cite this, too: {about.citation}" if about.citation else ""
    facts = {
        "cff-version": _FORMAT,
        "message": f"If you use this replication package, cite it as below.{cite}",
        "type": "dataset",
        "title": _title(about),
        "abstract": description,
        "authors": [_cff_author(each) for each in about.authors] or [{"name": f"The authors of {about.name}"}],
        "date-released": about.date[:10],
        "keywords": list(_KEYWORDS),
        **_cff_licence(about),
    }
    return "\n".join(_yaml(facts)) + "\n"


def zenodo_text(about: About, description: str) -> str:
    """Return `.zenodo.json`, Zenodo's metadata of an upload; `description` is one sentence."""
    creators = [
        {
            "name": _family_first(str(each["name"])),
            **{name: each[name] for name in ("affiliation", "orcid") if each.get(name)},
        }
        for each in about.authors
    ]
    doi = _DOI.search(about.citation or "")
    facts = {
        "upload_type": "dataset",
        "title": _title(about),
        "description": description,
        "creators": creators or [{"name": f"The authors of {about.name}"}],
        "publication_date": about.date[:10],
        "keywords": list(_KEYWORDS),
        # Without a licence, the authors choose the access rights in the form of the upload.
        **({"access_right": "open", "license": about.licence} if about.licence in _known_licences() else {}),
        **({"notes": f"Cite this, too: {about.citation}"} if about.citation else {}),
    }
    if doi:
        identifier = doi[0].rstrip(".,;)")
        facts["related_identifiers"] = [{"identifier": identifier, "relation": "isSupplementTo", "scheme": "doi"}]
    return json.dumps(facts, indent=2, ensure_ascii=False) + "\n"


def _known_licences() -> dict[str, dict[str, Any]]:
    import spdx  # noqa: PLC0415 - an extra

    known = {str(each["id"]): each for each in spdx.licenses()}
    # The list is older than these names of GNU's licences.
    gnu = {f"{name}-{kind}": known[name] for name in known if "GPL-" in name for kind in ("only", "or-later")}
    return {**gnu, **known}


def _title(about: About) -> str:
    return f"Replication package of the experiment {about.name}"


def _cff_licence(about: About) -> dict[str, str]:
    if about.licence is None:
        return {}
    if about.licence in _known_licences():  # the format has its own list of licences, which includes these
        return {"license": about.licence}
    return {"license-url": str(about.licence_url)}


def _cff_author(author: Mapping[str, str | None]) -> dict[str, str]:
    family, _, given = _family_first(str(author["name"])).partition(", ")
    orcid = author.get("orcid")
    facts = {
        "family-names": family,
        "given-names": given,
        "affiliation": author.get("affiliation"),
        "orcid": f"https://orcid.org/{orcid}" if orcid else None,
    }
    return {name: text for name, text in facts.items() if text}


def _family_first(name: str) -> str:
    """Return a name with the family name first: the part before a comma, otherwise the last word.

    Example:
        >>> _family_first("Josiah S. Carberry"), _family_first("van Beethoven, Ludwig"), _family_first("Plato")
        ('Carberry, Josiah S.', 'van Beethoven, Ludwig', 'Plato')
    """
    if "," in name:
        family, _, given = name.partition(",")
        return f"{family.strip()}, {given.strip()}"
    given, _, family = name.strip().rpartition(" ")
    return f"{family}, {given}" if given else family


def _yaml(facts: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a mapping of texts, lists of texts and lists of mappings; JSON's texts are YAML's, too."""
    for name, value in facts.items():
        if isinstance(value, str):
            yield f"{name}: {json.dumps(value, ensure_ascii=False)}"
            continue
        yield f"{name}:"
        for each in value:
            lines = list(_yaml(each)) if isinstance(each, dict) else [json.dumps(each, ensure_ascii=False)]
            yield f"  - {lines[0]}"
            yield from (f"    {line}" for line in lines[1:])
