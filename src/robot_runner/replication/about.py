"""Who made an experiment, under which terms it may be used, and how it is cited."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.errors import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from typing import Self

    from robot_runner.config.authors import Author

__all__ = ["About"]


@dataclass(frozen=True, slots=True)
class About:
    """What others have to know before they use a package.

    Attributes:
        name: the experiment's.
        authors: each a mapping with `name`, `orcid`, `affiliation`, `affiliation_url`.
        licence: an SPDX identifier or a URL.
        date: when the experiment ended last, or began where it did not end (UTC).

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
        """Return what the manifest says, which took it from the config; what is given here counts instead."""
        last = (manifest.get("executions") or [{}])[-1]
        return cls(
            str(manifest.get("experiment_name", "experiment")),
            tuple(author.as_mapping() for author in authors) or tuple(manifest.get("authors") or ()),
            licence or manifest.get("licence"),
            citation or manifest.get("citation"),
            str(last.get("finished_at") or last.get("started_at") or "1980-01-01T00:00:00Z"),
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

    def findings(self) -> Iterator[Finding]:
        """Yield what others will miss, each with what to write into the config or say to the command."""
        if not self.authors:
            yield Finding.warning(
                "authors", "nobody is named", "Give authors=[Author(...)] in the config, or --author."
            )
        for each in self.authors:
            missing = [part for part in ("orcid", "affiliation", "affiliation_url") if not each.get(part)]
            if missing:
                problem = f"{each['name']} has no {', '.join(missing)}, which RO-Crate recommends"
                yield Finding.warning("authors", problem, "Give it in Author(...), or to --author.")
        if not self.licence:
            problem = "without a licence nobody may use the results"
            yield Finding.warning("licence", problem, 'Give licence="CC-BY-4.0" in the config, or --licence.')
        if not self.citation:
            yield Finding.warning(
                "citation", "nothing says what to cite", "Give citation in the config, or --citation."
            )
