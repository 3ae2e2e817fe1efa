"""The page with which a package greets whoever opens it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.replication.container import container_commands
from robot_runner.replication.names import CONTAINERFILE, CRATE, DATA_PACKAGE, ENVIRONMENT, REQUIREMENTS, SUMS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from robot_runner.replication.about import About
    from robot_runner.replication.contents import LeftOut

__all__ = ["readme"]

_FILES = (
    ("run_table.csv", "all runs, with their treatments and measures; `run_table.schema.json` says what each column is"),
    ("runs/", "the raw data and the log of each run"),
    ("config/", "the config and the local modules that it imports, as executed"),
    ("report/", "the report, with its tables and figures"),
    ("manifest.json", "the circumstances: host, versions, seed, what was set by hand"),
    ("journal.jsonl", "everything that happened, in order"),
    (REQUIREMENTS, "the Python packages that the experiment needs"),
    (ENVIRONMENT, "everything that was installed; host; ROS"),
    (CONTAINERFILE, "the recipe of a container image"),
    (DATA_PACKAGE, "describes the run table (Frictionless Data Package)"),
    (CRATE, "describes everything (RO-Crate)"),
    (SUMS, "the SHA-256 of each file: `sha256sum -c SHA256SUMS` checks them without any tool of ours"),
)


def readme(about: About, manifest: Mapping[str, Any], names: Sequence[str], left_out: Sequence[LeftOut]) -> str:
    """Return the text, in Markdown.

    Args:
        about: who made the experiment, and under which terms.
        manifest: the experiment's.
        names: the files of the package.
        left_out: what is not in it.
    """
    return "\n".join(_lines(about, manifest, names, left_out)) + "\n"


def _lines(
    about: About, manifest: Mapping[str, Any], names: Sequence[str], left_out: Sequence[LeftOut]
) -> Iterator[str]:
    software = manifest.get("software", {})
    yield f"# {about.name}"
    yield ""
    yield f"A replication package of an experiment executed with Robot Runner {software.get('robot_runner', '')}."
    yield ""
    for what, text in (("Authors", about.authors_in_words), ("Licence", about.licence), ("Cite", about.citation)):
        if text:
            yield f"- {what}: {text}"
    yield f"- Robot: {manifest.get('robot') or 'none, or as the config says'}"
    yield f"- Seed: {manifest.get('seed')}"
    yield ""
    yield "## Replicate it"
    yield ""
    yield "Nothing of the package is executed before it has been verified and you have said yes."
    yield ""
    yield "```console"
    yield "$ robot-runner verify PACKAGE.zip"
    yield "$ robot-runner replicate PACKAGE.zip --environment venv"
    yield "```"
    yield ""
    yield "`PACKAGE.zip` is this package, or the folder it was unpacked to. The last command makes the environment,"
    yield "executes the same runs in the same order from the same seed, and says whether the results agree."
    yield ""
    yield "Or in a container:"
    yield ""
    yield "```console"
    yield from (f"$ {command}" for command in container_commands(about.name, "."))
    yield "```"
    yield ""
    yield "## What is in it"
    yield ""
    yield "| file | holds |"
    yield "|---|---|"
    present = set(names) | {f"{name.partition('/')[0]}/" for name in names} | {CRATE, SUMS}
    yield from (f"| `{name}` | {holds} |" for name, holds in _FILES if name in present)
    if left_out:
        yield ""
        yield "## What is not in it"
        yield ""
        yield from (f"- `{each.name}`: {each.why}" for each in left_out)
