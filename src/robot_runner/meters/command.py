"""The profiler for any measuring program with a command line."""

from __future__ import annotations

import shutil
import signal
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import ClassVar

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.context import Clock, RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin
from robot_runner.core.events.window import Window
from robot_runner.core.links.connect import graph_variables
from robot_runner.core.plugin import Circumstances, Profiler, probe_window
from robot_runner.core.storage.input_files import InputFile, kept_copy
from robot_runner.measuring.evaluation import NEVER_STARTED, publish_measures
from robot_runner.measuring.measured_machine import clock_details, machine_clock
from robot_runner.measuring.meter_process import Ending, MeterProcess, Record
from robot_runner.measuring.own_scripts import script_inputs, scripts_in, unread_findings
from robot_runner.measuring.parameter_checks import check_kind, check_list, check_numbers, checked_codes, named_signal
from robot_runner.measuring.quality import Column, SampleQuality, quality_of, report_quality, write_samples
from robot_runner.meters.command_output import (
    Aggregate,
    CommandColumn,
    Parse,
    Row,
    TimeColumn,
    TimeKind,
    csv_cell,
    misplaced_rows,
    parse_csv,
    repeated_rows,
    row_times,
)

#: How long to wait after the measured window for the row that covers its end: in periods, and in s.
_AFTERMATH_PERIODS = 1.2
_LONGEST_AFTERMATH = 12.0
#: Stands for the path of the output file in a command.
_PLACE = "{output}"
_COUNTERS = (Aggregate.INCREASE, Aggregate.RATE)
#: If rows have only the times of their arrival, this share of them may equal the row before without a doubt.
_HELD_UP = 0.3
#: A row that is kept back has no time of arrival, and one with decimal commas has further cells.
_ENVIRONMENT = {"PYTHONUNBUFFERED": "1", "LC_NUMERIC": "C"}


@dataclass(frozen=True, slots=True)
class Measured:
    """The output of one run's meter, in rows.

    Attributes:
        rows: oldest first.
        times: when each row was taken, s on the run's clock.
        window: the mission.
        sampled: from the start of the measurement to its stop.
        ending: how the meter ended.
        other: records that are no rows.
        received: when each row arrived, s on the run's clock.
    """

    rows: Sequence[Row]
    times: Sequence[float]
    window: Window
    sampled: Window
    ending: Ending
    other: Sequence[str] = ()
    received: Sequence[float] = ()


