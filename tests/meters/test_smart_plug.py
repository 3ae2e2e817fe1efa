"""Smart plugs over HTTP, from a server of the tests' own, and over MQTT, through a real mosquitto."""

from __future__ import annotations

import csv
import gc
import itertools
import json
import logging
import socket
import threading
import time
from contextlib import closing
from types import SimpleNamespace

import pytest
from tests.meters.fake_plugs import FakePlug, PlugOnHttp, PlugOnMqtt
from tests.meters.mqtt_broker import Broker
from tests.meters.rehearsed import measured, only_finding, problems
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.meters import mqtt_requests
from robot_runner.meters.electrical_readings import ElectricalReading
from robot_runner.meters.http_requests import HttpDevice
from robot_runner.meters.mqtt_requests import MqttRequests
from robot_runner.meters.plug_dialects import DIALECTS
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import SmartPlug
from robot_runner.testing import FakeClock, ProfilerContract, make_context, rehearse

KINDS = ["tasmota", "shelly1", "shelly2"]
PASSWORD = "s3cret & more%"  # noqa: S105 - of the tests' own servers
VARIABLE = "PLUG_PASSWORD"


@pytest.fixture
def plug():
    return FakePlug()


@pytest.fixture
def on_http(plug):
    started = PlugOnHttp(plug)
    yield started
    started.stop()


@pytest.fixture(scope="module")
def broker(tmp_path_factory):
    pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
    started = Broker(tmp_path_factory.mktemp("mosquitto"))
    yield started
    started.stop()


@pytest.fixture
def on_mqtt(plug, broker, request):
    started = PlugOnMqtt(plug, getattr(request, "param", "tasmota"), f"plug-{time.monotonic_ns()}", broker.port)
    yield started
    started.stop()


def watch(plug, clock):
    """Have the load rise by 0.5 W a second, and the plug count it."""

    def load() -> None:
        plug.watts += 0.05
        plug.watt_hours += plug.watts * 0.1 / 3600

    clock.every(0.1, load)


# Over HTTP.


@pytest.mark.parametrize("kind", [*KINDS, "shelly2-pm"])
def test_each_kind_is_read_over_http(tmp_path, plug, on_http, kind):
    clock = FakeClock(5.0)
    watch(plug, clock)
    context = measured(tmp_path, SmartPlug(kind, url=on_http.url), clock, seconds=60)
    assert context.measures["Energy"] == pytest.approx(42.5 * 60 + 0.5 * 0.5 * 60**2, rel=0.01)
    assert context.measures["MeanPower"] == pytest.approx(57.5, rel=0.01)
    assert context.measures["MeanVoltage"] == (None if kind == "shelly1" else pytest.approx(230.0))
    assert problems(context) == []
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert (facts["kind"], facts["url"], facts["energy_from"]) == (kind, on_http.url, {"": "power"})
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        assert {"time_s", "power_W", "energy_J"} <= set(next(csv.DictReader(file)))


@pytest.mark.long
def test_a_counter_that_contradicts_the_power_of_a_long_mission_is_doubted(tmp_path, plug, on_http):
    clock = FakeClock()
    clock.every(1.0, lambda: setattr(plug, "watt_hours", plug.watt_hours + 20.0 / 3600))
    clock.every(1.0, lambda: setattr(plug, "watts", 42.0 if plug.watts == 42.5 else 42.5))
    context = measured(tmp_path, SmartPlug("shelly2", url=on_http.url), clock, seconds=900.0)
    assert context.measures["MeanPower"] == pytest.approx(42.25, rel=0.01)
    assert any("energy counter rose by 1.8e+04 J, and its power" in problem for problem in problems(context))


def test_power_in_whole_watts_is_doubted_and_tasmota_told_how_to_mend_it(tmp_path, plug, on_http):
    plug.watts = 7
    context = measured(tmp_path, SmartPlug("tasmota", url=on_http.url), FakeClock(), seconds=60)
    assert any("whole watts, at 7 W (Tasmota's command `WattRes 2`" in problem for problem in problems(context))


