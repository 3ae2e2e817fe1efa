"""An experiment of an earlier tool as one of ours: the config object that executing, planning and checking see."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from robot_runner.dialects.hooks import call
from robot_runner.dialects.recognition import Dialect
from robot_runner.dialects.run_data import as_mapping, publish_row
from robot_runner.dialects.run_log import printed_to_log
from robot_runner.dialects.session import Session, active_session
from robot_runner.dialects.stand_ins.contexts import EarlierContext
from robot_runner.dialects.stand_ins.models import MISSING
from robot_runner.dialects.stand_ins.progress import RunProgress
from robot_runner.dialects.treatments import value_of
from robot_runner.errors import ConfigError
from robot_runner.events.event import RobotRunnerEvents
from robot_runner.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from robot_runner.design.run_table_model import RunTableModel
    from robot_runner.dialects.run_table import EarlierDesign
    from robot_runner.dialects.stand_ins.finder import StandIns
    from robot_runner.events.context import ExperimentContext, RobotRunnerContext
    from robot_runner.plugins.api.plugin import Plugin

__all__ = ["EarlierExperiment"]


class EarlierExperiment:
    """Hears our events and calls the callbacks that the config subscribed; its attributes are static parameters.

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
            ConfigError: the config could not make it.
        """
        return self._made.model

    def before_experiment(self, context: ExperimentContext) -> None:
        """Call the callbacks of BEFORE_EXPERIMENT."""
        del context
        self._emit(RobotRunnerEvents.BEFORE_EXPERIMENT)

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
        """Call the callbacks of STOP_RUN; Robot Runner asked for the run's data before it stopped the run."""
        try:
            if self._session.recognised.dialect is Dialect.ROBOT_RUNNER and self._is_measured:
                self._returned = self._emit(RobotRunnerEvents.POPULATE_RUN_DATA, context)
        finally:
            self._emit(RobotRunnerEvents.STOP_RUN, context)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Call the callbacks of POPULATE_RUN_DATA, and publish what they return and wrote into the row."""
        if self._session.recognised.dialect is not Dialect.ROBOT_RUNNER:
            self._returned = self._emit(RobotRunnerEvents.POPULATE_RUN_DATA, context)
        row = dict(self._earlier_context(context).run_variation)
        for returned in self._returned:
            row |= as_mapping(returned)
        publish_row(context, self._made, row)

    def continue_experiment(self, context: RobotRunnerContext) -> bool:
        """Call the callbacks of CONTINUE: they are the wait. Returns whether there are any."""
        return bool(self._emit(RobotRunnerEvents.CONTINUE, context))

    def after_experiment(self, context: ExperimentContext) -> None:
        """Call the callbacks of AFTER_EXPERIMENT."""
        del context
        self._emit(RobotRunnerEvents.AFTER_EXPERIMENT)

    @contextmanager
    def executing_nothing(self) -> Iterator[Session]:
        """Have the modules of the earlier tools there for whoever looks at the config; yields what is known of it."""
        with self._executing(None):
            yield self._session

    @property
    def _made(self) -> EarlierDesign:
        if isinstance(self._design, ConfigError):
            raise self._design
        return self._design

    def _emit(self, event: RobotRunnerEvents, context: RobotRunnerContext | None = None) -> list[Any]:
        """Call whoever subscribed an event; returns what each returned."""
        heard = [each.callback for each in self._session.subscriptions if each.event is event]
        is_needed = bool(heard) or event is RobotRunnerEvents.START_RUN  # a run has its folder, whoever hears it
        with self._executing(context):
            given = self._earlier_context(context) if context is not None and is_needed else None
            return [call(callback, event, given) for callback in heard]

    @contextmanager
    def _executing(self, context: RobotRunnerContext | None) -> Iterator[None]:
        self._session.context = context
        with active_session(self._session), self._stand_ins.present():
            yield

    def _earlier_context(self, context: RobotRunnerContext) -> EarlierContext:
        """Return the one context of a run: what a callback writes into it, the following callbacks see."""
        if self._context is None or self._context.run_variation.get("__run_id") != context.run_id:
            row = {"__run_id": context.run_id, "__done": RunProgress.TODO}
            design = self._made
            row |= {column: value_of(context.combination[design.names[column]]) for column in design.factors}
            row |= dict.fromkeys(design.data_columns, MISSING)
            self._context = EarlierContext(row, context.run_number, context.run_folder)
        return self._context
