"""Threats to validity from changes between runs on the computers of an experiment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from glob import escape
from typing import Any

from robot_runner.analysis.report.blocks import Tone
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.sample_files import noted_number, notes_of
from robot_runner.analysis.wording import listed
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.events.measure import Origin
from robot_runner.core.storage.executed_runs import done_before
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import host_in_words
from robot_runner.core.words import counted, enumerated

#: The profiler whose files are read, by the class name in the manifest.
_WATCH = ":MachineWatch"
#: Smallest reported differences between runs: of the mean frequency, as a share, and of the temperature, degC.
_FREQUENCY, _TEMPERATURE = 0.1, 10.0
_GIGA, _DEGREES = 1e9, "\N{DEGREE SIGN}C"


def read_machines(material: Material) -> dict[str, dict[str, Mapping[str, Any]]]:
    """Return the notes on each computer in each run that is done, by host and by run."""
    watches = [
        str(plugin.get("name"))
        for plugin in material.manifest("plugins", default=[])
        if str(plugin.get("class", "")).endswith(_WATCH)
    ]
    folder = ExperimentFolder(material.results.folder)
    found: dict[str, dict[str, Mapping[str, Any]]] = {}
    for name in watches:
        for run_id, _, facts in notes_of(folder, material.done[RUN_ID], f"{escape(name)}/*.json"):
            if isinstance(facts, dict):
                found.setdefault(str(facts.get("host")), {})[str(run_id)] = facts
    return found


def machine_threats(material: Material) -> Iterator[tuple[str, str, Tone]]:
    """Yield runs of unknown computers, and settings of one that differed between runs or were not controlled."""
    before = done_before(material.results.manifest, material.executed)
    if elsewhere := [run for run in material.done[RUN_ID] if run in before]:
        text = (
            f"The run table had {counted(len(elsewhere), 'run')} as done before the experiment began here "
            f"({listed(elsewhere)}): where and by what is not known, and their values count as all others do."
        )
        yield "Runs were executed elsewhere", text, Tone.WARNING
    yield from _hardware(material)
    for host, runs in read_machines(material).items():
        whose = "this machine" if host == "localhost" else host
        yield from _governor(whose, runs)
        yield from _frequency(whose, runs)
        yield from _temperature(whose, runs)


def machines_of_runs(material: Material) -> dict[str, list[str]]:
    """Return the runs that are done by what the machine is that executed them, in words; empty without a cluster."""
    attempts = material.results.attempts.attrs
    if not attempts["machines"]:
        return {}
    here = host_in_words(material.manifest("host", default={}))
    found: dict[str, list[str]] = {}
    for run in material.done[RUN_ID].astype("str"):
        machine = attempts["machines"].get(run, "" if run in attempts["workers"] else here)
        if machine:
            found.setdefault(machine, []).append(run)
    return found


def _machines_in_words(material: Material) -> str:
    """Return the machines of `machines_of_runs`, and how many runs each kind executed."""
    found = machines_of_runs(material).items()
    return listed((f"{machine} ({counted(len(runs), 'run')})" for machine, runs in found), shown=8)


def described_workers(material: Material) -> Iterator[tuple[str, str]]:
    """Yield what executed the runs of a cluster, each a heading and a text; nothing without one."""
    if workers := material.results.attempts.attrs["workers"]:
        names = listed(sorted(set(workers.values())))
        machines = _machines_in_words(material)
        whose = ": " if machines else ", whose machines are not recorded: "
        executed = f"{counted(len(workers), 'run')} on workers of a cluster{whose}{names}"
        yield "Machine", f"described here is the one that directed {executed}"
        if machines:
            yield "Executed on", machines


def _hardware(material: Material) -> Iterator[tuple[str, str, Tone]]:
    """Yield that runs were executed on machines that differ, and whether these go with a factor or the blocks."""
    found = machines_of_runs(material)
    if len(found) < 2:  # noqa: PLR2004 - one kind is no difference
        return
    text, title = f"{_machines_in_words(material)}.", "Runs were executed on machines that differ"
    if goes_with := _goes_with(material, found):
        also = f"It goes with {goes_with}: their effects cannot be told apart, unless {goes_with} is about the machine."
        if goes_with == material.statistics.design.block:
            also = f"It goes with the blocks ({goes_with}), which take its effect out."
        yield title, f"{text} {also}", Tone.NOTE
    elif measured := [name for name in material.results.measures if _is_measured(material, name)]:
        also = (
            f"Energy, time and load of the same program differ by it, and no factor or block tells it: look at "
            f"{listed(measured)}. Have one kind of machine execute all runs, or make it a factor (a claim that its "
            "workers offer)."
        )
        yield title, f"{text} {also}", Tone.WARNING
    else:
        yield title, f"{text} No measure comes from a sensor there.", Tone.NOTE


def _goes_with(material: Material, found: Mapping[str, Sequence[str]]) -> str:
    """Return the blocks' column, or a factor, each of whose values had machines of one kind; empty if none had.

    Where each run has a value of its own, as in a design that fills a space, that tells nothing.
    """
    machines = {run: machine for machine, runs in found.items() for run in runs}
    known = material.done[material.done[RUN_ID].isin(machines)]
    at, design = known[RUN_ID].astype("str").map(machines), material.statistics.design
    columns = [name for name in (design.block, *design.factors) if name is not None]
    by_value = {each: at.groupby(known[each].astype("str")) for each in columns}
    return next((each for each, of in by_value.items() if of.nunique().max() == 1 < of.size().max()), "")


def _is_measured(material: Material, name: str) -> bool:
    return Origin.MEASURED.value in str(material.results.columns[name].origin).split(", ")


def _governor(whose: str, runs: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str, Tone]]:
    settings: dict[tuple[str, str], list[str]] = {}
    for run, facts in runs.items():
        governors, turbo = facts.get("governors"), facts.get("turbo")
        governor = enumerated(map(str, governors)) if isinstance(governors, list) and governors else ""
        settings.setdefault((governor, {True: "on", False: "off"}.get(turbo, "")), []).append(run)  # type: ignore[arg-type]
    if len(settings) > 1:
        texts = [f"{_setting(*setting)} in {listed(members)}" for setting, members in settings.items()]
        yield f"The processor of {whose} was set up differently", f"{'; '.join(texts)}.", Tone.WARNING
        return
    for governor, turbo in settings:
        if turbo == "on" or governor not in {"", "performance"}:
            text = (
                f"The frequency of the processor depended on {_setting(governor, turbo)}: energy and time of the same "
                "program differ by temperature and by what ran before. `Tune` fixes the frequency."
            )
            yield f"The frequency of {whose} was not fixed", text, Tone.NOTE


def _setting(governor: str, turbo: str) -> str:
    parts = [f"the governor {governor}" if governor else "", f"turbo {turbo}" if turbo else ""]
    return ", ".join(filter(None, parts)) or "settings that are not known"


def _frequency(whose: str, runs: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str, Tone]]:
    means = {run: mean for run, mean in _means(runs, "frequency_hz").items() if mean}
    if len(means) > 1 and max(means.values()) > (1 + _FREQUENCY) * min(means.values()):
        slowest, fastest = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
        text = (
            f"The cores ran at {means[slowest] / _GIGA:.2f} GHz on average in {slowest}, and at "
            f"{means[fastest] / _GIGA:.2f} GHz in {fastest}."
        )
        yield f"The frequency of {whose} differs between runs", text, Tone.WARNING


def _temperature(whose: str, runs: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str, Tone]]:
    means = _means(runs, "temperature_degc")
    if len(means) > 1 and max(means.values()) - min(means.values()) >= _TEMPERATURE:
        coolest, hottest = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
        text = (
            f"The processor was at {means[coolest]:.0f} {_DEGREES} in {coolest}, and at {means[hottest]:.0f} "
            f"{_DEGREES} in {hottest}: a hot processor draws more power for the same work. Let it rest between runs, "
            "or warm it up."
        )
        yield f"The temperature of {whose} differs between runs", text, Tone.NOTE


def _means(runs: Mapping[str, Mapping[str, Any]], name: str) -> dict[str, float]:
    spreads = {run: spread for run, facts in runs.items() if isinstance(spread := facts.get(name), dict)}
    return {run: mean for run, spread in spreads.items() if (mean := noted_number(spread.get("mean"))) is not None}