@pytest.mark.parametrize(
    ("total", "joules"), [(8.0, None), ([3.0, 5.0], 5.0 * 3.6e6)], ids=["one counter for both", "a counter each"]
)
def test_the_outlets_of_a_tasmota_strip_are_told_apart(total, joules):
    energy = {"Total": total, "Power": [3.0, 5.0], "Voltage": 230.0, "Current": [0.02, 0.03]}
    answer = json.dumps({"StatusSNS": {"ENERGY": energy}}).encode()
    assert DIALECTS["tasmota"].read({"": answer}, 1) == ElectricalReading(5.0, 230.0, 0.03, joules)


def test_a_number_beyond_all_bounds_is_no_number():
    with pytest.raises(ValueError, match="reports apower = inf, which is not a number"):
        DIALECTS["shelly2"].read({"": b'{"apower": 1' + b"0" * 400 + b"}"}, 0)


@pytest.mark.parametrize("error", ["power_meter_failure", "out_of_range:apower"])
def test_a_reading_that_the_plug_itself_says_to_be_wrong_is_none(error):
    told = {"id": 0, "apower": 0.0, "voltage": 230.1, "current": 0.0, "errors": ["overtemp", error]}
    for dialect in ("shelly2", "shelly2-pm"):
        with pytest.raises(ValueError, match=f"the plug reports {error!r} for its power meter"):
            DIALECTS[dialect].read({"": json.dumps(told).encode()}, 0)
    harmless = json.dumps({**told, "errors": ["overtemp"]}).encode()
    assert DIALECTS["shelly2"].read({"": harmless}, 0).power == 0.0


def test_the_power_that_a_shelly_1_was_told_of_its_load_is_no_reading():
    # It measures nothing: its firmware (v1.12.1) shows the power of its settings, 0 W unless somebody has set one.
    answer = b'{"relays":[{"ison":true}],"meters":[{"power":0.00,"is_valid":true}],"ext_sensors":{}}'
    with pytest.raises(ValueError, match="reported no power"):
        DIALECTS["shelly1"].read({"": answer}, 0)


def test_an_answer_that_is_nested_without_end_is_no_answer():
    with pytest.raises(ValueError, match="which is not JSON"):
        DIALECTS["shelly2"].read({"": b"[" * 100_000}, 0)


def test_the_single_meter_of_a_tasmota_plug_is_not_that_of_a_further_outlet(plug, on_http):
    problem = only_finding(SmartPlug("tasmota", url=on_http.url, channel=2)).problem
    assert "reported no power" in problem


def test_a_plug_that_falls_silent_blocks_no_mission(tmp_path, on_http, monkeypatch):
    clock, plugin = SystemClock(), SmartPlug("tasmota", url=on_http.url, rate_hz=10.0, timeout_s=20.0)
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    get, falls_silent = HttpDevice.get, threading.Event()

    def get_in_time(device, *path, **headers):  # before, an answer may take long on a busy machine
        if falls_silent.is_set():
            on_http.is_hanging, device._timeout = True, 0.3
        return get(device, *path, **headers)

    silent_since: list[float] = []

    def mission() -> None:
        clock.sleep(0.2)
        silent_since.append(time.monotonic())
        falls_silent.set()
        clock.sleep(0.8)

    monkeypatch.setattr(HttpDevice, "get", get_in_time)
    rehearse(context, plugin, mission=mission)
    assert time.monotonic() - silent_since[0] < 5.0
    assert set(context.measures.values()) == {None}
    assert any("it timed out" in problem for problem in problems(context))


@pytest.fixture
def guarded(plug):
    started = PlugOnHttp(plug, password=PASSWORD)
    yield started
    started.stop()


@pytest.mark.parametrize("kind", KINDS)
def test_the_password_comes_from_the_environment_and_is_written_nowhere(tmp_path, monkeypatch, caplog, guarded, kind):
    caplog.set_level(logging.DEBUG)
    monkeypatch.setenv(VARIABLE, PASSWORD)
    plugin = SmartPlug(kind, url=guarded.url, password_env=VARIABLE)
    context = measured(tmp_path, plugin, FakeClock(), seconds=10.0)
    assert context.measures["MeanPower"] == pytest.approx(42.5)
    written = [path.read_text() for path in tmp_path.rglob("*") if path.is_file()]
    told = [str(vars(plugin)), repr(context.broker.records), caplog.text, *written]
    assert not [text for text in told if "s3cret" in text]


