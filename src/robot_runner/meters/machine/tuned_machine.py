"""The plugin that sets up this machine for an experiment, and the process that restores it if all others are killed."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from robot_runner.core.design.numeric_range import is_whole
from robot_runner.core.errors import Finding, PluginError, StorageError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.execution.processes import needed_process
from robot_runner.core.plugin import Circumstances, Plugin, System
from robot_runner.measuring.parameter_checks import check_list
from robot_runner.meters.machine.tuning import Machine, Wishes

if TYPE_CHECKING:
    from robot_runner.core.config.parameters import Parameters

_log = logging.getLogger(__name__)

_SCOPES = ("experiment", "run")
_MODULE = "robot_runner.meters.machine.tuned_machine"
#: How long the guardian may take to end when it is no longer needed, and an experiment that has let go of it, s.
_PATIENCE = 5.0
_LOOK = 0.02


def check_left_behind(where: str, parameters: Parameters, plugins: Sequence[Plugin]) -> list[Finding]:
    """Return a finding if this machine is still set up, by a killed process or by hand; a check of each experiment."""
    del where, parameters
    try:
        return [] if any(isinstance(plugin, Tune) for plugin in plugins) else Machine().left_behind("this machine")
    except StorageError:  # without a home folder there is no file of state
        return []


class Tune(System):
    """Sets up this machine before the experiment or before each run, and restores it afterwards, even if killed.

    The previous settings are written to a file first. If the experiment is killed, a separate process restores them; if
    that is killed as well, the next experiment with a `Tune` does, or `robot-runner tune --restore`.

    Args:
        name: distinguishes several instances; None for the class's name.
        governor: of the processor's frequency, such as `performance`.
        turbo: whether the processor may exceed its nominal frequency.
        cores: reserved for the experiment; all other threads that may be moved are kept off them meanwhile.
        drop_caches: whether the kernel drops its caches of files before each run.
        scope: `experiment`, or `run` to set the machine up for each run and restore it in between.
        root: the folder with this machine's `proc` and `sys`.
        state: the file for the previous settings; None takes one in the user's folder of state.

    Raises:
        PluginError: there is no setting, or no such scope.

    Example:
        >>> Tune(governor="performance", turbo=False).wishes.governor
        'performance'
    """

    needs: ClassVar[str] = "Linux, and the right to write to /sys: root, mostly."

    def __init__(
        self,
        *,
        name: str | None = None,
        governor: str | None = None,
        turbo: bool | None = None,
        cores: Sequence[int] = (),
        drop_caches: bool = False,
        scope: str = "experiment",
        root: str | Path = "/",
        state: str | Path | None = None,
    ) -> None:
        super().__init__(name=name)
        if scope not in _SCOPES:
            raise PluginError(f"scope is {scope!r}", where=self.name, fix=did_you_mean(scope, _SCOPES))
        check_list(self.name, cores=cores)
        odd = [core for core in cores if not is_whole(core) or core < 0]
        if odd:
            raise PluginError(f"there is no core {odd[0]!r}", where=self.name, fix="Number the cores from 0.")
        self.wishes = Wishes(governor, turbo, tuple(dict.fromkeys(cores)), drop_caches)
        if self.wishes == Wishes():
            fix = "Ask for governor, turbo, cores or drop_caches, or leave the plugin out."
            raise PluginError("nothing is to be set", where=self.name, fix=fix)
        self.scope = scope
        self.is_for_all_runs = scope == "experiment" and self.wishes != Wishes(drops_caches=True)  # each run drops them
        self.machine = Machine(Path(root), None if state is None else Path(state))
        self._guardian: subprocess.Popen[bytes] | None = None

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: the machine has no such setting, or it may not be changed."""
        del circumstances
        return self.machine.findings(f"plugin {self.name}", self.wishes)

    def before_experiment(self) -> None:
        """Set the machine up for the experiment, or restore what a killed process left."""
        words = [sys.executable, "-P", "-m", _MODULE, str(self.machine.root), str(self.machine.state.absolute())]
        # Its input ends when this process and all its forks have ended: then nothing measures any more.
        with needed_process("restoring the machine afterwards"):
            self._guardian = subprocess.Popen(words, stdin=subprocess.PIPE, start_new_session=True)  # noqa: S603 - ours
        if self.scope == "experiment":
            self.machine.apply(self.wishes, owner=os.getpid())
        else:
            self.machine.restore()

    def start_run(self, context: RobotRunnerContext) -> None:
        """Set the machine up for this run, and drop the caches."""
        del context
        if self.scope == "run":
            self.machine.apply(self.wishes, owner=os.getpid())
        if self.wishes.drops_caches:
            self.machine.drop_caches()

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Restore the settings from before the run."""
        if self.scope == "run":
            for problem in self.machine.restore():
                context.warn(problem, fix="Set it by hand.")

    def after_experiment(self) -> None:
        """Restore the settings from before the experiment."""
        for problem in self.machine.restore():
            _log.warning("%s: %s", self.name, problem)
        guardian, self._guardian = self._guardian, None
        if guardian is not None and guardian.stdin is not None:
            guardian.stdin.close()
            try:
                guardian.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                guardian.kill()
                guardian.wait()


def _guard(root: Path, state: Path) -> None:
    """Wait until no other process is left that could restore the machine, and do it; usually it is done already."""
    nobody = (None, os.getppid())  # our own experiment's process
    sys.stdin.buffer.read()
    machine, deadline = Machine(root, state), time.monotonic() + _PATIENCE
    while machine.in_use_by not in nobody and time.monotonic() < deadline:  # by a run that is ending
        time.sleep(_LOOK)
    if machine.in_use_by in nobody:  # else another experiment has set it up: we are late (SIGSTOP, a busy machine)
        machine.restore()


if __name__ == "__main__":
    _guard(Path(sys.argv[1]), Path(sys.argv[2]))
