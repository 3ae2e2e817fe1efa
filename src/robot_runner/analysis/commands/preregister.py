"""Write down what is fixed before the first run: design, order, seed, plan of the analysis, power; with a checksum.

The report cites the checksum and lists every deviation. Where the config gives no seed, one is drawn and registered,
and the experiment uses it. With --check, say how a config differs from a registration (exit code 1 where it does).
Nothing is sent anywhere.
"""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robot_runner.analysis.plan_file import choices_in_words
from robot_runner.analysis.wording import shown_level
from robot_runner.cli.console import (
    UserConsole,
    output,
    print_facts,
    print_folded,
    print_json,
    quiet_loading,
    shown_path,
)
from robot_runner.cli.parser import Parser, UsageError, add_config, add_json, add_set
from robot_runner.core.config.dialects import load_config
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.config.preparation import prepare
from robot_runner.core.config.registered_config import registration_content, registration_path
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.columns import REPETITION
from robot_runner.core.errors import ConfigError, StorageError
from robot_runner.core.storage.journal import utc_now
from robot_runner.core.storage.registration import (
    Registration,
    differences,
    read_registration,
    repeated_in_words,
    write_registration,
)
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.words import INACTIVE, counted, listed, one_line

#: The exit code where a config differs from its registration.
_DIFFERS = 1


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_config(parser)
    add_set(parser)
    parser.add_argument("--power", metavar="FILE", help="register this power.json, which `power --output` has written")
    parser.add_argument("--check", metavar="FILE", help="compare the config with this registration, and write nothing")
    parser.add_argument("--replace", action="store_true", help="register again; the file says which one it replaces")
    parser.add_argument(
        "--output", metavar="FILE", help="where to write it; else where the config's `registration` says, or beside it"
    )
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Write the registration, or compare with one."""
    with quiet_loading():
        path, content, experiment = _content(arguments)
    if arguments.check is not None:
        return _check(arguments, read_registration(Path(arguments.check).expanduser()), content)
    _refuse_begun(experiment)
    target = Path(arguments.output).expanduser() if arguments.output else path
    replaced = _replaced(target, is_asked=arguments.replace)
    power = _power(arguments.power, content)
    # The date comes first, for human readers.
    made = write_registration(
        target, {"registered_at": utc_now(), **content, "power": power, **({"replaces": replaced} if replaced else {})}
    )
    if arguments.json:
        print_json(dict(made.content))
        return 0
    _print(output(), made, target, is_found=target.resolve() == path.resolve())
    return 0


def _content(arguments: Namespace) -> tuple[Path, dict[str, Any], Experiment]:
    """Return the path of a config's registration, its content, and the experiment."""
    loaded = load_config(Path(arguments.config), parse_assignments(arguments.set))
    preparation = prepare(loaded.source.path, loaded.overrides, lambda _path, _overrides: loaded, is_for_here=False)
    experiment = preparation.experiment
    if experiment is None:
        raise ConfigError.of_findings(preparation.findings)
    parameters = experiment.parameters
    content = registration_content(loaded, experiment.model, parameters, experiment.columns)
    return registration_path(loaded), content, experiment


def _refuse_begun(experiment: Experiment) -> None:
    if experiment.folder.manifest.exists():
        problem = f"the experiment has begun: its runs are in {shown_path(experiment.folder.root)}"
        fix = "Register before the first run; for a new study choose another experiment_name."
        raise StorageError(problem, where=str(experiment.config_path), fix=fix)


def _replaced(target: Path, *, is_asked: bool) -> dict[str, Any] | None:
    """Return the date and digest of the registration that is replaced; None where there is none."""
    if not target.exists():
        return None
    earlier = read_registration(target)
    if not is_asked:
        problem = f"the study was registered on {earlier.registered_at[:10]}"
        fix = f"Compare with it (--check {shown_path(target)}), or register again: --replace."
        raise StorageError(problem, where=str(target), fix=fix)
    return {"registered_at": earlier.registered_at, "sha256": earlier.sha256}


