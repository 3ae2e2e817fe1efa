"""The adapter of a config of an earlier tool: the config object for executing, planning and checking."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import lru_cache
from typing import Any, TextIO

from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import ConfigError
from robot_runner.core.events.context import ExperimentContext, RobotRunnerContext
from robot_runner.core.events.manager import RobotRunnerEvents, place_of
from robot_runner.core.late_annotations import signature_of
from robot_runner.core.plugin import Plugin
from robot_runner.core.storage.layout import ExperimentFolder, LazyLog
from robot_runner.legacy.recognition import Dialect
from robot_runner.legacy.run_data import WatchedRow, as_mapping, planned_of, publish_row, unwatched
from robot_runner.legacy.run_tables import EarlierDesign, value_of
from robot_runner.legacy.session import Session, active_session
from robot_runner.legacy.stand_ins.events import EarlierContext
from robot_runner.legacy.stand_ins.machinery import RunProgress
from robot_runner.legacy.stand_ins.models import MISSING
from robot_runner.legacy.stand_ins.modules import StandIns

#: Events whose callbacks the earlier tools called without a context.
WITHOUT_CONTEXT = frozenset(
    {
        RobotRunnerEvents.BEFORE_EXPERIMENT,
        RobotRunnerEvents.BEFORE_RUN,
        RobotRunnerEvents.CONTINUE,
        RobotRunnerEvents.AFTER_EXPERIMENT,
    }
)
#: Names of the only parameter of `before_run` in a fork that passes the row of the table.
ROW_NAMES = frozenset({"row", "run", "run_variation", "variation"})


def call(callback: Callable[..., Any], event: RobotRunnerEvents, context: EarlierContext | None) -> Any:
    """Call a callback with the arguments that it takes: none, the context, or (as in some forks) the table's row."""
    for arguments in _offers(callback, event, context):
        if _takes(callback, len(arguments)):
            return callback(*arguments)
    raise _unfit(callback, event)


def check_callback(callback: Callable[..., Any], event: RobotRunnerEvents) -> None:
    """Check the signature of a callback.

    Raises:
        ConfigError: the callback can be called neither without arguments nor with a context.
    """
    most = 2 if event is RobotRunnerEvents.LAUNCH_MISSION else 1
    # All counts are tried, to fill the cache: forked runs inherit it.
    fits = [_takes(callback, count) for count in range(most + 1)]
    if not any(fits):
        raise _unfit(callback, event)


def _offers(
    callback: Callable[..., Any], event: RobotRunnerEvents, context: EarlierContext | None
) -> Sequence[tuple[Any, ...]]:
    given = context.run_variation if context is not None and _wants_row(callback, event) else context
    if event is RobotRunnerEvents.LAUNCH_MISSION:
        return ((given,), (), (given, _Signal()))  # the first version of Robot Runner also passed a signal
    return ((), (given,)) if event in WITHOUT_CONTEXT else ((given,), ())


class _Signal:
    """A signal that callbacks set in the first version of Robot Runner to complete the run; it has no effect here."""

    def set(self) -> None:
        """Do nothing."""

    def is_set(self) -> bool:
        return False


@lru_cache(maxsize=256)
def _wants_row(callback: Callable[..., Any], event: RobotRunnerEvents) -> bool:
    if event is not RobotRunnerEvents.BEFORE_RUN:
        return False
    try:
        names = list(signature_of(callback).parameters)
    except (TypeError, ValueError):
        return False
    return bool(names) and names[0] in ROW_NAMES


@lru_cache(maxsize=256)
def _takes(callback: Callable[..., Any], count: int) -> bool:
    try:
        signature_of(callback).bind(*(object(),) * count)
    except TypeError:
        return False
    except ValueError:  # a function in C without a signature
        return True
    return True


def _unfit(callback: Callable[..., Any], event: RobotRunnerEvents) -> ConfigError:
    name = getattr(callback, "__name__", repr(callback))
    signature = "self" if event in WITHOUT_CONTEXT else "self, context"
    problem = f"{name}{signature_of(callback)} cannot be called at {event.name}"
    return ConfigError(problem, where=place_of(callback), fix=f"Write def {name}({signature}).")


@contextmanager
def printed_to_log(folder: ExperimentFolder) -> Iterator[None]:
    """Write the output of `before_run` to the log of its run, which has no process yet; the user sees prompts."""
    terminal, keyboard = sys.stdout, sys.stdin
    with _Said(folder) as said:
        sys.stdin = _Asking(keyboard, said, terminal)
        try:
            with redirect_stdout(said), redirect_stderr(said):
                yield
        finally:
            sys.stdin = keyboard


class _Said(LazyLog):
    """The run's log, which keeps the text that the user has not seen."""

    def __init__(self, folder: ExperimentFolder) -> None:
        super().__init__(folder)
        self.unseen: list[str] = []

    def write(self, text: str) -> int:
        self.unseen.append(text)
        return super().write(text)


class _Asking(io.TextIOBase):
    """Standard input; before it is read, it shows the latest output to the user, as that may be the prompt."""

    def __init__(self, keyboard: Any, said: _Said, terminal: TextIO) -> None:
        self._keyboard = keyboard
        self._said = said
        self._terminal = terminal

    def readable(self) -> bool:
        return True

    def readline(self, size: int | None = -1, /) -> str:  # type: ignore[override] # a text stream's own
        self._show()
        return str(self._keyboard.readline(-1 if size is None else size))

    def read(self, size: int | None = -1, /) -> str:
        self._show()
        return str(self._keyboard.read(-1 if size is None else size))

    def fileno(self) -> int:
        return int(self._keyboard.fileno())

    def isatty(self) -> bool:
        return bool(self._keyboard.isatty())

    def _show(self) -> None:
        self._terminal.write("".join(self._said.unseen))
        self._terminal.flush()
        self._said.unseen.clear()


