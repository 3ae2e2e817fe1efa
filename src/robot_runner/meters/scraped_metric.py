"""A metric of a Prometheus exporter, selected by its name and labels, and the measure that it yields."""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from robot_runner.core.errors import PluginError, did_you_mean
from robot_runner.core.events.measure import Measure, Over

_SELECTOR = re.compile(r"([a-zA-Z_:][a-zA-Z0-9_:]*)(?:\{(.*)\})?")
_LABEL = re.compile(r"""\s*([a-zA-Z_][a-zA-Z0-9_]*)\s*=\s*("[^"]*"|'[^']*')\s*(?:,|$)""")
#: Endings of names that only counters have, and base units by the ending of a name. Source: Prometheus' documentation,
#: Metric and label naming; node_exporter has some in the singular, and amps.
BUCKETS = "_bucket"
_COUNTER_ENDINGS = ("_total", "_sum", "_count", BUCKETS)
_UNITS = {
    "second": "s",
    "byte": "B",
    "joule": "J",
    "watt": "W",
    "volt": "V",
    "ampere": "A",
    "amp": "A",
    "celsius": "°C",
    "hertz": "Hz",
    "meter": "m",
    "gram": "g",
    "percent": "%",
}
_PREFIXES = {None: "", "micro": "\N{MICRO SIGN}", "milli": "m", "kilo": "k"}
_ENDING = re.compile(rf"_({'|'.join(filter(None, _PREFIXES))})?({'|'.join(_UNITS)})s?$")
_COMBINATIONS: Mapping[str, Callable[[Sequence[float]], float]] = {
    "sum": math.fsum,
    "mean": statistics.fmean,
    "max": max,
    "min": min,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ScrapedMetric:
    """A metric of an exporter, and the measure that it yields.

    Attributes:
        selector: its name on the exporter's page, and labels that series must have: `node_load1` or
            `node_cpu_seconds_total{mode="user"}`.
        measure: that it yields; None names it after the selector, with the unit at the name's end.
        is_counter: whether its increase is measured, not its mean; None decides by the name's ending (`_total`, `_sum`,
            ...).
        combine: how several series are combined: `sum`, `mean`, `max` or `min`; counters are summed.

    Raises:
        PluginError: the selector is malformed, or there is no such combination.

    Example:
        >>> metric = ScrapedMetric(selector='node_cpu_seconds_total{mode="user"}')
        >>> metric.yields.name, metric.yields.unit, metric.counts
        ('NodeCpuSeconds_user', 's', True)
    """

    selector: str
    measure: Measure | None = None
    is_counter: bool | None = None
    combine: str | None = None

    def __post_init__(self) -> None:
        _ = self.labels
        if self.combine is not None and self.combine not in _COMBINATIONS:
            fix = did_you_mean(self.combine, _COMBINATIONS)
            raise PluginError(f"combine is {self.combine!r}", where=self.selector, fix=fix)

    @property
    def name(self) -> str:
        """The metric's name, without labels."""
        return self.selector.partition("{")[0].strip()

    @property
    def labels(self) -> Mapping[str, str]:
        """The labels that its series must have."""
        match = _SELECTOR.fullmatch(self.selector.strip())
        inner = (match[2] or "").strip() if match else ""
        labels = {label[1]: label[2][1:-1] for label in _LABEL.finditer(inner)}
        if match is None or _LABEL.sub("", inner):
            fix = """Write it as on the exporter's page: 'node_cpu_seconds_total{mode="user"}'."""
            raise PluginError(f"{self.selector!r} selects no metric", where="metrics", fix=fix)
        return labels

    @property
    def counts(self) -> bool:
        """Whether it is a counter."""
        return self.name.endswith(_COUNTER_ENDINGS) if self.is_counter is None else self.is_counter

    @property
    def yields(self) -> Measure:
        """The measure."""
        if self.measure is not None:
            return self.measure
        stem = self.name.removesuffix("_total")
        camel = "".join(part[:1].upper() + part[1:] for part in re.split("[_:]+", stem))
        suffix = "".join("_" + re.sub(r"\W+", "_", value).strip("_") for value in self.labels.values())
        told = stem.removesuffix("_sum")  # a histogram's or summary's sum has the unit of what it adds up
        match = _ENDING.search(told)
        unit = _PREFIXES[match[1]] + _UNITS[match[2]] if match else "1"
        what, over = ("increase", Over.SUM) if self.counts else ("mean", Over.MEAN)
        return Measure(camel + suffix, unit, f"{self.selector}, {what} over the measured window.", over=over)

    def combined(self, values: Sequence[float]) -> float:
        """Return the value of several series at one moment."""
        return _COMBINATIONS[self.combine or "sum"](values)
