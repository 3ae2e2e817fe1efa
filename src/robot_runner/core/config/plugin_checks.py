"""The plugins that a config asks for: gathered, built with the treatments they are bound to, and checked with each."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from math import prod
from typing import Any, TypeVar

from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.config.raised_errors import place_in
from robot_runner.core.config.slow_checks import told_if_slow
from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.entry_points import EntryPoint, entry_points, instances_of
from robot_runner.core.errors import SLIP, Finding, RobotRunnerError, did_you_mean, nearest
from robot_runner.core.events.manager import EVENTS_BY_CALLBACK
from robot_runner.core.events.measure import Measure
from robot_runner.core.late_annotations import code_of, mistyped, names_read_by
from robot_runner.core.plugin import Circumstances, Plugin, refused_name
from robot_runner.core.treatments import Treatment, bind, built_with, factors_of, given_name, given_to

T = TypeVar("T")


def gather_plugins(loaded: LoadedConfig, model: RunTableModel | None) -> tuple[tuple[Plugin, ...], list[Finding]]:
    """Return the plugins of the config: those in `plugins`, then those that an import line activated.

    Those with bound parameters are built with the treatments of the first run, if they can be built with all. One that
    cannot be is left out, with a finding; without a run table, all of them are left out.
    """
    findings: list[Finding] = []
    plugins = list(_listed(loaded, findings))
    for activated in loaded.activated:
        if not any(isinstance(plugin, activated) for plugin in plugins):
            plugins += _instantiated(loaded, activated, findings)
    built = [plugin for plugin in plugins if _is_built(plugin, model, findings)]
    misspelt = dict.fromkeys(each for plugin in built for each in misspelt_callbacks(plugin))
    return tuple(built), [*findings, *misspelt, *_equal_names(loaded, built)]


def unbuilt_names(loaded: LoadedConfig, built: Sequence[Plugin]) -> list[str]:
    """Return the names of the plugins of a config that could not be built."""
    kept = set(map(id, built))
    return [given_name(each) for each in _listed(loaded, []) if id(each) not in kept]


def companions(parameters: Parameters, plugins: Sequence[Plugin]) -> tuple[tuple[Plugin, ...], list[Finding]]:
    """Return the plugins that packages add to those of a config (group `robot_runner.companions`), and findings.

    Each is a function that takes the static parameters and the plugins of the config, and returns plugins. They come
    before those of the config: they begin before them, and end after them.
    """
    added: list[Plugin] = []
    findings: list[Finding] = []
    for point in entry_points("companions"):
        try:
            added += instances_of(Plugin, point.load()(parameters, plugins))
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's code; what it raises is a finding like others
            findings.append(failed_check(point.where, error, "the function"))
    return tuple(added), findings


def check_plugins(
    plugins: Sequence[Plugin],
    model: RunTableModel | None,
    robot: str | None,
    robots: Sequence[str] = (),
    unbuilt: Sequence[str] = (),
) -> list[Finding]:
    """Return the findings of the plugins' checks, and on the plugins; bound ones are checked with each treatment.

    `model` is None where there is no run table; `unbuilt` names the config's other plugins, which are not missing.
    """
    factors = {factor.name: factor.treatments for factor in model.factors} if model else {}
    listed = [*(each.name for each in plugins), *unbuilt]
    around = Circumstances(robot, factors, listed=listed, robots=robots, has_run_table=model is not None)
    findings: list[Finding] = []
    for plugin in plugins:
        if model is not None and factors_of(plugin):
            findings += _checked_with_each(plugin, plugins, _some_of(model, factors_of(plugin)), around)
        else:
            check = partial(plugin.check, replace(around, plugins=tuple(plugins)))
            findings += asked(plugin.name, check, plugin=plugin)
    return findings


def check_treatments(
    plugins: Sequence[Plugin], model: RunTableModel, robot: str | None, combinations: Iterable[Mapping[str, Any]]
) -> list[Finding]:
    """Return errors for plugins that cannot be built with treatments of a run table that was written by hand."""
    bound = [plugin for plugin in plugins if factors_of(plugin)]
    listed = list(combinations) if bound else []
    factors = {factor.name: factor.treatments for factor in model.factors}
    findings: list[Finding] = []
    for plugin in bound:
        unbuilt = _unbuilt_with_each(plugin, listed, [])
        findings += unbuilt or _checked_with_each(plugin, plugins, listed, Circumstances(robot, factors))
    return findings


def with_each_treatment(plugin: Plugin, model: RunTableModel | None) -> Iterator[Plugin]:
    """Yield a plugin built with each treatment to which its parameters are bound, or the plugin itself."""
    if model is None or not factors_of(plugin):
        yield plugin
        return
    factors = factors_of(plugin)
    yield from (built_with(plugin, each) for each in _distinct(_some_of(model, factors), factors.values()))


def asked(
    where: str, check: Callable[[], Iterable[Finding]], what: str = "the check", plugin: Plugin | None = None
) -> list[Finding]:
    """Return the findings of another package's check, or of `what` it does; an exception becomes a finding."""
    try:
        with told_if_slow(f"{where}: {what}"):
            return instances_of(Finding, check())
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's code
        return [failed_check(where, error, what, plugin)]


