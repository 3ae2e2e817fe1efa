"""Write configs of an earlier tool in our own spelling.

The earlier tools are Experiment Runner and the first versions of Robot Runner. The old files are not changed. The file
of a config's base class is converted with it. Each new config is loaded, and its run table is compared with the old
one's.

Exit code 0: both plan the same runs; 2: an old file is refused, or a new one has to be corrected by hand.
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
from robot_runner.core.storage.guarded_files import open_to_write
from robot_runner.core.words import counted
from robot_runner.legacy.conversion.bases import load_apart
from robot_runner.legacy.conversion.callbacks import NOTHING, is_told_as_of_codecarbon
from robot_runner.legacy.conversion.converting import Conversion, convert, new_file
from robot_runner.legacy.conversion.names import ONLY_FACTOR
from robot_runner.legacy.recognition import recognise
from robot_runner.legacy.stand_ins.events import do_nothing


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
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
    """Write the configs in our own spelling; a refused one does not stop the others."""
    old = list(dict.fromkeys(file for each in arguments.configs for file in _files_in(Path(each))))
    folder, name = _folder_and_name(arguments.out, arguments.configs)
    codes, refused, written = [0], {}, set[Path]()
    for file in old:
        new = (folder or file.parent) / (name or new_file(file, folder).name)
        try:
            codes.append(_convert(file, new, folder, written, overwrites=arguments.overwrite))
        except RobotRunnerError as error:
            refused[new] = error
    # A file that is not an experiment by itself may have been written as the base of another config.
    findings = [each for new, error in refused.items() if new not in written for each in error.findings]
    if findings:
        show_findings(findings)
    return REFUSED if findings else max(codes)


def _files_in(place: Path) -> list[Path]:
    """Return the file itself, or all configs of an earlier tool in a folder and its subfolders."""
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
    except RobotRunnerError:  # not a config, or an invalid one, whose error is shown if it is named
        return False
    return recognised is not None


def _folder_and_name(out: str | None, configs: list[str]) -> tuple[Path | None, str]:
    """Return the folder for all files, and the name of the file if one is given."""
    if out is None:
        return None, ""
    place = Path(out)
    is_one = len(configs) == 1 and not Path(configs[0]).is_dir()
    if place.is_dir() or out.endswith("/") or not (is_one or place.suffix == ".py"):
        place.mkdir(parents=True, exist_ok=True)
        return place, ""
    if place.suffix != ".py":
        fix = f"Name it {place.name}.py; a folder, {place.name}/."
        raise UsageError("a config is a Python file", where=str(place), fix=fix)
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
            # A base that this call has written must not differ; an earlier one is kept.
            stale += _write_base(base, text, kept, may_differ=base not in written)
        written |= set(conversion.bases)
        findings = (*stale, *check_conversion(conversion, new))
    console = output()
    if any(finding.is_error for finding in findings):
        show_findings(findings)
        console.tell(f"{shown_path(new)} is written, and has to be corrected by hand.")
        return REFUSED
    print_findings(console, (*conversion.findings, *findings))
    runs = counted(len(conversion.before.model.plan()), "run")
    console.tell(f"{shown_path(new)} is written: it plans the same {runs}.")
    name = conversion.before.parameters.experiment_name
    # With the old name, earlier results would refuse the changed config.
    beside = ("--set", f"experiment_name={name}_2") if conversion.before.folder.manifest.is_file() else ()
    print_facts(
        console,
        [
            ("Derives from", ", ".join(map(shown_path, conversion.bases))),
            ("Beside it", ", ".join(conversion.beside)),
            ("Check", command_line("check", str(new), *beside)),
            ("Execute", command_line(str(new), *beside)),
        ],
    )
    return 0


def _write(file: Path, text: str, kept: Collection[Path] | None, *, instead: str) -> None:
    """Write a file, unless it exists with this text.

    Files in `kept` are not overwritten; None keeps all files.

    Raises:
        StorageError: another file is there and is kept, or the file cannot be written.
    """
    if file.is_file():
        if file.read_text(encoding="utf-8", errors="replace") == text:
            return
        if kept is not None and file.resolve() not in kept:
            with open_to_write(file, mode=0o666) as written:
                written.write(text.encode())
            return
    write_new_file(file, text, instead=instead)


def _write_base(base: Path, text: str, kept: Collection[Path] | None, *, may_differ: bool) -> Iterator[Finding]:
    """Write the file of a config's base class; yields a warning if another file is there and is kept."""
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
        yield Finding.warning(str(base), problem, "Convert with --overwrite, to write it again.")


