"""Experiment Runner's CodecarbonWrapper: decorators that add CodeCarbon's estimates to a config."""

from __future__ import annotations

import csv
import functools
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from robot_runner.core.errors import PluginError
from robot_runner.legacy.session import current_session, warn_of_run
from robot_runner.meters.codecarbon import started_tracker, stop_tracker

_PREFIX = "codecarbon__"
_EMISSIONS = "__co2_emissions"
_TRACKER = "__emission_tracker__"
#: The last row of the file before the run, as all runs of a config may write to the same file.
_BEFORE = "__emissions_before__"

Method = Callable[..., Any]


class DataColumns(Enum):
    """CodeCarbon's columns in all versions of the wrapper; `name` is the heading in the run table."""

    EMISSIONS = "emissions"
    EMISSIONS_RATE = "emissions_rate"
    CPU_POWER = "cpu_power"
    GPU_POWER = "gpu_power"
    RAM_POWER = "ram_power"
    CPU_ENERGY = "cpu_energy"
    GPU_ENERGY = "gpu_energy"
    RAM_ENERGY = "ram_energy"
    ENERGY_CONSUMED = "energy_consumed"

    @property
    def name(self) -> str:
        """The heading in the run table."""
        return f"{_PREFIX}{self.value}"


def emission_tracker(*arguments: Any, online: bool = False, **settings: Any) -> Callable[[type], type]:
    """Decorate a config class: a tracker runs during its measurement, and its run table gets the columns."""
    columns = settings.pop("data_columns", [DataColumns.EMISSIONS])

    def decorated(config: Any) -> Any:
        table = "create_run_table_model" if hasattr(config, "create_run_table_model") else "create_run_table"
        decorators = {
            table: add_data_columns(columns),
            "start_measurement": start_emission_tracker(*arguments, online=online, **settings),
            "stop_measurement": stop_emission_tracker,
            "populate_run_data": populate_data_columns,
        }
        for name, decorator in decorators.items():
            setattr(config, name, decorator(getattr(config, name)))
        return config

    return decorated


def start_emission_tracker(*arguments: Any, online: bool = False, **settings: Any) -> Callable[[Method], Method]:
    """Decorate `start_measurement`: start the tracker before it."""
    kind = "EmissionsTracker" if online else "OfflineEmissionsTracker"

    def decorated(method: Method) -> Method:
        @functools.wraps(method)
        def started(self: Any, context: Any) -> Any:
            given = {"project_name": self.name, "output_dir": str(context.run_dir.resolve())} | settings
            tracker = started_tracker(kind, *arguments, **given)
            setattr(self, _TRACKER, tracker)
            setattr(self, _BEFORE, _last_row(tracker))
            return method(self, context)

        return started

    return decorated


def stop_emission_tracker(method: Method) -> Method:
    """Decorate `stop_measurement`: stop the tracker after it."""

    @functools.wraps(method)
    def stopped(self: Any, context: Any) -> Any:
        try:
            return method(self, context)
        finally:
            self.__emissions__ = stop_tracker(getattr(self, _TRACKER))

    return stopped


def add_data_columns(data_cols: Iterable[DataColumns]) -> Callable[[Method], Method]:
    """Decorate the method that makes the run table: add these columns."""
    return functools.partial(_with_columns, [column.name for column in data_cols])


def populate_data_columns(method: Method) -> Method:
    """Decorate `populate_run_data`: add the tracker's values."""

    @functools.wraps(method)
    def populated(self: Any, context: Any) -> Any:
        data = dict(method(self, context) or {})
        measured = _measured(getattr(self, _TRACKER), getattr(self, _BEFORE))
        for name in self.run_table_model.get_data_columns():
            if name.startswith(_PREFIX) and measured:
                data[name] = float(measured[name.removeprefix(_PREFIX)])
                current_session().estimated.add(name)
        return data

    return populated


def _measured(tracker: Any, before: Mapping[str, str]) -> Mapping[str, str]:
    """Return the row that a tracker wrote; if it could not measure, warn, and return an empty row."""
    row = _last_row(tracker)
    if row and row != before:
        return row
    problem = "CodeCarbon measured nothing: it wrote no emissions.csv, or nothing into it"
    warn_of_run(problem, fix="Look into the run's log for why.")
    return {}


def _last_row(tracker: Any) -> dict[str, str]:
    file = Path(tracker._output_dir) / tracker._output_file  # noqa: SLF001 - there is no public attribute
    if not file.exists():
        return {}
    with file.open(newline="", encoding="utf-8") as rows:
        return [{}, *csv.DictReader(rows)][-1]


def add_co2_data_column(method: Method) -> Method:
    """Decorate the method that makes the run table, as the plugin's first version did."""
    return _with_columns([_EMISSIONS], method)


def populate_co2_data(method: Method) -> Method:
    """Decorate `populate_run_data`, as the plugin's first version did."""

    @functools.wraps(method)
    def populated(self: Any, context: Any) -> Any:
        current_session().estimated.add(_EMISSIONS)
        return dict(method(self, context) or {}) | {_EMISSIONS: self.__emissions__}

    return populated


def _with_columns(names: Iterable[str], method: Method) -> Method:
    @functools.wraps(method)
    def made(self: Any) -> Any:
        made = method(self)
        model = getattr(self, "run_table_model", None)
        if model is None:
            problem = "the config keeps no run-table model, to which columns could be added"
            fix = "Write self.run_table_model = RunTableModel(...)."
            raise PluginError(problem, where="CodecarbonWrapper", fix=fix)
        columns = model.get_data_columns()
        columns += [name for name in names if name not in columns]
        return model.generate_experiment_run_table() if isinstance(made, list) else model

    return made
