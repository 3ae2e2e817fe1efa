"""A config's hosts in each run: connected before the robot moves; their files are fetched when it stops."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from robot_runner.core.config.parameters import Parameters
from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.declared_host import Host, host_findings
from robot_runner.core.plugin import Circumstances, Plugin, System
from robot_runner.core.words import shown_duration

_NAME = "host_files"
#: The share of the grace that fetching may take after a failure: the rest is for the robot and the other plugins.
_SHARE_OF_GRACE = 0.6
#: The timeout for a file once the time is over, s: fetching it then fails as too late.
_SHORTEST = 0.001
#: The resolution of clocks and file times of hosts, s.
_STEP = 2.0


def bring_host_files(parameters: Parameters, plugins: Sequence[Plugin]) -> Sequence[Plugin]:
    """Return the plugin that looks after the hosts of a config, where it names any."""
    del plugins
    return [HostFiles(parameters.hosts, parameters.grace_in_s)] if parameters.hosts else []


class HostFiles(System):
    """Connects to the hosts of a config when a run starts, and fetches their files when it stops.

    It begins before all other plugins and ends after them, so that what they write there is fetched, too. A host that
    cannot be reached fails the run before anything moves; files that do not come are warnings of the run. A run that
    failed may take `grace` s to close.
    """

    needs: ClassVar[str] = "The computers that the config's `hosts` names."

    def __init__(self, hosts: Mapping[str, Host], grace: float) -> None:
        super().__init__(name=_NAME)
        self._hosts = hosts
        self._grace = grace
        self._run_began: float | None = None
        self._begun: dict[str, float] = {}

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return what a run needs for itself: only the hosts, which the experiment names."""
        del robot
        return ()

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return which hosts cannot be reached, or have the name of a plugin, whose folder they would share."""
        names = {plugin.name for plugin in circumstances.plugins}
        for name, host in self._hosts.items():
            yield from host_findings("config", name, host, circumstances.robot)
            if name in names:
                problem = f"the host is named {name!r}, and so is a plugin: both would keep files in one folder"
                yield Finding.error(f"hosts[{name!r}]", problem, "Give one of them another name.")

    def before_run(self) -> None:
        """Note when the run began: callbacks may use hosts from here on."""
        self._run_began = time.time()

    def start_run(self, context: RobotRunnerContext) -> None:
        """Connect to each host, and read its clock."""
        for name, host in self._hosts.items():
            now = time.time()
            since = 0.0 if self._run_began is None else now - self._run_began  # a fresh interpreter was not told
            if not host.is_local:
                told = context.host(name).run("date +%s", timeout_s=host.fetch_within_s, check=False).output.strip()
                now = float(told) if told.isdecimal() else 0.0
            self._begun[name] = now - since

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Fetch the declared files of each host; after a failure as many as the grace allows."""
        end = time.monotonic() + self._grace * _SHARE_OF_GRACE
        for name, host in self._hosts.items():
            if not host.fetch:
                continue
            seconds = host.fetch_within_s
            if context.ending.has_failed:
                seconds = min(seconds, max(0.0, end - time.monotonic()))
            deadline = time.monotonic() + seconds
            try:
                for pattern in host.fetch:
                    left = max(_SHORTEST, deadline - time.monotonic())
                    self._look_at(context, name, pattern, context.host(name).fetch(pattern, timeout_s=left))
            except LinkError as error:
                context.warn(f"nothing was fetched from {name}: {error.problem}", fix=error.fix)

    def _look_at(self, context: RobotRunnerContext, name: str, pattern: str, came: Sequence[Path]) -> None:
        """Warn where no fetched file was written since the run began: they may be those of an earlier run."""
        before = self._begun.get(name, 0.0) - max((path.stat().st_mtime for path in came), default=math.inf)
        if before > _STEP:
            problem = f"files fetched from {name} as {pattern} were written {shown_duration(before)} before the run"
            context.warn(problem, fix="Check whether this run wrote it; have each run remove what an earlier one left.")
