"""What differs between the circumstances of two experiments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from robot_runner.analysis.results import Results

__all__ = ["differing_circumstances", "names_of"]

_ASPECTS = (
    ("Robot", ("robot",)),
    ("Config", ("config", "file")),
    ("Seed of the order", ("seed",)),
    ("Set by hand", ("deviations",)),
    ("Robot Runner", ("software", "robot_runner")),
    ("Python", ("software", "python")),
    ("System", ("host", "system")),
    ("Machine", ("host", "machine")),
    ("Processor", ("host", "processor")),
)


def names_of(first: Results, second: Results, measures: Sequence[tuple[str, str]] = ()) -> tuple[str, str]:
    """Return names that tell two experiments apart, or two measures of one."""
    if first.folder == second.folder and len(measures) == 1 and len(set(measures[0])) > 1:
        return measures[0]
    if first.name != second.name:
        return first.name, second.name
    folders = (first.folder, second.folder)
    if folders[0].name != folders[1].name:
        return folders[0].name, folders[1].name
    return f"first {first.name}", f"second {second.name}"


def differing_circumstances(first: Results, second: Results) -> tuple[tuple[str, str, str], ...]:
    """Return what differs: what it is, how it is in the first, how it is in the second."""
    rows = [("Runs that are done", str(len(first.done)), str(len(second.done)))]
    for name, keys in _ASPECTS:
        rows.append((name, _shown(_within(first.manifest, keys)), _shown(_within(second.manifest, keys))))
    for factor in first.factors:
        if factor in second.factors:
            ours, theirs = (", ".join(map(str, each.runs[factor].cat.categories)) for each in (first, second))
            rows.append((f"Treatments of {factor}", ours, theirs))
    return tuple(row for row in rows if row[1] != row[2])


def _within(manifest: Mapping[str, Any], keys: tuple[str, ...]) -> Any:
    found: Any = manifest
    for key in keys:
        found = found.get(key) if hasattr(found, "get") else None
    return found


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} = {each}" for name, each in value.items()) or "nothing"
    return "not recorded" if value is None else str(value)
