"""The registration of a study: a file with its plan, fixed before its first run, and a checksum of its content."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.design.precision import rule_in_words, rules_of_mapping
from robot_runner.core.errors import DesignError, StorageError
from robot_runner.core.storage.file_shapes import RegistrationFile
from robot_runner.core.storage.guarded_files import MissingFileError, read_declared, replace
from robot_runner.core.words import combination_label, counted, enumerated, listed

#: Version of the file's format; readers refuse a newer one.
FORMAT = 1

_SUM = "sha256"
#: A larger file, bytes, is not a registration, which has some kilobytes.
_LARGEST = 16 << 20
#: At most so many differing combinations are named.
_MOST = 6


@dataclass(frozen=True, slots=True)
class Registration:
    """A registration that was read.

    Attributes:
        content: everything in it, the checksum included.
        is_intact: whether the checksum is that of the content.
    """

    path: Path
    content: Mapping[str, Any]
    is_intact: bool

    @property
    def sha256(self) -> str:
        """The checksum that it states."""
        return str(self.content[_SUM])

    @property
    def registered_at(self) -> str:
        """When it was made (UTC)."""
        return str(self.content["registered_at"])

    @property
    def seed(self) -> int:
        """The seed of the order of runs."""
        return int(self.content["seed"])

    def facts(self) -> dict[str, Any]:
        """Return its facts for the manifest."""
        return {"file": self.path.name, "registered_at": self.registered_at, _SUM: self.sha256}


def checksum_of(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a registration without its checksum, as JSON with sorted keys and without blanks.

    Example:
        >>> checksum_of({"a": 1, "sha256": "whatever"}) == checksum_of({"a": 1})
        True
    """
    kept = {name: value for name, value in content.items() if name != _SUM}
    text = json.dumps(kept, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def write_registration(path: Path, content: Mapping[str, Any]) -> Registration:
    """Write a registration with its checksum; raise a `StorageError` if it cannot be written."""
    plain = json.loads(json.dumps({"format": FORMAT, **content}))
    sealed = {**plain, _SUM: checksum_of(plain)}
    replace(path, json.dumps(sealed, indent=2, ensure_ascii=False) + "\n")
    return Registration(path, sealed, is_intact=True)


def read_registration(path: Path) -> Registration:
    """Read a registration; see `is_intact` for one whose content was changed.

    Raises:
        StorageError: there is no such file, it cannot be read, or it is not a registration that this version knows.
    """
    try:
        content = read_declared(path, "registration", RegistrationFile, newest=FORMAT, fix=_FIX, limit=_LARGEST)
    except MissingFileError as error:
        fix = "Register the study: robot-runner preregister CONFIG"
        raise StorageError("there is no registration", where=str(path), fix=fix) from error
    if not _is_comparable(content):
        raise StorageError("this is not a registration: parts of it are not as it has them", where=str(path), fix=_FIX)
    return Registration(path, content, checksum_of(content) == content[_SUM])


def _is_comparable(content: Mapping[str, Any]) -> bool:
    """Return whether all parts of a registration that are compared have the expected shape."""
    nothing: dict[str, Any] = {"design": {}, "analysis": None, "repeat_until": None, "measures": []}
    try:
        for now in (content, nothing):
            list(differences(content, now))
            list(differences({**content, **nothing}, now))
        return all(isinstance(each.get("name"), str) for each in content["measures"])
    except (KeyError, TypeError, AttributeError, ValueError, DesignError):
        return False


_FIX = "Restore the file from where it was deposited, or register again before the first run."


# How a study differs from its registration.


def differences(registered: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    """Yield in words how a study differs from its registration: design, order, analysis, measures.

    `registered` is the content of the registration; `now` has `design`, `seed`, `analysis`, `repeat_until` and
    `measures` likewise. What `now` lacks is not compared.
    """
    if "design" in now:
        yield from _design_differences(registered["design"], now["design"])
    is_random = registered["design"].get("shuffle") and now.get("design", {}).get("shuffle", True)
    if "seed" in now and is_random and now["seed"] != registered["seed"]:
        yield f"the seed of the order is {now['seed']}, and {registered['seed']} was registered"
    if "analysis" in now:
        yield from _plan_differences(registered["analysis"], now["analysis"])
    if "repeat_until" in now and now["repeat_until"] != registered.get("repeat_until"):
        before, after = map(repeated_in_words, (registered.get("repeat_until"), now["repeat_until"]))
        yield f"combinations are repeated {after}, and {before} was registered"
    if "measures" in now:
        yield from _measure_differences(registered["measures"], now["measures"])


def repeated_in_words(recorded: Mapping[str, Any] | None) -> str:
    """Return in words how often combinations are repeated, by the recorded `repeat_until`."""
    return rule_in_words(*rules_of_mapping(recorded)) or "as often as is planned"


def _design_differences(registered: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    before, after = registered.get("factors") or {}, now.get("factors") or {}
    ranges = registered.get("ranges", {})
    for name in [*before, *(name for name in after if name not in before)]:
        if name not in after:
            yield f"the factor {name} was registered, and is gone"
        elif name not in before:
            yield f"the factor {name} was not registered"
        elif (was := ranges.get(name)) and (is_now := now.get("ranges", {}).get(name)):
            if was != is_now:  # the treatments within it are the design's choice
                yield f"the range of {name} is {is_now}, and {was} was registered"
        elif list(map(plain_text, before[name])) != list(map(plain_text, after[name])):
            yield f"the treatments of {name} are {_several(after[name])}, and {_several(before[name])} were registered"
    for name, words in _DESIGN_WORDS.items():
        if (name in now or name in registered) and now.get(name) != registered.get(name):
            yield f"{words}: {_shown(now.get(name))}, and {_shown(registered.get(name))} was registered"
    yield from _unit_differences(registered.get("units", {}), now.get("units", {}))
    if "combinations" in registered and "combinations" in now and list(before) == list(after):
        was, are = ({tuple(map(plain_text, each)) for each in design["combinations"]} for design in (registered, now))
        yield from combination_differences(was, are, "the design", before)


def plain_text(treatment: object) -> str:
    """Return the text of a treatment, by which 1 and 1.0 are the same."""
    text = str(treatment)
    number = text.removesuffix(".0")
    return number if number.removeprefix("-").isdecimal() else text


def combination_differences(
    registered: set[tuple[str, ...]], now: set[tuple[str, ...]], where: str, factors: Mapping[str, Sequence[str]]
) -> Iterator[str]:
    """Yield in words which combinations were not registered, and which are missing though they were.

    Args:
        registered: the combinations, each as the `plain_text` of its treatments.
        now: those that there are.
        where: they are, in words.
        factors: the registered treatments of each; other treatments are reported as such.
    """
    treatments = [set(map(plain_text, texts)) for texts in factors.values()]
    added = [cell for cell in sorted(now - registered) if all(map(set.__contains__, treatments, cell))]
    missing = sorted(registered - now)
    for words, cells in (("not registered", added), (f"registered and not in {where}", missing)):
        if cells:
            yield f"{counted(len(cells), 'combination')} {words}: {listed(map(combination_label, cells), _MOST)}"


#: Further keys of a design, in words.
_DESIGN_WORDS = {
    "repetitions": "repetitions",
    "shuffle": "whether the order is randomised",
    "blocks": "blocks of the order",
    "warm_up": "warm-up runs",
    "excluded": "combinations left out of the design",
    "parameters": "parameters of the design",
}


def _plan_differences(registered: Mapping[str, Any] | None, now: Mapping[str, Any] | None) -> Iterator[str]:
    before, after = _full(registered), _full(now)
    if before is None or after is None:
        if (before is None) is not (after is None):
            is_now, was = ("there", "none") if before is None else ("gone", "one")
            yield f"the analysis plan is {is_now}, and {was} was registered"
        return
    for name in [*before, *(name for name in after if name not in before)]:
        if name != "hypotheses" and after.get(name) != before.get(name):
            then = _shown(before.get(name))
            yield f"{name} of the analysis plan: {_shown(after.get(name))}, and {then} was registered"
    earlier, later = ({each["statement"]: each for each in plan.get("hypotheses", ())} for plan in (before, after))
    for statement in [*earlier, *(each for each in later if each not in earlier)]:
        if statement not in later:
            yield f"the hypothesis {statement!r} was registered, and is gone"
        elif statement not in earlier:
            yield f"the hypothesis {statement!r} was not registered"
        elif earlier[statement] != later[statement]:
            yield f"the hypothesis {statement!r} claims something else than was registered"


def _full(plan: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """Return a plan with defaults for choices that an earlier version, which wrote it, did not have."""
    if plan is None:
        return None
    try:
        every = {"doubtful": Doubtful.KEEP.value, **AnalysisPlan.of_mapping(plan).as_mapping()}
        return json.loads(json.dumps(every))  # type: ignore[no-any-return]
    except DesignError:  # of another version: it is compared as it is
        return plan


def _measure_differences(registered: list[Any], now: list[Any]) -> Iterator[str]:
    before, after = ({each["name"]: each.get("unit", "") for each in several} for several in (registered, now))
    for name in before:
        if name not in after:
            yield f"the measure {name} was registered, and the run table has no column for it"
    yield from _unit_differences(before, after)
    added = [name for name in after if name not in before]
    if added:
        yield f"the run table has measures that were not registered: {enumerated(added)}"


def _unit_differences(registered: Mapping[str, str], now: Mapping[str, str]) -> Iterator[str]:
    for name, unit in registered.items():
        if unit and now.get(name, "") not in {"", unit}:
            yield f"{name} is in {now[name]}, and {unit} was registered"


def _several(texts: object) -> str:
    return ", ".join(map(str, texts)) if isinstance(texts, list | tuple) else str(texts)


def _shown(value: object) -> str:
    if value is None or value in ([], (), ""):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return "; ".join(_several(each) for each in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
