"""A real mosquitto on loopback: its own port, its own password, started and stopped by its process id."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest
from tests.loopback_port import claim_port

if TYPE_CHECKING:
    from pathlib import Path

_SEARCHED = os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/sbin", "/usr/local/sbin"])
_DEADLINE = 30.0


class Broker:
    """A mosquitto that lets everybody in, or the user `robot` with a password; with a certificate, over TLS.

    Attributes:
        url: as a plug's config names it.
        certificate: what is to be trusted.
        port: on loopback.
    """

    def __init__(self, folder: Path, *, password: str | None = None, is_tls: bool = False) -> None:
        found = shutil.which("mosquitto", path=_SEARCHED)
        if found is None:
            pytest.skip("mosquitto is not installed (Debian, Ubuntu: sudo apt install mosquitto)")
        self.port = claim_port()
        self.url = f"mqtt://127.0.0.1:{self.port}"
        lines = [f"listener {self.port} 127.0.0.1", f"allow_anonymous {'false' if password else 'true'}"]
        if os.geteuid() == 0:
            lines.append("user root")
        if password is not None:
            users = folder / "users"
            users.touch(mode=0o600)
            subprocess.run(["mosquitto_passwd", "-b", users, "robot", password], check=True, timeout=_DEADLINE)
            lines.append(f"password_file {users}")
        self.certificate = folder / "certificate.pem"
        if is_tls:
            self._certify(folder / "key.pem")
            self.url = self.url.replace("mqtt:", "mqtts:")
            lines += [f"certfile {self.certificate}", f"keyfile {folder / 'key.pem'}"]
        config = folder / "mosquitto.conf"
        config.write_text("\n".join(lines) + "\n")
        self._command = [found, "-c", str(config)]
        self.start()

    def _certify(self, key: Path) -> None:
        openssl = shutil.which("openssl")
        if openssl is None:
            pytest.skip("openssl is not installed (Debian, Ubuntu: sudo apt install openssl)")
        subject = ["-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1"]
        files = ["-keyout", key, "-out", self.certificate]
        command = [openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", *subject, *files]
        subprocess.run(command, check=True, capture_output=True, timeout=_DEADLINE)

    def start(self) -> None:
        """Start it, or start it again."""
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        deadline = time.monotonic() + _DEADLINE
        while time.monotonic() < deadline:
            assert self._process.poll() is None, "mosquitto does not start"
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), timeout=1):
                return
            time.sleep(0.02)

    def stop(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.wait(_DEADLINE)
