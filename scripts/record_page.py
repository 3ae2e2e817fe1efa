"""Record the live page for half a minute, while an experiment is executed: `record_page.py picture.webp`.

It needs a headless Chromium (Debian: chromium). The page is that of `robot-runner watch`, at a free port.
"""

from __future__ import annotations

import argparse
import base64
import io
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from PIL import Image

_ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(_ROOT))  # the browser is that of the tests

_CONFIG = _ROOT / "examples" / "basic_experiment.py"
#: More than are executed in the time of the recording; the rest is left.
_REPETITIONS = 40
_WIDTH, _HEIGHT = 1100, 800
_FRAMES, _INTERVAL = 25, 1.2  # seconds between two frames, in the recording as in the picture
#: Frames are kept smaller than they are taken: the file, which is part of the repository, has some 300 kB.
_SCALE, _QUALITY = 0.8, 60
_DEADLINE = 60.0  # seconds until the page shows the experiment


def main() -> int:
    """Record the page; leave nothing behind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path, help="the WebP file to write")
    chosen = parser.parse_args()
    with ExitStack() as closing:
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory())) / "lab"
        folder.mkdir()
        frames = _frames(folder, closing)
    first, *others = frames
    first.save(
        chosen.picture, save_all=True, append_images=others, duration=int(_INTERVAL * 1000), loop=0, quality=_QUALITY
    )
    print(f"{chosen.picture}: {len(frames)} frames, {chosen.picture.stat().st_size / 1000:.0f} kB")
    return 0


def _frames(folder: Path, closing: ExitStack) -> list[Image.Image]:
    from tests.headless_browser import started_browser  # noqa: PLC0415 - once the path leads there

    links = folder.with_name("links.txt")
    _started(closing, links, "watch", str(folder), "--port", str(_free_port()))
    address = _address(links)
    settings = (f"results_output_path={folder}", f"repetitions={_REPETITIONS}")
    words = [word for setting in settings for word in ("--set", setting)]
    _started(closing, folder.with_name("run.txt"), "run", str(_CONFIG), "--plain", *words)
    program = shutil.which("chromium") or sys.exit("No Chromium is installed (Debian: apt install chromium).")
    browser: Any = closing.enter_context(started_browser(program, folder.with_name("profile")))
    browser.call("Emulation.setDeviceMetricsOverride", width=_WIDTH, height=_HEIGHT, deviceScaleFactor=1, mobile=False)
    browser.call("Page.navigate", url=address)
    _open_experiment(browser)
    return [_frame(browser) for _ in range(_FRAMES)]


def _started(closing: ExitStack, said: Path, *words: str) -> None:
    program = str(Path(sys.executable).with_name("robot-runner"))
    with said.open("wb") as file:
        process = subprocess.Popen([program, *words], stdout=file, stderr=file)
    closing.callback(process.wait)
    closing.callback(process.terminate)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
    return port


def _address(links: Path) -> str:
    end = time.monotonic() + _DEADLINE
    while not (found := re.search(r"http://\S+#key=\w+\n", links.read_text(encoding="utf-8"))):
        if time.monotonic() > end:
            sys.exit(f"robot-runner watch gave no link within {_DEADLINE:.0f} s: {links.read_text(encoding='utf-8')}")
        time.sleep(0.2)
    return found[0].strip()


def _open_experiment(browser: Any) -> None:
    link = "[...document.querySelectorAll('a[href^=\"#/e/\"]')][0]"
    end = time.monotonic() + _DEADLINE
    while not browser.evaluate(f"Boolean({link})"):
        if time.monotonic() > end:
            sys.exit(f"The page showed no experiment within {_DEADLINE:.0f} s.")
        time.sleep(0.2)
    browser.evaluate(f"{link}.click()")
    time.sleep(_INTERVAL)


def _frame(browser: Any) -> Image.Image:
    began = time.monotonic()
    picture = Image.open(io.BytesIO(base64.b64decode(browser.call("Page.captureScreenshot")["data"]))).convert("RGB")
    small = picture.resize((int(_WIDTH * _SCALE), int(_HEIGHT * _SCALE)))
    time.sleep(max(0.0, _INTERVAL - (time.monotonic() - began)))
    return small


if __name__ == "__main__":
    sys.exit(main())
