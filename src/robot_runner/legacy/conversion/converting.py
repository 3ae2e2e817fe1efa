"""Convert the text of a config file of an earlier tool to our own spelling."""

from __future__ import annotations

import ast
import shlex
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.config.source import CONFIG_CLASS, read_source, read_tree
from robot_runner.core.errors import ConfigError, Finding
from robot_runner.core.words import listed
from robot_runner.legacy.config_checks import check_waiting
from robot_runner.legacy.conversion.bases import (
    BaseFile,
    Inherited,
    base_files,
    convert_base_imports,
    earlier_import_in,
    imported_files,
    load_apart,
    name_whole_modules,
)
from robot_runner.legacy.conversion.callbacks import (
    convert_continue,
    convert_decorators,
    convert_lists_of_callbacks,
    convert_rows_of_before_run,
    leave_unheard,
    named_callbacks,
    order_findings,
    remove_subscriptions,
    taken_over,
    write_values_as_text,
)
from robot_runner.legacy.conversion.contexts import convert_contexts
from robot_runner.legacy.conversion.earlier_imports import ConvertedFile, convert_imports, convert_names, modules_beside
from robot_runner.legacy.conversion.names import (
    convert_parameters,
    convert_run_tables,
    leave_out_treatments,
    own_members,
    rename_clashing,
)
from robot_runner.legacy.earlier_experiment import EarlierExperiment
from robot_runner.legacy.recognition import Recognised, recognise
from robot_runner.legacy.session import Session, active_session
from robot_runner.legacy.syntax import Edits, classes_of, nodes


def check_neighbours(experiment: Experiment, tree: ast.Module, written: Collection[str | Path]) -> Iterator[Finding]:
    """Yield an error for each imported module that uses the earlier tool itself, and so must be converted first.

    Those in `written`, files or their names, are converted with the config.
    """
    modules = {*experiment.local_modules, *imported_files(tree)}
    for module in sorted(each for each in modules if not {each, each.name} & set(written)):
        found = earlier_import_in(module)
        if found is not None:
            problem = f"the config imports this module, which imports {found.module} of the earlier tool"
            fix = "Write this line with robot_runner, or put what is needed into the config."
            yield Finding.error(f"{module}:{found.line}", problem, fix)


@dataclass(frozen=True, slots=True)
class Conversion:
    """A config file in our own spelling.

    Attributes:
        text: the text of the new file.
        before: the experiment of the original file.
        findings: for the user to check.
        beside: the texts of imported modules to write beside it, by the names of their files.
        bases: the texts of the files of its base classes, by the paths to write.
        originals: the original files, which are never overwritten.
    """

    text: str
    before: Experiment
    findings: tuple[Finding, ...]
    beside: Mapping[str, str]
    bases: Mapping[Path, str]
    originals: frozenset[Path]


def convert(path: Path, folder: Path | None = None, name: str = "") -> Conversion:
    """Convert a config file of an earlier tool, and the files of its base classes.

    Args:
        path: the file.
        folder: the folder for all new files; if left out, each is beside its original.
        name: the name of the converted file in this folder.

    Raises:
        ConfigError: the file is not such a config, cannot be loaded, or uses something without a counterpart here.
    """
    recognised = recognise(path)
    if recognised is None:
        read_source(path)  # refuses a file that is not a config
        fix = f"Execute it: robot-runner {shlex.quote(str(path))}"
        raise ConfigError("the config is written in our own spelling already", where=str(path), fix=fix)
    with load_apart():
        experiment = prepare_or_refuse(path, is_for_here=False)
        return _Chain(recognised, experiment, folder, name or path.name).converted()


def new_file(original: Path, folder: Path | None) -> Path:
    """Return the path of a converted file: in the folder, or beside its original with another name."""
    if folder is not None and (folder / original.name).resolve() != original.resolve():
        return folder / original.name
    return original.with_name(f"{original.stem}_converted.py")


