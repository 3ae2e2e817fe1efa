"""The live screen: a growing table of finished runs, and beneath it the present activity."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, Self, TextIO

from rich.cells import cell_len, set_cell_size
from rich.console import Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from robot_runner.cli.console import UserConsole
from robot_runner.cli.findings import print_findings
from robot_runner.cli.screens import plain
from robot_runner.cli.screens.progress import CurrentRun, Progress, RunRows, treatments_in_words
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.execution import notices
from robot_runner.core.storage.lock import is_requested
from robot_runner.core.words import counted, one_line, shown_duration

_BAR = 40
#: The arrow and the id of a run.
_LEAST_OF_RUN = 12
#: Where more runs end between two refreshes than this, only those that failed get a row.
_MOST_ROWS = 4


class _Keyboard:
    """Standard input that calls `give_way` before a line is read; otherwise unchanged.

    `input()` comes by here as well: while rich redirects stdout, Python reads the line from `sys.stdin`.
    """

    def __init__(self, stream: TextIO, give_way: Callable[[], None]) -> None:
        self._stream = stream
        self._give_way = give_way

    def readline(self, *size: int) -> str:
        self._give_way()
        return self._stream.readline(*size)

    def read(self, *size: int) -> str:
        self._give_way()
        return self._stream.read(*size)

    def __iter__(self) -> Iterator[str]:
        return iter(self.readline, "")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def input_gives_way(give_way: Callable[[], None]) -> Iterator[None]:
    """While this lasts, `give_way` is called before a callback of this process reads from the keyboard."""
    earlier = sys.stdin
    keyboard: Any = _Keyboard(earlier, give_way)
    sys.stdin = keyboard
    try:
        yield
    finally:
        sys.stdin = earlier


class LiveScreen:
    """An observer that keeps the terminal up to date. It starts no thread: the orchestrator calls `refresh`.

    What the orchestrating process prints meanwhile (callbacks such as `before_run`) appears above the live part.
    `progress` is what it knows, by a monotonic clock in s.
    """

    refresh_interval: float | None = 0.125

    def __init__(self, console: UserConsole, experiment: Experiment, clock: Callable[[], float]) -> None:
        self.progress = Progress(clock)
        self.user_input = plain.terminal_input()
        self._console = console
        self._experiment = experiment
        self._clock = clock
        self._live: Live | None = None
        self._drawn = float("-inf")
        self._printed = float("-inf")
        self._rows: RunRows | None = None
        self._headed = 0
        self._keyboard = ExitStack()
        self._finished: list[notices.AttemptFinished] = []
        self._hidden = 0
        self._last: notices.AttemptFinished | None = None

    def __enter__(self) -> Self:
        """Draw from here on; input for callbacks is typed beneath the table."""
        if self.user_input is not None:
            self._keyboard.enter_context(input_gives_way(self._give_way))
        return self

    def __exit__(self, *raised: object) -> None:
        """Take the live part away; the table stays."""
        with self._keyboard, suppress(OSError):  # the terminal is gone
            self._print_finished()
            self._print_hidden()
            self._take_live_part_away()

    def notice(self, notice: notices.Notice) -> None:
        """Take a notice; permanent lines are printed above the live part, the rest is shown at the next refresh."""
        self.progress.take(notice)
        match notice:
            case notices.PreparationStarted() | notices.ProbeStarted() | notices.HostRestarts():
                self._print_finished()
                self._console.tell(plain.announced(notice), style="dim")
            case notices.ExperimentStarted():
                self._begin(notice)
            case notices.AttemptStarted():
                self._show_live_part()
                self.refresh()
            case notices.AttemptFinished():
                self._take_end(notice)
            case notices.NextDecided():
                self._print_finished()
                self._print_lines([Text(f"  {notice.told}")])
            case notices.FindingsNoticed(findings):
                self._print_finished()
                print_findings(self._console, findings)
            case notices.InterruptionNoticed(run_id):
                self._print_finished()
                self._print_lines([Text(plain.closing(run_id), style="bold yellow")])
            case _:
                self._take_part(notice)

    def _take_part(self, notice: notices.Notice) -> None:
        by_key = self.user_input is not None
        match notice:
            case notices.WaitingForUser():
                self._ask(*plain.run_to_come(notice, self._experiment.model), plain.request(notice, by_key=by_key))
            case notices.Paused():
                self._ask(plain.pausing(notice, by_key=by_key))
            case notices.QuestionAsked(question):
                self._console.print(Text(plain.question_asked(question), style="bold cyan"), end="", soft_wrap=True)
            case notices.AnswersRefused():
                for line in plain.refusals(notice):
                    self._console.tell(line, style="bold yellow")
            case notices.UserHasContinued():
                self._show_live_part()
                self.refresh()
            case notices.GatePassed(problem=problem) if problem:
                self._print_finished()
                self._print_lines([Text(f"  {plain.gate_passed(notice)}", style="yellow")])

    def refresh(self) -> None:
        """Draw news, unless the screen was drawn a moment ago: records come faster than anybody reads."""
        now = self._clock()
        if self.progress.is_waiting or now - self._drawn < (self.refresh_interval or 0) * 0.9:
            return
        self._drawn = now
        self._print_finished()
        if self._live is not None:
            self._live.update(self._now(), refresh=True)

    def _take_end(self, ended: notices.AttemptFinished) -> None:
        self._finished.append(ended)
        if self._clock() - self._printed >= (self.refresh_interval or 0):
            self._print_finished()

    def _begin(self, started: notices.ExperimentStarted) -> None:
        self._rows = RunRows(self._experiment, started.columns, started.run_count)
        first, *more = plain.opening(started)
        self._console.tell(first, style="bold")
        for line in more:
            self._console.tell(line)
        print_findings(self._console, started.findings)
        if started.done_count < started.run_count:
            self._print_header(self._rows)
            self._show_live_part()

    def _print_header(self, rows: RunRows) -> None:
        """Print the headings that fit, and name the others; repeated when the width of the terminal changes."""
        self._headed = self._console.width
        self._console.print(rows.header(self._headed), no_wrap=True, overflow="ellipsis")
        if left_out := rows.left_out(self._headed):
            self._console.tell(f"  {left_out}", style="dim")

    def _show_live_part(self) -> None:
        if self._live is None:
            self._live = Live(console=self._console, auto_refresh=False, transient=True)
            self._live.start()

    def _take_live_part_away(self) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None  # a new one next time: this one would draw over what was printed meanwhile

    def _give_way(self) -> None:
        # The live part is taken away while somebody types: what the terminal echoes would tear it.
        self._print_finished()
        self._take_live_part_away()

    def _ask(self, *asked: str) -> None:
        self._give_way()
        plain.forget_typed(self.user_input)
        for line in asked:
            self._console.tell(line, style="bold cyan")

    def _print_finished(self) -> None:
        if not self._finished or self._rows is None:
            return
        self._printed = self._clock()
        finished, self._finished = self._finished, []
        self._last = finished[-1]
        shown = finished if len(finished) <= _MOST_ROWS else [each for each in finished if each.outcome.failure]
        if shown:
            self._print_hidden()
            width = self._console.width
            if self._rows.left_out(width) != self._rows.left_out(self._headed):
                self._print_header(self._rows)
            self._print_lines([self._rows.row(each, width) for each in shown])
        self._hidden += len(finished) - len(shown)

    def _print_hidden(self) -> None:
        if self._hidden:
            hidden = f"  … {counted(self._hidden, 'run')}, too fast to be shown; run_table.csv has them …"
            self._print_lines([Text(hidden, style="dim")])
            self._hidden = 0

    def _print_lines(self, lines: list[Text]) -> None:
        for line in lines:
            line.truncate(self._console.width, overflow="ellipsis")
        self._console.print(Text("\n").join(lines), no_wrap=True, crop=False)

    def _now(self) -> RenderableType:
        progress = self.progress
        bar = ProgressBar(
            progress.run_count,
            progress.done + progress.failed,
            width=min(_BAR, self._console.width // 4),
            complete_style="green",
        )
        line = Table.grid(padding=(0, 2, 0, 0))
        line.add_row("", bar, self._counts())
        last = [self._rows.row(self._last, self._console.width)] if self._hidden and self._last and self._rows else []
        return Group(*last, "", line, *self._current())

    def _counts(self) -> Text:
        progress = self.progress
        counts = Text(f"{progress.done:,} of {progress.run_count:,} done", no_wrap=True, overflow="ellipsis")
        if progress.failed:
            counts.append(f", {progress.failed:,} failed", style="bold red")
        counts.append(f"   {shown_duration(progress.elapsed)}", style="dim")
        if left := progress.left_in_words:
            counts.append(f", {left}", style="dim")
        return counts

    def _current(self) -> list[Text]:
        """Return the present activity: two lines of the only run, or one line of each place."""
        runs = list(self.progress.in_flight.values())
        waits = list(self.progress.gates.values())
        if not runs and len(waits) <= 1:
            return self._between_runs(waits)
        if len(runs) == 1 and not runs[0].task.place:
            return [self._run(runs[0], with_count=True), self._event(runs[0], self._pause())]
        width = max((cell_len(each.task.place) for each in runs), default=0)
        places = [self._at_place(each, width) for each in sorted(runs, key=lambda each: each.task.slot)]
        gates = (self._at_gate(each).append(f"   {plain.waited_so_far(each)}", style="default") for each in waits)
        return [*places, *gates]

    def _at_place(self, current: CurrentRun, width: int) -> Text:
        line = Text(f"  {set_cell_size(current.task.place, width)}", style="dim", no_wrap=True, overflow="ellipsis")
        run, event = self._run(current, with_count=False), self._event(current, "")
        # What happens now is worth more than the last treatments.
        run.truncate(max(_LEAST_OF_RUN, self._console.width - line.cell_len - event.cell_len), overflow="ellipsis")
        return line.append(run).append(event)

    def _run(self, current: CurrentRun, *, with_count: bool) -> Text:
        task = current.task
        attempt = f"attempt {task.attempt}" if task.attempt > 1 else ""
        count = f"run {task.run_number} of {task.run_count}" if with_count else ""
        brackets = ", ".join(filter(None, (count, attempt)))
        treatments = treatments_in_words(task, self._experiment.model)
        run = Text("  ▶ ", style="cyan", no_wrap=True, overflow="ellipsis")
        run.append(f"{task.run_id}", style="bold")
        return run.append(f"{f' ({brackets})' if brackets else ''}: {treatments}", style="default")

    def _pause(self) -> str:
        return ", pauses after this run" if is_requested(self._experiment.folder.pause) else ""

    def _between_runs(self, waits: Sequence[notices.GateWaiting]) -> list[Text]:
        if not waits:
            return [Text(f"  between two runs{self._pause()}", style="dim"), Text("")]
        waited = Text(f"    {plain.waited_so_far(waits[0])}", no_wrap=True, overflow="ellipsis")
        return [self._at_gate(waits[0]), waited]

    def _at_gate(self, waiting: notices.GateWaiting) -> Text:
        return Text(f"  ▷ {plain.waiting_at_gate(waiting)}", style="cyan", no_wrap=True, overflow="ellipsis")

    def _event(self, current: CurrentRun, pause: str) -> Text:
        line = Text("    ", no_wrap=True, overflow="ellipsis")
        line.append(current.event or "starting", style="default")
        if current.shared:
            line.append(f": {one_line(current.shared)}", style="cyan")
        line.append(f"   {shown_duration(self.progress.elapsed_in(current))}{pause}", style="dim")
        if current.failure:
            line.append(f"   ✗ {one_line(current.failure)}; closing what is open", style="red")
        return line
