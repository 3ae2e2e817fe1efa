"""Small wheels, and a package index on loopback that has them (PEP 503)."""

from __future__ import annotations

import hashlib
import threading
import zipfile
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_SETTINGS = ("PIP_FIND_LINKS", "PIP_EXTRA_INDEX_URL", "PIP_NO_INDEX", "PIP_CERT", "PIP_DEFAULT_TIMEOUT")


def pip_settings(index: str) -> dict[str, str | None]:
    """Return the variables that make pip ask this index only, whatever its settings here are; None is not there."""
    own = {"PIP_INDEX_URL": index, "PIP_CONFIG_FILE": "/dev/null", "PIP_NO_CACHE_DIR": "1"}
    # Of two spellings, the small one counts where somebody has set it.
    return {**dict.fromkeys(_SETTINGS), **own, **dict.fromkeys(("NO_PROXY", "no_proxy"), "127.0.0.1")}


def tiny_wheel(
    folder: Path, name: str = "tiny", version: str = "1.0", platform: str = "any", code: str = "", needs: str = ""
) -> str:
    """Write a wheel with one module, which has the extra `more`, and return its SHA-256."""
    folder.mkdir(parents=True, exist_ok=True)
    module = name.replace("-", "_")
    path = folder / f"{module}-{version}-py3-none-{platform}.whl"
    info = f"{module}-{version}.dist-info"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"{module}.py", code)
        needed = f"Requires-Dist: {needs}\n" if needs else ""
        described = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\nProvides-Extra: more\n{needed}"
        archive.writestr(f"{info}/METADATA", described)
        purelib = str(platform == "any").lower()
        archive.writestr(f"{info}/WHEEL", f"Wheel-Version: 1.0\nRoot-Is-Purelib: {purelib}\nTag: py3-none-{platform}\n")
        archive.writestr(f"{info}/RECORD", f"{module}.py,,\n")
    return hashlib.sha256(path.read_bytes()).hexdigest()


class SmallIndex:
    """A folder that is an index once it is served."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def add(self, name: str, version: str = "1.0", platform: str = "any", needs: str = "") -> str:
        """Add a wheel, and return its SHA-256, which is on the page, too."""
        digest = tiny_wheel(self.folder / name, name, version, platform, needs=needs)
        files = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in self.folder.glob(f"{name}/*.whl")}
        links = "".join(f'<a href="{file}#sha256={known}">{file}</a>\n' for file, known in sorted(files.items()))
        (self.folder / name / "index.html").write_text(f"<!DOCTYPE html><html><body>{links}</body></html>", "utf-8")
        return digest

    @contextmanager
    def served(self) -> Iterator[str]:
        """Serve it, and yield its address."""
        server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(self.folder)))
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()
            thread.join(10)
            server.server_close()


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Say nothing."""
