"""Live pages that are really served, by the program itself, and experiments that are really executed beside them."""

from __future__ import annotations

import http.client
import json
import os
import re
import subprocess
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.command_line import PROGRAM
from tests.loopback_port import claim_port
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

pytest.importorskip("starlette", reason="the extra 'page' is not installed")


@dataclass
class Answer:
    """What the server answered."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass
class ServedPage:
    """A page that a process of its own serves."""

    folder: Path
    port: int
    words: tuple[str, ...] = ()
    process: subprocess.Popen[str] | None = None
    links: dict[str, str] = field(default_factory=dict)

    def start(self) -> None:
        command = [PROGRAM, "watch", str(self.folder), "--port", str(self.port), *self.words]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if found := re.match(r"\s+(Here|Phone|To look)\s+(\S+)", line):
                self.links[found[1]] = found[2]
            if line.strip().startswith("End"):
                return
        raise AssertionError("the page has ended")

    def stop(self) -> None:
        if self.process is not None:
            self.process.terminate()
            self.process.communicate(timeout=PATIENCE)

    def key(self, link: str = "Here") -> str:
        return self.links[link].partition("#key=")[2]

    def ask(
        self, path: str, *, key: str | None = "Here", method: str = "GET", body: Any = None, **headers: str
    ) -> Answer:
        """Ask the server; `key` names the link whose key goes along, None for none."""
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        if key is not None:
            given.setdefault("Authorization", f"Bearer {self.key(key)}")
        data = None if body is None else json.dumps(body).encode()
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        try:
            connection.request(method, path, body=data, headers=given)
            answer = connection.getresponse()
            return Answer(answer.status, {k.casefold(): v for k, v in answer.getheaders()}, answer.read())
        finally:
            connection.close()

    def act(self, path: str, body: Any, **headers: str) -> Answer:
        """Ask for something that changes the experiment, as the page does."""
        own = {"X_Robot_Runner": "1", "Origin": f"http://127.0.0.1:{self.port}"}
        return self.ask(path, method="POST", body=body, **{**own, **headers})

    @property
    def experiments(self) -> dict[str, str]:
        """The ids of all experiments, by their names."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        connection.request("GET", "/api/events", headers={"Authorization": f"Bearer {self.key()}"})
        stream = connection.getresponse()
        deadline = time.monotonic() + PATIENCE
        try:
            while not (line := stream.readline()).startswith(b"data: [") or line.strip() == b"data: []":
                assert line, "the stream has ended"
                assert time.monotonic() < deadline, "no experiment was told"  # what keeps a stream alive goes on
        finally:
            connection.close()
        return {each["name"]: each["id"] for each in json.loads(line[6:])}


@pytest.fixture
def serve_page() -> Iterator[Callable[..., ServedPage]]:
    """Return what serves the page of a folder, with further words of `robot-runner watch`."""
    started: list[ServedPage] = []

    def serve(folder: Path, *words: str) -> ServedPage:
        page = ServedPage(folder, claim_port(), words)
        started.append(page)
        page.start()
        return page

    yield serve
    for page in started:
        page.stop()


@contextmanager
def executed(config: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """Execute a config in a process of its own, with nobody at its terminal."""
    command = [PROGRAM, "run", str(config), *words]
    with subprocess.Popen(
        command,
        cwd=config.parent,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.terminate()


def processor_seconds(pid: int) -> float:
    """Return the processor time that a process has used, s."""
    words = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