def announced_findings(
    group: str, find: Callable[[EntryPoint], Iterable[Finding]], what: str = "the check"
) -> list[Finding]:
    """Return the findings of all entry points in a group, for each of which `find` is called."""
    return [finding for point in entry_points(group) for finding in asked(point.where, partial(find, point), what)]


def failed_check(where: str, error: BaseException, what: str = "the check", plugin: Plugin | None = None) -> Finding:
    """Return the finding for a check, or another function of a package or plugin, that raised."""
    if isinstance(error, RobotRunnerError):
        return Finding.error(error.where or where, error.problem, error.fix)
    if plugin is not None:
        for each in mistyped(type(plugin), given_to(plugin)):
            return Finding.error(type(plugin).__name__, each.problem, each.fix)
    problem = f"{what} raised {type(error).__name__}: {error}"
    return Finding.error(where, problem, "Tell the plugin's author; update or leave out the plugin.")


# Methods with misspelt names of ours, which nothing calls: a robot would not be made safe.


def misspelt_callbacks(plugin: Plugin) -> Iterator[Finding]:
    """Yield a warning for each method whose name is close to one of ours, and that nothing calls.

    Unlike in a config it is not an error: the plugin may be another author's, and called from outside.
    """
    kinds = type(plugin).__mro__[:-1]
    own = [each for each in kinds if each.__module__.partition(".")[0] != "robot_runner"]
    written = {name for kind in own for name in _methods_of(kind)}
    ours = {*EVENTS_BY_CALLBACK, *(name for kind in kinds if kind not in own for name in _methods_of(kind))}
    called = {name for kind in own for each in vars(kind).values() for name in names_read_by(each)}
    for name in sorted(written - ours - called):
        if (meant := nearest(name, ours - written, SLIP)) is not None:
            fix = f"Did you mean {meant!r}? Otherwise begin the name with '_'."
            where = f"{type(plugin).__name__}.{name}"
            yield Finding.warning(where, "nothing calls this method of the plugin", fix)


def _methods_of(kind: type) -> Iterator[str]:
    yield from (name for name, each in vars(kind).items() if not name.startswith("_") and code_of(each) is not None)


def _listed(loaded: LoadedConfig, findings: list[Finding]) -> Iterable[Plugin]:
    where = f"{loaded.where}.plugins"
    listed = getattr(loaded.config, "plugins", ())
    if not isinstance(listed, list | tuple):
        fix = "Give a list, such as [BasicTurtlebot3(), PsUtil()]."
        findings.append(Finding.error(where, f"the value is {listed!r}", fix))
        return
    for plugin in listed:
        if isinstance(plugin, Plugin):
            yield plugin
        elif isinstance(plugin, type) and issubclass(plugin, Plugin):
            name = plugin.__name__
            findings.append(Finding.error(where, f"{name} is a class, not a plugin", f"Write {name}()."))
        else:
            shown, fix = repr(plugin), "Give instances of System or Profiler (robot_runner.plugins)."
            if isinstance(plugin, str) and plugin.isidentifier():
                fix = f"Import it, and write {plugin}() without quotes."
            elif " object at 0x" in shown:
                shown = f"the object of the class {type(plugin).__name__}"
                fix = f"Derive {type(plugin).__name__} from System or Profiler (robot_runner.plugins)."
            findings.append(Finding.error(where, f"{shown} is not a plugin", fix))


def _instantiated(loaded: LoadedConfig, activated: type[Plugin], findings: list[Finding]) -> list[Plugin]:
    try:
        return [activated()]
    except (TypeError, RobotRunnerError) as error:
        name = activated.__name__
        place = place_in(loaded.source.path, error)
        problem = f"{name} cannot be activated by its import alone: {error}"
        fix = f"List it in `plugins` instead, with its parameters: {name}(...)."
        findings.append(Finding.error(place, problem, fix))
        return []


