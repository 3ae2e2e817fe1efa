"""A checklist of ACM's artifact badges for a package, with a fact for each line.

Artifact Review and Badging, version 1.1 (24 August 2020):
https://www.acm.org/publications/policies/artifact-review-and-badging-current. Criteria that only a person can judge
are left to the author or to the reviewers; they are never marked as met.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import groupby
from pathlib import Path
from typing import Any

from robot_runner.core.errors import PackageError
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import last_execution, read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole, TableLayout
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.core.words import counted
from robot_runner.replication.about import About
from robot_runner.replication.contents import (
    BADGES,
    CRATE,
    DATA_PACKAGE,
    DESCRIPTION,
    LICENCE,
    README,
    REQUIREMENTS,
    SUMS,
    ZENODO,
    choose_contents,
    config_of,
)
from robot_runner.replication.opening import open_package
from robot_runner.replication.run_by_run import statuses_that_count
from robot_runner.replication.verification import read_text_of

_POLICY = "https://www.acm.org/publications/policies/artifact-review-and-badging-current"
_AVAILABLE = "Artifacts Available"
_FUNCTIONAL = "Artifacts Evaluated: Functional"
_REUSABLE = "Artifacts Evaluated: Reusable"
_REPRODUCED = "Results Reproduced"
_REPLICATED = "Results Replicated"
_PACK_IT = "robot-runner pack makes it"


class State(Enum):
    """The state of a line of the checklist."""

    MET = "met"
    NOT_MET = "not met"
    AUTHOR = "for the author to say"
    REVIEWERS = "for the reviewers to say"


@dataclass(frozen=True, slots=True)
class BadgeLine:
    """One line of the checklist: a badge's criterion, its state, and the fact behind it."""

    badge: str
    what: str
    state: State
    fact: str


@dataclass(frozen=True, slots=True)
class BadgeFacts:
    """Facts of an experiment or of its package.

    Attributes:
        columns, rows: the run table's.
        names: the existing files.
        left_out: the files that are not in the package.
        packages: the number of Python packages that the experiment needs; None if it is not packed.
        without_hash: the number of these packages without a known hash.
    """

    about: About
    manifest: Mapping[str, Any]
    columns: Sequence[ColumnDescription]
    names: Collection[str]
    rows: RunTableRows
    left_out: Sequence[str] = ()
    packages: int | None = None
    without_hash: int = 0


def badge_lines(facts: BadgeFacts) -> tuple[BadgeLine, ...]:
    """Return the checklist, badge by badge."""
    return (*_available(facts), *_functional(facts), *_reusable(facts), *_results(facts))


def badges_text(facts: BadgeFacts) -> str:
    """Return the checklist as Markdown."""
    rows: list[str] = []
    for badge, lines in groupby(badge_lines(facts), key=lambda line: line.badge):
        rows += ["", f"## {badge}", "", "| asked for | state | fact |", "|---|---|---|"]
        rows += [f"| {line.what} | {line.state.value} | {_cell(line.fact)} |" for line in lines]
    return (
        f"# Checklist for ACM's artifact badges: {facts.about.name}\n\n"
        f"What this package has of what [ACM's policy]({_POLICY}), version 1.1, asks for. The badges are given by "
        "reviewers.\n" + "\n".join(rows) + "\n"
    )


def _line(badge: str, what: str, is_met: object, met: str, otherwise: str) -> BadgeLine:
    return BadgeLine(badge, what, State.MET if is_met else State.NOT_MET, met if is_met else otherwise)


def _available(facts: BadgeFacts) -> Iterator[BadgeLine]:
    described = f"{ZENODO} describes it for Zenodo" if ZENODO in facts.names else _PACK_IT
    fact = f"Deposit the package in an archive that gives it a DOI; {described}."
    yield BadgeLine(_AVAILABLE, "A DOI or link in a public archive that lasts", State.AUTHOR, fact)
    licence = facts.about.licence
    where = f", its text in {LICENCE}" if LICENCE in facts.names else ""
    missing = "No licence was given: robot-runner pack --licence."
    yield _line(_AVAILABLE, "Terms of use", licence, f"{licence}{where}.", missing)
    authors = facts.about.authors_in_words
    yield _line(_AVAILABLE, "Authors to cite", authors, f"{authors}.", "Nobody is named: robot-runner pack --author.")


def _functional(facts: BadgeFacts) -> Iterator[BadgeLine]:
    inventory = f"{README} and {CRATE} list {counted(len(facts.names), 'file')}."
    has_inventory = {README, CRATE} <= set(facts.names)
    yield _line(_FUNCTIONAL, "Documented: an inventory", has_inventory, inventory, f"No {CRATE}: {_PACK_IT}.")
    cited = facts.about.citation
    fact = f"The paper is said to be {cited}." if cited else "No paper is named: citation in the config, or --citation."
    yield BadgeLine(_FUNCTIONAL, "Consistent: it belongs to the paper", State.AUTHOR, fact)
    statuses = statuses_that_count(facts.rows)
    done, excluded = statuses.count(RunStatus.DONE), len(facts.rows) - len(statuses)
    fact = f"{done} of {counted(len(statuses), 'run')} are done."
    fact += f" Excluded: {counted(excluded, 'run')}." if excluded else ""
    yield _line(_FUNCTIONAL, "Complete: all runs", done and done == len(statuses), fact, fact)
    left_out = f"Left out: {', '.join(facts.left_out)}."
    yield _line(_FUNCTIONAL, "Complete: nothing is left out", not facts.left_out, "Nothing was left out.", left_out)
    yield from _exercisable(facts)
    fact = f"{SUMS} has the SHA-256 of each file; robot-runner verify checks them."
    yield _line(_FUNCTIONAL, "Verified: it is whole", SUMS in facts.names, fact, f"No {SUMS}: {_PACK_IT}.")