class _Chain:
    """A config and the files of its base classes, the farthest first: each gets names from those before it."""

    def __init__(self, recognised: Recognised, experiment: Experiment, folder: Path | None, name: str) -> None:
        self._recognised = recognised
        self._experiment = experiment
        self._folder = folder
        self._taken = {name}
        self._parts: dict[Path, Inherited] = {}
        self._texts: dict[Path, str] = {}
        self._findings: list[Finding] = []
        self._beside: dict[str, str] = {}

    def converted(self) -> Conversion:
        """Convert all files.

        Raises:
            ConfigError: a file uses something without a counterpart here.
        """
        dialect = self._recognised.dialect
        with self._experiment.config.executing_nothing() as session:
            config_class = session.config_class
            waiting = check_waiting(session, self._experiment.parameters.operation_type)
            findings = [*order_findings(session), *_left_out(session), *waiting]
        bases = base_files(self._recognised.path, config_class)
        for file, base_class in bases.items():
            text, tree = read_tree(file)
            name_whole_modules(tree, base_class)
            self._convert_base(Recognised(dialect, file, text, tree), base_class, set(bases))
        text = self._convert(self._recognised, config_class, self._experiment, set(bases)).text
        ConfigError.refuse(finding for finding in self._findings if finding.is_error)
        said = tuple(dict.fromkeys([*self._findings, *findings]))
        originals = frozenset({self._recognised.path, *bases})
        return Conversion(text, self._experiment, said, self._beside, self._texts, originals)

    def _convert_base(self, recognised: Recognised, base_class: type, bases: set[Path]) -> None:
        file = recognised.path
        new = new_file(file, self._folder)
        if self._folder is not None and self._folder.resolve() == self._recognised.path.parent.resolve():
            # Another name, so that the old config still imports the old file.
            new = self._folder / f"{file.stem}_converted.py"
        while new.name in self._taken and self._folder is not None:
            new = new.with_name(f"{new.stem}_base.py")
        self._taken.add(new.name)
        converting = self._convert(recognised, base_class, self._by_itself(file), bases)
        gained = self._inherited(file, base_class).gained_by(recognised.tree)
        base = BaseFile(new, self._folder is None, converting.classes(), gained)
        self._parts[file] = Inherited.of_base(file, base, converting.config, converting.members)
        self._texts[new] = converting.text

    def _convert(
        self, recognised: Recognised, config_class: type, experiment: Experiment, bases: set[Path]
    ) -> _Converting:
        inherited = self._inherited(recognised.path, config_class)
        with experiment.config.executing_nothing() as session:
            converting = _Converting(recognised, config_class.__name__, session, experiment, inherited)
            converting.convert()
        self._beside |= converting.file.beside | modules_beside(recognised.path, imported_files(recognised.tree))
        self._findings += converting.file.findings
        self._findings += check_neighbours(self._experiment, recognised.tree, {*self._beside, *bases})
        return converting

    def _inherited(self, file: Path, config_class: type) -> Inherited:
        return Inherited.together(self._parts[base] for base in base_files(file, config_class))

    def _by_itself(self, base: Path) -> Experiment:
        """Return the experiment of a base file; that of the derived config if the base has none or no subscriptions.

        So the converted base is the same, whichever config it is converted with.
        """
        experiment = prepare(base, is_for_here=False).experiment
        if experiment is None or not isinstance(experiment.config, EarlierExperiment):
            return self._experiment
        with experiment.config.executing_nothing() as session:
            return experiment if session.subscriptions else self._experiment