#: The treatments of a run by factor, as texts.
Run = tuple[tuple[str, str], ...]


def _differences(before: Experiment, after: Experiment) -> Iterator[Finding]:
    """Yield findings on differences between two run tables; ids are not compared, as each tool has its own."""
    old, new = _runs(before), _runs(after)
    if not before.model.factors and [factor.name for factor in after.model.factors] == [ONLY_FACTOR]:
        old = [((ONLY_FACTOR, str(after.model.factors[0].treatments[0])),)] * len(old)
        problem = f"nothing is varied, so there is a factor {ONLY_FACTOR!r} with one treatment"
        yield Finding.warning("run table", problem, "Name what you will compare it with.")
    for more, fewer, change in ((old, new, "less"), (new, old, "more")):
        for run, count in (Counter(more) - Counter(fewer)).items():
            shown = ", ".join(f"{name}={value}" for name, value in run)
            problem = f"{shown} is planned {count} times {change} than before"
            yield Finding.error("run table", problem, "Correct it by hand.")
    if Counter(old) == Counter(new) and old != new and not (before.model.shuffle or after.model.shuffle):
        yield Finding.error("run table", "the order of the runs is another", "Correct it by hand.")
    if before.model.shuffle and before.model.seed_is_given and old != new:
        seed = before.model.seed
        fix = (
            f"Write RunTableModel(..., seed={seed}) for an order that comes again each time; it is another one than "
            "before."
        )
        yield Finding.warning("run table", f"random.seed({seed}) does not decide the order of the runs any more", fix)
    names = after.columns.names
    lost = {name for name in before.columns.names if name not in names and not is_told_as_of_codecarbon(name, names)}
    if lost:
        fix = "Add it to data_columns, unless a plugin has it under another name."
        yield Finding.warning("run table", f"there is no column {', '.join(map(repr, sorted(lost)))} any more", fix)


def _runs(experiment: Experiment) -> list[Run]:
    return [tuple((name, str(value)) for name, value in run.combination.items()) for run in experiment.model.plan()]


def check_conversion(conversion: Conversion, written: Path) -> tuple[Finding, ...]:
    """Load the written file, and compare its run table and callbacks with those of the original."""
    with load_apart():
        preparation = prepare(written, is_for_here=False)
    if preparation.experiment is None:
        return tuple(_left_behind(conversion, written)) or preparation.findings
    before, after = conversion.before, preparation.experiment
    return (*_differences(before, after), *_heard_otherwise(before, after))


def _left_behind(conversion: Conversion, written: Path) -> Iterator[Finding]:
    """Yield findings on modules that the old file imports from its folder, and that are missing beside the new file."""
    old, new = conversion.before.config_path.parent, written.resolve().parent
    kept = [
        each for each in conversion.before.local_modules if old in each.parents and each not in conversion.originals
    ]
    for name in dict.fromkeys(each.relative_to(old).parts[0] for each in kept):
        if not (new / name).exists():
            problem = f"it imports {name}, which stands beside the old file and not beside this one"
            fix = f"Copy {old / name} to {new}, or convert beside the old file: leave --out out."
            yield Finding.error(str(written), problem, fix)


def _heard_otherwise(before: Experiment, after: Experiment) -> Iterator[Finding]:
    """Yield findings on events whose number of callbacks of the config has changed."""
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
            yield Finding.error(event.callback_name, problem, "Correct it by hand.")