def _equal_names(loaded: LoadedConfig, plugins: list[Plugin]) -> list[Finding]:
    named: defaultdict[str, list[Plugin]] = defaultdict(list)
    for plugin in plugins:
        named[plugin.name.casefold()].append(plugin)
    alike = [(len(each), each[0]) for each in named.values() if len(each) > 1]
    where, fix = f"{loaded.where}.plugins", "Give each a name of its own: {}(name=...)."
    return [
        Finding.error(where, f"{count} plugins are named {first.name!r}", fix.format(type(first).__name__))
        for count, first in alike
    ]


# Plugins with bound parameters: built and checked with each of their treatments.

#: With more combinations of bound treatments, each treatment is tried in at least one combination only.
_MOST_COMBINATIONS = 256


def _is_built(plugin: Plugin, model: RunTableModel | None, findings: list[Finding]) -> bool:
    """Build a plugin for the first run, where it has bound parameters; return whether it can be used."""
    factors = factors_of(plugin)
    if not factors:
        malformed = _malformed(plugin)
        findings += [*_misled(plugin), *malformed]
        return not malformed
    if model is None:
        return False
    unknown = list(_unknown_factors(plugin, [factor.name for factor in model.factors]))
    planned = [*_some_of(model, factors)] if not unknown else []
    built: list[Plugin] = []
    refused = unknown or _unbuilt_with_each(plugin, planned, built)
    findings += refused or _varying(plugin, built)
    if not refused:
        bind(plugin, planned[0])
        # The largest over all treatments, for the check of disk space; building it for a run sets the run's again.
        vars(plugin)["bytes_per_run"] = max(each.bytes_per_run for each in built)
    return not refused


def _misled(plugin: Plugin) -> Iterator[Finding]:
    """Yield an error for attributes with an unbound treatment: a `__new__` has hidden it from the binding."""
    for name, value in vars(plugin).items():
        if isinstance(value, Treatment):
            fix = f"Have __new__ of {type(plugin).__name__} call super().__new__(cls, ...) with all of its arguments."
            yield Finding.error(f"{type(plugin).__name__}.{name}", f"{value!r} was taken for a value", fix)


def _unknown_factors(plugin: Plugin, known: Sequence[str]) -> Iterator[Finding]:
    for name, factor in factors_of(plugin).items():
        if factor not in known:
            where = f"{type(plugin).__name__}({name}=treatment({factor!r}))"
            yield Finding.error(where, f"the run table has no factor {factor!r}", did_you_mean(factor, known))


def _some_of(model: RunTableModel, factors: Mapping[str, str]) -> Iterator[Mapping[str, Any]]:
    """Yield a planned combination for each combination of the treatments of these factors, until all have come."""
    names = set(factors.values())
    left = prod(len(factor.treatments) for factor in model.factors if factor.name in names)
    seen: set[Any] = set()
    for run in model.plan():
        key = _key(run.combination, names)
        if key not in seen:
            seen.add(key)
            yield run.combination
        if len(seen) == left:
            return


def _key(combination: Mapping[str, Any], factors: Iterable[str]) -> tuple[tuple[type, str], ...]:
    return tuple((type(combination[name]), str(combination[name])) for name in sorted(factors))


def _distinct(combinations: Iterable[Mapping[str, Any]], factors: Iterable[str]) -> Iterator[Mapping[str, Any]]:
    """Yield one run's combination for each combination of these factors, `_MOST_COMBINATIONS` at most."""
    names = sorted(set(factors))
    seen: set[Any] = set()
    tried: set[Any] = set()
    for combination in combinations:
        key = _key(combination, names)
        treatments = set(zip(names, key, strict=True))
        if key not in seen and (len(seen) < _MOST_COMBINATIONS or not treatments <= tried):
            seen.add(key)
            tried |= treatments
            yield combination


def _with_each(
    plugin: Plugin, combinations: Iterable[Mapping[str, Any]], look: Callable[[Mapping[str, Any]], Sequence[Finding]]
) -> list[Finding]:
    """Return the findings with each combination; one that is not found with all names the treatments."""
    factors = list(dict.fromkeys(factors_of(plugin).values()))
    found: defaultdict[Finding, list[str]] = defaultdict(list)
    count = 0
    for combination in _distinct(combinations, factors):
        count += 1
        treatments = ", ".join(f"{name} = {combination[name]!s}" for name in factors)
        for finding in dict.fromkeys(look(combination)):
            found[finding].append(treatments)
    return [finding if len(under) == count > 1 else _under(finding, under) for finding, under in found.items()]


