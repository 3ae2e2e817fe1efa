"""Programs that are forked from a process which has imported what they import: a second of processor time less each.

Each is otherwise as one that was started: it leads a session, has its own output, gets signals, and can be killed.
"""

from __future__ import annotations

import atexit
import ctypes
import gc
import importlib
import json
import os
import runpy
import select
import socket
import struct
import subprocess
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["MARK", "RUNS", "SIMULATES", "ForkedProgram", "child_processes"]

#: By this variable a test knows all processes of what it has started: 32 characters.
MARK = "ROBOT_RUNNER_TEST_MARK"
#: What `robot_runner run` imports before it reads the config; and `robot_runner simulate`.
RUNS = (
    *("robot_runner.cli.main", "robot_runner.cli.commands.run", "robot_runner.cli.executing"),
    *("robot_runner.cli.screens.plain", "robot_runner.core.execution.orchestrator"),
)
SIMULATES = (
    *("robot_runner.cli.main", "robot_runner.simulator.commands.simulate"),
    *("robot_runner.simulator.graph_simulation", "robot_runner.simulator.graph_robot"),
    *("robot_runner.ros.dds_transport", "rospy"),  # neither starts a thread
)
_NUMBER = struct.Struct("=q")
_MOST = 1 << 20  # bytes of a request
_ENVIRONMENT = 47  # of the fields behind the name in /proc/self/stat: where the environment begins


class ForkedProgram(subprocess.Popen[Any]):
    """`python -m module` with these words, forked in a session of its own; its keyword arguments are those of `Popen`.

    Args:
        module: that is executed.
        words: that it gets.
        imported: modules that were imported before.
        env: its environment, with a `MARK` where a test looks for its processes.
    """

    def __init__(self, module: str, words: Sequence[str], imported: tuple[str, ...], **settings: Any) -> None:
        self._imported = imported
        self._told = -1
        super().__init__([module, *words], start_new_session=True, **settings)

    def _execute_child(self, args: Any, *settings: Any) -> None:
        """Have it forked: called by `Popen`, which has made the pipes."""
        cwd, env, pipes = settings[4], settings[5], settings[9:15]
        streams = [settings[9], settings[12], settings[14]]
        env = dict(os.environ if env is None else env)
        request = {"words": args, "env": env, "cwd": str(cwd or Path.cwd())}
        self._told, telling = os.pipe()
        with Path(os.devnull).open("r+b", buffering=0) as nothing:
            given = [nothing.fileno() if each == -1 else each for each in streams]
            socket.send_fds(_nursery(self._imported), [json.dumps(request).encode()], [*given, telling])
        os.close(telling)
        self.pid = self._number()
        self._child_created = True
        self._close_pipe_fds(*pipes)

    def _number(self) -> int:
        number: int = _NUMBER.unpack(os.read(self._told, _NUMBER.size))[0]
        return number

    def _try_wait(self, wait_flags: int) -> tuple[int, int]:
        """Return its id and its wait status once it has ended: also called by `Popen`."""
        if not select.select([self._told], [], [], 0.0 if wait_flags & os.WNOHANG else None)[0]:
            return 0, 0
        status = self._number()
        os.close(self._told)
        return self.pid, status

    def _internal_poll(self, *_: object, **__: object) -> int | None:
        if self.returncode is None:
            pid, status = self._try_wait(os.WNOHANG)
            if pid:
                self._handle_exitstatus(status)
        return self.returncode


def child_processes() -> set[int]:
    """Return the children of this process that were not reaped; the processes that fork programs stay among them."""
    import psutil  # here, as forked programs are to import it by themselves

    return {child.pid for child in psutil.Process().children()}


@cache
def _nursery(imported: tuple[str, ...]) -> socket.socket:
    """Start the process that forks programs; it ends when this one closes the connection, or ends."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for each in (ours, theirs):
        each.setblocking(True)  # rospy sets a timeout for all sockets of its process
    with theirs:
        nursery = subprocess.Popen(
            [sys.executable, str(Path(__file__)), str(theirs.fileno()), *imported],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            env={**os.environ, MARK: "0" * 32},
            start_new_session=True,
        )
    atexit.register(_end, ours, nursery)
    return ours


def _end(connection: socket.socket, nursery: subprocess.Popen[bytes]) -> None:
    """End it and wait for it, so that its processor time is among that of the tests."""
    connection.shutdown(socket.SHUT_RDWR)  # forks of this process may have it, too
    nursery.wait()


def _be_nursery(connection: socket.socket, imported: Sequence[str]) -> list[str]:
    """Fork what is asked for; return the words of a program in its own process."""
    for module in imported:
        with suppress(ImportError):  # what is not installed
            importlib.import_module(module)
    gc.collect()
    gc.freeze()
    while True:
        request, descriptors, _, _ = socket.recv_fds(connection, _MOST, 4)
        _reap()
        if not request:
            os._exit(0)
        if os.fork() == 0:
            connection.close()
            return _begun(json.loads(request), descriptors)
        for each in descriptors:
            os.close(each)


def _reap() -> None:
    """Wait for the parents of programs that have ended."""
    with suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            """There may be more of them."""


def _begun(request: dict[str, Any], descriptors: Sequence[int]) -> list[str]:
    *streams, telling = descriptors
    if (pid := os.fork()) != 0:
        _tell_end(pid, streams, telling)
    os.close(telling)
    os.setsid()
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.environ.clear()
    os.environ.update(request["env"])
    _mark(request["env"].get(MARK, ""))
    os.chdir(request["cwd"])
    sys.path[0] = request["cwd"]
    words: list[str] = request["words"]
    return words


def _tell_end(pid: int, streams: Sequence[int], telling: int) -> NoReturn:
    for each in streams:
        os.close(each)
    os.write(telling, _NUMBER.pack(pid))
    os.write(telling, _NUMBER.pack(os.waitpid(pid, 0)[1]))
    os._exit(0)


def _mark(mark: str) -> None:
    """Write the mark to where /proc shows the environment with which a process was started."""
    shown = Path("/proc/self/environ").read_bytes()
    place = shown.index(f"{MARK}=".encode()) + len(MARK) + 1
    begin = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[_ENVIRONMENT])
    ctypes.memmove(begin + place, mark.encode().ljust(32, b"0"), 32)


if __name__ == "__main__":
    sys.argv[:] = _be_nursery(socket.socket(fileno=int(sys.argv[1])), sys.argv[2:])
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
