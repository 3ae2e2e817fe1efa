"""The base classes of Experiment Runner's profilers: programs and devices that are started and stopped, and have a log.

Configs and forks derive their own profilers from these classes, so that attributes and hooks keep their names.
"""

from __future__ import annotations

import platform
import shlex
import shutil
import threading
from abc import ABC, abstractmethod
from collections import UserDict
from collections.abc import Iterable, Mapping
from contextlib import suppress
from enum import Enum
from os import X_OK, access, geteuid
from queue import Empty, Queue
from typing import Any, ClassVar

from robot_runner.core.errors import LinkError, PluginError, did_you_mean
from robot_runner.legacy.profilers.programs import Program

_CLOSING_S = 5.0
_WORKER = "DeviceWorker"


class ParameterDict(UserDict[Any, Any]):
    """The parameters of a program, each with all its spellings: `{("-o", "--output"): str}`.

    Example:
        >>> "--output" in ParameterDict({("-o", "--output"): str})
        True
    """

    def __setitem__(self, key: Any, item: Any) -> None:
        super().__setitem__((key,) if isinstance(key, str) else tuple(key), item)

    def __getitem__(self, key: Any) -> Any:
        for spellings, value in self.data.items():
            if set((key,) if isinstance(key, str) else key) <= set(spellings):
                return value
        raise KeyError(key)

    def __contains__(self, key: object) -> bool:
        wanted = {key} if isinstance(key, str) else set(key) if isinstance(key, Iterable) else {key}
        return any(wanted <= set(spellings) for spellings in self.data)


class ValueRef:
    """A reference to a value of a parameter, which is read when the program is started."""

    def __init__(self, value: Any) -> None:
        self.value = value


class DataSource(ABC):
    """A source of data that measures between `start` and `stop`, and writes a log."""

    supported_platforms: ClassVar[Any] = ()
    source_name: ClassVar[Any] = ""

    def __init__(self) -> None:
        self._validate_platform()

    def _validate_platform(self) -> None:
        if self.supported_platforms and platform.system() not in self.supported_platforms:
            raise PluginError(
                f"{self.source_name} measures on {' and '.join(self.supported_platforms)}, "
                f"and this is {platform.system()}",
                where=type(self).__name__,
                fix="Choose another profiler, or execute the experiment there.",
            )

    def is_admin(self) -> bool:
        """Return whether this process runs as root."""
        return geteuid() == 0

    @abstractmethod
    def start(self) -> None:
        """Start measuring."""

    @abstractmethod
    def stop(self) -> Any:
        """Stop measuring."""

    @staticmethod
    def parse_log(logfile: Any) -> Any:
        """Return the contents of a log."""
        raise NotImplementedError(logfile)


class CLISource(DataSource):
    """A program of the command line that measures until it is stopped.

    Attributes:
        args: its parameters, by spelling; the value is None if a parameter has none.
        requires_admin: whether it needs root: then it is started by `sudo`, unless the user is root.
    """

    parameters: ClassVar[Any] = ParameterDict()

    def __init__(self) -> None:
        super().__init__()
        self.requires_admin = False
        self.args: dict[str, Any] = {}
        self.process: Any = None
        self._program: Program | None = None
        self._logfile = ValueRef(None)

    def __del__(self) -> None:
        program = getattr(self, "_program", None)
        if program is not None:
            program.kill()

    @property
    def logfile(self) -> Any:
        """The file of the samples."""
        return self._logfile.value

    @logfile.setter
    def logfile(self, value: Any) -> None:
        self._logfile.value = value

    def update_parameters(self, add: Mapping[str, Any] | None = None, remove: Iterable[str] = ()) -> None:
        """Add and remove parameters.

        Raises:
            PluginError: there is no such parameter.
        """
        self._validate_parameters(add or {})
        self.args.update(add or {})
        for name in remove:
            self.args.pop(name, None)

    def start(self) -> None:
        """Start the program.

        Raises:
            PluginError: the program cannot be started.
            LinkError: the program failed at once.
        """
        self._program = Program(self._format_cmd(), name=str(self.source_name))
        self.process = self._program.process

    def stop(self, wait: bool = False) -> str:
        """Stop the program, or `wait` until it ends by itself; returns its output.

        Raises:
            LinkError: the program had to be killed.
        """
        if self._program is None:
            return ""
        program, self._program = self._program, None
        return program.end(wait=wait)

    def _validate_platform(self) -> None:
        super()._validate_platform()
        name = str(self.source_name)
        if name and shutil.which(name) is None and not access(name, X_OK):
            fix = f"Install {name}, or name its path."
            raise PluginError(f"the program {name} is not there", where=type(self).__name__, fix=fix)

    def _validate_parameters(self, parameters: Mapping[str, Any]) -> None:
        spellings = [spelling for known in self.parameters for spelling in known]
        for name in parameters:
            if name not in self.parameters:
                fix = did_you_mean(name, spellings)
                raise PluginError(f"{self.source_name} has no parameter {name!r}", where=type(self).__name__, fix=fix)

    def _format_cmd(self) -> str:
        """Return the command line, which derived profilers may extend."""
        self._validate_parameters(self.args)
        words = ["sudo"] if self.requires_admin and not self.is_admin() else []
        words.append(str(self.source_name))
        for name, value in self.args.items():
            words.append(name)
            if value is not None:
                words.append(shlex.quote(_shown(value)))
        return " ".join(words)


class DeviceSource(DataSource):
    """A device that is read in its own thread, every `sample_frequency` milliseconds.

    A derived profiler's `log` reads until `stop_thread` is set, and puts the readings into `thread_queue`.
    """

    def __init__(self) -> None:
        super().__init__()
        self.device_handle: Any = None
        self.process: Any = None
        self.sample_frequency: Any = None
        self.stop_thread = threading.Event()
        self.thread_queue: Queue[Any] = Queue(maxsize=1)

    def log(self) -> Any:
        """Read until `stop_thread` is set; a derived profiler's `log` calls this one first.

        Raises:
            PluginError: no device was opened, or the caller is not `start`.
        """
        if threading.current_thread().name != _WORKER:  # `process` is None if `stop` was called first
            raise PluginError("log was called", where=type(self).__name__, fix="Call start instead.")

    def start(self) -> None:
        """Start reading."""
        if self.process is not None:
            raise PluginError("the device was started already", where=type(self).__name__, fix="Call stop first.")
        self.stop_thread.clear()
        self.process = threading.Thread(target=self.log, name=_WORKER, daemon=True)
        self.process.start()

    def stop(self) -> Any:
        """Stop reading, and return the readings.

        Raises:
            LinkError: the thread had ended before, or does not end.
        """
        if self.process is None:
            return None
        worker, self.process = self.process, None
        self.stop_thread.set()
        with suppress(Empty):
            read = self.thread_queue.get(timeout=max(_CLOSING_S, 2e-3 * float(self.sample_frequency or 0)))
            worker.join(_CLOSING_S)
            return read
        raise LinkError("the device delivered nothing", where=type(self).__name__, fix="Look at the log of the run.")


def _shown(value: Any) -> str:
    if isinstance(value, ValueRef):
        return str(value.value)
    if isinstance(value, Iterable) and not isinstance(value, str | Enum):
        return ",".join(map(_shown, value))
    return str(value.value if isinstance(value, Enum) else value)
