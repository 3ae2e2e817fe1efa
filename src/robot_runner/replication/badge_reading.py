"""The checklist of ACM's artifact badges, of an experiment's folder or as a package has it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from robot_runner.core.errors import PackageError
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.replication.about import About
from robot_runner.replication.badges import BadgeFacts, BadgeLine, State, badge_lines
from robot_runner.replication.contents import BADGES, DESCRIPTION, choose_contents
from robot_runner.replication.crate_actions import undone_count
from robot_runner.replication.opening import open_package
from robot_runner.replication.verification import read_text_of

if TYPE_CHECKING:
    from pathlib import Path


def badges_of(path: Path) -> tuple[str, tuple[BadgeLine, ...]]:
    """Return the name and the checklist of an experiment's folder, or of a package, zipped or unpacked.

    Raises:
        PackageError: it is a package that has no checklist, or one that is damaged.
        StorageError: something cannot be read.
    """
    if path.is_file() or (path / DESCRIPTION).is_file():
        with open_package(path) as package:
            if package.faults:
                raise PackageError.of_findings(package.faults)
            return _of_text(read_text_of(package, BADGES))
    files = ExperimentFolder.found_at(path)
    manifest, columns = read_manifest(files.manifest), read_schema(files.schema)
    rows = read_run_table(files.run_table, TableLayout.of_schema(columns))
    chosen = choose_contents(files, [rows.run_id(place) for place in range(len(rows))])
    about, names = About.of_manifest(manifest), {file.name for file in chosen.files}
    facts = BadgeFacts(about, manifest, columns, names, undone_count(rows), len(rows))
    return about.name, badge_lines(facts)


def _of_text(text: str) -> tuple[str, tuple[BadgeLine, ...]]:
    """Read a checklist as `badges_text` writes it; what is no line of it is passed over."""
    name, badge, states = "", "", {state.value: state for state in State}
    found = []
    for line in text.splitlines():
        name = line.rpartition(": ")[2] if line.startswith("# ") else name
        badge = line[3:] if line.startswith("## ") else badge
        cells = [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) == 3 and cells[1] in states:  # noqa: PLR2004 - asked for, state, fact
            found.append(BadgeLine(badge, cells[0], states[cells[1]], cells[2]))
    return name, tuple(found)
