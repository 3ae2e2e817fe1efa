"""Experiments executed by scripts, notebooks and tests: `run_experiment`."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.config import preparation
from robot_runner.core.config.executed_as_script import tell_nothing
from robot_runner.core.config.loader import file_being_loaded
from robot_runner.core.design.columns import STATUS
from robot_runner.core.entry_points import entry_points
from robot_runner.core.errors import AnalysisError, ConfigError, ExecutionError, Finding, PluginError, RobotRunnerError
from robot_runner.core.execution import notices
from robot_runner.core.execution.left_systems import see_to_it_first
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.execution.task import AttemptStatus
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import read_described_table
from robot_runner.core.words import counted, shown_duration
from robot_runner.notebook.apart import execute_forked, execute_in_interpreter
from robot_runner.notebook.python_config import NAME, PREFIX, as_texts, config_of_object, is_config, runs_named

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, repr=False)
class ExperimentResults:
    """What an experiment has yielded so far, this call and earlier ones together.

    Attributes:
        folder: where everything of it is kept.
        rows: the run table, in its order: the value of each column, by its heading; None for a missing one.
        done_count, failed_count, todo_count: the state of the run table.
        failures: why each failed run failed, by its id.
        findings: what looked odd.
        is_interrupted: whether it was ended by Ctrl-C, or by another stop request.
        seconds: how long this call took, s.
    """

    folder: Path
    rows: tuple[Mapping[str, Any], ...]
    done_count: int
    failed_count: int
    todo_count: int
    failures: Mapping[str, str]
    findings: tuple[Finding, ...]
    is_interrupted: bool
    is_stopped_by_policy: bool
    seconds: float

    def __repr__(self) -> str:
        """Return what a notebook shows: the counts; rows, failures and findings may be many, and have names."""
        states = {"done": self.done_count, "failed": self.failed_count, "to do": self.todo_count}
        told = ", ".join(f"{count} {state}" for state, count in states.items() if count) or "no runs"
        return f"<ExperimentResults of {self.folder}: {told}; {counted(len(self.findings), 'finding')}>"

    @property
    def exit_code(self) -> int:
        """What `robot-runner run` would have ended with: 0, 1 where a run failed, or 130 where it was interrupted."""
        if self.is_interrupted:
            return 130
        return 1 if self.failed_count or self.is_stopped_by_policy else 0

    def frame(self) -> pd.DataFrame:
        """Return the run table as a data frame of pandas, as `robot_runner.analysis.load_results` has it.

        Raises:
            AnalysisError: the libraries of the extra `analysis` are not installed.
        """
        try:
            (point,) = entry_points("frames")[:1]
            frame: pd.DataFrame = point.load()(self.folder).runs
        except (ValueError, PluginError) as error:
            fix = "Install the libraries: pip install 'robot-runner[analysis]'. `rows` needs none."
            raise AnalysisError(f"no data frame can be made: {error}", where=str(self.folder), fix=fix) from error
        return frame


def run_experiment(  # noqa: PLR0913 - one keyword for each thing that the command line knows
    config: Any,
    *,
    settings: Mapping[str, Any] | None = None,
    folder: Path | str | None = None,
    only: Sequence[str] = (),
    redo: Sequence[str] = (),
    accept_changes: bool = False,
    probe: bool = True,
    say: Callable[[str], object] | None = None,
    observer: notices.Observer | None = None,
) -> ExperimentResults:
    """Execute an experiment, or resume it, and return its results; runs that failed are told in them.

    In the main thread of a program without other threads it is executed in this process. Elsewhere (a notebook, a
    thread) it is executed in a process of its own, as signals cannot be taken there and forking runs beside threads
    is not safe: a config file in a fresh interpreter, a class in one forked copy of this process.

    Args:
        config: the path of a config file, a config class, or an instance of one.
        settings: static parameters to set, by name; recorded as deviations, as `--set` does.
        folder: where the experiment's folder is made, in the place of the config's `results_output_path`.
        only: the only runs to execute: ids and treatments, as `--only` takes them.
        redo: the runs to execute again though they are done.
        accept_changes: go on though the config, or what is set, differs from what was executed before.
        probe: whether profilers are tried before the first run, where the config does not forbid it.
        say: takes a line when a run starts and when it ends, such as `print`.
        observer: gets every notice; only where the experiment is executed in this process.

    Raises:
        ConfigError: the config is refused; all findings are told.
        RobotRunnerError: the experiment cannot start, or cannot go on.
        KeyboardInterrupt: the user interrupted before the experiment was begun; later, the results tell it.

    Example:
        >>> from robot_runner import ExperimentConfig, Factor, RunTableModel
        >>> class TwoSpeeds(ExperimentConfig):
        ...     experiment_name = "two_speeds"
        ...     def populate_run_data(self, context):
        ...         return {"Way": 10.0 * context.combination["Speed"]}
        ...     def create_run_table(self):
        ...         return RunTableModel([Factor("Speed", [0.1, 0.2])], data_columns=["Way"])
        >>> results = run_experiment(TwoSpeeds, folder="unused")
        >>> [row["Way"] for row in results.rows]
        [1.0, 2.0]
    """
    if file_being_loaded() is not None:  # `check` loads it, too, and touches nothing
        fix = "Put the call below `if __name__ == '__main__':`, so that only `python FILE` executes it."
        raise ConfigError("the file executes an experiment while it is loaded", where="run_experiment", fix=fix)
    texts = as_texts(settings or {})
    if folder is not None:
        texts["results_output_path"] = str(Path(folder).expanduser().absolute())
    resumption = Resumption(
        accept_changes=accept_changes, redo=runs_named("redo", redo), only=runs_named("only", only), probe=probe
    )
    if not isinstance(config, str | Path) and not is_config(config):
        fix = "Give the path of a config file, a class with create_run_table, or an instance of one."
        raise ConfigError(f"{config!r} is not a config", where="run_experiment", fix=fix)
    with _said_for_python(), ExitStack() as at_end:
        at_end.callback(tell_nothing)  # the config may be a class of the script
        return _carried_out(config, texts, resumption, say, observer)


def _carried_out(
    config: Any,
    texts: Mapping[str, str],
    resumption: Resumption,
    say: Callable[[str], object] | None,
    observer: notices.Observer | None,
) -> ExperimentResults:
    if _is_free():
        return _results(_executed(config, texts, resumption, observer or _Teller(say)))
    if observer is not None:
        problem = "an observer can only watch an experiment that is executed in this process"
        fix = "Take lines by say=print, or call it in the main thread of a program without other threads."
        raise ExecutionError(problem, where="run_experiment", fix=fix)
    if isinstance(config, str | Path):
        path = str(Path(config).expanduser().absolute())
        request = {"config": path, "texts": texts, "asked": asdict(resumption)}
        return _results(execute_in_interpreter(f"{__name__}:requested", request, say))

    def work(tell: Callable[[str], object]) -> notices.ExperimentFinished:
        return _executed(config, texts, resumption, _Teller(tell))

    return _results(execute_forked(work, say))


#: What a message advises on the command line, and what it is here.
_IN_PYTHON = {
    "--accept-changes": "accept_changes=True",
    "--only": "only",
    "--redo": "redo",
    "--table journal": "robot-runner run FILE --table journal",
    "--table file": "accept_changes=True",
}
_SET_TO, _SET = re.compile(r"--set (\w+)=([^\s,;)]*[^\s,;).])"), re.compile(r"--set (\w+)")
#: The file that a class of a notebook has for a moment.
_MOMENTARY = re.compile(rf"[^\s']*{PREFIX}\w+/{NAME}")


@contextmanager
def _said_for_python() -> Iterator[None]:
    """Have what is refused be told in the words of who calls a function, and not those of the command line.

    Raises:
        RobotRunnerError: what was raised, in other words.
    """
    try:
        yield
    except RobotRunnerError as error:
        findings = [
            replace(each, where=_in_python(each.where), problem=_in_python(each.problem), fix=_in_python(each.fix))
            for each in error.findings
        ]
        if tuple(findings) == tuple(error.findings):
            raise
        raise type(error).of_findings(findings) from error


def _in_python(text: str) -> str:
    for option, keyword in _IN_PYTHON.items():
        text = text.replace(option, keyword)
    text = _SET_TO.sub(r'settings={"\1": "\2"}', text)
    text = _SET.sub(r'settings["\1"]', text)
    return _MOMENTARY.sub("the class", text)


def requested(request: Mapping[str, Any], tell: Callable[[str], object]) -> notices.ExperimentFinished:
    """Execute what a program with threads asks a fresh interpreter for."""
    return _executed(request["config"], request["texts"], Resumption(**request["asked"]), _Teller(tell))


def _is_free() -> bool:
    """Whether signals can be taken here and runs can be forked."""
    return threading.current_thread() is threading.main_thread() and threading.active_count() == 1


def _executed(
    config: Any, texts: Mapping[str, str], resumption: Resumption, observer: notices.Observer
) -> notices.ExperimentFinished:
    prepare = partial(preparation.prepare, first=see_to_it_first)
    with ExitStack() as opened:
        if isinstance(config, str | Path):
            prepared = prepare(Path(config).expanduser(), texts)
        else:
            loaded = opened.enter_context(config_of_object(config, texts))
            prepared = prepare(loaded.source.path, texts, lambda _path, _texts: loaded)
        if prepared.experiment is None:
            raise ConfigError.of_findings(prepared.findings)
        return execute_experiment(prepared.experiment, observer, findings=prepared.findings, resumption=resumption)


def _results(finished: notices.ExperimentFinished) -> ExperimentResults:
    rows = read_described_table(ExperimentFolder.found_at(finished.folder))
    return ExperimentResults(
        folder=finished.folder,
        rows=tuple({**row, STATUS: row[STATUS].value} for row in rows),
        done_count=finished.done_count,
        failed_count=finished.failed_count,
        todo_count=finished.todo_count,
        failures=dict(each.split(": ", 1) for each in finished.failures),
        findings=tuple(finished.findings),
        is_interrupted=finished.interrupted,
        is_stopped_by_policy=bool(finished.stopped_by),
        seconds=finished.seconds,
    )


class _Teller(notices.SilentObserver):
    """Says in a line when a run starts, and when it ends."""

    def __init__(self, say: Callable[[str], object] | None) -> None:
        self._say = say

    def notice(self, notice: notices.Notice) -> None:
        """Say what is worth a line."""
        if self._say is None:
            return
        match notice:
            case notices.ExperimentStarted():
                self._say(f"{notice.experiment_name}: {notice.run_count} runs, {notice.done_count} of them done before")
            case notices.NextDecided():
                self._say(notice.told)
            case notices.AttemptStarted(task):
                treatments = ", ".join(f"{name}={value}" for name, value in task.combination.items())
                self._say(f"run {task.run_number} of {task.run_count} ({task.run_id}) starts: {treatments}")
            case notices.AttemptFinished(task, outcome):
                is_done = outcome.status is AttemptStatus.DONE
                how = "is done" if is_done else f"{outcome.status.value}: {outcome.failure}"
                left = f", {notice.left.in_words()}" if notice.left is not None and notice.left.others else ""
                self._say(f"{task.run_id} {how} after {shown_duration(outcome.seconds)}{left}")