class EarlierExperiment:
    """Calls the subscribed callbacks of the earlier config at our events; its attributes are static parameters.

    While a callback is executed, the modules of the earlier tools can be imported.
    """

    def __init__(
        self,
        session: Session,
        stand_ins: StandIns,
        parameters: Mapping[str, Any],
        design: EarlierDesign | ConfigError,
        plugins: list[Plugin],
    ) -> None:
        self._session = session
        self._stand_ins = stand_ins
        self._design = design
        self._context: EarlierContext | None = None
        self._returned: list[Any] = []
        self._is_measured = False
        vars(self).update(parameters)
        self.plugins = plugins

    def create_run_table(self) -> RunTableModel:
        """Return the design of the config's run table.

        Raises:
            ConfigError: the config failed to make it.
        """
        return self._made.model

    def before_experiment(self, context: ExperimentContext) -> bool:
        """Call the callbacks of BEFORE_EXPERIMENT. Returns True: the first run starts by itself, as before."""
        del context
        self._emit(RobotRunnerEvents.BEFORE_EXPERIMENT)
        return True

    def before_run(self, context: RobotRunnerContext) -> None:
        """Call the callbacks of BEFORE_RUN; what they print goes to the run's log."""
        self._context = None
        self._returned, self._is_measured = [], False
        with printed_to_log(ExperimentFolder(context.experiment_folder)):
            self._emit(RobotRunnerEvents.BEFORE_RUN, context)

    def start_run(self, context: RobotRunnerContext) -> None:
        """Call the callbacks of START_RUN."""
        self._emit(RobotRunnerEvents.START_RUN, context)

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Call the callbacks of START_MEASUREMENT."""
        self._emit(RobotRunnerEvents.START_MEASUREMENT, context)

    def launch_mission(self, context: RobotRunnerContext) -> None:
        """Call the callbacks of LAUNCH_MISSION, which is INTERACT in Experiment Runner."""
        self._emit(RobotRunnerEvents.LAUNCH_MISSION, context)
        self._is_measured = True

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """Call the callbacks of STOP_MEASUREMENT."""
        was_measured, self._is_measured = self._is_measured, False
        self._emit(RobotRunnerEvents.STOP_MEASUREMENT, context)
        self._is_measured = was_measured

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Call the callbacks of STOP_RUN; Robot Runner called POPULATE_RUN_DATA before STOP_RUN."""
        try:
            if self._session.recognised.dialect is Dialect.ROBOT_RUNNER and self._is_measured:
                self._returned = self._emit(RobotRunnerEvents.POPULATE_RUN_DATA, context)
        finally:
            self._emit(RobotRunnerEvents.STOP_RUN, context)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Call the callbacks of POPULATE_RUN_DATA, and publish the values that they returned or wrote into the row."""
        if self._session.recognised.dialect is not Dialect.ROBOT_RUNNER:
            self._returned = self._emit(RobotRunnerEvents.POPULATE_RUN_DATA, context)
        row = unwatched(self._earlier_context(context).run_variation)
        for returned in self._returned:
            row |= as_mapping(returned)
        publish_row(context, self._made, row, self._session.estimated)

    def continue_experiment(self, context: RobotRunnerContext) -> bool:
        """Call the callbacks of CONTINUE, which wait for the user. Returns whether there are any."""
        return bool(self._emit(RobotRunnerEvents.CONTINUE, context))

    def after_experiment(self, context: ExperimentContext) -> None:
        """Call the callbacks of AFTER_EXPERIMENT."""
        del context
        self._emit(RobotRunnerEvents.AFTER_EXPERIMENT)

    @contextmanager
    def executing_nothing(self) -> Iterator[Session]:
        """Make the modules of the earlier tools importable without executing a run; yields the session."""
        with self._executing(None):
            yield self._session

    @property
    def _made(self) -> EarlierDesign:
        if isinstance(self._design, ConfigError):
            raise self._design
        return self._design

    def _emit(self, event: RobotRunnerEvents, context: RobotRunnerContext | None = None) -> list[Any]:
        heard = [each.callback for each in self._session.subscriptions if each.event is event]
        if not heard and event is not RobotRunnerEvents.START_RUN:  # START_RUN also makes the run's folder
            return []
        with self._executing(context):
            given = None if context is None else self._earlier_context(context)
            return [call(callback, event, given) for callback in heard]

    @contextmanager
    def _executing(self, context: RobotRunnerContext | None) -> Iterator[None]:
        self._session.context = context
        with active_session(self._session), self._stand_ins.present():
            yield

    def _earlier_context(self, context: RobotRunnerContext) -> EarlierContext:
        """Return the context of the run, which all its callbacks share, so that they see each other's values."""
        if self._context is None or self._context.run_variation.get("__run_id") != context.run_id:
            row = {"__run_id": context.run_id, "__done": RunProgress.TODO}
            design, planned = self._made, planned_of(context)
            names = {column: design.names[column] for column in design.factors}
            row |= {column: value_of(planned[name]) for column, name in names.items()}
            row |= dict.fromkeys(design.data_columns, MISSING)
            watched = WatchedRow(row, names, context.combination, design.counting)
            self._context = EarlierContext(watched, context.run_number, context.run_folder)
        elif isinstance(known := self._context.run_variation, WatchedRow):
            known.combination = context.combination  # the combination of before_run belongs to another process
        return self._context