@pytest.mark.parametrize("kind", KINDS)
def test_a_wrong_password_is_refused_and_not_repeated_in_the_finding(tmp_path, guarded, kind):
    (tmp_path / "password").write_text("not the s3cret\n")
    finding = only_finding(SmartPlug(kind, url=guarded.url, password_file=tmp_path / "password"))
    assert "refuses" in finding.problem
    assert "s3cret" not in str(finding)


@pytest.mark.parametrize("kind", KINDS)
def test_a_plug_that_wants_a_password_is_told(guarded, kind):
    finding = only_finding(SmartPlug(kind, url=guarded.url))
    assert "refuses" in finding.problem


def test_a_password_that_is_not_there_is_told(on_http, tmp_path, monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    finding = only_finding(SmartPlug("tasmota", url=on_http.url, password_env=VARIABLE))
    assert "PLUG_PASSWORD" in finding.problem
    finding = only_finding(SmartPlug("tasmota", url=on_http.url, password_file=tmp_path / "nothing"))
    assert "cannot be read" in finding.problem


def test_a_plug_without_a_power_sensor_is_told(plug, on_http):
    plug.measures = False
    for kind in KINDS:
        assert "reported no power" in only_finding(SmartPlug(kind, url=on_http.url)).problem


def test_a_plug_of_another_kind_is_told(on_http, monkeypatch):
    monkeypatch.setattr(on_http, "answer", lambda path, _: (404, "no such page", {}))
    finding = only_finding(SmartPlug("shelly2", url=on_http.url))
    assert "404" in finding.problem
    assert "kind" in finding.fix


@pytest.mark.parametrize("said", ["hello", [1, 2], {"apower": "much"}, {"apower": True}, {"result": []}, float("nan")])
def test_answers_that_make_no_sense_are_findings_and_no_tracebacks(on_http, monkeypatch, said):
    monkeypatch.setattr(on_http, "answer", lambda path, _: (200, said, {}))
    for kind in KINDS:
        assert only_finding(SmartPlug(kind, url=on_http.url)).problem


def test_nothing_at_the_address_is_told(on_http):
    on_http.stop()
    finding = only_finding(SmartPlug("tasmota", url=on_http.url))
    assert "does not answer" in finding.problem


# Over MQTT.


@pytest.mark.parametrize("on_mqtt", KINDS, indirect=True)
def test_each_kind_is_read_through_a_broker(tmp_path, plug, broker, on_mqtt):
    clock = FakeClock(5.0)
    watch(plug, clock)
    plugin = SmartPlug(on_mqtt.kind, broker=broker.url, topic=on_mqtt.topic)
    assert list(plugin.check(Circumstances())) == []
    context = measured(tmp_path, plugin, clock, seconds=30.0)
    assert context.measures["Energy"] == pytest.approx(42.5 * 30 + 0.5 * 0.5 * 30**2, rel=0.01)
    assert problems(context) == []
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["topic"] == on_mqtt.topic


@pytest.fixture
def _broker_may_be_slow(monkeypatch):
    """Have a broker waited for as long as it takes: only the plug's answers come too late or not at all."""
    connect = MqttRequests._connect

    def connect_at_last(requests):
        timeout, requests._timeout, requests._client.connect_timeout = requests._timeout, PATIENCE, PATIENCE
        connect(requests)
        requests._timeout = timeout

    monkeypatch.setattr(MqttRequests, "_connect", connect_at_last)


@pytest.mark.usefixtures("_broker_may_be_slow")
@pytest.mark.parametrize("on_mqtt", ["shelly1"], indirect=True)
def test_what_the_broker_has_kept_is_no_reading(broker, on_mqtt):
    on_mqtt.retain(f"shellies/{on_mqtt.topic}/relay/0/power", "999.0")
    on_mqtt.retain(f"shellies/{on_mqtt.topic}/relay/0/energy", "1")
    on_mqtt.is_mute = True
    finding = only_finding(SmartPlug("shelly1", broker=broker.url, topic=on_mqtt.topic, timeout_s=0.5))
    assert "no answer came on" in finding.problem


def arrived(connection: socket.socket) -> bytes:
    try:
        return connection.recv(4096, socket.MSG_PEEK)
    except BlockingIOError:  # nothing yet
        return b""


@pytest.mark.usefixtures("_broker_may_be_slow")
def test_answers_that_come_late_are_not_taken_for_those_to_the_next_question(broker, on_mqtt, plug):
    on_mqtt.is_mute = True
    exchange = DIALECTS["tasmota"].exchange(on_mqtt.topic, 0, "")
    requests = MqttRequests(broker.url, exchange, timeout=0.05, where="plug")
    for _ in range(2):
        with pytest.raises(LinkError, match="no answer came"):
            requests.ask()
    for word in (b"first", b"second"):
        on_mqtt._client.publish(exchange.answers[0], word).wait_for_publish(20)
    wait_until(lambda: b"second" in arrived(requests._client.socket()))
    on_mqtt.is_mute, requests._timeout = False, 20.0
    assert json.loads(requests.ask()[exchange.answers[0]])["StatusSNS"]["ENERGY"]["Power"] == plug.watts
    requests.close()


@pytest.mark.usefixtures("_broker_may_be_slow")
@pytest.mark.parametrize("on_mqtt", ["tasmota"], indirect=True)
def test_answers_that_come_without_end_are_told(broker, on_mqtt, monkeypatch):
    """What had come before a question was read until there was no more: somebody who sends on and on hung the run."""
    exchange = DIALECTS["tasmota"].exchange(on_mqtt.topic, 0, "")
    requests = MqttRequests(broker.url, exchange, timeout=20.0, where="plug")
    moments = itertools.count(0.0, 5.0)
    monkeypatch.setattr(mqtt_requests, "time", SimpleNamespace(monotonic=lambda: next(moments)))
    monkeypatch.setattr(mqtt_requests, "select", SimpleNamespace(select=lambda *_: [True, [], []]))
    with closing(requests), pytest.raises(LinkError, match="come faster than they can be read"):
        requests.ask()


@pytest.mark.parametrize("on_mqtt", ["tasmota"], indirect=True)
def test_a_message_that_is_far_too_long_for_an_answer_is_not_decoded(broker, on_mqtt, plug, monkeypatch):
    """A broker passes on up to 256 MiB: 250 MB of JSON took 70 s and 5.6 GB."""
    endless = {**plug.tasmota(), "beside": "x" * (2 << 20)}
    monkeypatch.setattr(plug, "tasmota", lambda: endless)
    finding = only_finding(SmartPlug("tasmota", broker=broker.url, topic=on_mqtt.topic, timeout_s=20.0))
    assert "which is not JSON" in finding.problem


def test_a_topic_that_nobody_answers_is_told(broker):
    finding = only_finding(SmartPlug("tasmota", broker=broker.url, topic="nobody", timeout_s=0.5))
    assert "no answer came on stat/nobody/STATUS10 within 0.5 s" in finding.problem
    assert "mosquitto_sub" in finding.fix


def test_a_broker_that_restarts_costs_samples_and_not_the_run(tmp_path, plug, monkeypatch):
    pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
    broker = Broker(tmp_path)
    device = PlugOnMqtt(plug, "tasmota", "charger", broker.port)
    clock = SystemClock()
    plugin = SmartPlug("tasmota", broker=broker.url, topic="charger", rate_hz=5.0, timeout_s=1.0)
    context = make_context(tmp_path, plugin, robot=None, clock=clock)

    ask, answered, back_at = MqttRequests.ask, [], []

    def ask_and_note(requests):
        answered.append(False)
        answers = ask(requests)
        answered[-1] = True
        return answers

    def mission() -> None:
        wait_until(lambda: answered.count(True) > 1)
        broker.stop()
        wait_until(lambda: answered[-2:] == [False, False])
        broker.start()
        back_at.append(clock.now())
        wait_until(lambda: answered[-3:].count(True) == 3)

    monkeypatch.setattr(MqttRequests, "ask", ask_and_note)
    try:
        rehearse(context, plugin, mission=mission)
    finally:
        device.stop()
        broker.stop()
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        times = [float(row["time_s"]) for row in csv.DictReader(file)]
    assert times[0] < back_at[0] < times[-1]
    assert any("failed, the first with: LinkError" in problem for problem in problems(context))


@pytest.fixture(scope="module")
def closed_broker(tmp_path_factory):
    pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
    started = Broker(tmp_path_factory.mktemp("mosquitto"), password=PASSWORD)
    yield started
    started.stop()


def test_a_broker_takes_the_password_from_a_file(tmp_path, plug, closed_broker):
    device = PlugOnMqtt(plug, "shelly2", "plus", closed_broker.port, password=PASSWORD)
    (tmp_path / "password").write_text(f"{PASSWORD}\n")
    settings = {"broker": closed_broker.url, "topic": "plus", "user": "robot", "password_file": tmp_path / "password"}
    try:
        context = measured(tmp_path, SmartPlug("shelly2", **settings), FakeClock(), seconds=5.0)
    finally:
        device.stop()
    assert context.measures["MeanPower"] == pytest.approx(42.5)


# paho leaves the socket of a handshake that failed to the collector of garbage.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_broker_over_tls_is_trusted_by_its_certificate_alone(tmp_path, plug, monkeypatch):
    pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
    broker = Broker(tmp_path, is_tls=True)
    device = PlugOnMqtt(plug, "tasmota", "charger", broker.port, certificate=broker.certificate)
    plugin = SmartPlug("tasmota", broker=broker.url, topic="charger")
    try:
        assert "certificate verify failed" in only_finding(plugin).problem
        gc.collect()
        monkeypatch.setenv("SSL_CERT_FILE", str(broker.certificate))
        assert list(plugin.check(Circumstances())) == []
    finally:
        device.stop()
        broker.stop()


@pytest.mark.parametrize("password", [None, "wrong"])
def test_a_broker_that_lets_nobody_in_is_told(tmp_path, closed_broker, password):
    login = {}
    if password is not None:
        (tmp_path / "password").write_text(password)
        login = {"user": "robot", "password_file": tmp_path / "password"}
    finding = only_finding(SmartPlug("tasmota", broker=closed_broker.url, topic="charger", **login))
    assert "refuses: Not authorized" in finding.problem
    assert "password_env" in finding.fix


def test_no_broker_at_the_address_fails_the_run_before_its_mission(tmp_path):
    pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
    plugin = SmartPlug("tasmota", broker="mqtt://127.0.0.1:9", topic="charger")
    with pytest.raises(LinkError, match="does not answer"):
        measured(tmp_path, plugin, FakeClock(), seconds=60)


def test_a_machine_without_the_library_is_told_which_extra_brings_it(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "robot-runner[mqtt]" in only_finding(SmartPlug("tasmota", broker="mqtt://127.0.0.1", topic="charger")).fix


URL = {"url": "http://127.0.0.1"}
BROKER = {"broker": "mqtt://127.0.0.1", "topic": "charger"}


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {**URL, **BROKER},
        {"broker": "mqtt://127.0.0.1"},
        {**URL, "topic": "charger"},
        {**BROKER, "topic": "charger/#"},
        {"url": "ftp://127.0.0.1"},
        {"url": "127.0.0.1"},
        {"url": "http://127.0.0.1:port"},
        {**URL, "channel": -1},
        {**URL, "timeout_s": 0},
        {**URL, "user": "admin"},
        {**URL, "password_env": "A", "password_file": "b"},
    ],
)
def test_what_cannot_be_is_refused(settings):
    with pytest.raises(PluginError):
        SmartPlug("tasmota", **settings)


