"""Supervises a program on another computer: sends the supervisor there over ssh, and writes down its events.

It is a program of its own on this machine, like the supervisor, with the same input and the same events; the output of
the remote program is written to files here. The remote supervisor ends everything once ssh ends, or once it has
received nothing for as long as its lease: then the network is cut.

The task has, in addition: `ssh`, the command that executes `BOOTSTRAP` on the other computer, and `where`, its name.
"""

import fcntl
import json
import os
import select
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

#: Python reads its program as one line of JSON, and not a byte more. Isolated, as modules of the user's may lie in the
#: home folder, where it is executed: json.py, signal.py.
BOOTSTRAP = (
    "exec python3 -I -S -c 'import json,os;"
    'exec(json.loads(b"".join(iter(lambda:os.read(0,1) or exit(1),b"\\n")).decode()))\''
)
#: How often a sign of life is sent to the remote supervisor, and how long it goes on without one, s.
_TOLD_EVERY, LEASE = 5.0, 30.0
#: How much longer than its own deadlines the remote supervisor may take to end everything, s.
_PATIENCE = 15.0
_LAST_WORDS = 4096


class _Relay:
    def __init__(self, task: dict[str, Any]) -> None:
        self._task = task
        self._files = {name: Path(task[f"std{name}"]).open("ab", buffering=0) for name in ("out", "err")}  # noqa: SIM115
        self._rest, self._said = b"", b""
        self._has_ended = self._is_gone = False
        self._is_told = False
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
            signal.signal(number, self._take_signal)

    def relay(self) -> None:
        try:
            self._ssh = subprocess.Popen(  # noqa: S603 - from `ssh_command`
                self._task["ssh"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        except OSError as error:
            _say(refused=f"ssh cannot be started: {error.strerror}")
            return
        self._send()
        self._follow()
        self._conclude()

    def _take_signal(self, *_: object) -> None:
        self._is_told = True

    def _send(self) -> None:
        program = Path(__file__).with_name("supervisor.py").read_text(encoding="utf-8")
        there = {**self._task, "stdout": None, "stderr": None, "lease": LEASE}
        for line in (program, {name: value for name, value in there.items() if name not in {"ssh", "where"}}):
            self._write(json.dumps(line).encode() + b"\n")

    def _write(self, data: bytes) -> None:
        if self._ssh.stdin is not None:
            with suppress(OSError):  # ssh has ended, which shows in the end of its output
                self._ssh.stdin.write(data)
                self._ssh.stdin.flush()

    def _follow(self) -> None:
        assert self._ssh.stdout is not None and self._ssh.stderr is not None  # noqa: S101, PT018 - for mypy
        streams = {self._ssh.stdout.fileno(): self._take, self._ssh.stderr.fileno(): self._hear}
        kill_at: float | None = None
        while streams:
            asking = [] if self._is_told else [0]
            ready = select.select([*asking, *streams], [], [], _TOLD_EVERY if kill_at is None else 0.2)[0]
            if 0 in ready:
                said = os.read(0, 4096)
                self._is_told = not said or b"stop" in said
            for stream in set(ready).intersection(streams):
                data = os.read(stream, 1 << 16)
                streams[stream](data)
                if not data:
                    del streams[stream]
            if kill_at is None:
                self._write(b"stop\n" if self._is_told else b"\n")
                kill_at = time.monotonic() + self._seconds() if self._is_told or self._has_ended else None
            elif time.monotonic() > kill_at:
                self._ssh.kill()

    def _seconds(self) -> float:
        last = self._task["last_seconds"] if self._task["last"] is not None else 0.0
        return float(self._task["grace"] + last + _PATIENCE)

    def _take(self, data: bytes) -> None:
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            event = _event(line)
            output = next((name for name in self._files if name in event), None)
            if output is not None:
                self._files[output].write(event[output].encode("latin-1"))
            else:
                self._has_ended |= "ended" in event or "refused" in event
                self._is_gone |= "gone" in event or "refused" in event
                _say(**event)

    def _hear(self, data: bytes) -> None:
        self._said = (self._said + data)[-_LAST_WORDS:]

    def _conclude(self) -> None:
        code = self._ssh.wait()
        if not self._is_gone:
            said = self._said.decode(errors="replace").strip()
            _say(lost=said or f"ssh ended with code {code}", at=time.time())


def _event(line: bytes) -> dict[str, Any]:
    """Return an event; empty for a line that the remote login shell has written, because of its ~/.bashrc."""
    try:
        # The shell may set the terminal's title before it, which does not end the line.
        event: dict[str, Any] = json.loads(b"{" + line.partition(b"{")[2])
    except ValueError:
        return {}
    return event


def _say(**event: object) -> None:
    os.write(1, json.dumps(event).encode() + b"\n")


def main() -> None:
    """Read the task and relay the events of the remote supervisor."""
    with os.fdopen(0, "rb", buffering=0, closefd=False) as unbuffered:  # it reads not a byte more
        task = json.loads(unbuffered.readline())
    fcntl.flock(1, fcntl.LOCK_EX | fcntl.LOCK_NB)
    _Relay(task).relay()


if __name__ == "__main__":
    main()
