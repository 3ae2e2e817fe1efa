"""The kinds of values of static parameters: how each is checked, normalised, and read from the command line."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from robot_runner.core.config.authors import Author, authors_from_text, is_licence
from robot_runner.core.config.notify import Notify
from robot_runner.core.config.operator_steps import OperatorStep
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.numeric_range import is_number, is_whole
from robot_runner.core.design.precision import Precision
from robot_runner.core.events.window import is_phase_name
from robot_runner.core.links.declared_host import are_hosts, named_hosts
from robot_runner.core.links.robot_name import Robots

if TYPE_CHECKING:
    from enum import Enum


@dataclass(frozen=True, slots=True)
class Kind:
    """The kind of values of a static parameter.

    Attributes:
        expected: completes the sentence "it must be ...".
        accepts: returns whether a value is valid.
        from_text: reads a value of the command line; raises ValueError or KeyError.
        normalise: converts a valid value to what `Parameters` holds.
        type_name: the type in the documentation, where the annotation says less.
        is_secret: whether an invalid value may hold a password, and is not shown.
    """

    expected: str
    accepts: Callable[[Any], bool]
    from_text: Callable[[str], Any] = str
    normalise: Callable[[Any], Any] = lambda value: value
    type_name: str = ""
    is_secret: bool = False

    def or_none(self) -> Kind:
        """Return the same with None as one more value."""
        return replace(
            self,
            expected=f"{self.expected}, or None",
            accepts=lambda value: value is None or self.accepts(value),
            from_text=lambda text: None if text.casefold() == "none" else self.from_text(text),
            normalise=lambda value: None if value is None else self.normalise(value),
        )

    def or_any(self, expected: str) -> Kind:
        """Return the same with None and `any` (the word, or Python's function) as two more values."""
        return replace(
            self.or_none(),
            expected=expected,
            accepts=lambda value: value is None or _is_any(value) or self.accepts(value),
            normalise=lambda value: "any" if _is_any(value) else value,
        )


def _is_any(value: Any) -> bool:
    return value is any or (isinstance(value, str) and value.casefold() == "any")


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and value.strip() != ""


def _not_from_text(text: str) -> NoReturn:
    raise ValueError(f"{text!r} cannot be set from outside")


def _none_from_text(text: str) -> tuple[()]:
    """Return an empty tuple, the only list of such objects that a text can express."""
    return () if text.strip().casefold() == "none" else _not_from_text(text)


def _names_from_text(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def whole(least: int, what: str) -> Kind:
    """Return the kind of whole numbers from `least` on; `what` says of what, as in " of milliseconds"."""
    return Kind(f"a whole number{what}, {least} or more", lambda value: is_whole(value) and value >= least, int)


def choice(choices: type[Enum]) -> Kind:
    """Return the kind of the members of an enumeration; the command line gives their names."""
    by_name = {each.name.casefold(): each for each in choices}
    return Kind(
        f"one of {', '.join(f'{choices.__name__}.{each.name}' for each in choices)}",
        lambda value: isinstance(value, choices),
        lambda text: by_name[text.strip().casefold().rpartition(".")[2]],
    )


def instances(of: type, expected: str) -> Kind:
    """Return the kind of lists of objects of a class; `expected` says what such a list is."""
    return Kind(
        f"{expected} in the config file; from outside, none",
        lambda value: isinstance(value, list | tuple) and all(isinstance(each, of) for each in value),
        _none_from_text,
        tuple,
    )


_FOLDER_NAME = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9 ._-]{0,126}[A-Za-z0-9_-])?")
NAME = Kind(
    "a name that can name a folder: the letters a to z, digits, and between them blanks, '.', '_' and '-', 128 at most",
    lambda value: isinstance(value, str) and _FOLDER_NAME.fullmatch(value) is not None,
)
PATH = Kind(
    "a path, such as Path('~/results')",
    lambda value: isinstance(value, str | Path) and "\0" not in str(value) and str(value) != "",
    lambda text: Path(text) if text else text,  # Path("") would be the current folder
    Path,
)
LINK = Kind(
    'the name of a robot link, such as "simulated", or Robots(...) of several',
    lambda value: isinstance(value, Robots) or (isinstance(value, str) and value != ""),
)
_SCHEDULER = re.compile(r"(tcp|tls)://(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):[0-9]{1,5}")
CLUSTER = Kind(
    "the address of a Dask scheduler, such as tcp://scheduler:8786 or tls://scheduler:8786",
    lambda value: isinstance(value, str) and _SCHEDULER.fullmatch(value) is not None,
)
ROS_GENERATION = Kind(
    "", lambda value: is_whole(value) and value in {1, 2}, lambda text: int(text) if text.isdigit() else text
).or_any("1, 2, any or None")
ROS_DISTRIBUTION = Kind("", _is_text).or_any('the name of a ROS distribution, such as "noetic", any or None')
SECONDS = Kind("a positive number of seconds", lambda value: is_number(value) and value > 0, float)
_FLAGS = {"true": True, "false": False, "yes": True, "no": False, "1": True, "0": False}
FLAG = Kind("True or False", lambda value: isinstance(value, bool), lambda text: _FLAGS[text.strip().casefold()])
PLAN = Kind("an AnalysisPlan(...) in the config file", lambda value: isinstance(value, AnalysisPlan), _not_from_text)
REPEAT_UNTIL = Kind(
    "Precision(...), or a list of them, in the config file; from outside, none",
    lambda value: all(isinstance(each, Precision) for each in (value if isinstance(value, list | tuple) else [value])),
    _none_from_text,
    lambda value: tuple(value) if isinstance(value, list | tuple) else (value,),
)
AUTHORS = Kind(
    "a list of names or Author(...)",
    lambda value: isinstance(value, list | tuple) and all(isinstance(each, Author) or _is_text(each) for each in value),
    authors_from_text,
    lambda value: tuple(each if isinstance(each, Author) else Author(each.strip()) for each in value),
)
HOSTS = Kind(
    'names with addresses, such as {"robot": "pi@robot", "base": "local"}, or with Host(...), in the config file; '
    "a name is of letters, digits, '_' and '-'",
    are_hosts,
    _not_from_text,
    named_hosts,
)
LICENCE = Kind('an SPDX identifier such as "CC-BY-4.0", a URL', is_licence)
SMOKE = Kind(
    'names with values, such as {"BasicTurtlebot3.task_s": 1.0}, in the config file',
    lambda value: isinstance(value, Mapping) and all(isinstance(name, str) and name for name in value),
    _not_from_text,
    dict,
)
TEXT = Kind("a text", _is_text)
CLAIMS = Kind(
    'a list of texts such as "serial:/dev/ttyUSB0"; from outside, separated by commas',
    lambda value: isinstance(value, list | tuple) and all(map(_is_text, value)),
    _names_from_text,
    tuple,
)
_MOST_WORKERS = 10_000  # each is prepared before the first run: a mistake would fill the memory
WORKERS = Kind(
    f'a whole number, 1 to {_MOST_WORKERS:,}, or "auto"',
    lambda value: value == "auto" or (is_whole(value) and 1 <= value <= _MOST_WORKERS),
    lambda text: int(text) if text.strip().isdecimal() else text.strip().casefold(),
)
OPERATOR_STEPS = instances(OperatorStep, "a list of OperatorStep(...)")
NOTIFY = Kind("Notify(...) in the config file", lambda value: isinstance(value, Notify), _not_from_text, is_secret=True)
PHASES = Kind(
    "a list of the names of phases: letters, digits, '_' and '-'; from outside, separated by commas",
    lambda value: isinstance(value, list | tuple) and all(map(is_phase_name, value)),
    _names_from_text,
    lambda value: tuple(dict.fromkeys(value)),
)
