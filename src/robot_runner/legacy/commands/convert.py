"""Write configs of an earlier tool in our own spelling.

The earlier tools are Experiment Runner and the first versions of Robot Runner. The old files stay as they are. A file
whose class a config derives from is converted with it. Each new config is loaded, and its run table compared with that
of the old one.

Exit code 0: both plan the same runs; 2: an old file is refused, or a new one has to be mended by hand.
"""

from __future__ import annotations

from argparse import Namespace
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path

from robot_runner.cli.console import command_line, output, print_facts, quiet_loading, shown_path
from robot_runner.cli.findings import print_findings, show_findings
from robot_runner.cli.guard import REFUSED
from robot_runner.cli.parser import Parser, UsageError
from robot_runner.cli.templating import write_new_file
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import Finding, RobotRunnerError, StorageError
from robot_runner.core.events.manager import RobotRunnerEvents
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.words import counted
from robot_runner.legacy.conversion.bases import load_apart
from robot_runner.legacy.conversion.callbacks import NOTHING, is_told_as_of_codecarbon
from robot_runner.legacy.conversion.converting import Conversion, convert, new_file
from robot_runner.legacy.conversion.names import ONLY_FACTOR
from robot_runner.legacy.recognition import recognise
from robot_runner.legacy.stand_ins.events import do_nothing


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    parser.add_argument(
        "configs", metavar="CONFIG", nargs="+", help="a config of an earlier tool, or a folder: all that are in it"
    )
    parser.add_argument(
        "--out",
        metavar="PLACE",
        help="the file to write, or the folder for all of them (each beside the old one, with _converted in its name, "
        "if left out)",
    )
    parser.add_argument("--overwrite", action="store_true", help="write over files that are there already")


def execute(arguments: Namespace) -> int:
    """Write the configs in our own spelling; one that is refused does not keep the others from it."""
    old = list(dict.fromkeys(file for each in arguments.configs for file in _files_in(Path(each))))
    folder, name = _folder_and_name(arguments.out, arguments.configs)
    codes, refused, written = [0], {}, set[Path]()
    for file in old:
        new = (folder or file.parent) / (name or new_file(file, folder).name)
        try:
            codes.append(_convert(file, new, folder, written, overwrites=arguments.overwrite))
        except RobotRunnerError as error:
            refused[new] = error
    # What is no experiment by itself is written where another config derives from it.
    findings = [each for new, error in refused.items() if new not in written for each in error.findings]
    if findings:
        show_findings(findings)
    return REFUSED if findings else max(codes)


def _files_in(place: Path) -> list[Path]:
    """Return a file itself, and of a folder the configs in it and below it that are an earlier tool's."""
    if not place.is_dir():
        return [place]
    files = [file for file in sorted(place.rglob("*.py")) if _is_earlier(file)]
    if not files:
        fix = "Name the folder that has them, or one of the files."
        raise UsageError("the folder has no config of an earlier tool", where=str(place), fix=fix)
    return files


def _is_earlier(file: Path) -> bool:
    try:
        recognised = recognise(file)
    except RobotRunnerError:  # not a config, or one that says why when it is named
        return False
    return recognised is not None


def _folder_and_name(out: str | None, configs: list[str]) -> tuple[Path | None, str]:
    """Return the folder for everything, and the file's name where one is named."""
    if out is None:
        return None, ""
    place = Path(out)
    is_one = len(configs) == 1 and not Path(configs[0]).is_dir()
    if place.is_dir() or out.endswith("/") or not (is_one or place.suffix == ".py"):
        place.mkdir(parents=True, exist_ok=True)
        return place, ""
    if place.suffix != ".py":
        raise UsageError(
            "a config is a Python file", where=str(place), fix=f"Name it {place.name}.py; a folder, {place.name}/."
        )
    if not is_one:
        raise UsageError("several configs cannot become one file", where=str(place), fix="Name a folder: --out FOLDER")
    return place.parent, place.name


def _convert(old: Path, new: Path, folder: Path | None, written: set[Path], *, overwrites: bool) -> int:
    with quiet_loading():
        conversion = convert(old, folder, new.name)
        kept = conversion.originals if overwrites else None
        _write(new, conversion.text, kept, instead="Choose another name: --out NAME.py")
        for name, text in conversion.beside.items():
            _write(new.with_name(name), text, kept, instead="Convert into a folder of its own: --out FOLDER/NAME.py")
        stale: list[Finding] = []
        for base, text in conversion.bases.items():
            # One that another config of this call has brought may not differ; one from before is kept.
            stale += _write_base(base, text, kept, may_differ=base not in written)
        written |= set(conversion.bases)
        findings = (*stale, *check_conversion(conversion, new))
    console = output()
    if any(finding.is_error for finding in findings):
        show_findings(findings)
        console.tell(f"{shown_path(new)} is written, and has to be mended by hand.")
        return REFUSED
    print_findings(console, (*conversion.findings, *findings))
    runs = counted(len(conversion.before.model.plan()), "run")
    console.tell(f"{shown_path(new)} is written: it plans the same {runs}.")
    name = conversion.before.parameters.experiment_name
    # Its own results would be refused for each line that is another now.
    beside = ("--set", f"experiment_name={name}_2") if conversion.before.folder.manifest.is_file() else ()
    print_facts(
        console,
        [
            ("Derives from", ", ".join(map(shown_path, conversion.bases))),
            ("Beside it", ", ".join(conversion.beside)),
            ("Check", command_line("check", str(new))),
            ("Execute", command_line(str(new), *beside)),
        ],
    )
    return 0


def _write(file: Path, text: str, kept: Collection[Path] | None, *, instead: str) -> None:
    """Write a file; nothing is done where it is there as it would be written.

    Files that are `kept` are not written over; None is for all of them.

    Raises:
        StorageError: another one is there and is kept, or it cannot be written.
    """
    if file.is_file():
        if file.read_text(encoding="utf-8", errors="replace") == text:
            return
        if kept is not None and file.resolve() not in kept:
            file.unlink()
    write_new_file(file, text, instead=instead)


def _write_base(base: Path, text: str, kept: Collection[Path] | None, *, may_differ: bool) -> Iterator[Finding]:
    """Write the file of a class that a config derives from; yields a warning where another one is there and is kept."""
    instead = "Convert the configs into folders of their own: --out FOLDER"
    try:
        _write(base, text, kept if may_differ else None, instead=instead)
    except StorageError:
        if not (may_differ and base.is_file()):
            raise
        problem = (
            "the config derives from a class in this file, which is there already and is kept, though it would be "
            "written in another way"
        )
        yield Finding.warning(str(base), problem, "Convert with --overwrite, to write it anew.")


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
    names = after.columns.names
    lost = {name for name in before.columns.names if name not in names and not is_told_as_of_codecarbon(name, names)}
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
