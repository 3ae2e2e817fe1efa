"""Smart plugs as their makers' documents describe them, on HTTP and on MQTT."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import secrets
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


class FakePlug:
    """What a plug measures; a test changes it meanwhile.

    Attributes:
        volts: V.
        watt_hours: of the energy counter.
        measures: whether the model has a power sensor.
    """

    def __init__(self, watts: float = 42.5) -> None:
        self.watts = watts
        self.volts = 230.0
        self.watt_hours = 1234.567
        self.measures = True

    @property
    def amperes(self) -> float:
        return round(self.watts / self.volts, 3)

    def tasmota(self) -> dict[str, object]:
        energy = {
            "TotalStartTime": "2026-01-01T00:00:00",
            "Total": round(self.watt_hours / 1000, 3),
            "Yesterday": 0.1,
            "Today": 0.2,
            "Power": self.watts,
            "ApparentPower": 55,
            "ReactivePower": 35,
            "Factor": 0.77,
            "Voltage": self.volts,
            "Current": self.amperes,
        }
        return {"StatusSNS": {"Time": "2026-11-22T10:00:00", **({"ENERGY": energy} if self.measures else {})}}

    def shelly1(self) -> dict[str, object]:
        meter = {
            "power": self.watts,
            "overpower": 0.0,
            "is_valid": True,
            "timestamp": 1680779310,
            "counters": [2.1, 2.1, 2.1],
            "total": round(self.watt_hours * 60),
        }
        return {"relays": [{"ison": True}], "meters": [meter] if self.measures else []}

    def shelly2(self) -> dict[str, object]:
        metered = {
            "apower": self.watts,
            "voltage": self.volts,
            "current": self.amperes,
            "aenergy": {"total": round(self.watt_hours, 3), "by_minute": [0.0, 0.0, 0.0], "minute_ts": 1700000000},
        }
        return {"id": 0, "source": "init", "output": True, **(metered if self.measures else {})}


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


class PlugOnHttp:
    """The local HTTP interface of a plug, guarded as each maker guards it where a password is set.

    Attributes:
        url: of the interface.
        requests: the paths that were asked for.
        is_hanging: whether it takes requests and does not answer.
    """

    def __init__(self, plug: FakePlug, *, password: str | None = None) -> None:
        self.plug = plug
        self.password = password
        self.requests: list[str] = []
        self.is_hanging = False
        self._released = threading.Event()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer.requests.append(self.path)
                if outer.is_hanging:
                    outer._released.wait(20)
                code, told, extra = outer.answer(self.path, self.headers.get("Authorization", ""))
                body = json.dumps(told).encode()
                self.send_response(code)
                for name, value in extra.items():
                    self.send_header(name, value)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *args: object) -> None:
                pass

            def handle(self) -> None:
                try:
                    super().handle()
                except OSError:  # the other end did not wait
                    return

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        self._thread.start()
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"

    def answer(self, path: str, authorization: str) -> tuple[int, object, Mapping[str, str]]:  # noqa: PLR0911 - the routes of a server
        parts = urlsplit(path)
        query = {name: values[0] for name, values in parse_qs(parts.query).items()}
        if parts.path == "/cm" and query.get("cmnd") == "Status 10":
            if self.password is not None and (query.get("user"), query.get("password")) != ("admin", self.password):
                return 200, {"WARNING": "Need user=<username>&password=<password>"}, {}
            return 200, self.plug.tasmota(), {}
        if parts.path == "/status":
            expected = "Basic " + base64.b64encode(f"admin:{self.password}".encode()).decode()
            if self.password is not None and authorization != expected:
                return 401, "401 Unauthorized", {"WWW-Authenticate": 'Basic realm="shellyplug-s-1"'}
            return 200, self.plug.shelly1(), {}
        if re.fullmatch(r"/rpc/(Switch|PM1)\.GetStatus", parts.path) and query == {"id": "0"}:
            if self.password is not None and not self._is_digest(authorization, path):
                challenge = (
                    f'Digest qop="auth", realm="shellyplus-1", nonce="{secrets.token_hex(8)}", algorithm=SHA-256'
                )
                return 401, "", {"WWW-Authenticate": challenge}
            return 200, self.plug.shelly2(), {}
        return 404, "no such page", {}

    def _is_digest(self, authorization: str, path: str) -> bool:
        """Check as RFC 7616 says."""
        said = {
            name: plain or quoted for name, quoted, plain in re.findall(r'(\w+)=(?:"([^"]*)"|([^\s,]+))', authorization)
        }
        if not authorization.startswith("Digest ") or said.get("uri") != path:
            return False
        first = _sha256(f"{said['username']}:shellyplus-1:{self.password}")
        second = _sha256(f"GET:{path}")
        expected = _sha256(f"{first}:{said['nonce']}:{said['nc']}:{said['cnonce']}:{said['qop']}:{second}")
        return said["response"] == expected

    def stop(self) -> None:
        self._released.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class PlugOnMqtt:
    """A plug that is connected to a broker, and answers there as its maker's document says.

    Attributes:
        is_mute: whether it receives questions and does not answer.
    """

    def __init__(
        self,
        plug: FakePlug,
        kind: str,
        topic: str,
        port: int,
        *,
        password: str | None = None,
        certificate: Path | None = None,
    ) -> None:
        import paho.mqtt.client as paho

        self.plug, self.kind, self.topic = plug, kind, topic
        self.is_mute = False
        self._is_ready = threading.Event()
        asked = {"tasmota": f"cmnd/{topic}/#", "shelly1": f"shellies/{topic}/command", "shelly2": f"{topic}/rpc"}[kind]
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        if password is not None:
            self._client.username_pw_set("robot", password)
        if certificate is not None:
            self._client.tls_set(ca_certs=str(certificate))
        self._client.on_connect = lambda client, *_: client.subscribe(asked)
        self._client.on_subscribe = lambda *_: self._is_ready.set()
        self._client.on_message = self._receive
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        assert self._is_ready.wait(20)

    def _receive(self, client, _data, message) -> None:
        if self.is_mute:
            return
        if self.kind == "tasmota":
            assert (message.topic.lower(), message.payload) == (f"cmnd/{self.topic}/status".lower(), b"10")
            client.publish(f"stat/{self.topic}/STATUS10", json.dumps(self.plug.tasmota()))
        elif self.kind == "shelly1":
            assert message.payload == b"update"
            client.publish(f"shellies/{self.topic}/relay/0", "on")
            client.publish(f"shellies/{self.topic}/relay/0/power", f"{self.plug.watts:.2f}")
            client.publish(f"shellies/{self.topic}/relay/0/energy", str(round(self.plug.watt_hours * 60)))
        else:
            request = json.loads(message.payload)
            assert request["method"] == "Switch.GetStatus"
            assert request["params"] == {"id": 0}
            answer = {"id": request["id"], "src": self.topic, "dst": request["src"], "result": self.plug.shelly2()}
            client.publish(f"{request['src']}/rpc", json.dumps(answer))

    def retain(self, topic: str, payload: str) -> None:
        """Have the broker keep a message."""
        self._client.publish(topic, payload, retain=True).wait_for_publish(20)

    def stop(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()
        del self._client  # its inner sockets close with it
