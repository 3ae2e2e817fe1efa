"""A headless Chromium that tests open pages with, spoken to by its DevTools protocol over two pipes."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from collections import deque
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Browser", "browser", "started_browser"]

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_DEADLINE = 120.0


class Browser:
    """One tab.

    Attributes:
        events: what the browser told, oldest first: (method, parameters).
    """

    def __init__(self, write: int, read: int) -> None:
        self.events: list[tuple[str, dict[str, Any]]] = []
        self._write, self._read = write, read
        self._buffer = b""
        self._waiting: deque[dict[str, Any]] = deque()
        self._number = 0
        self._session: str | None = None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while (answer := self._next()).get("id") != self._number:
            self._take(answer)
        assert "error" not in answer, answer
        result: dict[str, Any] = answer["result"]
        return result

    def open(self, path: Path | str, *, width: int = 1280, height: int = 900, is_phone: bool = False) -> None:
        """Open a file, or an address, in a window of this size."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=is_phone
        )
        self.events.clear()
        self.call("Page.navigate", url=path if isinstance(path, str) else path.as_uri())
        while not any(method == "Page.loadEventFired" for method, _ in self.events):
            self._take(self._next())
        self.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def evaluate(self, script: str) -> Any:
        result = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def point_at(self, selector: str, x: float, y: float) -> None:
        """Move the pointer to a place in an element, as shares of its width and height."""
        place = self.evaluate(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)}); e.scrollIntoView({{block: 'center',"
            f" behavior: 'instant'}}); const r = e.getBoundingClientRect();"
            f" return [r.left + r.width * {x}, r.top + r.height * {y}]; }})()"
        )
        for step in (3, 0):
            self.call("Input.dispatchMouseEvent", type="mouseMoved", x=place[0] - step, y=place[1])
        self.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def wait_for(self, condition: str, *, seconds: float = _DEADLINE) -> None:
        """Wait until an expression is true in the page."""
        deadline = time.monotonic() + seconds
        while not self.evaluate(f"Boolean({condition})"):
            if time.monotonic() >= deadline:
                pytest.fail(f"this never came: {condition}\n{self.evaluate('document.body.innerText')}")
            time.sleep(0.05)

    def press(self, selector: str) -> None:
        """Press what a selector names with the pointer, where it is on the screen.

        Again where that was drawn anew between press and release, or has moved: it gets no click then.
        """
        deadline, name = time.monotonic() + _DEADLINE, json.dumps(selector)
        while True:
            place = self.evaluate(
                f"(() => {{ const e = document.querySelector({name}); e.scrollIntoView({{block: 'center',"
                " behavior: 'instant'}); const r = e.getBoundingClientRect(); window.isClicked = false;"
                f" const look = (event) => {{ window.isClicked ||= Boolean(event.target.closest({name})); }};"
                " window.addEventListener('click', look, true);"
                " window.lookAway = () => window.removeEventListener('click', look, true);"
                " return [r.left + r.width / 2, r.top + r.height / 2]; })()"
            )
            for kind in ("mousePressed", "mouseReleased"):
                self.call("Input.dispatchMouseEvent", type=kind, x=place[0], y=place[1], button="left", clickCount=1)
            if self.evaluate("(window.lookAway?.(), window.isClicked !== false)"):  # or another page is open by now
                return
            assert time.monotonic() < deadline, f"{selector} cannot be pressed"

    def key(self, name: str, code: int = 0) -> None:
        """Press a key, such as Tab or Enter."""
        text = {"Enter": "\r"}.get(name, "")
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=name, code=name, windowsVirtualKeyCode=code, text=text)

    def write(self, text: str) -> None:
        """Type a text where the focus is."""
        self.call("Input.insertText", text=text)

    def screenshot(self, *, whole: bool = False) -> bytes:
        """Return what is seen, or the whole page, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", captureBeyondViewport=whole)["data"])

    def inaccessible(self) -> list[str]:
        """Return what axe-core finds against WCAG 2.1, A and AA: the rule, what it asks for, the elements."""
        package = pytest.importorskip("axe_core_python", reason="axe-core-python is not installed (the extra 'dev')")
        self.evaluate(Path(package.__file__).with_name("axe.min.js").read_text(encoding="utf-8") + "; 0")
        found = self.evaluate(
            "axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa'], resultTypes: ['violations']})"
            ".then(done => done.violations.map(each => `${each.id}: ${each.help}: `"
            " + each.nodes.slice(0, 5).map(node => node.target.join(' ')).join(', ')))"
        )
        assert isinstance(found, list)
        return found

    def is_dark(self, is_dark: bool) -> None:
        """Have the reader prefer a dark page, or a light one."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def pdf(self, *, paper: tuple[float, float] = (8.5, 11.0)) -> bytes:
        """Print on paper of this width and height, inches."""
        return base64.b64decode(self.call("Page.printToPDF", paperWidth=paper[0], paperHeight=paper[1])["data"])

    @property
    def complaints(self) -> list[tuple[str, dict[str, Any]]]:
        """Exceptions, console messages, log entries and dialogs since the page was opened."""
        kinds = {
            "Runtime.exceptionThrown",
            "Runtime.consoleAPICalled",
            "Log.entryAdded",
            "Page.javascriptDialogOpening",
        }
        return [event for event in self.events if event[0] in kinds]

    @property
    def requests(self) -> list[str]:
        """Addresses that were asked for since the page was opened, without data that stand in the page."""
        asked = [event["request"]["url"] for method, event in self.events if method == "Network.requestWillBeSent"]
        return [url for url in asked if not url.startswith("data:")]

    def _take(self, message: dict[str, Any]) -> None:
        if "method" in message:
            self.events.append((message["method"], message["params"]))

    def _next(self) -> dict[str, Any]:
        deadline = time.monotonic() + _DEADLINE
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._read], [], [], max(0.0, deadline - time.monotonic()))
            assert ready, "Chromium does not answer"
            data = os.read(self._read, 1 << 20)
            assert data, "Chromium has ended"
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(b"\0")
        told: dict[str, Any] = json.loads(message)
        return told


@contextmanager
def started_browser(program: str, profile: Path) -> Iterator[Browser]:
    with ExitStack() as closing:
        theirs_in, ours_out = os.pipe()
        ours_in, theirs_out = os.pipe()
        for descriptor in (ours_out, ours_in):
            closing.callback(os.close, descriptor)
        # Chromium reads commands from descriptor 3 and answers on 4.
        shell = f'exec "$0" "$@" 3<&{theirs_in} 4>&{theirs_out}'
        options = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--remote-debugging-pipe",
            f"--user-data-dir={profile}",
        ]
        # Killed, it leaves its socket, whose path has to be short: it is not beside the profile.
        temporary = closing.enter_context(TemporaryDirectory(ignore_cleanup_errors=True))
        process = subprocess.Popen(
            ["/bin/bash", "-c", shell, program, *options, f"--user-data-dir={profile}"],
            env={**os.environ, "TMPDIR": temporary},
            pass_fds=(theirs_in, theirs_out),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        closing.callback(process.wait)
        closing.callback(process.kill)
        yield Browser(ours_out, ours_in)


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Return a headless Chromium; without one, tests that need it are skipped."""
    program = next(filter(None, map(shutil.which, _NAMES)), None)
    if program is None:
        pytest.skip("no Chromium is installed (Debian: apt install chromium)")
    with started_browser(program, tmp_path_factory.mktemp("chromium")) as started:
        yield started
