"""Who made an experiment, and under which licence: named in its manifest, in its package, and in citations."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from robot_runner.core.errors import ConfigError, Finding

#: No affiliation looks so: one with a digit too few is refused.
_MEANT_AS_ORCID = re.compile(r"(?i).*orcid\.org/.*|[\dx -]*\d[\dx -]*")
_ORCID = re.compile(r"(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])")
_URL = re.compile(r"https?://[^\s/]+\S*")
_SPDX = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*")


@dataclass(frozen=True, slots=True, init=False)
class Author:
    """One person who made an experiment.

    Attributes:
        name: as it is to be cited.
        orcid: the person's identifier at orcid.org, 16 digits in groups of four, or None.
        affiliation: the organisation that the person works for, or None.
        affiliation_url: its page, best its identifier at ror.org, or None.

    Raises:
        ConfigError: an attribute is invalid; `findings` lists all problems.

    Example:
        >>> Author("Josiah Carberry", orcid="https://orcid.org/0000-0002-1825-0097").orcid
        '0000-0002-1825-0097'
    """

    name: str
    orcid: str | None
    affiliation: str | None
    affiliation_url: str | None

    def __init__(
        self, name: str, *, orcid: str | None = None, affiliation: str | None = None, affiliation_url: str | None = None
    ) -> None:
        ConfigError.refuse(_findings(name, orcid, affiliation, affiliation_url))
        organisation = {"affiliation": affiliation, "affiliation_url": affiliation_url}
        for attribute, value in {"name": name, "orcid": orcid[-19:] if orcid else None, **organisation}.items():
            object.__setattr__(self, attribute, value)

    def as_mapping(self) -> dict[str, str | None]:
        """Return the author as plain data, for the manifest."""
        return {name: getattr(self, name) for name in self.__slots__}


def authors_from_text(text: str) -> tuple[Author, ...]:
    """Read authors from the command line: separated by `|`, their parts by `;`.

    Raises:
        ValueError: the form is another one; ConfigError: a part is invalid.

    Example:
        >>> [author.name for author in authors_from_text("Ada Lovelace | Josiah Carberry; 0000-0002-1825-0097")]
        ['Ada Lovelace', 'Josiah Carberry']
    """
    return tuple(_author(part) for part in text.split("|") if part.strip())


def is_licence(value: object) -> bool:
    """Whether a value can name a licence: an SPDX identifier (https://spdx.org/licenses/), or a URL."""
    return isinstance(value, str) and bool(_SPDX.fullmatch(value) or _URL.fullmatch(value))


def _author(text: str) -> Author:
    name, *parts = (part.strip() for part in text.split(";"))
    orcid = next((part for part in parts if _MEANT_AS_ORCID.fullmatch(part)), None)
    url = next((part for part in parts if part != orcid and _URL.fullmatch(part)), None)
    rest = [part for part in parts if part and part not in {orcid, url}]
    if len(rest) > 1:
        raise ValueError(text)
    return Author(name, orcid=orcid, affiliation=rest[0] if rest else None, affiliation_url=url)


def _findings(name: Any, orcid: Any, affiliation: Any, url: Any) -> Iterator[Finding]:
    where = f"author {name!r}"
    if not isinstance(name, str) or not name.strip():
        yield Finding.error(where, f"the name is {name!r}", "Give the name as it is to be cited.")
    if orcid is not None and not _is_orcid(orcid):
        fix = "Give its 16 digits as on orcid.org, such as 0000-0002-1825-0097."
        yield Finding.error(where, f"{orcid!r} is not an ORCID (its last digit checks the others)", fix)
    if affiliation is not None and (not isinstance(affiliation, str) or not affiliation.strip()):
        yield Finding.error(where, f"the affiliation is {affiliation!r}", "Give the organisation's name.")
    if url is not None and (not isinstance(url, str) or not _URL.fullmatch(url)):
        yield Finding.error(where, f"affiliation_url is {url!r}", "Give a URL, such as 'https://ror.org/008xxew50'.")


def _is_orcid(value: Any) -> bool:
    """Whether the check digit is right: ISO 7064, MOD 11-2 (ORCID, Structure of the ORCID Identifier)."""
    found = _ORCID.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        return False
    digits = found[1].replace("-", "")
    total = 0
    for digit in digits[:-1]:
        total = (total + int(digit)) * 2
    check = (12 - total % 11) % 11
    return digits[-1] == ("X" if check == 10 else str(check))  # noqa: PLR2004 - ten is written X
