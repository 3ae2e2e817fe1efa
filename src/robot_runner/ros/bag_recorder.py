"""ROS' own recorders, here or on the robot's computer, and when they have subscribed to their topics."""

from __future__ import annotations

import shlex
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.links.robot import Encoding, GraphListing
from robot_runner.core.links.ssh_command import BEGIN, execute, remedy, ssh_command
from robot_runner.measuring.meter_process import MeterProcess
from robot_runner.ros.graph_transport import until

#: The program that records and plays messages of each generation of ROS.
PROGRAMS = {Encoding.ROS1: "rosbag", Encoding.CDR: "ros2"}

#: How long a recorder may take to begin, and to finish its bag, s.
_STARTUP, _GRACE = 15.0, 30.0
#: For how long nothing may arrive of a bag that is fetched, s. All of it may take hours: Wi-Fi may carry less than
#: 1 MB/s, and a mission of a day leaves tens of GB.
_SILENCE = 120.0
#: How long ssh may take to end once all is unpacked, s; it does not where what it sends is no longer taken.
_ENDING = 5.0
#: How long a publisher takes to connect to a subscription that the graph knows, s: tenths, over Wi-Fi.
_CONNECTING = 0.5
#: As `passes_login`, of an input that cannot be gone back in: a shell reads no byte beyond a line.
_PASS_LOGIN = f"""while IFS= read -r line && [ "$line" != '{BEGIN}' ]; do :; done"""
_NOT_FINISHED = "the recorder has not finished the bag within {:g} s"
#: How often to look into the folder until the bag is finished, s.
_LOOK = 0.02

#: The signal at which each finishes its bag and ends. `rosbag` passes SIGTERM on to the program behind it as SIGINT,
#: but not SIGINT, which a terminal would send to both.
ENDING = {Encoding.ROS1: signal.SIGTERM, Encoding.CDR: signal.SIGINT}

#: How often the host sends a sign of life, s: where the network is cut, sshd notices only by sending that nobody is
#: there any more, and a recorder would go on for hours, and disturb later runs.
_BEAT = 10.0

#: Recording goes on until this script's input ends, which it does when ssh ends for any reason; then the recorder gets
#: its signal. The line of output behind BEGIN names the folder. Without `set -m` the recorder would ignore SIGINT.
_ON_HOST = """set -m
trap : INT TERM
folder=$(mktemp -d) && cd "$folder" || exit 1
{setup}
{command} >record.txt 2>&1 </dev/null &
recorder=$!
for i in $(seq 150); do ls bag* >/dev/null 2>&1 && break; kill -0 $recorder 2>/dev/null || break; sleep 0.1; done
kill -0 $recorder 2>/dev/null || {{ tail -n 1 record.txt >&2; exit 1; }}
echo "$folder"
while sleep {beat:g}; do echo; done </dev/null 2>/dev/null &
exec >/dev/null 2>&1
cat
kill -- -$!
kill -{signal} $recorder
wait $recorder
for i in $(seq 300); do ls ./*.active >/dev/null 2>&1 || break; sleep 0.1; done
touch done
"""


class BagProgram:
    """A recorder of ROS' own, from its start until it is closed; raises a `PluginError` if it cannot be started.

    The generation of ROS follows from the encoding of the messages; topics are given by their full names. It is
    executed on `host`, in one of ssh's forms (`localhost` is this machine), where the file `setup` is sourced first,
    such as `/opt/ros/humble/setup.bash`; `ssh_config` is used instead of the user's ssh config.
    """

    def __init__(
        self,
        encoding: Encoding,
        topics: Sequence[str],
        folder: Path,
        *,
        host: str = LOCAL,
        setup: str | None = None,
        ssh_config: Path | None = None,
    ) -> None:
        self._folder = folder
        self._host = host
        self._config = ssh_config
        self._encoding = encoding
        words = shlex.join(recording(encoding, topics))
        if host == LOCAL:
            sourced = f". {shlex.quote(setup)} && " if setup else ""
            command = ["bash", "-c", f"cd {shlex.quote(str(folder))} && {sourced}exec {words}"]
        else:
            sourced = f". {shlex.quote(setup)}" if setup else ""
            ending_signal = ENDING[encoding].name.removeprefix("SIG")
            script = _ON_HOST.format(setup=sourced, command=words, signal=ending_signal, beat=_BEAT)
            command = ssh_command(host, f"bash -c {shlex.quote(script)}", config=ssh_config)
        self._process = MeterProcess(command, output=None, folder=folder, clock=SystemClock())
        try:
            self._process.wait(self._has_begun, seconds=_STARTUP)
        except BaseException:  # the run ends now: what was begun on another computer is removed there, too
            self.close()
            raise
        if not self._process.is_running:
            ending = self._process.stop(ENDING[encoding], grace=_GRACE)
            problem = f"{PROGRAMS[encoding]} ended at once: {ending.complaint}"
            fix = remedy(host, self._process.said) if host != LOCAL else "Source the setup file of ROS (`setup`)."
            raise PluginError(problem, where=f"RosBag on {host}", fix=fix)

    def close(self) -> str | None:
        """End it, fetch the bag from another computer, and return what went wrong, if anything did."""
        if self._host == LOCAL:
            ending = self._process.stop(ENDING[self._encoding], grace=_GRACE)
            problem = self._unfinished()
        else:
            ending = self._process.stop(signal.SIGTERM, grace=_GRACE)
            problem = self._fetched()
        if problem is not None:
            return problem
        return None if ending.was_asked else f"the recorder ended by itself: {ending.complaint}"

    def _unfinished(self) -> str | None:
        """Wait for the recorder behind `rosbag`, which outlives it: an unfinished bag is called `.active`."""
        is_finished = until(lambda: not any(self._folder.glob("*.active")), _GRACE)
        return None if is_finished else _NOT_FINISHED.format(_GRACE)

    def _has_begun(self) -> bool:
        if self._host != LOCAL:
            return self._there is not None
        return any(path.name.startswith("bag") for path in self._folder.iterdir())

    @property
    def _there(self) -> str | None:
        """The folder of the bag on the host, once it is told there."""
        said = [record.text for record in self._process.records]
        return said[said.index(BEGIN) + 1] if BEGIN in said[:-1] else None

    def _fetched(self) -> str | None:
        """Copy the host's folder into ours, and remove it there once all of it is here; return what went wrong."""
        if self._there is None:
            return "the recorder on the robot did not say where its bag is"
        remote = shlex.quote(self._there)
        # The script finishes the bag a moment after its ssh has ended.
        wait = f"for i in $(seq {round(10 * _GRACE)}); do [ -e {remote}/done ] && break; sleep 0.1; done"
        command = ssh_command(self._host, f"{wait}; tar -C {remote} -cf - .", config=self._config)
        problem = _unpacked(command, self._folder)
        if problem is None and not (self._folder / "done").exists():
            problem = _NOT_FINISHED.format(_GRACE)
        if problem is not None:
            return f"{problem}; it is in {remote} on {self._host}"
        # Only now, as a connection may be cut when the host has sent all of it and we have received some of it.
        with suppress(OSError, subprocess.TimeoutExpired):
            execute(ssh_command(self._host, f"rm -rf {remote}", config=self._config), timeout=_GRACE)
        return None


