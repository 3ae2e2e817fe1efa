"""Whether a converted config plans the runs of the one that it is from, and hears the same events."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import Finding
from robot_runner.core.events.manager import RobotRunnerEvents
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.words import counted
from robot_runner.legacy.conversion.bases import load_apart
from robot_runner.legacy.conversion.callbacks import NOTHING
from robot_runner.legacy.conversion.names import ONLY_FACTOR
from robot_runner.legacy.stand_ins.events import do_nothing

if TYPE_CHECKING:
    from robot_runner.core.config.experiment import Experiment
    from robot_runner.legacy.conversion.converting import Conversion

#: The treatments of a run by factor, as texts.
Run = tuple[tuple[str, str], ...]


def _differences(before: Experiment, after: Experiment) -> Iterator[Finding]:
    """Yield what the run table of one config has and that of the other lacks; ids are each tool's own."""
    old, new = _runs(before), _runs(after)
    if not before.model.factors and [factor.name for factor in after.model.factors] == [ONLY_FACTOR]:
        old = [((ONLY_FACTOR, str(after.model.factors[0].treatments[0])),)] * len(old)
        yield Finding.warning(
            "run table",
            f"nothing is varied, so there is a factor {ONLY_FACTOR!r} with one treatment",
            "Name what you will compare it with.",
        )
    for more, fewer, change in ((old, new, "less"), (new, old, "more")):
        for run, count in (Counter(more) - Counter(fewer)).items():
            shown = ", ".join(f"{name}={value}" for name, value in run)
            yield Finding.error(
                "run table", f"{shown} is planned {count} times {change} than before", "Mend it by hand."
            )
    is_random = before.model.shuffle or after.model.shuffle
    if Counter(old) == Counter(new) and old != new and not is_random:
        yield Finding.error("run table", "the order of the runs is another", "Mend it by hand.")
    lost = set(before.columns.names) - set(after.columns.names)
    if lost:
        yield Finding.warning(
            "run table",
            f"there is no column {', '.join(map(repr, sorted(lost)))} any more",
            "Add it to data_columns, unless a plugin has it under another name.",
        )


def _runs(experiment: Experiment) -> list[Run]:
    return [tuple((name, str(value)) for name, value in run.combination.items()) for run in experiment.model.plan()]


def check_conversion(conversion: Conversion, written: Path) -> tuple[Finding, ...]:
    """Load the file that was written, and compare its run table and callbacks with those of the file it is from."""
    with load_apart():
        preparation = prepare(written, is_for_here=False)
    if preparation.experiment is None:
        return tuple(_left_behind(conversion, written)) or preparation.findings
    before, after = conversion.before, preparation.experiment
    return (*_differences(before, after), *_heard_otherwise(before, after))


def _left_behind(conversion: Conversion, written: Path) -> Iterator[Finding]:
    """Yield what the old file imports from beside it and what does not stand beside the new one."""
    old, new = conversion.before.config_path.parent, written.resolve().parent
    kept = [
        each for each in conversion.before.local_modules if old in each.parents and each not in conversion.originals
    ]
    for name in dict.fromkeys(each.relative_to(old).parts[0] for each in kept):
        if not (new / name).exists():
            yield Finding.error(
                str(written),
                f"it imports {name}, which stands beside the old file and not beside this one",
                f"Copy {old / name} to {new}, or convert beside the old file: leave --out out.",
            )


def _heard_otherwise(before: Experiment, after: Experiment) -> Iterator[Finding]:
    """Yield the events that have more callbacks of the config than before, or fewer."""
    with before.config.executing_nothing() as session:
        subscribed = [
            each for each in session.subscriptions if getattr(each.callback, "__func__", None) is not do_nothing
        ]
    old = Counter(each.event for each in subscribed)
    for event in RobotRunnerEvents:
        heard = [each.callback for each in after.events.subscribers(event) if each.owner == CONFIG_OWNER]
        new = sum(callback.__doc__ != NOTHING for callback in heard)
        is_added = event is RobotRunnerEvents.BEFORE_EXPERIMENT and RobotRunnerEvents.CONTINUE in old
        if new != old[event] and not (is_added and new > old[event]):
            problem = f"the config has {counted(new, 'callback')} of this event now, and had {old[event]} before"
            yield Finding.error(event.callback_name, problem, "Mend it by hand.")
