"""An RTSP server for one camera: answers as RFC 2326 says, and sends RTP packets of ffmpeg over the same connection."""

from __future__ import annotations

import re
import socket
import struct
import subprocess
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from pathlib import Path


class RtspServer:
    """ffmpeg encodes a test picture in real time and sends it as RTP; clients get it interleaved (RFC 2326, 10.12).

    Attributes:
        port: of the loopback interface.
        url: of the stream.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        self._description = folder / "stream.sdp"
        self._packets = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._packets.bind(("127.0.0.1", 0))
        self._packets.settimeout(0.2)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.2)
        self.port = self._listener.getsockname()[1]
        self.url = f"rtsp://127.0.0.1:{self.port}/camera"
        self._is_over = threading.Event()
        self._client: socket.socket | None = None

    def __enter__(self) -> Self:
        picture = "testsrc2=size=160x120:rate=25"
        encoder = (
            "-c:v",
            "libx264",
            "-preset",
            "ultrafast",
            "-tune",
            "zerolatency",
            "-g",
            "10",
            "-bsf:v",
            "dump_extra",
        )
        target = f"rtp://127.0.0.1:{self._packets.getsockname()[1]}?pkt_size=1200"
        words = ["ffmpeg", "-nostdin", "-loglevel", "error", "-re", "-f", "lavfi", "-i", picture, *encoder, "-f", "rtp"]
        self._encoder = subprocess.Popen([*words, "-sdp_file", str(self._description), target])
        self._threads = [threading.Thread(target=each, daemon=True) for each in (self._serve, self._forward)]
        for thread in self._threads:
            thread.start()
        deadline = time.monotonic() + 20.0
        while not (self._description.is_file() and self._description.stat().st_size) and time.monotonic() < deadline:
            time.sleep(0.02)
        return self

    def __exit__(self, *raised: object) -> None:
        self._is_over.set()
        self._encoder.kill()
        self._encoder.wait()
        for thread in self._threads:
            thread.join()
        self._packets.close()
        self._listener.close()

    def _serve(self) -> None:
        while not self._is_over.is_set():
            with suppress(TimeoutError, ConnectionError):
                connection, _ = self._listener.accept()
                with connection:
                    connection.settimeout(0.2)
                    self._answer(connection)
                self._client = None

    def _answer(self, connection: socket.socket) -> None:
        heard = b""
        while not self._is_over.is_set():
            try:
                data = connection.recv(65536)
            except TimeoutError:
                continue
            if not data:
                return
            heard += data
            while heard[:1] == b"$" and len(heard) >= 4:  # RTCP of the client
                heard = heard[4 + struct.unpack(">H", heard[2:4])[0] :]
            while b"\r\n\r\n" in heard:
                request, _, heard = heard.partition(b"\r\n\r\n")
                connection.sendall(self._response(request.decode()))
                if request.startswith(b"PLAY"):
                    self._client = connection

    def _response(self, request: str) -> bytes:
        found = re.search(r"^CSeq: *(\d+)", request, re.MULTILINE | re.IGNORECASE)
        lines, body = [f"CSeq: {found[1] if found else 0}"], ""
        if request.startswith("OPTIONS"):
            lines.append("Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN")
        elif request.startswith("DESCRIBE"):
            if "/camera" not in request.partition("\r\n")[0]:
                return f"RTSP/1.0 404 Not Found\r\n{lines[0]}\r\n\r\n".encode()
            text = self._description.read_text(encoding="ascii").removeprefix("SDP:").strip()
            body = re.sub(r"^m=video \d+", "m=video 0", text, flags=re.MULTILINE) + "\r\na=control:track1\r\n"
            body = "\r\n".join(body.splitlines()) + "\r\n"
            lines += ["Content-Type: application/sdp", f"Content-Base: {self.url}/", f"Content-Length: {len(body)}"]
        elif request.startswith("SETUP"):
            lines += ["Transport: RTP/AVP/TCP;unicast;interleaved=0-1", "Session: 1"]
        else:
            lines.append("Session: 1")
        return ("\r\n".join(["RTSP/1.0 200 OK", *lines]) + "\r\n\r\n" + body).encode()

    def _forward(self) -> None:
        while not self._is_over.is_set():
            with suppress(TimeoutError, OSError):
                packet = self._packets.recv(65536)
                client = self._client
                if client is not None:
                    client.sendall(b"$\x00" + struct.pack(">H", len(packet)) + packet)
