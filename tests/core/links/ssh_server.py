"""A real sshd on loopback: its own port, its own keys, started and stopped by its process id."""

from __future__ import annotations

import getpass
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from tests.loopback_port import claim_port

_SEARCHED = os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/sbin", "/usr/local/sbin", "/sbin"])
_SEPARATED = Path("/run/sshd")
_DEADLINE = 60.0

_SERVER = """\
Port {port}
ListenAddress 127.0.0.1
HostKey {folder}/host_key
PidFile none
AuthorizedKeysFile {folder}/user_key.pub
AuthenticationMethods publickey
PasswordAuthentication no
KbdInteractiveAuthentication no
PermitRootLogin prohibit-password
StrictModes no
UsePAM no
PrintMotd no
UseDNS no
KexAlgorithms curve25519-sha256
SetEnv {variables}
"""
#: A bash that sshd starts reads the user's .bashrc, which may take long; one that takes itself for the second does not.
_NO_BASHRC = "SHLVL=2"

_CLIENT = """\
Host robot
    HostName 127.0.0.1
    Port {port}
    User {user}
    IdentityFile {folder}/user_key
    IdentitiesOnly yes
    UserKnownHostsFile {folder}/known_hosts
    GlobalKnownHostsFile none
    StrictHostKeyChecking yes
"""


#: An sshd has two processes for a connection; of a user other than root, the second one outlives the first.
_REBOOT = """\
#!/bin/sh
echo once >>{folder}/reboots
setsid sh -c '
sleep 0.2
old=$(cat {folder}/sshd.pid)
kill -KILL $(pgrep -P "$(pgrep -d, -P $old)") $(pgrep -P $old) $old
for _ in $(seq 600); do [ -e {folder}/missed ] && break; sleep 0.1; done
rm -f {folder}/missed
sleep 0.5
{sshd} -D -e -f {folder}/sshd_config </dev/null >>{folder}/sshd.log 2>&1 &
echo $! >{folder}/sshd.pid
' </dev/null >/dev/null 2>&1 &
"""


def needed(name: str) -> str:
    """Return the path of a program of OpenSSH; without it, the tests that need it are skipped."""
    found = shutil.which(name, path=_SEARCHED)
    if found is None:
        package = "openssh-server" if name == "sshd" else "openssh-client"
        pytest.skip(f"{name} is not installed (Debian, Ubuntu: sudo apt install {package})")
    return found


class SshServer:
    """An sshd that lets the user of the tests in, as host `robot` of the config `config`.

    Args:
        folder: for its files.
        environment: of its sessions.
        line: one more line of its configuration.

    Attributes:
        config: for `ssh -F`.
    """

    def __init__(self, folder: Path, *, environment: dict[str, str] | None = None, line: str = "") -> None:
        self.folder = folder
        self.config = folder / "ssh_config"
        sshd, keygen = needed("sshd"), needed("ssh-keygen")
        needed("ssh")
        for key in ("host_key", "user_key"):
            subprocess.run([keygen, "-q", "-t", "ed25519", "-N", "", "-f", folder / key], check=True, timeout=30)
        self.port = claim_port()
        variables = [_NO_BASHRC, *(f'"{name}={value}"' for name, value in (environment or {}).items())]
        configured = _SERVER.format(port=self.port, folder=folder, variables=" ".join(variables))
        (folder / "sshd_config").write_text(f"{configured}{line}\n")
        self.config.write_text(_CLIENT.format(port=self.port, folder=folder, user=getpass.getuser()))
        self.know((folder / "host_key.pub").read_text())
        self._provide_separation()
        self._log = (folder / "sshd.log").open("wb")
        self._process = subprocess.Popen(
            [sshd, "-D", "-e", "-f", folder / "sshd_config"],
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=self._log,
            start_new_session=True,
        )
        self._await_port()

    def know(self, key: str) -> None:
        """Have the client know the host by this key."""
        kind, data, *_ = key.split()
        (self.folder / "known_hosts").write_text(f"[127.0.0.1]:{self.port} {kind} {data}\n")

    def reboot_script(self) -> Path:
        """Return a script that stands for `reboot` on the host: it ends this sshd, and starts it again.

        It is away until `miss` tells that this was noticed, and for half a second from then on. The process id of the
        sshd that was started last stands in `sshd.pid`; `stop` ends that one, too.
        """
        (self.folder / "sshd.pid").write_text(str(self._process.pid))
        script = self.folder / "reboot.sh"
        script.write_text(_REBOOT.format(folder=self.folder, sshd=needed("sshd")))
        script.chmod(0o755)
        return script

    def miss(self) -> None:
        """Tell that somebody has noticed that the server is away."""
        (self.folder / "missed").touch()

    def cut(self) -> None:
        """End the connections that are open, as a network that fails would; the server goes on."""
        self._signal_connections(signal.SIGKILL)

    def stall(self) -> None:
        """Have nothing pass over the connections that are open, as a network that nobody is told of; new ones can."""
        self._signal_connections(signal.SIGSTOP)

    def _signal_connections(self, number: signal.Signals) -> None:
        for pid in _descendants(self._process.pid):
            if "sshd" in _name(pid):
                with suppress(ProcessLookupError):
                    os.kill(pid, number)

    def stop(self) -> None:
        """End the server and its connections."""
        self.cut()
        self._end_restarted()
        self._process.terminate()
        try:
            self._process.wait(_DEADLINE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(_DEADLINE)
        self._log.close()

    def _end_restarted(self) -> None:
        recorded = self.folder / "sshd.pid"
        if not recorded.exists() or int(recorded.read_text()) == self._process.pid:
            return
        started = int(recorded.read_text())
        for pid in (*_descendants(started), started):
            if "sshd" in _name(pid):
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)

    def _provide_separation(self) -> None:
        # Debian's service makes this empty folder when it starts; an sshd of root wants it at each connection, so that
        # it stays: other tests may have one at the same time.
        if os.geteuid() == 0:
            _SEPARATED.mkdir(mode=0o755, exist_ok=True)

    def _await_port(self) -> None:
        deadline = time.monotonic() + _DEADLINE
        while time.monotonic() < deadline and self._process.poll() is None:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), timeout=1):
                return
            time.sleep(0.02)
        self.stop()
        pytest.skip(f"sshd does not start here: {(self.folder / 'sshd.log').read_text(errors='replace')[-500:]}")


def _descendants(pid: int) -> list[int]:
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            fields = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
            parents[int(folder.name)] = int(fields[1])
    found, last = [], {pid}
    while last:
        last = {child for child, parent in parents.items() if parent in last}
        found += last
    return found


def _name(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text(errors="replace")
    except OSError:
        return ""


@contextmanager
def server_of_own_files(folder: Path) -> Iterator[SshServer]:
    """Yield a server whose programs keep their files in `folder / "tmp"`, where nobody else has any."""
    (folder / "tmp").mkdir()
    started = SshServer(folder, environment={"TMPDIR": str(folder / "tmp")})
    try:
        yield started
    finally:
        started.stop()