def test_an_address_with_a_password_is_refused_without_repeating_it():
    with pytest.raises(PluginError) as caught:
        SmartPlug("shelly1", url="http://admin:s3cret@192.168.0.20")
    assert "s3cret" not in str(caught.value)
    assert "password_env" in caught.value.fix


def test_an_unknown_kind_is_answered_with_the_nearest():
    with pytest.raises(PluginError) as caught:
        SmartPlug("shely2", url="http://127.0.0.1")
    assert "'shelly2'" in caught.value.fix


class TestSmartPlugOverHttp(ProfilerContract):
    robot = None
    measuring_seconds = 5.0

    @pytest.fixture(autouse=True)
    def _plug(self):
        self.server = PlugOnHttp(FakePlug())
        yield
        self.server.stop()

    def make_plugin(self) -> SmartPlug:
        return SmartPlug("shelly2", url=self.server.url)


class TestSmartPlugOverMqtt(ProfilerContract):
    robot = None
    measuring_seconds = 5.0

    @pytest.fixture(autouse=True)
    def _plug(self, broker):
        self.url = broker.url
        self.device = PlugOnMqtt(FakePlug(), "tasmota", "contract", broker.port)
        yield
        self.device.stop()

    def make_plugin(self) -> SmartPlug:
        return SmartPlug("tasmota", broker=self.url, topic="contract")
