"""The pages of a package: who made the experiment and under which terms, how to replicate it, what is in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from robot_runner.core.config.authors import Author
from robot_runner.core.errors import Finding
from robot_runner.core.words import shown_commit
from robot_runner.replication.container import container_commands
from robot_runner.replication.contents import CRATE, DESCRIBED, SUMS, LeftOut


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

    def described(self, manifest: Mapping[str, Any]) -> str:
        """Return what the package is, in one sentence."""
        version = manifest.get("software", {}).get("robot_runner", "")
        return (
            f"Replication package of the experiment {self.name}, executed with Robot Runner {version}: "
            "config, run table, raw data, circumstances."
        )

    def findings(self) -> Iterator[Finding]:
        """Yield what others will miss, each with what to write into the config or to pass to the command."""
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

A replication package of an experiment executed with Robot Runner {version}.

{facts}

## Replicate it

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
```

## What is in it

| file | holds |
|---|---|
{rows}
"""
_NOT_IN_IT = """
## What is not in it

{items}
"""


def readme(about: About, manifest: Mapping[str, Any], names: Sequence[str], left_out: Sequence[LeftOut]) -> str:
    """Return the README, in Markdown.

    Args:
        about: who made the experiment, and under which terms.
        manifest: the experiment's.
        names: the files of the package.
        left_out: what is not in it.
    """
    facts = {
        "Authors": about.authors_in_words,
        "Licence": about.licence,
        "Cite": about.citation,
        "Robot": manifest.get("robot") or "none, or as the config says",
        "Seed": str(manifest.get("seed")),
        "Commit of the config": shown_commit((manifest.get("executions") or [{}])[-1].get("repository")),
    }
    present = {*names, *(f"{name.partition('/')[0]}/" for name in names), CRATE, SUMS}
    text = _README.format(
        name=about.name,
        version=manifest.get("software", {}).get("robot_runner", ""),
        facts="\n".join(f"- {what}: {text}" for what, text in facts.items() if text),
        commands="\n".join(f"$ {command}" for command in container_commands(about.name, ".")),
        rows="\n".join(f"| `{name}` | {holds} |" for name, holds in DESCRIBED.items() if name in present),
    )
    items = "\n".join(f"- `{each.name}`: {each.why}" for each in left_out)
    return text + (_NOT_IN_IT.format(items=items) if items else "")
