"""The plugins that a config asks for: that they are plugins, can be told apart, and find what they need."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.config.loader import place_in
from robot_runner.errors import Finding, RobotRunnerError
from robot_runner.plugins.api.plugin import Circumstances, Plugin

if TYPE_CHECKING:
    from collections.abc import Iterable

    from robot_runner.config.loader import LoadedConfig
    from robot_runner.design.run_table_model import RunTableModel

__all__ = ["check_plugins", "gather_plugins"]


def gather_plugins(loaded: LoadedConfig) -> tuple[tuple[Plugin, ...], list[Finding]]:
    """Return the plugins of the config: those in `plugins`, then those that an import line activated."""
    findings: list[Finding] = []
    plugins = list(_listed(loaded, findings))
    for activated in loaded.activated:
        if not any(isinstance(plugin, activated) for plugin in plugins):
            plugins += _instantiated(loaded, activated, findings)
    return tuple(plugins), [*findings, *_equal_names(loaded, plugins)]


def check_plugins(plugins: Iterable[Plugin], model: RunTableModel | None, robot: Any) -> list[Finding]:
    """Return what each plugin finds missing."""
    factors = {factor.name: factor.treatments for factor in model.factors} if model else {}
    circumstances = Circumstances(
        robot=robot if isinstance(robot, str) else None, factors=factors, plugins=tuple(plugins)
    )
    findings: list[Finding] = []
    for plugin in plugins:
        try:
            findings += plugin.check(circumstances)
        except Exception as error:  # noqa: BLE001 - a stranger's code; what it raises is a finding like others
            findings.append(_failed_check(plugin, error))
    return findings


def _listed(loaded: LoadedConfig, findings: list[Finding]) -> Iterable[Plugin]:
    where = f"{loaded.where}.plugins"
    listed = getattr(loaded.config, "plugins", ())
    if not isinstance(listed, list | tuple):
        findings.append(
            Finding.error(where, f"it is {listed!r}", "Give a list, such as [BasicTurtlebot3(), PsUtil()].")
        )
        return
    for plugin in listed:
        if isinstance(plugin, Plugin):
            yield plugin
        elif isinstance(plugin, type) and issubclass(plugin, Plugin):
            name = plugin.__name__
            findings.append(Finding.error(where, f"{name} is a class, not a plugin", f"Write {name}()."))
        else:
            fix = "Give instances of System or Profiler (robot_runner.plugins)."
            findings.append(Finding.error(where, f"{plugin!r} is no plugin", fix))


def _instantiated(loaded: LoadedConfig, activated: type[Plugin], findings: list[Finding]) -> list[Plugin]:
    try:
        return [activated()]
    except (TypeError, RobotRunnerError) as error:
        name = activated.__name__
        place = place_in(loaded.source.path, error)
        problem = f"{name} cannot be activated by its import alone: {error}"
        findings.append(
            Finding.error(place, problem, f"List it in `plugins` instead, with its parameters: {name}(...).")
        )
        return []


def _equal_names(loaded: LoadedConfig, plugins: list[Plugin]) -> list[Finding]:
    names = [plugin.name.casefold() for plugin in plugins]
    return [
        Finding.error(
            f"{loaded.where}.plugins",
            f"{names.count(folded)} plugins are named {plugin.name!r}",
            f"Give each a name of its own: {type(plugin).__name__}(name=...).",
        )
        for index, (plugin, folded) in enumerate(zip(plugins, names, strict=True))
        if names.count(folded) > 1 and names.index(folded) == index
    ]


def _failed_check(plugin: Plugin, error: Exception) -> Finding:
    if isinstance(error, RobotRunnerError):
        return Finding.error(error.where or plugin.name, error.problem, error.fix)
    problem = f"its check raised {type(error).__name__}: {error}"
    return Finding.error(plugin.name, problem, "Tell the plugin's author; update or leave out the plugin.")
