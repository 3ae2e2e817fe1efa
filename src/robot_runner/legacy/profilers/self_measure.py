"""Experiment Runner's own measurement of each run with EnergiBridge (`self_measure`)."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Iterable, Sequence
from typing import ClassVar

from robot_runner.core.errors import Finding
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure
from robot_runner.core.plugin import Circumstances, Profiler
from robot_runner.legacy.profilers.programs import Program

#: The column that it fills.
COLUMN = "self-measure"

_DEFAULT_BINARY = "/usr/local/bin/energibridge"
#: EnergiBridge's summary: `Energy consumption in joules: 12.3 for 4.5 sec of execution.`
_JOULES = re.compile(r"joules:\s*([0-9]+(?:\.[0-9]+)?)")


class SelfMeasure(Profiler):
    """Measures the energy of this machine over a whole run, by EnergiBridge's own summary.

    The earlier tool defines this column as the whole run, from `start_run` to `stop_run`: its window is not the
    mission, and is not meant to be, so nothing about it is doubted.

    Args:
        binary: the program; None is where Experiment Runner looked for it.
        logfile: the name of its log in the run's folder; None for none.

    Example:
        >>> SelfMeasure().measures[0].name
        'self-measure'
    """

    measures: Sequence[Measure] = (
        Measure(
            COLUMN,
            "J",
            "Energy of this machine's processor over the whole run, not the mission alone, by EnergiBridge's summary.",
        ),
    )
    #: It has one total for a whole run.
    probe_s: float | None = None
    needs: ClassVar[str] = "EnergiBridge, at self_measure_bin."

    def __init__(
        self, *, name: str | None = None, binary: str | os.PathLike[str] | None = None, logfile: object = None
    ) -> None:
        super().__init__(name=name)
        self.binary = os.fspath(binary or _DEFAULT_BINARY)
        self.logfile = logfile
        self._program: Program | None = None
        self._joules: float | None = None

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return what stands in the way: no such program, or a machine that it does not measure."""
        del circumstances
        off = "write self_measure = False."
        if sys.platform != "linux":
            yield Finding.error("self_measure", "self_measure measures on Linux alone", "Write self_measure = False.")
        elif shutil.which(self.binary) is None:
            problem = f"there is no program {self.binary!r}"
            yield Finding.error("self_measure_bin", problem, f"Install EnergiBridge and name its path, or {off}")

    def start_run(self, context: RobotRunnerContext) -> None:
        """Start EnergiBridge beside the run."""
        log = "/dev/null" if self.logfile is None else str(context.run_folder / str(self.logfile))
        self._joules = None
        self._program = Program([self.binary, "--summary", "-o", log, "--", "sleep", "1000000"], name="EnergiBridge")

    def stop_run(self, context: RobotRunnerContext) -> None:
        """End EnergiBridge, and read its summary."""
        program, self._program = self._program, None
        if program is None:
            return
        found = _JOULES.search(program.end())
        if found is None:
            context.doubt("EnergiBridge gave no summary", fix=f"Try {self.binary} --summary -- sleep 1 in a terminal.")
        else:
            self._joules = round(float(found[1]), 3)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the energy."""
        context.publish(COLUMN, self._joules)
