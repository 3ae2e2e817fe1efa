"""The profiler that scrapes a Prometheus exporter: its counters and gauges become measures."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from robot_runner.core.errors import Finding, LinkError, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure
from robot_runner.measuring.parameter_checks import check_list, check_numbers
from robot_runner.measuring.quality import Column
from robot_runner.measuring.series import Series, cut, growth, integrate, mean, renewed_every
from robot_runner.meters.counters import fall_count, unwrapped
from robot_runner.meters.electrical_readings import OFF_SHARE, step_error
from robot_runner.meters.http_requests import HttpDevice, Secret, check_url
from robot_runner.meters.polled import Meter, PolledProfiler, known_series
from robot_runner.meters.scraped_metric import BUCKETS, ScrapedMetric

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances
    from robot_runner.measuring.periodic import Sampling

_INSTALL = "Install it: pip install 'robot-runner[prometheus]'."
#: A series is updated rarely if an update takes this many scrapes, and this share of the window: at each edge a counter
#: may be behind by as much, and a gauge does not show changes in between.
_SELDOM_SCRAPES, _SELDOM_COUNTED, _SELDOM_GAUGED = 3, 0.05, 0.2
#: Units, with or without a prefix, of what differs at each renewal, unless it is in whole watts.
_RESTLESS = ("W", "J")
#: The unit in the help of a metric, such as `Power draw (in W).` of NVIDIA's DCGM exporter.
_UNIT_IN_HELP = re.compile(r"\(in [^)]+\)")
_TEXT_FORMAT = "text/plain;version=0.0.4"

#: The labels of one series, sorted.
Labels = tuple[tuple[str, str], ...]
#: The series of each metric at one moment.
Scrape = tuple["Mapping[Labels, _Shown]", ...]


class _Shown(NamedTuple):
    value: float
    stamp: float | None  # of the value, by the exporter's clock; None without one


class _Exporter(Meter[Scrape]):
    def __init__(self, plugin: Prometheus) -> None:
        try:
            parser: Any = import_module("prometheus_client.parser")
        except ModuleNotFoundError as error:
            raise PluginError("prometheus-client is not installed", where=plugin.name, fix=_INSTALL) from error
        self._families = parser.text_string_to_metric_families
        self._metrics = plugin.metrics
        self._where = plugin.name
        password = plugin.secret.read(plugin.name) if plugin.secret is not None else None
        timeout, where = plugin.timeout_s, plugin.name
        self._page = HttpDevice(plugin.url, timeout=timeout, user=plugin.user, password=password, where=where)

    def families(self) -> list[Any]:
        """Return the metrics on the exporter's page; a `LinkError` says that it does not answer, or has none."""
        text = self._page.get(Accept=_TEXT_FORMAT).decode("utf-8", errors="replace")
        if text and not text.endswith("\n"):
            # The format requires a line feed after the last line; unchecked, half a number would be taken for one.
            fix = "Check whether the exporter was restarted, and that the address is its page, as a rule /metrics."
            raise LinkError(f"the page of {self._page.url} breaks off within a line", where=self._where, fix=fix)
        try:
            return list(self._families(text))
        except (ValueError, IndexError, KeyError) as error:
            problem = f"{self._page.url} shows no metrics that can be read: {error}"
            fix = "Name the exporter's page, which mostly ends in /metrics."
            raise LinkError(problem, where=self._where, fix=fix) from error

    def read(self) -> Scrape:
        samples = [sample for family in self.families() for sample in family.samples]
        scrape = tuple(_chosen(metric, samples) for metric in self._metrics)
        for metric, series in zip(self._metrics, scrape, strict=True):
            if not _numbers(series):
                what = "no number, but NaN or infinity, for" if series else "no"
                raise LinkError(f"the exporter shows {what} {metric.selector}", where=self._where)
        return scrape


def _chosen(metric: ScrapedMetric, samples: Iterable[Any]) -> Mapping[Labels, _Shown]:
    wanted = metric.labels.items()
    return {
        tuple(sorted(sample.labels.items())): _Shown(float(sample.value), sample.timestamp)
        for sample in samples
        if sample.name == metric.name and wanted <= sample.labels.items()
    }


