"""Treatments that have to be made before the first run, such as revisions that are built.

Packages announce their makers in the group `robot_runner.preparations`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from robot_runner.core.config.original import replicated_original
from robot_runner.core.config.plugin_checks import announced_findings
from robot_runner.core.design.factor import Factor
from robot_runner.core.entry_points import EntryPoint, entry_points
from robot_runner.core.errors import ExecutionError, Finding, StorageError
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest

#: The kind of the journal's record of made treatments.
PREPARED = "prepared"


@dataclass(frozen=True, slots=True)
class Workshop:
    """The folder and functions that a maker of treatments may use.

    Attributes:
        logs: a folder, not made yet, for logs and for copies of what treatments are made from.
        is_interrupted: returns whether the user wants to stop: then the maker raises `KeyboardInterrupt`.
        tell: shows on the screen what is being made.
    """

    logs: Path
    is_interrupted: Callable[[], bool]
    tell: Callable[[str], None]


class TreatmentMaker(Protocol):
    """Makes treatments of some kind; `known` are the facts that it returned when the experiment first began."""

    def findings(self, factors: Sequence[Factor], known: Mapping[str, Any]) -> Iterable[Finding]:
        """Yield why treatments cannot be made, and what has changed since; nothing is touched."""

    def prepare(self, factors: Sequence[Factor], known: Mapping[str, Any], workshop: Workshop) -> Mapping[str, Any]:
        """Make the treatments, and return plain facts to be kept; empty where there are no such treatments.

        Raises:
            RobotRunnerError: one cannot be made.
            KeyboardInterrupt: the user has interrupted it.
        """


def maker_findings(factors: Sequence[Factor], folder: ExperimentFolder) -> list[Finding]:
    """Return the findings of all makers on the treatments of these factors; those of an original are known."""
    original = replicated_original()
    known = known_treatments(folder) or (original.treatments if original is not None else {})
    return announced_findings("preparations", lambda each: each.load().findings(factors, known.get(each.name, {})))


def made_treatments(factors: Sequence[Factor], known: Mapping[str, Any], workshop: Workshop) -> dict[str, Any]:
    """Make the treatments that have to be made, and return the facts of each maker, by its name.

    Raises:
        RobotRunnerError: a treatment cannot be made.
        KeyboardInterrupt: the user has interrupted it.
    """

    def made_by(point: EntryPoint) -> dict[str, Any]:
        return dict(point.load().prepare(factors, known.get(point.name, {}), workshop) or {})

    made = {point.name: point.called(partial(made_by, point)) for point in entry_points("preparations")}
    return {name: facts for name, facts in made.items() if facts}


def known_treatments(folder: ExperimentFolder) -> dict[str, Any]:
    """Return the facts of the first execution from the journal, by the name of each maker.

    Empty for a new experiment, and for a damaged folder, which is reported elsewhere.
    """
    known: dict[str, Any] = {}
    with suppress(StorageError, ExecutionError, KeyError, TypeError):
        for record in read_journal(folder.journal, kinds={PREPARED}):
            known |= record["treatments"]
        if not known and folder.manifest.exists():
            manifest = read_manifest(folder.manifest)
            known = {point.name: manifest.get(point.name, {}) for point in entry_points("preparations")}
    return known
