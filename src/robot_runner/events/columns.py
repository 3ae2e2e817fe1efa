"""Which measures the run table has a column for, and who may publish what."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from robot_runner.errors import Finding, MeasureError, did_you_mean
from robot_runner.events.measure import Measure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["CONFIG_OWNER", "MeasureColumn", "MeasureColumns", "resolve_columns"]

CONFIG_OWNER = "config"


@dataclass(frozen=True, slots=True)
class MeasureColumn:
    """A measure and its name in the run table.

    Attributes:
        name: the column: the measure's name, or `<plugin>.<measure>` where names clash.
        owner: the plugin that yields it, or `config`.
        is_in_table: whether the run table has a column for it; published values are in the journal in any case.
    """

    name: str
    owner: str
    measure: Measure
    is_in_table: bool = True


@dataclass(frozen=True)
class MeasureColumns:
    """All measures of an experiment, and among them the columns of its run table in their order."""

    in_table: tuple[MeasureColumn, ...]
    declared: tuple[MeasureColumn, ...]

    @cached_property
    def _by_owner(self) -> Mapping[str, Mapping[str, MeasureColumn]]:
        by_owner: dict[str, dict[str, MeasureColumn]] = {}
        for column in self.declared:
            names = by_owner.setdefault(column.owner, {})
            names[column.measure.name] = names[column.name] = column
        # The config may fill every column: its populate_run_data adds to and overrides what plugins publish.
        everything = {column.name: column for column in (*self.declared, *self.in_table)}
        by_owner[CONFIG_OWNER] = everything | by_owner.get(CONFIG_OWNER, {})
        return by_owner

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the run table's measure columns, in order."""
        return tuple(column.name for column in self.in_table)

    def prepare(self) -> None:
        """Look everything up that looking up a column needs, so that a run that is forked finds it done."""
        _ = self._by_owner

    def column_for(self, owner: str, name: object) -> MeasureColumn:
        """Return the column that `owner` means by `name`.

        Raises:
            MeasureError: the owner declared no such measure.
        """
        declared = self._by_owner.get(owner, {})
        if isinstance(name, str) and name in declared:
            return declared[name]
        hint = did_you_mean(str(name), declared)
        remedy = "Or add it to data_columns." if owner == CONFIG_OWNER else f"Or add it to the measures of {owner}."
        raise MeasureError(f"measure {name!r} was not declared", where=owner, fix=f"{hint} {remedy}".strip())


def resolve_columns(
    data_columns: Sequence[str] | None, measures_by_plugin: Mapping[str, Sequence[Measure]]
) -> tuple[MeasureColumns, list[Finding]]:
    """Match the config's `data_columns` with the measures that plugins declare.

    Args:
        data_columns: the measure columns that the run table is to have, in order; None asks for all measures of
            all plugins. A name that no plugin declares is the config's own.
        measures_by_plugin: what each plugin declares, by the plugin's name.

    Returns:
        The columns, and a finding for each name that two plugins could mean.
    """
    declared = _declared_columns(measures_by_plugin)
    if data_columns is None:
        return MeasureColumns(tuple(declared), tuple(declared)), []
    by_name = {column.name: column for column in declared}
    findings: list[Finding] = []
    chosen: list[MeasureColumn] = []
    for name in data_columns:
        column = by_name.get(name)
        findings += _ambiguity(name, declared) if column is None else []
        chosen.append(column or MeasureColumn(name, CONFIG_OWNER, Measure(name)))
    wanted = {column.name for column in chosen}
    own = [column for column in chosen if column.owner == CONFIG_OWNER]
    marked = [
        MeasureColumn(column.name, column.owner, column.measure, is_in_table=column.name in wanted)
        for column in declared
    ]
    return MeasureColumns(tuple(chosen), (*marked, *own)), findings


def _declared_columns(measures_by_plugin: Mapping[str, Sequence[Measure]]) -> list[MeasureColumn]:
    names = [measure.name for measures in measures_by_plugin.values() for measure in measures]
    return [
        MeasureColumn(measure.name if names.count(measure.name) == 1 else f"{plugin}.{measure.name}", plugin, measure)
        for plugin, measures in measures_by_plugin.items()
        for measure in measures
    ]


def _ambiguity(name: str, declared: Sequence[MeasureColumn]) -> list[Finding]:
    full_names = [column.name for column in declared if column.measure.name == name]
    if not full_names:
        return []
    return [
        Finding.error(
            "data_columns",
            f"{name!r} could be any of " + ", ".join(map(repr, full_names)),
            f"Write {full_names[0]!r}, or give one of the plugins fewer measures.",
        )
    ]