def recording(encoding: Encoding, topics: Sequence[str]) -> list[str]:
    """Return the command that records topics into `bag.bag`, or into the folder `bag`, until it gets SIGINT."""
    if encoding is Encoding.ROS1:
        return ["rosbag", "record", "--quiet", "-O", "bag.bag", *topics]
    return ["ros2", "bag", "record", "-o", "bag", *topics]


def _unpacked(command: Sequence[str], folder: Path) -> str | None:
    """Unpack the archive that a host writes, as it comes, since a bag may be large; return what went wrong."""
    with tempfile.TemporaryFile() as said, _started(command, said) as sent:
        unpacking = ["sh", "-c", f'{_PASS_LOGIN}; exec tar -C "$1" -xof - --no-same-permissions', "sh", str(folder)]
        with subprocess.Popen(  # noqa: S603  # an argument list
            unpacking, stdin=sent.stdout, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        ) as tar:
            try:
                refused = _last_words(tar, folder)
            except BaseException as error:  # also where the run ends now
                sent.kill()  # before its output is closed, so that it does not complain of that
                tar.kill()
                if isinstance(error, subprocess.TimeoutExpired):
                    return f"the bag could not be fetched: nothing came for {_SILENCE:g} s"
                raise
        try:
            sent.wait(_ENDING)
        except subprocess.TimeoutExpired:
            sent.kill()
        said.seek(0)
        complaint = said.read() if (sent.wait() or 0) > 0 else refused if tar.returncode else None
    if complaint is None:
        return None
    return f"the bag could not be fetched: {complaint.decode(errors='replace').strip()[-200:]}"


def _last_words(tar: subprocess.Popen[bytes], folder: Path) -> bytes:
    """Return what it complained of, once it has ended; let it time out only while the folder does not grow."""
    arrived = _size(folder)
    while True:
        try:
            return tar.communicate(timeout=_SILENCE)[1]
        except subprocess.TimeoutExpired:
            before, arrived = arrived, _size(folder)
            if arrived == before:
                raise


def _size(folder: Path) -> int:
    return sum(path.lstat().st_size for path in folder.rglob("*"))


def _started(command: Sequence[str], said: IO[bytes]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(  # noqa: S603  # an argument list; the host's name was checked
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=said, start_new_session=True
    )


def subscriptions_of(link: GraphListing, topics: Sequence[str]) -> dict[str, int]:
    """Return the number of subscribers of each topic, by its full name; empty where the graph cannot be listed."""
    try:
        return {topic: len(link.subscribers(topic)) for topic in topics}
    except LinkError:  # a rosbridge without rosapi
        return {}


def await_subscriptions(link: GraphListing, before: Mapping[str, int], *, seconds: float) -> list[str]:
    """Wait, for `seconds` at most, until each topic has more subscribers than before; return those that have not.

    A recorder opens its file first, and subscribes after that: what is published meanwhile is not in the bag.
    """
    deadline = time.monotonic() + seconds
    missing = list(before)
    while missing and time.monotonic() < deadline:
        now = subscriptions_of(link, missing)
        missing = [topic for topic in missing if topic in now and now[topic] <= before[topic]]
        if missing:
            time.sleep(_LOOK)
    time.sleep(_CONNECTING)
    return missing
