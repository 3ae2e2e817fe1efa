"""From the text of a config file of an earlier tool to that of one of ours."""

from __future__ import annotations

import ast
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.core.config.dialects import prepare
from robot_runner.core.config.source import CONFIG_CLASS
from robot_runner.core.errors import ConfigError, Finding
from robot_runner.legacy.conversion.callbacks import (
    convert_contexts,
    convert_continue,
    convert_decorators,
    convert_lists_of_callbacks,
    convert_rows_of_before_run,
    named_callbacks,
    order_findings,
    remove_subscriptions,
)
from robot_runner.legacy.conversion.clashing_names import rename_clashing
from robot_runner.legacy.conversion.names import (
    ONLY_FACTOR,
    ConvertedImports,
    convert_imports,
    convert_parameters,
    convert_run_tables,
)
from robot_runner.legacy.recognition import Recognised, is_earlier_import, recognise
from robot_runner.legacy.session import active_session
from robot_runner.legacy.syntax import Edits, attributes_of, classes_of, imports_of, nodes

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.legacy.earlier_experiment import EarlierExperiment
    from robot_runner.legacy.session import Session

__all__ = ["Conversion", "check_conversion", "check_neighbours", "convert", "differences"]


#: The events that have another name here.
_RENAMED_EVENTS = {
    "INTERACT": "LAUNCH_MISSION",
    "DURING_RUN": "LAUNCH_MISSION",
    "SIGNAL_SEMI_CONTINUE": "CONTINUE",
    "VALIDATE_EXPERIMENT": "BEFORE_EXPERIMENT",
}
_INSTALLED = frozenset({"dist-packages", "site-packages"})

#: The treatments of a run by factor, as texts.
Run = tuple[tuple[str, str], ...]


def differences(before: Experiment, after: Experiment) -> Iterator[Finding]:
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


def check_neighbours(experiment: Experiment, tree: ast.Module, written: Collection[str]) -> Iterator[Finding]:
    """Yield which modules that the config imports are written for the earlier tool themselves: they come first.

    Args:
        experiment: of the config.
        tree: of the config.
        written: the names of the files that are converted with it.
    """
    modules = {*experiment.local_modules, *_imported_files(tree)}
    for module in sorted(each for each in modules if each.name not in written):
        for each in imports_of(ast.parse(module.read_text(encoding="utf-8"))):
            if is_earlier_import(each.module):
                yield Finding.error(
                    f"{module}:{each.line}",
                    f"the config imports this module, which imports {each.module} of the earlier tool",
                    "Write this line with robot_runner, or put what is needed into the config.",
                )
                break


def _imported_files(tree: ast.Module) -> Iterator[Path]:
    """Yield the files of what a config imports, wherever it put their folder on the path itself."""
    for each in imports_of(tree):
        file = Path(getattr(sys.modules.get(each.module), "__file__", None) or "")
        is_installed = each.module.partition(".")[0] in sys.stdlib_module_names or _INSTALLED & set(file.parts)
        if file.suffix == ".py" and not is_installed:
            yield file


@dataclass(frozen=True, slots=True)
class Conversion:
    """A config file in our own spelling.

    Attributes:
        text: the file.
        before: the experiment of the file that was converted.
        findings: what a user should look at.
        beside: the texts of modules that the file imports and that are to stand beside it, by their files' names.
    """

    text: str
    before: Experiment
    findings: tuple[Finding, ...]
    beside: Mapping[str, str]


def convert(path: Path) -> Conversion:
    """Convert a config file of an earlier tool.

    Raises:
        ConfigError: the file is none, cannot be loaded, or uses what has no counterpart here.
    """
    recognised = recognise(path)
    if recognised is None:
        raise ConfigError(
            "the config is written in our own spelling already", where=str(path), fix=f"Execute it: robot-runner {path}"
        )
    preparation = prepare(path, is_for_here=False)
    experiment = preparation.experiment
    if experiment is None:
        raise ConfigError.of_findings(preparation.findings)
    config: EarlierExperiment = experiment.config
    with config.executing_nothing() as session:
        converting = _Converting(recognised, session, experiment)
        text = converting.text()
    refused = [*converting.imports.findings, *check_neighbours(experiment, recognised.tree, converting.imports.beside)]
    if any(finding.is_error for finding in refused):
        raise ConfigError.of_findings([finding for finding in refused if finding.is_error])
    findings = (*refused, *order_findings(session), *_left_out(session))
    return Conversion(text, experiment, findings, converting.imports.beside)


def check_conversion(conversion: Conversion, written: Path) -> tuple[Finding, ...]:
    """Load the file that was written, and compare its run table with that of the file it is from."""
    preparation = prepare(written, is_for_here=False)
    if preparation.experiment is None:
        return preparation.findings
    return tuple(differences(conversion.before, preparation.experiment))


