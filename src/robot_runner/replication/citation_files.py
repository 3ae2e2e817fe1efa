"""What others need to cite a package and to use it: licence text, `CITATION.cff`, `.zenodo.json`."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding, nearest
from robot_runner.replication.contents import LICENCE

if TYPE_CHECKING:
    from robot_runner.replication.about import About

#: Said wherever a licence would stand.
NO_LICENCE = (
    "No licence was given: all rights are reserved by the authors. Ask them before you use or share the package."
)

_FORMAT = "1.2.0"
_KEYWORDS = ("robotics", "experiment", "replication")
_DOI = re.compile(r"10\.\d{4,9}/[^\s\"<>]+")
#: How the texts of SPDX mark what a user may change: `original` is what stands there otherwise.
_VARIABLE = re.compile(r"<<var;[^>]*?original=((?:<[^>]*>|[^;>])*);.*?>>")
_OPTIONAL = re.compile(r"<<(?:begin|end)Optional[^>]*>>")
_YEAR = re.compile(r"<year>|\[yyyy\]")
_OWNER = re.compile(r"<(?:copyright holders?|owner|organization)>|\[name of copyright owner\]")


def licence_text(about: About) -> str | None:
    """Return the text of the licence, from the licence list of SPDX; None where the list does not have it.

    Year and owner are filled in where the text has a place for them.
    """
    if about.licence is None:
        return f"{NO_LICENCE}\n"
    if (record := _known_licences().get(about.licence)) is None:
        return None
    import spdx  # noqa: PLC0415 - an extra

    owners = "; ".join(str(each["name"]) for each in about.authors) or "the authors"
    # A function each: a backslash in a name is no escape.
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
    """Return `.zenodo.json`, which Zenodo takes the description of an upload from: one sentence."""
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
        # Without a licence, what an upload shows to everyone is still the authors' choice: it is left to the form.
        **({"access_right": "open", "license": about.licence} if about.licence in _known_licences() else {}),
        **({"notes": f"Cite this, too: {about.citation}"} if about.citation else {}),
    }
    if doi:
        identifier = doi[0].rstrip(".,;)")
        facts["related_identifiers"] = [{"identifier": identifier, "relation": "isSupplementTo", "scheme": "doi"}]
    return json.dumps(facts, indent=2, ensure_ascii=False) + "\n"


def _known_licences() -> dict[str, dict[str, Any]]:
    """Return the records of SPDX's list by their identifiers."""
    import spdx  # noqa: PLC0415 - an extra

    known = {str(each["id"]): each for each in spdx.licenses()}
    # The list is of a time before GNU's licences had these names.
    gnu = {f"{name}-{kind}": known[name] for name in known if "GPL-" in name for kind in ("only", "or-later")}
    return {**gnu, **known}


def _title(about: About) -> str:
    return f"Replication package of the experiment {about.name}"


def _cff_licence(about: About) -> dict[str, str]:
    if about.licence is None:
        return {}
    if about.licence in _known_licences():  # the format has a list of its own, which has these
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
    """Return a name with the family name in front: what stands before a comma, otherwise the last word.

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