def _exercisable(facts: BadgeFacts) -> Iterator[BadgeLine]:
    config = config_of(facts.manifest)
    fact = f"robot-runner replicate executes {config} again."
    yield _line(_FUNCTIONAL, "Exercisable: it runs again", config in facts.names, fact, "There is no config.")
    robot = str(facts.manifest.get("robot") or "")
    what = "Exercisable: the hardware is within reach"
    if robot.startswith("simulated"):
        yield BadgeLine(_FUNCTIONAL, what, State.MET, "On the simulated robot: no hardware is needed.")
    else:
        fact = f"Say whether reviewers can use {robot or 'what it needs'}, or try --set robot=simulated."
        yield BadgeLine(_FUNCTIONAL, what, State.AUTHOR, fact)
    known = (facts.packages or 0) - facts.without_hash
    fact = f"{REQUIREMENTS} pins {counted(facts.packages or 0, 'package')}, {known} of them by the hash of their files."
    otherwise = f"No {REQUIREMENTS}: {_PACK_IT}." if facts.packages is None else fact
    is_pinned = facts.packages and not facts.without_hash
    yield _line(_FUNCTIONAL, "Exercisable: the software is pinned", is_pinned, fact, otherwise)


def _reusable(facts: BadgeFacts) -> Iterator[BadgeLine]:
    measures = [each for each in facts.columns if each.role is ColumnRole.MEASURE]
    # Texts and booleans have no unit.
    lacking = [
        each.name for each in measures if not each.description or not (each.unit or each.type in {"string", "boolean"})
    ]
    described = f"Each of {counted(len(measures), 'measure')} has a meaning in the schema, and each number a unit."
    otherwise = f"Without a meaning, or a unit: {', '.join(lacking)}." if lacking else "There are no measures."
    yield _line(_REUSABLE, "Each measure is described", measures and not lacking, described, otherwise)
    has_formats = {CRATE, DATA_PACKAGE} <= set(facts.names)
    fact = "RO-Crate and Frictionless Data Package, CSV and JSON."
    yield _line(_REUSABLE, "Formats of the field", has_formats, fact, f"No {DATA_PACKAGE}: {_PACK_IT}.")
    commit = (last_execution(facts.manifest).get("repository") or {}).get("commit")
    otherwise = "No commit of the config was recorded: it was in no repository, or git could not read that."
    yield _line(_REUSABLE, "The version of the source is known", commit, f"Commit {commit}.", otherwise)
    fact = "Say in the paper or a README what can be changed, and what it is good for beyond the paper."
    yield BadgeLine(_REUSABLE, "Structured so that others can build on it", State.AUTHOR, fact)


def _results(facts: BadgeFacts) -> Iterator[BadgeLine]:
    own = " This is itself a replication of another package." if facts.manifest.get("replication") else ""
    fact = f"robot-runner replicate ends in a verdict on each measure.{own}"
    yield BadgeLine(_REPRODUCED, "Others got the results with this package", State.REVIEWERS, fact)
    fact = "It asks for a study of its own: nothing in a package can show it."
    yield BadgeLine(_REPLICATED, "Others got the results without this package", State.REVIEWERS, fact)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def badges_of(path: Path) -> tuple[str, tuple[BadgeLine, ...]]:
    """Return the name and the checklist of an experiment's folder, or of a package, zipped or unpacked.

    Raises:
        PackageError: the package is damaged, or has no checklist.
        StorageError: a file cannot be read.
    """
    if path.is_file() or (path / DESCRIPTION).is_file():
        with open_package(path) as package:
            PackageError.refuse(package.faults)
            return _of_text(read_text_of(package, BADGES))
    files = ExperimentFolder.found_at(path)
    manifest, columns = read_manifest(files.manifest), read_schema(files.schema)
    rows = read_run_table(files.run_table, TableLayout.of_schema(columns))
    chosen = choose_contents(files, [rows.run_id(place) for place in range(len(rows))])
    about, names = About.of_manifest(manifest), {file.name for file in chosen.files}
    return about.name, badge_lines(BadgeFacts(about, manifest, columns, names, rows))


def _of_text(text: str) -> tuple[str, tuple[BadgeLine, ...]]:
    """Read a checklist in the form of `badges_text`; other lines are skipped."""
    name, badge, states = "", "", {state.value: state for state in State}
    found = []
    for line in text.splitlines():
        name = line.partition(": ")[2] if line.startswith("# ") else name
        badge = line[3:] if line.startswith("## ") else badge
        cells = [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) == 3 and cells[1] in states:  # noqa: PLR2004 - asked for, state, fact
            found.append(BadgeLine(badge, cells[0], states[cells[1]], cells[2]))
    return name, tuple(found)