def _power(path: str | None, content: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the power that was computed for this study.

    Raises:
        UsageError: the file is not of this study.
        StorageError: the file cannot be read.
    """
    if path is None:
        return None
    where = f"--power {path}"
    try:
        power = json.loads(Path(path).expanduser().read_text(encoding="utf-8"))
    except OSError as error:
        raise storage_error(Path(path), "read", error) from error
    except ValueError as error:
        raise UsageError(f"the file cannot be read: {error}", where=where, fix=_POWER_FIX) from error
    if not isinstance(power, dict) or not isinstance(power.get("scenarios"), list) or "answers" not in power:
        raise UsageError("this is not a file of `robot-runner power`", where=where, fix=_POWER_FIX)
    design = content["design"]
    factors = {name: texts for name, texts in design["factors"].items() if not _counts(name)}
    plan = json.loads(json.dumps(content["analysis"]))
    if plan is not None:
        plan["blocks"] = _blocks(plan["blocks"])
    for what, then, now in (
        ("names of the experiment", power.get("experiment"), content["experiment"]),
        ("the factors", power.get("columns"), factors),
        ("the blocks", power.get("blocks"), _blocks(design["blocks"])),
        ("choices of the analysis plan", power.get("analysis"), plan),
    ):
        if then != now:
            raise UsageError(f"{what} differ from those that the power was computed for", where=where, fix=_POWER_FIX)
    return power


def _blocks(name: str | None) -> str | None:
    """Return the name of the blocks in `power`: blocks of a factor that only counts are the repetitions."""
    return REPETITION if name is not None and _counts(name) else name


def _counts(factor: str) -> bool:
    """Return whether a factor only counts repetitions, as in the paper's Listing 1."""
    return factor.casefold() == REPETITION.casefold()


_POWER_FIX = "Compute it: robot-runner power CONFIG ... --output FOLDER; the file is FOLDER/power.json."


def _check(arguments: Namespace, found: Registration, content: Mapping[str, Any]) -> int:
    if not found.is_intact:
        problem = "the registration was changed after it was made: its checksum is not that of its content"
        fix = "Restore the file from where it was deposited."
        raise StorageError(problem, where=str(arguments.check), fix=fix)
    plain = json.loads(json.dumps(dict(content)))
    if not plain["seed_is_given"] and not found.content.get("seed_is_given"):
        plain["seed"] = found.seed  # drawn: the experiment takes the registered one
    differing = list(differences(found.content, plain))
    told = found.content["config"]
    files = {told.get("file"): told.get("sha256"), **(told.get("modules") or {})}
    now = {plain["config"]["file"]: plain["config"]["sha256"], **plain["config"]["modules"]}
    changed = sorted(str(name) for name in {*files, *now} if files.get(name) != now.get(name))
    if arguments.json:
        print_json({**found.facts(), "differences": differing, "changed_files": changed})
        return _DIFFERS if differing else 0
    console = output()
    for each in differing:
        print_folded(console, "  ! ", one_line(each), style="bold yellow")
    print_facts(
        console,
        [
            ("Registered", f"{found.registered_at}, SHA-256 {found.sha256}"),
            ("Differences", f"{len(differing)}" if differing else "none in design, seed, plan and measures"),
            ("Changed files", listed(changed)),
        ],
    )
    return _DIFFERS if differing else 0


def _print(console: UserConsole, made: Registration, target: Path, *, is_found: bool) -> None:
    print_facts(console, [(what, one_line(told)) for what, told in _text(made.content)])
    print_facts(console, [("SHA-256", made.sha256), ("Written", shown_path(target.resolve()))])
    if not is_found:
        told = "The config does not name this file: write registration = ... into it, or the report will not cite it."
        print_folded(console, "  ! ", told, style="yellow")
    if made.content["analysis"] is None:
        told = "The config has no analysis plan: write analysis = AnalysisPlan(...) to fix measures and tests."
        print_folded(console, "  ! ", told, style="yellow")
    for told in _too_few(made.content):
        print_folded(console, "  ! ", told, style="yellow")
    told = "Deposit the file where it gets a date that is not yours (osf.io, zenodo.org), before the first run."
    print_folded(console, "  ", told, style="")


def _too_few(content: Mapping[str, Any]) -> Iterator[str]:
    """Yield each scenario that needs more repetitions than the config plans."""
    design = content["design"]
    counted_by = (len(texts) for name, texts in design["factors"].items() if _counts(name))
    planned = next(counted_by, design["repetitions"])
    for scenario in (content["power"] or {}).get("scenarios", ()):
        needed = (scenario.get("needed") or {}).get("repetitions")
        if needed is not None and planned < needed:
            asked = shown_level(content["power"]["power"])
            yield f"The config plans {counted(planned, 'repetition')}; at {scenario['title']} {asked} take {needed}."


def _treatments(texts: Sequence[str], unit: str) -> str:
    """Return treatments in words, as in `720, 1080 px; where it applies`."""
    active = [each for each in texts if each != str(INACTIVE)]
    told = f"{', '.join(active)} {unit}".rstrip()
    return told if len(active) == len(texts) else f"{told}; where it applies"


def _text(content: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the facts of a registration in words, with their labels."""
    design, plan = content["design"], content["analysis"]
    yield "Experiment", f"{content['experiment']} ({content['config']['file']})"
    units = design.get("units") or {}
    factors = " x ".join(
        f"{name} ({_treatments(texts, units.get(name, ''))})" for name, texts in design["factors"].items()
    )
    left_out = f", less {counted(len(design['excluded']), 'combination')}" if design.get("excluded") else ""
    if "parameters" in design:
        kind = str(design["parameters"]["kind"]).replace("_", " ")
        left_out = f", {counted(len(design['combinations']), 'combination')} of a {kind} design"
    warm_up = ", those that only warm up among them" if design.get("warm_up") else ""
    runs = f"{counted(design['repetitions'], 'repetition')}, {counted(design['runs'], 'run')}{warm_up}"
    yield "Design", f"{factors}{left_out}; {runs}"
    blocks = f" within blocks of {design['blocks']}" if design["blocks"] else ""
    yield "Decided", str((design.get("facts") or {}).get("decides", ""))
    yield "Repeated", repeated_in_words(content["repeat_until"]) if content.get("repeat_until") else ""
    whence = "given by the config" if content["seed_is_given"] else "drawn now, and used by the experiment"
    order = f"randomised{blocks} from seed {content['seed']} ({whence})"
    yield "Order", order if design["shuffle"] else f"as written{blocks}"
    yield "Measures", listed(each["name"] for each in content["measures"])
    if plan is not None:
        yield "Primary", listed(plan["measures"])
        yield "Secondary", listed(plan["secondary"])
        yield "Test", f"{plan['estimand']}, {plan['statistic']}, alpha {plan['alpha']:g}, {plan['correction']}"
        units = {each["name"]: each.get("unit", "") for each in content["measures"]}
        for each in choices_in_words(AnalysisPlan.of_mapping(plan), lambda name: units.get(name, "")):
            yield "Values", each
        for each in plan["hypotheses"]:
            yield "Hypothesis", each["statement"]
    power = content["power"]
    yield "Power", " ".join(power["answers"]) if power is not None else "no power analysis was registered"