class _Converting:
    """The conversion of one file.

    Attributes:
        file: the converted file.
        config: its original config class.
        class_name: the new name of the class.
        members: the new names of its methods.
        text: the new text, once it is converted.
    """

    def __init__(
        self, recognised: Recognised, class_name: str, session: Session, experiment: Experiment, inherited: Inherited
    ) -> None:
        self._session = session
        self._experiment = experiment
        self._inherited = inherited
        self._tree = recognised.tree
        self._edits = Edits(recognised.text)
        self.text = ""
        self.file = ConvertedFile(recognised.path, recognised.tree, self._edits)
        config = classes_of(self._tree).get(class_name)
        if config is None:
            fix = "Convert the file that has it."
            raise ConfigError(f"the class {class_name} is not in this file", where=str(recognised.path), fix=fix)
        self.config = config
        self.class_name = CONFIG_CLASS if class_name == recognised.dialect.class_name else class_name
        self._callbacks = named_callbacks(session, config, inherited)
        self._own = own_members(config)
        self.members = self._own | self._callbacks.renamed | {"create_run_table_model": "create_run_table"}

    def classes(self) -> dict[str, str]:
        """Return the new names of the file's config classes, its own and imported ones."""
        imported = {name: self.file.names.get(name, name) for name in self.file.classes if name.isidentifier()}
        return imported | {self.config.name: self.class_name}

    def convert(self) -> None:
        config, callbacks = self.config, self._callbacks
        convert_decorators(self.file, config, self._experiment.columns.names)
        lines = [*convert_imports(self.file), *convert_base_imports(self.file, self._inherited)]
        self.file.findings += rename_clashing(self._session, self.file)
        self.file.findings += leave_out_treatments(self._session, self.file, config)
        where = f"{self.file.path}:{config.lineno}"
        self.file.findings += taken_over(where, config, callbacks, self._inherited)
        if self._own:
            told = listed([f"{name} (now {now})" for name, now in self._own.items()])
            problem = f"what the config calls {told} is called otherwise: to Robot Runner these names mean something"
            fix = "Use the new names where other modules ask the config for them."
            self.file.findings.append(Finding.warning(where, problem, fix))
        self._rename_class(config)
        if callbacks.is_by_name:
            gone = {id(node) for each in remove_subscriptions(config, self._edits) for node in ast.walk(each)}
            left = {self.file.names.get(node.id) for node in nodes(self._tree, ast.Name) if id(node) not in gone}
            self.file.ours -= {"EventSubscriptionController", "RobotRunnerEvents"} - left
        convert_rows_of_before_run(config, self._session, self._edits)
        write_values_as_text(config, self._session, self._edits)
        convert_continue(config, callbacks, self._inherited, self._edits)
        leave_unheard(config, callbacks, self._inherited, self._edits)
        self.file.findings += convert_contexts(self.file, self._session, self._experiment.columns.names)
        self._rename_members(config)
        convert_run_tables(self._session, self.file)
        convert_names(self.file)
        convert_lists_of_callbacks(config, self._edits)
        convert_parameters(config, self._experiment.parameters.results_output_path, self._own, self._edits)
        self.text = self.file.text_with_imports(lines)

    def _rename_class(self, config: ast.ClassDef) -> None:
        start = self._edits.find("class", self._edits.line_start(config.lineno))
        arguments = [*config.bases, *config.keywords]
        header_end = self._edits.find(":", max([start, *(self._edits.end_of(each) for each in arguments)]))
        parents = [self.file.names.get(each, each) for each in map(self._edits.edited, arguments)]
        parents = [each for each in parents if each != "ExperimentConfig"]
        if not self._inherited.files:  # else the base files derive from it
            parents.insert(0, "ExperimentConfig")
            self.file.ours.add("ExperimentConfig")
        self._edits.replace_span(start, header_end, f"class {self.class_name}({', '.join(parents)})")
        self.file.names[config.name] = self.class_name

    def _rename_members(self, config: ast.ClassDef) -> None:
        names = {**self.members, "name": "experiment_name"}
        for node in config.body:
            if isinstance(node, ast.FunctionDef) and node.name in self.members:
                start = self._edits.find(node.name, self._edits.line_start(node.lineno))
                self._edits.replace_span(start, start + len(node.name.encode()), names[node.name])
        owners = self._owners(config)
        for member in nodes(config, ast.Attribute):
            is_super = isinstance(member.value, ast.Call) and ast.unparse(member.value.func) == "super"
            if member.attr in names and (is_super or ast.unparse(member.value) in owners):
                end = self._edits.end_of(member.value)
                self._edits.replace_span(end, self._edits.end_of(member), f".{names[member.attr]}")

    def _owners(self, config: ast.ClassDef) -> set[str]:
        """Return the names of objects and classes that have the members of the class and its bases."""
        owners = {"self", "cls", config.name, *self.file.classes}
        for node in self._tree.body:
            match node:
                case ast.Assign(targets=[ast.Name(id=name)], value=value) if ast.unparse(value) in owners:
                    owners.add(name)
        return owners


def _left_out(session: Session) -> Iterator[Finding]:
    with active_session(session):
        if any(node.id == "self_measure" for node in nodes(session.recognised.tree, ast.Name)):
            fix = "List EnergiBridge() in `plugins` (robot_runner.plugins.profilers)."
            yield Finding.warning(session.path.name, "self_measure means nothing here", fix)