class _Converting:
    def __init__(self, recognised: Recognised, session: Session, experiment: Experiment) -> None:
        self._recognised = recognised
        self._session = session
        self._experiment = experiment
        self._tree = recognised.tree
        self._edits = Edits(recognised.text)
        self.imports = ConvertedImports()

    def text(self) -> str:
        """Return the converted text."""
        config = classes_of(self._tree).get(self._recognised.dialect.class_name)
        if config is None:
            raise ConfigError(
                f"the class {self._recognised.dialect.class_name} is not in this file",
                where=str(self._recognised.path),
                fix="Convert the file that has it.",
            )
        convert_decorators(f"{self._recognised.path}:{config.lineno}", self._tree, config, self.imports, self._edits)
        convert_imports(self._recognised.path, self._tree, self.imports, self._edits)
        methods = {node.name for node in config.body if isinstance(node, ast.FunctionDef)}
        callbacks = named_callbacks(self._session, methods)
        self.imports.findings += rename_clashing(self._session, self._tree, self.imports, self._edits)
        self._rename_class(config)
        if callbacks.is_by_name:
            remove_subscriptions(config, self._edits)
            self.imports.ours -= {"EventSubscriptionController", "RobotRunnerEvents"}
        convert_rows_of_before_run(config, self._session, self._edits)
        convert_continue(config, callbacks, self._edits)
        convert_contexts(self._tree, self._edits, self._experiment.columns.names)
        self._rename_members(config, callbacks.renamed | {"create_run_table_model": "create_run_table"})
        convert_run_tables(self._session, self._tree, self.imports, self._edits)
        self._convert_names()
        convert_lists_of_callbacks(config, self._edits)
        convert_parameters(config, self._experiment.parameters.results_output_path, self._edits)
        self._put_imports()
        return self._edits.applied()

    def _rename_class(self, config: ast.ClassDef) -> None:
        start = self._edits.find("class", self._edits.line_start(config.lineno))
        header_end = self._edits.find(":", max([start, *(self._edits.end_of(base) for base in config.bases)]))
        own = [self._edits.source(base) for base in config.bases]
        bases = [base for base in own if self.imports.names.get(base) != "ExperimentConfig"]
        self._edits.replace_span(start, header_end, f"class {CONFIG_CLASS}({', '.join(['ExperimentConfig', *bases])})")
        self.imports.ours.add("ExperimentConfig")
        self.imports.names[self._recognised.dialect.class_name] = CONFIG_CLASS

    def _rename_members(self, config: ast.ClassDef, renamed: dict[str, str]) -> None:
        for node in config.body:
            if isinstance(node, ast.FunctionDef) and node.name in renamed:
                start = self._edits.find(node.name, self._edits.line_start(node.lineno))
                self._edits.replace_span(start, start + len(node.name.encode()), renamed[node.name])
        names = {**renamed, "name": "experiment_name"}
        for owner, member in attributes_of(config, {"self", "cls", "RunnerConfig"}):
            if member.attr in names:
                self._edits.replace_span(
                    self._edits.end_of(owner), self._edits.end_of(member), f".{names[member.attr]}"
                )

    def _convert_names(self) -> None:
        for call in nodes(self._tree, ast.Call):
            match call.func:
                case ast.Attribute(value=ast.Name(id=name), attr=called) if (
                    name in self.imports.outputs and called.startswith("console_log") and call.args
                ):
                    end = self._edits.end_of(call.args[0])
                    self._edits.replace_span(self._edits.start_of(call), self._edits.start_of(call.args[0]), "print(")
                    self._edits.replace_span(end, self._edits.end_of(call), ")")
                case _:
                    pass
        for _, event in attributes_of(self._tree, self.imports.events):
            if event.attr in _RENAMED_EVENTS:
                self._edits.replace(event, f"RobotRunnerEvents.{_RENAMED_EVENTS[event.attr]}")
        for node in nodes(self._tree, ast.Name):
            if self.imports.names.get(node.id, node.id) != node.id:
                self._edits.replace(node, self.imports.names[node.id])

    def _put_imports(self) -> None:
        lines = [each.line for each in imports_of(self._tree) if is_earlier_import(each.module)]
        first = min(lines, default=1)
        self._edits.insert(self._edits.line_start(first), self.imports.lines())


def _left_out(session: Session) -> Iterator[Finding]:
    with active_session(session):
        if any(node.id == "self_measure" for node in nodes(session.recognised.tree, ast.Name)):
            yield Finding.warning(
                session.path.name,
                "self_measure means nothing here",
                "List EnergiBridge() in `plugins` (robot_runner.plugins.profilers).",
            )
