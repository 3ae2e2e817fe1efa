"""The registration of a config: its place, its content, and the differences of the config from it."""

from __future__ import annotations

import hashlib
from importlib.metadata import version
from itertools import filterfalse
from pathlib import Path
from typing import Any

from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.design.batches import as_configured, described_design
from robot_runner.core.design.full_factorial import full_factorial
from robot_runner.core.design.precision import rules_as_mapping
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import Finding, StorageError
from robot_runner.core.events.measure import MeasureColumns
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.storage.registration import Registration, differences, read_registration
from robot_runner.core.words import listed

#: Appended to the stem of the config file.
SUFFIX = ".registration.json"
#: Static parameters that are not registered: the path of results is not part of the plan, and names private folders.
_UNREGISTERED = frozenset({"results_output_path"})


def registration_path(loaded: LoadedConfig) -> Path:
    """Return the path of the registration of a config: that of `registration`, or beside the config file.

    A relative path begins where the config file is; for a config without a file, where the program was started.
    """
    given = getattr(loaded.config, "registration", None)
    path = loaded.source.path
    if not isinstance(given, str | Path):
        return path.with_suffix(SUFFIX)
    return (path.parent if loaded.kept == "file" else Path.cwd()) / Path(given).expanduser()


def registered(loaded: LoadedConfig) -> Registration | None:
    """Return the registration of a config; None where there is none, or it cannot be used."""
    try:
        found = read_registration(registration_path(loaded))
    except StorageError:  # reported by `check_registration`
        return None
    return found if found.is_intact else None


def take_registered_seed(loaded: LoadedConfig, model: RunTableModel) -> None:
    """Set the registered seed in a design without a seed, so that its order is the registered one."""
    if model.shuffle and not model.seed_is_given and (found := registered(loaded)) is not None:
        model.take_seed(found.seed, is_registered=True)


def registration_content(
    loaded: LoadedConfig, model: RunTableModel, parameters: Parameters, columns: MeasureColumns
) -> dict[str, Any]:
    """Return the content of a registration, without date and power.

    For an experiment that was extended it is what the config plans.

    Raises:
        DesignError: the design is too large to be listed.
    """
    own, plan = as_configured(model), parameters.analysis
    runs = len(own.plan())
    units = {factor.name: factor.unit for factor in own.factors if factor.unit}
    path = loaded.source.path
    settings = {name: text for name, text in shown_settings(loaded.overrides).items() if name not in _UNREGISTERED}
    return {
        "experiment": str(getattr(loaded.config, "experiment_name", "")),
        "robot_runner": version("robot-runner"),
        "config": {
            "file": path.name,
            "class": loaded.source.class_name,
            "sha256": _digest(path),
            "modules": {place.as_posix(): _digest(each) for each, place in loaded.local_modules.items()},
            "settings": settings,
        },
        "design": {**described_design(own), **_combinations(own), "units": units, "runs": runs},
        "seed": own.seed,
        "seed_is_given": own.seed_is_given,
        "measures": [{"name": each.name, "unit": each.measure.unit} for each in columns.in_table if not each.tells_of],
        "analysis": None if plan is None else plan.as_mapping(),
        "repeat_until": rules_as_mapping(parameters.repeat_until, own.repetitions),
    }


def _combinations(model: RunTableModel) -> dict[str, list[list[str]]]:
    """Return the excluded combinations of a full factorial; of other designs the chosen ones, which are fewer."""
    kept = [each.texts for each in model.combinations_of(model.factors)]
    if not model.is_full_factorial or any(factor.when for factor in model.factors):
        return {"combinations": list(map(list, kept))}
    every = (each.texts for each in full_factorial(model.factors))
    return {"excluded": list(map(list, filterfalse(set(kept).__contains__, every)))}


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def check_registration(
    loaded: LoadedConfig, model: RunTableModel | None, parameters: Parameters, columns: MeasureColumns
) -> list[Finding]:
    """Return findings on the registration of a config: damaged, missing though it is named, or not followed."""
    path = registration_path(loaded)
    is_named = getattr(loaded.config, "registration", None) is not None
    if not path.exists() and not is_named:
        return []
    try:
        found = read_registration(path)
    except StorageError as error:
        return list(error.findings)
    if not found.is_intact:
        problem = "the registration was changed after it was made: its checksum is not that of its content"
        fix = "Restore the file from where it was deposited, or register again before the first run."
        return [Finding.error(str(path), problem, fix)]
    if model is None or model.is_too_large:
        return []
    now = registration_content(loaded, model, parameters, columns)
    if not (differing := listed(differences(found.content, now))):
        return []
    problem = f"the config differs from what was registered on {found.registered_at[:10]}: {differing}"
    return [Finding.warning(str(path), problem, "Follow the registration; the report lists each deviation from it.")]