def _numbers(series: Mapping[Labels, _Shown]) -> list[float]:
    """Return the finite values of the series: an exporter shows NaN for unknown values."""
    return [shown.value for shown in series.values() if math.isfinite(shown.value)]


def _number(scrape: Scrape, place: int, labels: Labels) -> float | None:
    shown = scrape[place].get(labels)
    return shown.value if shown is not None and math.isfinite(shown.value) else None


class Prometheus(PolledProfiler[Scrape]):
    """Measures metrics of a Prometheus exporter: the increase of counters over the mission, the mean of gauges.

    There are exporters for machines, GPUs, containers, supplies, weather and much more: node_exporter, DCGM, cAdvisor.

    Args:
        url: the exporter's page, such as `http://robot:9100/metrics`.
        metrics: from that page: `node_load1`, `node_cpu_seconds_total{mode="user"}`, or `ScrapedMetric(...)`.
        name: distinguishes several instances; None for the class's name.
        user: whose password it is, if the page needs one.
        password_env: the environment variable that holds the password.
        password_file: the file whose first line it is.
        rate_hz: scrapes a second, Hz.
        timeout_s: how long to wait for the page, s.

    Raises:
        PluginError: no metric is named, two would yield measures with the same name, or the address is invalid.

    Example:
        >>> [measure.unit for measure in Prometheus("http://robot:9100/metrics", ["node_hwmon_power_watt"]).measures]
        ['W']
    """

    needs: ClassVar[str] = "A Prometheus exporter that can be reached over HTTP, and robot-runner[prometheus]."
    bytes_per_run: int = 5_000  # a row a second of 50 bytes for a mission of 95 s

    def __init__(
        self,
        url: str,
        metrics: Sequence[str | ScrapedMetric],
        *,
        name: str | None = None,
        user: str = "",
        password_env: str | None = None,
        password_file: str | Path | None = None,
        rate_hz: float = 1.0,
        timeout_s: float = 2.0,
    ) -> None:
        super().__init__(name=name, rate_hz=rate_hz)
        check_list(self.name, metrics=metrics)
        if not metrics:
            fix = "Name what it shows: metrics=['node_load1']."
            raise PluginError(f"metrics is {metrics!r}", where=self.name, fix=fix)
        check_numbers(self.name, timeout_s=timeout_s)
        self.metrics = tuple(ScrapedMetric(selector=each) if isinstance(each, str) else each for each in metrics)
        for place, metric in enumerate(self.metrics):
            if not isinstance(metric, ScrapedMetric):
                fix = f"Give metrics[{place}] a text or a ScrapedMetric."
                raise PluginError(f"metrics[{place}] is {metric!r}", where=self.name, fix=fix)
        self.measures: Sequence[Measure] = tuple(metric.yields for metric in self.metrics)
        names = [measure.name for measure in self.measures]
        if len(set(names)) < len(names):
            twice = next(each for each in names if names.count(each) > 1)
            fix = "Name one otherwise: ScrapedMetric(selector=..., measure=Measure(...))."
            raise PluginError(f"two metrics would yield a measure {twice!r}", where=self.name, fix=fix)
        self.url = check_url(url, where=self.name)
        self.user = user
        self.secret = Secret.named(password_env, password_file, where=self.name)
        self.timeout_s = timeout_s

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return a claim of the exporter, and so of what it measures."""
        del robot
        return (f"device:{self.url}",)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: no library, no exporter, or a metric that it does not have."""
        del circumstances
        where = f"plugin {self.name}"
        try:
            families = _Exporter(self).families()
        except (LinkError, PluginError) as error:
            return [Finding.error(where, error.problem, error.fix)]
        return [finding for metric in self.metrics for finding in _metric_findings(where, metric, families)]

    def open(self, context: RobotRunnerContext) -> _Exporter:
        """Return the exporter after a scrape of all metrics; a `LinkError` or a `PluginError` says what is missing."""
        del context
        exporter = _Exporter(self)
        families = exporter.families()
        findings = (each for metric in self.metrics for each in _metric_findings(self.name, metric, families))
        for finding in filter(attrgetter("is_error"), findings):
            raise LinkError(finding.problem, where=self.name, fix=finding.fix)
        return exporter

    def columns(self, sampling: Sampling[Scrape]) -> Sequence[Column]:
        """Return each series as it was scraped; several series of a metric are numbered as in `quality.json`."""
        columns = []
        for place, measure in enumerate(self.measures):
            labels = _all_labels(sampling, place)
            for number, each in enumerate(labels):
                values = [_number(scrape, place, each) for scrape in sampling.readings]
                columns.append(Column(f"{measure.name}_{number}" if len(labels) > 1 else measure.name, values, "%.9g"))
        return columns

    def values(self, sampling: Sampling[Scrape]) -> Mapping[str, float | None]:
        """Return the increase of each counter, and the mean of each gauge."""
        value_of = {True: self._increase, False: self._mean}
        return {
            measure.name: value_of[metric.counts](sampling, place)
            for place, (metric, measure) in enumerate(zip(self.metrics, self.measures, strict=True))
        }

    def doubts(self, sampling: Sampling[Scrape]) -> Iterator[str]:
        """Yield doubts if a counter was reset, power changed much, or a series was rarely updated or partly missing."""
        yield from self._steps(sampling)
        sampling = sampling.within()
        for place, metric in enumerate(self.metrics):
            labels = _all_labels(sampling, place)
            series = [_series(sampling, place, each) for each in labels]
            if metric.counts and any(fall_count(each.values) for each in series):
                yield f"{metric.selector} was set back, as by a restart: what it counted shortly before that is lost"
            renewals = [every for each in labels if (every := _renewed_every(sampling, place, each, metric))]
            share = max(renewals, default=0.0) / (sampling.window.duration or 1.0)
            is_seldom = share > (_SELDOM_COUNTED if metric.counts else _SELDOM_GAUGED)
            if is_seldom and max(renewals) >= _SELDOM_SCRAPES / sampling.rate:
                off = f"its increase may be off by up to {100 * share:.0f} %"
                few = f"its mean is that of {max(1, round(1 / share))} values or so"
                yield f"{metric.selector} is renewed every {max(renewals):.0f} s only: {off if metric.counts else few}"
            if partial := sum(0 < len(each) < len(sampling.readings) for each in series):
                yield f"{partial} of {len(labels)} series of {metric.selector} were there for a part of the time only"
            if silent := sum(not len(each) for each in series):
                yield f"{silent} of {len(labels)} series of {metric.selector} showed no number, but NaN or infinity"

    def _steps(self, sampling: Sampling[Scrape]) -> Iterator[str]:
        """Yield a doubt about the mean of a power that changed so much between scrapes that it may be off."""
        for place, metric in enumerate(self.metrics):
            if metric.yields.unit.endswith("W") and not metric.counts:
                power = self._gauge(sampling, place)
                whole = abs(integrate(cut(power, sampling.window)) or math.inf)
                if (share := step_error(power, sampling.window) / whole) > OFF_SHARE:
                    apart = f"between scrapes that are {1 / sampling.rate:.1f} s apart"
                    yield f"{metric.selector} changed {apart}: its mean may be off by {100 * share:.0f} %"

    def details(self) -> Mapping[str, Any]:
        """Return the scraped metrics, and the labels of their series."""
        sampling = self._sampling
        series = [_all_labels(sampling, place) if sampling else [] for place in range(len(self.metrics))]
        shown = {metric.selector: list(map(dict, labels)) for metric, labels in zip(self.metrics, series, strict=True)}
        return {"url": self.url, "series": shown}

    def _increase(self, sampling: Sampling[Scrape], place: int) -> float | None:
        rises = []
        for labels in _all_labels(sampling, place):
            last = 0.0  # a series that appears later counts from 0, like a reset one; one that is gone counts no more
            numbers = (_number(scrape, place, labels) for scrape in sampling.readings)
            counts = [last := last if number is None else number for number in numbers]
            rises.append(growth(Series(sampling.times, unwrapped(counts)), sampling.window))
        known = [rise for rise in rises if rise is not None]
        return self.metrics[place].combined(known) if known else None

    def _mean(self, sampling: Sampling[Scrape], place: int) -> float | None:
        return mean(cut(self._gauge(sampling, place), sampling.window, reach=5 / self.rate_hz))

    def _gauge(self, sampling: Sampling[Scrape], place: int) -> Series:
        metric = self.metrics[place]
        return known_series(sampling, lambda scrape: metric.combined(_numbers(scrape[place])))


