"""From the text of a config file of an earlier tool to that of one of ours."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.config.source import CONFIG_CLASS
from robot_runner.dialects.conversion.callbacks import (
    convert_continue,
    convert_lists_of_callbacks,
    convert_rows_of_before_run,
    named_callbacks,
    order_findings,
    remove_subscriptions,
)
from robot_runner.dialects.conversion.comparison import differences
from robot_runner.dialects.conversion.contexts import convert_contexts
from robot_runner.dialects.conversion.decorators import convert_decorators
from robot_runner.dialects.conversion.edits import Edits
from robot_runner.dialects.conversion.imports import ConvertedImports, convert_imports
from robot_runner.dialects.conversion.neighbours import check_neighbours
from robot_runner.dialects.conversion.parameters import convert_parameters
from robot_runner.dialects.conversion.run_tables import convert_run_tables
from robot_runner.dialects.preparation import prepare
from robot_runner.dialects.recognition import Recognised, is_earlier_import, recognise
from robot_runner.dialects.session import active_session
from robot_runner.dialects.syntax import classes_of, imports_of
from robot_runner.errors import ConfigError, Finding

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner.config.experiment import Experiment
    from robot_runner.dialects.experiment import EarlierExperiment
    from robot_runner.dialects.session import Session

__all__ = ["Conversion", "check_conversion", "convert"]


@dataclass(frozen=True, slots=True)
class Conversion:
    """A config file in our own spelling.

    Attributes:
        text: the file.
        before: the experiment of the file that was converted.
        findings: what a user should look at.
    """

    text: str
    before: Experiment
    findings: tuple[Finding, ...]


def convert(path: Path) -> Conversion:
    """Convert a config file of an earlier tool.

    Raises:
        ConfigError: it is none, cannot be loaded, or uses what has no counterpart here.
    """
    recognised = recognise(path)
    if recognised is None:
        raise ConfigError(
            "it is written in our own spelling already", where=str(path), fix=f"Execute it: robot-runner {path}"
        )
    preparation = prepare(path, is_for_here=False)
    experiment = preparation.experiment
    if experiment is None:
        raise ConfigError.of_findings(preparation.findings)
    config: EarlierExperiment = experiment.config
    with config.executing_nothing() as session:
        converting = _Converting(recognised, session, experiment)
        text = converting.text()
    refused = [*converting.imports.findings, *check_neighbours(experiment, recognised.tree)]
    if any(finding.is_error for finding in refused):
        raise ConfigError.of_findings([finding for finding in refused if finding.is_error])
    return Conversion(text, experiment, (*refused, *order_findings(session), *_left_out(session)))


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
                f"its class {self._recognised.dialect.class_name} is not in this file",
                where=str(self._recognised.path),
                fix="Convert the file that has it.",
            )
        convert_decorators(f"{self._recognised.path}:{config.lineno}", self._tree, config, self.imports, self._edits)
        convert_imports(self._recognised.path, self._tree, self.imports, self._edits)
        methods = {node.name for node in config.body if isinstance(node, ast.FunctionDef)}
        callbacks = named_callbacks(self._session, methods)
        self._rename_class(config)
        if callbacks.is_by_name:
            remove_subscriptions(config, self._edits)
            self.imports.ours -= {"EventSubscriptionController", "RobotRunnerEvents"}
        convert_rows_of_before_run(config, self._session, self._edits)
        convert_continue(config, callbacks, self._edits)
        functions = [node for node in ast.walk(self._tree) if isinstance(node, ast.FunctionDef)]
        convert_contexts(functions, self._edits, self._experiment.columns.names)
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
        for reference in ast.walk(config):
            match reference:
                case ast.Attribute(value=ast.Name(id="self" | "cls" | "RunnerConfig"), attr=name) if name in names:
                    owner = self._edits.end_of(reference.value)
                    self._edits.replace_span(owner, self._edits.end_of(reference), f".{names[name]}")
                case _:
                    pass

    def _convert_names(self) -> None:
        for node in ast.walk(self._tree):
            match node:
                case ast.Call(func=ast.Attribute(value=ast.Name(id=name), attr=called)) if (
                    name in self.imports.outputs and called.startswith("console_log") and node.args
                ):
                    end = self._edits.end_of(node.args[0])
                    self._edits.replace_span(self._edits.start_of(node), self._edits.start_of(node.args[0]), "print(")
                    self._edits.replace_span(end, self._edits.end_of(node), ")")
                case ast.Attribute(value=ast.Name(id=name), attr="INTERACT" | "DURING_RUN") if (
                    name in self.imports.events
                ):
                    self._edits.replace(node, "RobotRunnerEvents.LAUNCH_MISSION")
                case ast.Attribute(value=ast.Name(id=name), attr="SIGNAL_SEMI_CONTINUE") if name in self.imports.events:
                    self._edits.replace(node, "RobotRunnerEvents.CONTINUE")
                case ast.Name(id=name) if self.imports.names.get(name, name) != name:
                    self._edits.replace(node, self.imports.names[name])
                case _:
                    pass

    def _put_imports(self) -> None:
        lines = [each.line for each in imports_of(self._tree) if is_earlier_import(each.module)]
        first = min(lines, default=1)
        self._edits.insert(self._edits.line_start(first), self.imports.lines())


def _left_out(session: Session) -> Iterator[Finding]:
    with active_session(session):
        if any(isinstance(node, ast.Name) and node.id == "self_measure" for node in ast.walk(session.recognised.tree)):
            yield Finding.warning(
                session.path.name,
                "self_measure means nothing here",
                "List EnergiBridge() in `plugins` (robot_runner.plugins.profilers).",
            )
