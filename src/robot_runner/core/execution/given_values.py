"""The values that an experiment was given, as JSON data: static parameters, and the arguments of its plugins.

The text of a config does not show what it takes from outside: a variable of the environment, the name of the machine.
So each execution records the values, and a later one is compared with them. Of what has no stable text (an object, a
temporary folder, a time, a secret) only the name is recorded, and it is not compared.
"""

from __future__ import annotations

import hashlib
import math
import os
import platform
import re
import sys
import tempfile
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from datetime import UTC, date, datetime, timedelta
from enum import Enum
from numbers import Number
from pathlib import Path, PurePath
from types import ModuleType
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.loader import own_parameters
from robot_runner.core.config.parameters import PARAMETERS
from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import RobotRunnerError
from robot_runner.core.events.condition import Condition
from robot_runner.core.secret_names import (
    REDACTED,
    is_secret_name,
    without_environment_secrets,
    without_secret_settings,
)
from robot_runner.core.storage.layout import home_folder
from robot_runner.core.storage.manifest import last_execution
from robot_runner.core.treatments import CONFIG_MODULE, Bindable, Treatment, given_to

#: Stands for a value that has no stable text; for a secret it is `REDACTED`, as everywhere.
LEFT_OUT = "(left out)"
#: Static parameters that change no value, or are compared in another way.
_UNCOMPARED = frozenset(
    {"experiment_name", "results_output_path", "workers", "cluster", "registration", "smoke", "notify"}
    | {"analysis", "authors", "licence", "citation"}
)
#: Texts with more characters and lists with more values are recorded by their SHA-256.
_LONGEST = 1000
_MOST = 200
#: Structures that are nested deeper are left out.
_DEEPEST = 8
_ADDRESS = re.compile(r"\b(?:at|id=) ?0x[0-9a-fA-F]{6,}")
#: User and password in a URL, or the credentials in an Authorization header.
_LOGIN = re.compile(r"(?<=://)[^/\s@]+(?=@)|(?<=\bBearer )\S+|(?<=\bBasic )[A-Za-z0-9+/=]{8,}")
_ASSIGNED = re.compile(r"(\w+)['\"]?\s*[=:]")
#: A set of texts, which has another order in each process.
_SET = re.compile(r"\{(['\"][^:{}]*)\}")
#: Ends the name of a value whose part is named: `gates[0].timeout_s`.
_PLACE = re.compile(r"[.\[]")
_DAY_S = 86_400
#: The year 2000, s since 1970: a clock that shows less was never set.
_CLOCK_IS_SET = 946_684_800
#: In a container, process ids are numbers as people write them, such as 1: a value is compared all the same.
_SMALL_PROCESS_ID = 1000
_SCALAR = (str, Number, PurePath, Enum)


def given_values(experiment: Experiment) -> dict[str, Any]:
    """Return the values that an experiment was given, each by its name: JSON data.

    `robot` and `task_s` are static parameters and attributes of the config, where they are not as they are by default;
    `Meter.gain` is a parameter of a plugin, `gates[0].timeout_s` a part of one, `lab.py: GAIN` of a module.
    """
    words = _Words(experiment.config_path.parent)
    pairs = [*_static(experiment), *_attributes(experiment), *_of_modules(experiment), *_plugins(experiment)]
    values: dict[str, Any] = {}
    for name, given in pairs:
        try:
            values |= dict(words.leaves(name, given))
        except Exception:  # noqa: BLE001 - a user's object may raise anything, and must not keep the experiment from starting
            values[name] = LEFT_OUT
    return values


def _static(experiment: Experiment) -> Iterator[tuple[str, Any]]:
    parameters = experiment.parameters
    for name, parameter in PARAMETERS.items():
        value = getattr(parameters, name)
        is_default = repr(value) == repr(parameter.default) or (not value and parameter.default in ((), {}))
        if name == "robot" and parameters.robots:
            yield name, parameters.robots
        elif name not in _UNCOMPARED and not is_default:
            yield name, value


def _attributes(experiment: Experiment) -> Iterator[tuple[str, Any]]:
    config = experiment.config
    if not is_from_file(experiment):  # an object in memory may have been changed by callbacks of an earlier execution
        yield from own_parameters(type(config)).items()
        return
    found = {name: value for kind in reversed(type(config).__mro__) for name, value in vars(kind).items()}
    found |= getattr(config, "__dict__", {})
    yield from ((name, value) for name, value in _data_of(found) if name not in PARAMETERS)