def _all_labels(sampling: Sampling[Scrape], place: int) -> list[Labels]:
    return sorted({labels for scrape in sampling.readings for labels in scrape[place]})


def _series(sampling: Sampling[Scrape], place: int, labels: Labels) -> Series:
    return known_series(sampling, lambda scrape: _number(scrape, place, labels))


def _renewed_every(sampling: Sampling[Scrape], place: int, labels: Labels, metric: ScrapedMetric) -> float | None:
    """Return the time between updates of a series, s, if these are rare; None for a counter of single events.

    Exporters such as DCGM's show values that were collected up to 30 s before by default; cAdvisor's adds their time.
    """
    shown = [each for scrape in sampling.readings if (each := scrape[place].get(labels))]
    if stamps := sorted({each.stamp for each in shown if each.stamp is not None}):
        return max((later - sooner for sooner, later in pairwise(stamps)), default=sampling.window.duration)
    series = _series(sampling, place, labels)
    steps = {later - sooner for sooner, later in pairwise(series.values) if later != sooner}
    has_decimals = metric.counts or any(value % 1 for value in series.values)
    is_restless = has_decimals and metric.yields.unit.endswith(_RESTLESS)
    return None if steps == {1} else renewed_every(series, is_restless=is_restless)


def _metric_findings(where: str, metric: ScrapedMetric, families: Sequence[Any]) -> Iterator[Finding]:
    """Yield errors for a metric that cannot be measured, and a warning for one whose unit is in its help alone.

    It may be missing, have other labels, several series, or be of another type.
    """
    samples = [sample for family in families for sample in family.samples]
    names = sorted({sample.name for sample in samples})
    if metric.name not in names:
        problem = f"the exporter shows no {metric.name!r}, of {len(names)} metrics"
        yield Finding.error(where, problem, did_you_mean(metric.name, names))
        return
    labels = [sample.labels for sample in samples if sample.name == metric.name]
    chosen = _chosen(metric, samples)
    buckets = {dict(each).get("le") for each in chosen} if metric.name.endswith(BUCKETS) else set()
    listed = ", ".join("{" + ",".join(f'{key}="{value}"' for key, value in each.items()) + "}" for each in labels[:8])
    if not chosen:
        yield Finding.error(where, f"no series of {metric.name} fits {metric.selector}", f"There are: {listed}.")
    elif not _numbers(chosen):
        fix = "Have the exporter see some of it first, or leave the metric out."
        yield Finding.error(where, f"{metric.selector} shows no number now, but {min(chosen.values()).value}", fix)
    elif len(buckets) > 1:
        fix = f"Choose one by its label `le`, or take {metric.name.removesuffix(BUCKETS)}_count. There are: {listed}."
        problem = f"{metric.selector} has {len(buckets)} buckets, each of which counts the smaller ones as well"
        yield Finding.error(where, problem, fix)
    elif len(chosen) > 1 and not metric.counts and metric.combine is None:
        fix = f"Choose one by its labels, or combine them: ScrapedMetric(..., combine='sum'). There are: {listed}."
        yield Finding.error(where, f"{metric.selector} has {len(chosen)} series", fix)
    family = next(each for each in families if any(sample.name == metric.name for sample in each.samples))
    if metric.yields.unit == "1" and _UNIT_IN_HELP.search(family.documentation):
        fix = f"Say so: ScrapedMetric(selector={metric.selector!r}, measure=Measure('Name', 'W', 'What it is.'))."
        problem = f"the unit of {metric.selector} is 1, as its name has none; its help is {family.documentation!r}"
        yield Finding.warning(where, problem, fix)
    told = family.type
    if told in {"counter", "gauge"} and (told == "counter") != metric.counts:
        fix = f"Say so: ScrapedMetric(selector={metric.selector!r}, is_counter={told == 'counter'})."
        yield Finding.error(where, f"the exporter declares that {metric.name} is a {told}", fix)