class CommandProfiler(Profiler):
    """Measures with a program: starts it, follows the rows of its output, ends it, and aggregates the columns.

    It starts the program and waits for a first row before the mission, and evaluates the rows over the mission. A
    measure without an `over` gets the one of its column's aggregate. In the arguments, `{output}` stands for the full
    path of the output file, in the folder of the plugin's raw data.

    Args:
        command: the program and its arguments.
        columns: the columns of the output that yield measures.
        name: distinguishes several instances; None for the class's name.
        output: the name of the file that the program writes to, in the raw-data folder; None for its stdout.
        parse: converts the records of the output to rows; None for `parse_csv`.
        separator: what ends a record of the output.
        time: the column with the time of a row; None takes the time of its arrival.
        period_s: the expected time between two rows, s.
        stop_signal: the signal at which the program writes its last rows and ends.
        grace_s: how long that may take before the program is killed, s.
        startup_s: how long to wait for the first row, s.
        exit_codes: exit codes that mean success, besides those of the stop signal.
        origin: where the values come from; ESTIMATED for a program that computes power from a model.
        install: how to get the program, in one imperative sentence, for the finding if it is missing.

    Raises:
        PluginError: a parameter is of another type, the command is empty, there are no columns or two of one measure.

    Example:
        >>> from robot_runner.plugins import Measure
        >>> from robot_runner.plugins.profilers import Aggregate, CommandColumn
        >>> energy = Measure("Energy", "J", "Integral of power over the measured window.")
        >>> column = CommandColumn("watts", energy, Aggregate.INTEGRAL)
        >>> CommandProfiler(command=["wattmeter", "--csv"], columns=[column], name="Wall").measures[0].name
        'Energy'
    """

    needs: ClassVar[str] = "The program, and the right to execute it."
    bytes_per_run: int = 100_000  # a row a second of 500 bytes for a mission of 95 s, twice: as it came and as samples

    _process: MeterProcess | None
    _clock: Clock
    _begun_at: float | None
    _sampled: Window | None
    _measured: Measured | None
    _fault: str
    _utc_offset: float
    _clock_step: float | None  # by how much the wall clock, which stamps the rows, was set during the measurement, s

    def __init__(  # noqa: PLR0913 - each is one habit of a program that we did not write
        self,
        *,
        command: Sequence[str],
        columns: Sequence[CommandColumn],
        name: str | None = None,
        output: str | None = None,
        parse: Parse | None = None,
        separator: str = "\n",
        time: TimeColumn | None = None,
        period_s: float = 1.0,
        stop_signal: signal.Signals = signal.SIGINT,
        grace_s: float = 5.0,
        startup_s: float = 5.0,
        exit_codes: Sequence[int] = (0,),
        origin: Origin = Origin.MEASURED,
        install: str = "Install it, or give its full path.",
    ) -> None:
        super().__init__(name=name)
        if isinstance(command, str):
            fix = f"Give a list: command={command.split()!r}."
            raise PluginError(f"command is {command!r}", where=self.name, fix=fix)
        check_list(self.name, command=command, columns=columns)
        check_kind(self.name, TimeColumn, **({} if time is None else {"time": time}))
        check_kind(self.name, Origin, origin=origin)
        check_kind(self.name, str, output=output or "")
        if not isinstance(separator, str) or not separator:
            raise PluginError(f"separator is {separator!r}", where=self.name, fix="Give the text that ends a record.")
        if parse is not None and not callable(parse):
            raise PluginError(f"parse is {parse!r}", where=self.name, fix="Give parse a function, or leave it out.")
        check_numbers(self.name, period_s=period_s, grace_s=grace_s, startup_s=startup_s)
        self.command = [str(word) for word in command]
        self.columns = tuple(columns)
        check_kind(self.name, CommandColumn, **{f"columns[{place}]": each for place, each in enumerate(self.columns)})
        self.measures: Sequence[Measure] = tuple(column.yields for column in self.columns)
        self.output = output
        self.period_s = period_s
        self.probe_s = probe_window(1 / period_s)
        self.grace_s = grace_s
        self.startup_s = startup_s
        self.exit_codes = checked_codes(self.name, exit_codes)
        self.origin = origin
        self._parse = parse or parse_csv
        self._separator = separator
        self._time = time
        self._stop_signal = named_signal(self.name, stop_signal)
        self._install = install
        self._refuse_what_cannot_be()
        self._forget()

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return an error if the program is missing, or warnings if a package of the experiment would lack scripts."""
        del circumstances
        missing = self._missing_programs(self._found[0])
        return missing or list(unread_findings(f"plugin {self.name}", map(Path, scripts_in(self.command))))

    def input_files(self) -> Iterable[InputFile]:
        """Yield the program if it is a file of the user, and the script if an interpreter executes one."""
        return script_inputs(map(Path, scripts_in(self.command)))

    def start_run(self, context: RobotRunnerContext) -> None:
        """Discard the results of the run before."""
        del context
        self._forget()

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Start the program and wait for its first row; a `PluginError` says why it cannot, or that it ended before."""
        folder, self._clock = context.raw_data_folder, machine_clock(context)
        begun_at = self._clock.now()
        self._utc_offset = self._clock.now() - time.time()
        self._process = process = MeterProcess(
            self.words(folder),
            output=self._output_file(folder),
            folder=folder,
            clock=self._clock,
            separator=self._separator,
            environment={**_ENVIRONMENT, **graph_variables(context.robot)},  # by which a ROS program finds its graph
        )
        has_begun = process.wait(lambda: self._has_row(process.records), seconds=self.startup_s)
        if not has_begun and not process.is_running:
            ending, self._process = process.stop(self._stop_signal, grace=self.grace_s), None
            problem = f"{self.command[0]!r} ended at once, with exit code {ending.exit_code}: {ending.complaint}"
            raise PluginError(problem, where=self.name, fix="Execute it by hand to see why: " + " ".join(self.command))
        self._begun_at = begun_at

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """Note the time. The program runs until `stop_run`, so that no other profiler waits for it."""
        del context
        if self._begun_at is not None and self._sampled is None:
            self._sampled = Window(self._begun_at, self._clock.now())

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Wait for the row that covers the window's end, end the program, and write the samples."""
        process, self._process = self._process, None
        if process is None:
            return
        count = len(process.records)
        aftermath = min(_AFTERMATH_PERIODS * self.period_s, _LONGEST_AFTERMATH)
        if self._sampled is not None:
            process.wait(lambda: len(process.records) > count, seconds=aftermath)
        ending = process.stop(self._stop_signal, grace=self.grace_s)
        if self._time is not None and self._time.kind is TimeKind.UTC:
            self._clock_step = abs(self._clock.now() - time.time() - self._utc_offset)
        mission = context.times.window(self._clock)
        if self._sampled is None or mission is None:
            return
        fault = process.unread
        try:
            self._measured = None if fault else self._read(process.records, mission, self._sampled, ending)
        except Exception as error:  # noqa: BLE001 - a parse function may raise anything; the meter costs its values only
            fault = f"{type(error).__name__}: {error}"
        if self._measured is None:
            self._fault = f"the program's output cannot be read: {fault}"
            return
        self._write(context.raw_data_folder, self._measured)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish one value for each column; no value where the rows do not suffice."""
        measured = self._measured
        if measured is None:
            context.doubt(self._fault or NEVER_STARTED, fix=self._look)
            publish_measures(context, self.measures, lambda _: {}, origin=self.origin)
            return
        for problem in self.doubts(measured):
            context.doubt(problem, fix=self._look)
        doubted: dict[str, list[str]] = {}
        for measure, problem in self.column_doubts(measured):
            doubted.setdefault(problem, []).append(measure)
        for problem, names in doubted.items():
            context.doubt(problem, fix=self._look, measures=names)
        details = {**clock_details(context), "command": self.command, "program": asdict(measured.ending)}
        quality = self._quality(measured.times, measured.window)
        report_quality(context, quality, measured.window, sampled=measured.sampled, fix=self._look, details=details)
        evaluate, times = self._evaluated, measured.times
        publish_measures(context, self.measures, evaluate, origin=self.origin, clock=self._clock, times=times)

    def words(self, folder: Path) -> list[str]:
        """Return the command with the path of the output file in it."""
        output = self._output_file(folder)
        return [word.replace(_PLACE, str(output)) if output else word for word in self._found]

    def doubts(self, measured: Measured) -> Iterable[str]:
        """Yield doubts about the output, besides the quality of its samples; a subclass may add to them."""
        ending = measured.ending
        asked = {*self.exit_codes, -self._stop_signal, 128 + self._stop_signal}
        said = f": {ending.complaint}" if ending.complaint else ""
        if not ending.was_asked:
            yield f"the program ended by itself, with exit code {ending.exit_code}{said}"
        elif ending.exit_code is None:
            yield "the program could not be ended, not even by SIGKILL: end it by hand"
        elif ending.was_killed:
            yield f"the program did not end on {self._stop_signal.name} and had to be killed"
        elif ending.exit_code not in asked:
            yield f"the program ended with exit code {ending.exit_code}{said}"
        if self._time is None and measured.times and measured.times[0] > measured.sampled.end:
            kept = f"the program kept its {len(measured.rows)} rows back until it ended"
            yield f"{kept}: have it flush each (such as by `stdbuf -oL`), or name their times"
        if self._clock_step is not None:
            yield from misplaced_rows(measured.times, measured.received, self.period_s + self._clock_step)
        if not measured.rows and len(measured.other) > 1:
            none = f"none of {len(measured.other)} lines of its output is a row, such as {measured.other[-1][:40]!r}"
            yield f"{none} (cells as in the heading, decimal points)"
        there = dict.fromkeys(name for row in measured.rows for name in row)
        missing = [column.source for column in self.columns if column.source not in there]
        if measured.rows and missing:
            lacking, found = (", ".join(map(repr, names)) for names in (missing, there))
            yield f"the program's output has no column {lacking}; it has {found}"

    def column_doubts(self, measured: Measured) -> Iterator[tuple[str, str]]:
        """Yield the names of doubtful measures, each with the doubt; a subclass may add to them.

        Reasons are cells with texts such as `N/A`, `7,5` or `7.5 W`, too few cells with a value, a counter that fell,
        and repeated rows that are summed.
        """
        window = measured.window
        yield from self._doubts_about_sums(measured)
        rows = [
            row for time, row in zip(measured.times, measured.rows, strict=True) if window.start <= time <= window.end
        ]
        for column in self.columns:
            told = [
                (row[column.source], number)
                for row, number in zip(rows, column.values(rows), strict=True)
                if column.source in row
            ]
            missing = [cell for cell, number in told if number is None]
            texts = [cell for cell in missing if cell and isinstance(cell, str)]
            if texts or (missing and not self._is_told(column, measured, window)):
                first = f", the first {texts[0]!r}" if texts else ""
                problem = f"{len(missing)} of {len(told)} rows hold no number in column {column.source!r}{first}"
                yield column.measure.name, problem
            elif told and column.aggregate in _COUNTERS and column.value(measured.times, measured.rows, window) is None:
                yield column.measure.name, f"the counter in column {column.source!r} was set back: no value"

    def _doubts_about_sums(self, measured: Measured) -> Iterator[tuple[str, str]]:
        count, repeated = len(measured.rows), repeated_rows(measured.times, measured.rows)
        # By their arrival, delayed rows look as if they were of one moment.
        if repeated > (0 if self._time is not None else _HELD_UP * count):
            same = f"{repeated} of {count} rows are the same as the row before, at the same moment"
            problem = f"{same}: each of them counts in the sum"
            yield from ((each.measure.name, problem) for each in self.columns if each.aggregate is Aggregate.SUM)

    def _is_told(self, column: CommandColumn, measured: Measured, window: Window) -> bool:
        """Whether the cells with a number cover enough of a window; the last row alone suffices for `LAST`."""
        if column.aggregate is Aggregate.LAST:
            return True
        numbers = zip(measured.times, column.values(measured.rows), strict=True)
        return self._quality([time for time, number in numbers if number is not None], window).is_sufficient

    def _quality(self, times: Sequence[float], window: Window) -> SampleQuality:
        moments = list(dict.fromkeys(times))  # some programs write several rows at once
        return quality_of(moments, window, 1 / self.period_s, clock_uncertainty=self._clock_step)

    def _evaluated(self, window: Window) -> Mapping[str, float | None]:
        measured = self._measured
        if measured is None or not self._quality(measured.times, window).is_sufficient:
            return {}
        return {
            column.measure.name: column.value(measured.times, measured.rows, window)
            for column in self.columns
            if self._is_told(column, measured, window)
        }

    def _read(self, records: Sequence[Record], window: Window, sampled: Window, ending: Ending) -> Measured:
        parsed = list(self._parse([record.text for record in records]))
        if self._separator == "\n" and any(parsed[:-1]) and not records[-1].is_ended:
            parsed[-1] = None  # half a number would pass for one where the program died in the middle of a line
        told = list(zip(parsed, records, strict=True))
        rows = [row for row, _ in told if row is not None]
        received = [record.received_at for row, record in told if row is not None]
        other = [record.text for row, record in told if row is None and record.text.strip()]
        times = row_times(rows, received, self._time, utc_offset=self._utc_offset)
        return Measured(rows, times, window, sampled, ending, other, received)

    def _write(self, folder: Path, measured: Measured) -> None:
        measures = {column.source: column.measure for column in self.columns}
        plain = [CommandColumn(source, measure) for source, measure in measures.items()]  # without their factors
        columns = [Column(csv_cell(each.source), each.values(measured.rows)) for each in plain]
        write_samples(folder / "samples.csv", [Column("time_s", measured.times), *columns])

    def _has_row(self, records: Sequence[Record]) -> bool:
        try:
            return any(row is not None for row in self._parse([record.text for record in records]))
        except Exception:  # noqa: BLE001 - a parse function may fail on half an output; stop_run reports it
            return False

    def _missing_programs(self, *programs: str) -> list[Finding]:
        problems = (f"the program {each!r} is not there" for each in programs if shutil.which(each) is None)
        return [Finding.error(f"plugin {self.name}", problem, self._install) for problem in problems]

    def _output_file(self, folder: Path) -> Path | None:
        return folder / self.output if self.output else None

    @property
    def _found(self) -> list[str]:
        """The command, with the copies that a package has of its scripts."""
        scripts = set(scripts_in(self.command))
        return [str((each in scripts and kept_copy(Path(each))) or each) for each in self.command]

    @property
    def _look(self) -> str:
        return f"Look at {self.output or 'stdout.txt'} and stderr.txt in the folder of {self.name}."

    def _forget(self) -> None:
        self._process = self._begun_at = self._sampled = self._measured = self._clock_step = None
        self._fault = ""

    def _refuse_what_cannot_be(self) -> None:
        names = [measure.name for measure in self.measures]
        wrong = [] if self.command else ["command is empty"]
        if len(set(names)) < max(len(names), 1):
            wrong.append(f"columns yield the measures {names}")
        if wrong:
            raise PluginError(wrong[0], where=self.name, fix="Give a command, and columns of different measures.")
        has_place = any(_PLACE in word for word in self.command)
        if has_place != bool(self.output):
            problem = f"output is {self.output!r}, and the command has {'' if has_place else 'no '}{_PLACE}"
            fix = f"Name a file, as in output='rows.csv', and write {_PLACE} where the command tells its path."
            raise PluginError(problem, where=self.name, fix=fix)