def _under(finding: Finding, treatments: Sequence[str]) -> Finding:
    shown = "; ".join(islice(treatments, 3))
    more = f" and {len(treatments) - 3} more" if len(treatments) > 3 else ""  # noqa: PLR2004 - as many as are shown
    return Finding(finding.severity, finding.where, f"with {shown}{more}: {finding.problem}", finding.fix)


def _unbuilt_with_each(plugin: Plugin, combinations: Iterable[Mapping[str, Any]], built: list[Plugin]) -> list[Finding]:
    return _with_each(plugin, combinations, lambda combination: _unbuilt(plugin, combination, built))


def _unbuilt(plugin: Plugin, combination: Mapping[str, Any], built: list[Plugin]) -> list[Finding]:
    """Return why a plugin cannot be built with a combination; a built one is added to `built`."""
    bound = ", ".join(f"{name}=treatment({factor!r})" for name, factor in factors_of(plugin).items())
    where = f"{type(plugin).__name__}({bound})"
    try:
        built.append(built_with(plugin, combination))
    except RobotRunnerError as error:
        return [Finding.error(where, error.problem, error.fix)]
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's code; what it raises is a finding like others
        problem = f"the plugin cannot be built: {type(error).__name__}: {error}"
        return [Finding.error(where, problem, "Change this treatment, or what is bound to its factor.")]
    return _malformed(built[-1])


def _malformed(plugin: Plugin) -> list[Finding]:
    """Return errors for attributes of a plugin that have the wrong type."""
    where = type(plugin).__name__
    if refused := refused_name(plugin):
        return [Finding.error(where, refused.problem, refused.fix)]
    try:
        measures = instances_of(Measure, plugin.measures)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's code; what it raises is a finding like others
        problem = f"measures: {error if isinstance(error, TypeError) else f'{type(error).__name__}: {error}'}"
        return [Finding.error(where, problem, 'Give a list, such as [Measure("Energy", "J")].')]
    # A text is true, whatever it says: "off" as well.
    given = mistyped(type(plugin), given_to(plugin))
    misread = [each for each in given if bool in each.types and type(each.value) is str]
    counts = Counter(each.name for each in measures)
    twice = (f"there are {count} measures {name!r}" for name, count in counts.items() if count > 1)
    found = [Finding.error(where, problem, "Rename or remove one.") for problem in twice]
    found += [Finding.error(where, each.problem, each.fix) for each in misread]
    for name, is_sound, fix in (
        ("bytes_per_run", is_number(plugin.bytes_per_run), "Give a number of bytes."),
        ("smoke_parameters", isinstance(plugin.smoke_parameters, Mapping), "Give values by the parameters' names."),
    ):
        if not is_sound:
            value = getattr(plugin, name)
            found.append(Finding.error(where, f"{name} is {value!r}, of type {type(value).__name__}", fix))
    return found


def _varying(plugin: Plugin, built: Sequence[Plugin]) -> Iterator[Finding]:
    """Yield an error if a plugin's name or measures differ between treatments: they must be the same in all runs."""
    factors = factors_of(plugin)
    where = f"plugin {built[0].name}, bound to {' and '.join(map(repr, dict.fromkeys(factors.values())))}"
    names = list(dict.fromkeys(each.name for each in built))
    if len(names) > 1:
        fix = "Give it a name of its own: name=... ."
        yield Finding.error(where, f"the plugin is named {names[0]!r} and {names[1]!r} under two treatments", fix)
    measures = list(dict.fromkeys(tuple((each.name, each.unit) for each in one.measures) for one in built))
    if len(measures) > 1:
        shown = " and ".join(", ".join(map(" ".join, each)) or "none" for each in measures[:2])
        fix = "Bind another parameter: the run table has the same columns in all runs. Or take a plugin for each."
        yield Finding.error(where, f"the measures of the plugin depend on a bound parameter: {shown}", fix)


def _checked_with_each(
    plugin: Plugin, plugins: Sequence[Plugin], combinations: Iterable[Mapping[str, Any]], circumstances: Circumstances
) -> list[Finding]:
    def look(combination: Mapping[str, Any]) -> list[Finding]:
        try:
            built: Plugin = built_with(plugin, combination)
            # It comes last: of two plugins that clash, the later one reports it.
            others = tuple(built_with(each, combination) for each in plugins if each is not plugin)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's code, which could be built a moment ago
            return [failed_check(plugin.name, error)]
        listed = [each.name for each in plugins]
        own = replace(circumstances, plugins=(*others, built), listed=listed)
        return asked(built.name, partial(built.check, own), plugin=built)

    return _with_each(plugin, combinations, look)