def is_from_file(experiment: Experiment) -> bool:
    """Return whether the config was loaded from its file: of an object of a script, callbacks may have changed more."""
    loaded = sys.modules.get(CONFIG_MODULE)
    return experiment.kept == "file" and getattr(loaded, "__file__", None) == str(experiment.config_path)


def _of_modules(experiment: Experiment) -> Iterator[tuple[str, Any]]:
    """Yield the names of the config file that hold data, and the constants of the modules that it imports."""
    if is_from_file(experiment):
        yield from ((f"top level: {name}", value) for name, value in _data_of(vars(sys.modules[CONFIG_MODULE])))
    for module in _local_modules(experiment).values():
        constants = ((name, value) for name, value in _data_of(vars(module)) if name.isupper())
        yield from ((f"{Path(str(module.__file__)).name}: {name}", value) for name, value in constants)


def _local_modules(experiment: Experiment) -> dict[str, ModuleType]:
    """Return the config's modules that are imported, by name; `sys.path` may have shown the way to them relatively."""
    local = {os.path.realpath(each): each.name for each in experiment.local_modules}
    files = {name: getattr(module, "__file__", None) for name, module in list(sys.modules.items())}
    near = {name: file for name, file in files.items() if isinstance(file, str) and file.endswith((*local.values(),))}
    return {name: sys.modules[name] for name, file in near.items() if os.path.realpath(file) in local}


def _plugins(experiment: Experiment) -> Iterator[tuple[str, Any]]:
    listed = getattr(experiment.config, "plugins", ())
    own = set(map(id, listed)) if isinstance(listed, list | tuple) else set()  # others may be added by packages
    yield from ((plugin.name, plugin) for plugin in experiment.plugins if id(plugin) in own)


