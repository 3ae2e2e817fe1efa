"""The durations of runs: as plugins and the config declare them beforehand, and as observed in runs that ended."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import Finding
from robot_runner.core.events.manager import EventManager, RobotRunnerEvents
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.plugin import Plugin
from robot_runner.core.treatments import built_with

#: A combination as the journal keeps it: each factor with the text of its treatment.
CombinationKey = frozenset[tuple[str, str]]


def combination_key(combination: Mapping[str, Any]) -> CombinationKey:
    """Return a key that is the same for a combination of the config and its record in the journal."""
    return frozenset((name, str(treatment)) for name, treatment in combination.items())


@dataclass(slots=True)
class DeclaredDurations:
    """The durations of runs that the plugins of an experiment, and its config, declare by a method `duration_s`.

    Attributes:
        sources: plugins, and the config, that have a `duration_s`, with their names.
        without: the names of those that take part in the mission and have none.
        is_simulated: whether the robot is the embedded one: then nobody is asked, as the physics takes its own time.
        findings: what was wrong with their answers.
    """

    sources: tuple[tuple[str, Any], ...] = ()
    without: tuple[str, ...] = ()
    is_simulated: bool = False
    findings: list[Finding] = field(default_factory=list)

    @classmethod
    def of(cls, config: Any, plugins: Sequence[Plugin], events: EventManager, robot: str | None) -> DeclaredDurations:
        """Find out which of them can be asked; none is asked yet."""
        if is_simulated(robot):
            return cls(is_simulated=True)
        sources = {plugin.name: plugin for plugin in plugins if plugin.knows_duration}
        if callable(getattr(config, "duration_s", None)):
            sources[CONFIG_OWNER] = config
        owners = dict.fromkeys(each.owner for each in events.subscribers(RobotRunnerEvents.LAUNCH_MISSION))
        return cls(tuple(sources.items()), tuple(owner for owner in owners if owner not in sources))

    def seconds(self, combination: Mapping[str, Any]) -> float | None:
        """Return the sum of what plugins and config declare for a run, s; None where none of them declares anything."""
        answers = [self._asked(name, source, combination) for name, source in self.sources]
        declared = [seconds for seconds in answers if seconds is not None]
        return math.fsum(declared) if declared else None

    def of_all(self, combinations: Iterable[Mapping[str, Any]]) -> dict[CombinationKey, float]:
        """Return the declared duration of a run of each combination, s; empty unless all of them are declared."""
        declared: dict[CombinationKey, float] = {}
        for combination in combinations if self.sources else ():
            key = combination_key(combination)
            if key in declared:
                continue
            seconds = self.seconds(combination)
            if seconds is None:
                return {}
            declared[key] = seconds
        return declared

    def _asked(self, name: str, source: Any, combination: Mapping[str, Any]) -> float | None:
        where = f"{name}.duration_s"
        try:
            seconds = built_with(source, combination).duration_s(combination)
        except Exception as error:  # noqa: BLE001 - a stranger's code
            self._doubt(where, f"the method raised {type(error).__name__}: {error}")
            return None
        if seconds is None:
            return None
        if not is_number(seconds) or seconds < 0:
            self._doubt(where, f"the method returned {seconds!r}, which is not a number of seconds")
            return None
        return float(seconds)

    def _doubt(self, where: str, problem: str) -> None:
        finding = Finding.warning(where, problem, "Return seconds of real time, or None where it is not known.")
        if finding not in self.findings:
            self.findings.append(finding)


def distinct_combinations(combinations: Iterable[Mapping[str, Any]]) -> list[tuple[Mapping[str, Any], int]]:
    """Return each combination and how often it occurs, by identity: the repetitions of a plan share one object."""
    kept = list(combinations)
    found = {id(each): each for each in kept}
    counts = Counter(map(id, kept))
    return [(each, counts[number]) for number, each in found.items()]


@dataclass(slots=True)
class _Mean:
    total: float = 0.0
    count: int = 0

    def take(self, value: float) -> None:
        self.total += value
        self.count += 1

    @property
    def value(self) -> float:
        return self.total / self.count


class ObservedDurations:
    """How long runs took: means of combinations, and of treatments for combinations not observed yet."""

    def __init__(self) -> None:
        self._all = _Mean()
        self._of_combination: defaultdict[CombinationKey, _Mean] = defaultdict(_Mean)
        self._of_treatment: defaultdict[tuple[str, str], _Mean] = defaultdict(_Mean)
        self._least, self._most = math.inf, -math.inf

    @property
    def count(self) -> int:
        """How many runs were observed."""
        return self._all.count

    def take(self, key: CombinationKey, seconds: float) -> None:
        """Take a run of this combination into account."""
        self._least, self._most = min(self._least, seconds), max(self._most, seconds)
        # A combination of one treatment needs no mean of its own: memory in use makes each later fork slower.
        combination = (self._of_combination[key],) if len(key) > 1 else ()
        for mean in (self._all, *combination, *(self._of_treatment[each] for each in key)):
            mean.take(seconds)

    def expected(self, key: CombinationKey) -> float | None:
        """Return how long a run of a combination is expected to take, s; None before any run has ended.

        For a combination not observed, it is the mean of all runs plus the effect of each treatment (additive), within
        the shortest and the longest run.
        """
        if not self._all.count:
            return None
        if key in self._of_combination:
            return self._of_combination[key].value
        effects = (self._of_treatment[each].value - self._all.value for each in key if each in self._of_treatment)
        return min(self._most, max(self._least, self._all.value + math.fsum(effects)))