def _data_of(names: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    return ((name, value) for name, value in list(names.items()) if not name.startswith("_") and _is_data(value))


def _is_data(value: Any, depth: int = 0) -> bool:
    if isinstance(value, Mapping) or type(value) in {list, tuple}:
        inside = [*value, *value.values()] if isinstance(value, Mapping) else value
        return depth < _DEEPEST and len(inside) <= _MOST and all(_is_data(each, depth + 1) for each in inside)
    return value is None or isinstance(value, str | bool | int | float | PurePath | Enum)


class _Words:
    """Turns values into JSON data that is the same in another folder and at another time as long as the values are."""

    def __init__(self, beside: Path) -> None:
        own = dict.fromkeys([str(beside), str(beside.resolve())], ".")
        folders = own | {sys.prefix: "(python)"} | ({str(home): "~"} if (home := home_folder()) else {})
        self._folders = {folder: short for folder, short in folders.items() if folder != "/"}
        now = datetime.now(UTC)
        moments = [each - ago for each in (now, now.astimezone()) for ago in (timedelta(), timedelta(minutes=1))]
        texts = {f"{each:{form}}" for each in moments for form in ("%Y-%m-%d", "%Y%m%d", "%H:%M", "%H-%M")}
        self._passing = re.compile("|".join(map(re.escape, [*texts, f"{tempfile.gettempdir()}/"])))
        #: Folder and host may change between executions; the manifest records them elsewhere.
        self._here = frozenset({os.getcwd(), platform.node()})  # noqa: PTH109 - a text

    def leaves(self, name: str, value: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
        """Yield a value, or each part of one that has parts, with its place."""
        if is_secret_name(name.rpartition(".")[2]):
            yield name, REDACTED
        elif (parts := _parts(name, value)) is None or depth > _DEEPEST:
            yield name, self._plain(value) if depth <= _DEEPEST else LEFT_OUT
        else:
            if not isinstance(value, Mapping | list | tuple):
                yield name, type(value).__qualname__
            found = [leaf for place, each in parts for leaf in self.leaves(place, each, depth + 1)]
            if len(found) <= _MOST:
                yield from found
            else:
                yield name, _digest(repr([leaf for leaf in found if leaf[1] != LEFT_OUT]))

    def _plain(self, value: Any) -> Any:
        if hasattr(value, "tolist"):  # an array or a number of NumPy's
            value = value.tolist()
        match value:
            case None | bool():
                return value
            case Enum():
                return value.name
            case int() | float():
                return self._number(value)
        if isinstance(value, list | tuple | set | frozenset):
            return self._listed(value)
        return self._text(str(value) if isinstance(value, str | PurePath) else _own_text(value))

    def _listed(self, values: Collection[Any]) -> Any:
        plain = list(map(self._plain, values))
        if not isinstance(values, list | tuple):
            plain.sort(key=str)
        return LEFT_OUT if LEFT_OUT in plain else plain if len(plain) <= _MOST else _digest(repr(plain))

    @staticmethod
    def _number(value: float) -> Any:
        if isinstance(value, float) and not math.isfinite(value):
            return str(value)
        if isinstance(value, int) and value.bit_length() > _LONGEST:
            return _digest(hex(value))
        now = time.time()
        is_near = any(abs(value - unit * now) < unit * _DAY_S for unit in (1, 1_000, 1_000_000_000))
        is_moment = is_near and now > _CLOCK_IS_SET
        return LEFT_OUT if is_moment or value == os.getpid() > _SMALL_PROCESS_ID else value

    def _text(self, text: str) -> str:
        if text == sys.executable:
            return "(python)"
        if text in self._here:
            return LEFT_OUT
        for folder, short in self._folders.items():
            text = short if text == folder else text.replace(f"{folder}/", f"{short}/")
        if self._passing.search(text) or _ADDRESS.search(text):
            return LEFT_OUT
        text = without_secret_settings(_LOGIN.sub(REDACTED, without_environment_secrets(text)))
        return text if len(text) <= _LONGEST else _digest(text)


def _parts(name: str, value: Any) -> Iterable[tuple[str, Any]] | None:
    """Return the parts of a value, with their places; None where it has none that are named."""
    if isinstance(value, Bindable):
        return [(f"{name}.{each}", part) for each, part in given_to(value).items()]
    if isinstance(value, Mapping):
        return [
            (f"{name}.{key}" if is_secret_name(str(key)) else f"{name}[{str(key)!r}]", part)
            for key, part in value.items()
        ]
    if is_dataclass(value) and not isinstance(value, type):
        given = [(each, getattr(value, each.name, None)) for each in fields(value)]
        # What is as it is by default is left out: a later version may have more of it.
        return [(f"{name}.{each.name}", part) for each, part in given if repr(part) != repr(each.default)]
    if isinstance(value, list | tuple) and not all(each is None or isinstance(each, _SCALAR) for each in value):
        return [(f"{name}[{place}]", part) for place, part in enumerate(value)]
    return None


def _own_text(value: Any) -> str:
    """Return a text that identifies an object's value; `LEFT_OUT` where it has none."""
    if isinstance(value, bytes | bytearray):
        return _digest(value)
    if isinstance(value, Condition | date | Treatment):
        return repr(value) if isinstance(value, Treatment) else str(value)
    name = getattr(value, "__qualname__", "")
    if isinstance(name, str) and name and "<" not in name:  # a function or a class: the text of its file is compared
        return f"{getattr(value, '__module__', '')}.{name}"
    if callable(value) or getattr(type(value), "__repr__", None) is object.__repr__:
        return LEFT_OUT
    return _shown(value)


def _shown(value: Any) -> str:
    try:
        text = repr(value)
    except Exception:  # noqa: BLE001 - a stranger's code
        return LEFT_OUT
    if any(map(is_secret_name, _ASSIGNED.findall(text))):
        return LEFT_OUT
    return _SET.sub(lambda found: f"{{{', '.join(sorted(found[1].split(', ')))}}}", text)


def _digest(content: str | bytes | bytearray) -> str:
    data = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    return f"SHA-256 {hashlib.sha256(data).hexdigest()}"


# What has changed since.


def changed_values(experiment: Experiment, manifest: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the values that differ from the last execution's, by name: `was`, `is`, or one of both where it is absent.

    What differs at each loading of the config, such as a random number, is left out.
    """
    now = given_values(experiment)
    changed = _changed_since(manifest, experiment, now)
    return _steady(experiment, now, changed) if changed else {}


def last_given(manifest: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the values of the last execution, by the manifest; None where an earlier version recorded nothing."""
    given = manifest.get("given_to_extension", last_execution(manifest).get("given"))
    return given if isinstance(given, dict) else None


def given_elsewhere(experiment: Experiment, original: Mapping[str, Any], settings: Collection[str]) -> list[str]:
    """Return in words which values differ from those in the manifest of the experiment that is replicated.

    Left out are files of the same name in another folder, and the `settings` that were made on purpose.
    """
    now = given_values(experiment)
    told: list[str] = []
    changed = _changed_since(original, experiment, now)
    for name, pair in _steady(experiment, now, changed).items() if changed else ():
        texts = [str(pair.get(each, "not given")) for each in ("was", "is")]
        is_hidden = any(REDACTED in text or "~" in text for text in texts)
        lies_elsewhere = all("/" in text for text in texts) and len({PurePath(text).name for text in texts}) == 1
        if not is_part_of(name, settings) and not is_hidden and not lies_elsewhere:
            told.append(f"{name} ({texts[0]}, here {texts[1]})")
    return told


def accept_given(experiment: Experiment, manifest: dict[str, Any]) -> None:
    """Record the present values for the next execution to be compared with: an extension has accepted the changes.

    Where other static parameters are set from outside than at the last execution, nothing will be compared.
    """
    settings = last_execution(manifest).get("deviations") or {}
    is_set_alike = settings.keys() == experiment.overrides.keys()
    manifest["given_to_extension"] = given_values(experiment) if is_set_alike else None


def _changed_since(
    manifest: Mapping[str, Any], experiment: Experiment, now: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """Return the differences between the values now and those in a manifest; none where that has no values.

    A class that a script executes shows fewer names than its file (`is_from_file`): one that only the file shows
    is not a change where the other of two executions was of such a class.
    """
    before = last_given(manifest)
    if before is None:
        return {}
    was_from_file = "given_to_extension" in manifest or not last_execution(manifest).get("config_is_object")
    is_alike = was_from_file == is_from_file(experiment)
    return {
        name: pair
        for name, pair in _differing(before, now)
        if is_alike or len(pair) > 1 or _PLACE.split(name)[0] in PARAMETERS
    }


def _differing(before: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    whole: tuple[str, ...] = ()  # what came or went as a whole: its parts are not told as well
    for name in dict.fromkeys([*now, *before]):
        if name.startswith(whole):
            continue
        pair = {which: given[name] for which, given in (("was", before), ("is", now)) if name in given}
        is_left_out = bool({LEFT_OUT, REDACTED}.intersection(map(str, pair.values())))
        if not is_left_out and (len(pair) == 1 or pair["was"] != pair["is"]):
            whole += (f"{name}.", f"{name}[") if len(pair) == 1 else ()
            yield name, pair


def is_part_of(name: str, settings: Collection[str]) -> bool:
    """Return whether a value is, or is a part of, one of the static parameters that were set from outside."""
    return name in settings or _PLACE.split(name)[0] in settings


def is_reordered(pair: Mapping[str, Any]) -> bool:
    """Return whether a value that has changed is a list of texts in another order, as one that was made of a set is."""
    was, is_now = pair.get("was"), pair.get("is")
    if isinstance(was, list) and isinstance(is_now, list) and all(isinstance(each, str) for each in (*was, *is_now)):
        return sorted(was) == sorted(is_now)
    return False


def _steady(
    experiment: Experiment, now: Mapping[str, Any], changed: dict[str, dict[str, Any]]
) -> dict[str, dict[str, Any]]:
    if not is_from_file(experiment):
        return changed
    again = None
    with _loaded_anew(experiment), suppress(RobotRunnerError, OSError):
        found = prepare(experiment.config_path, experiment.overrides, is_for_here=False).experiment
        again = None if found is None else given_values(found)
    if again is None:
        return changed
    # Which robot `auto` finds is not the config's choice.
    return {name: pair for name, pair in changed.items() if name == "robot" or again.get(name) == now.get(name)}


@contextmanager
def _loaded_anew(experiment: Experiment) -> Iterator[None]:
    """Take the config's local modules out of `sys.modules` for a while, so that importing executes them again."""
    before = _local_modules(experiment)
    if (config := sys.modules.get(CONFIG_MODULE)) is not None:
        before[CONFIG_MODULE] = config
    for name in before:
        del sys.modules[name]
    try:
        yield
    finally:
        sys.modules.update(before)
