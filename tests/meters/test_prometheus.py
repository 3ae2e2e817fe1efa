"""A real exporter in another process, scraped over HTTP."""

from __future__ import annotations

import csv
import json
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from tests.meters.rehearsed import measured, problems

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.plugins import Circumstances, Measure
from robot_runner.plugins.profilers import Prometheus, ScrapedMetric
from robot_runner.testing import FakeClock, ProfilerContract, make_context, rehearse

pytest.importorskip("prometheus_client", reason="prometheus-client is not installed")


class Exporter:
    """The exporter of exporter_program.py."""

    def __init__(self) -> None:
        program = Path(__file__).with_name("exporter_program.py")
        self._process = subprocess.Popen(
            [sys.executable, program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.port = int(self._process.stdout.readline())
        self.url = f"http://127.0.0.1:{self.port}/metrics"

    def tell(self, line: str) -> None:
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        assert self._process.stdout.readline() == "done\n"

    def stop(self) -> None:
        self._process.kill()
        self._process.communicate(timeout=30)


@pytest.fixture
def exporter():
    started = Exporter()
    yield started
    started.stop()


def findings(url, *metrics, **settings):
    return list(Prometheus(url, list(metrics), **settings).check(Circumstances()))


def test_counters_are_measured_by_their_increase_and_gauges_by_their_mean(tmp_path, exporter):
    clock = FakeClock(100.0)
    for second in range(1, 10):
        clock.at(100.0 + second, lambda: exporter.tell("inc joules 8.5"))
    clock.at(105.0, lambda: exporter.tell("set watts 12"))
    plugin = Prometheus(exporter.url, ["supply_energy_joules_total", "supply_power_watts"], rate_hz=2.0)
    context = measured(tmp_path, plugin, clock, seconds=10)
    assert context.measures["SupplyEnergyJoules"] == pytest.approx(9 * 8.5, rel=0.01)
    assert context.measures["SupplyPowerWatts"] == pytest.approx(10.0, rel=0.03)
    assert [measure.unit for measure in plugin.measures] == ["J", "W"]
    assert problems(context) == []
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time_s", "SupplyEnergyJoules", "SupplyPowerWatts"]
    assert float(rows[-1]["SupplyEnergyJoules"]) == pytest.approx(1076.5)


def test_the_series_of_a_counter_are_summed_and_can_be_chosen(tmp_path, exporter):
    clock = FakeClock()
    clock.at(5.0, lambda: exporter.tell("inc eth0 30"))
    clock.at(6.0, lambda: exporter.tell("inc wlan0 4"))
    context = measured(
        tmp_path, Prometheus(exporter.url, ["packets_total", 'packets_total{interface="wlan0"}']), clock, seconds=10
    )
    assert context.measures["Packets"] == pytest.approx(34.0)
    assert context.measures["Packets_wlan0"] == pytest.approx(4.0)
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["series"]["packets_total"] == [{"interface": "eth0"}, {"interface": "wlan0"}]


def test_a_series_of_a_counter_that_comes_late_counts_from_0_and_no_further(tmp_path, exporter):
    clock = FakeClock()
    clock.at(7.5, lambda: exporter.tell("inc usb0 50"))
    clock.at(8.5, lambda: exporter.tell("inc usb0 4"))
    context = measured(tmp_path, Prometheus(exporter.url, ["packets_total"]), clock, seconds=10)
    assert context.measures["Packets"] == pytest.approx(54.0)
    assert "1 of 3 series of packets_total were there for a part of the time only" in problems(context)


def test_the_series_of_a_gauge_are_combined_as_said(tmp_path, exporter):
    metrics = [
        ScrapedMetric(selector="core_load_percent", measure=Measure("Load", "%", "Mean of the cores."), combine="mean"),
        ScrapedMetric(selector="core_load_percent", measure=Measure("Peak", "%", "Busiest core."), combine="max"),
    ]
    context = measured(tmp_path, Prometheus(exporter.url, metrics), FakeClock(), seconds=10)
    assert context.measures["Load"] == pytest.approx(40.0)
    assert context.measures["Peak"] == pytest.approx(60.0)


def test_a_histogram_tells_how_often_and_how_long(tmp_path, exporter):
    clock = FakeClock()
    for second in (2.0, 3.0, 4.0):
        clock.at(second, lambda: exporter.tell("observe latency 0.25"))
    context = measured(tmp_path, Prometheus(exporter.url, ["latency_seconds_count", "latency_seconds_sum"]), clock, 10)
    assert context.measures["LatencySecondsCount"] == pytest.approx(3.0)
    assert context.measures["LatencySecondsSum"] == pytest.approx(0.75)


def test_buckets_which_count_those_below_them_as_well_are_not_added_up(tmp_path, exporter):
    (finding,) = findings(exporter.url, "latency_seconds_bucket")
    assert finding.problem == "latency_seconds_bucket has 15 buckets, each of which counts the smaller ones as well"
    assert finding.is_error
    assert 'le="0.005"' in finding.fix
    chosen = 'latency_seconds_bucket{le="0.5"}'
    assert findings(exporter.url, chosen) == []
    clock = FakeClock()
    for second, latency in ((2.0, 0.25), (3.0, 0.75), (4.0, 0.25)):
        clock.at(second, lambda latency=latency: exporter.tell(f"observe latency {latency}"))
    context = measured(tmp_path, Prometheus(exporter.url, [chosen]), clock, seconds=10)
    assert context.measures["LatencySecondsBucket_0_5"] == pytest.approx(2.0)


def test_a_series_that_shows_nan_is_missing_from_a_sum_and_told(tmp_path, exporter):
    exporter.tell("set core1 nan")
    total = ScrapedMetric(selector="core_load_percent", measure=Measure("Load", "%", "All cores."), combine="sum")
    context = measured(tmp_path, Prometheus(exporter.url, [total]), FakeClock(), seconds=10)
    assert context.measures["Load"] == pytest.approx(20.0)
    assert problems(context) == ["1 of 2 series of core_load_percent showed no number, but NaN or infinity"]
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        row = next(csv.DictReader(file))
    assert (row["Load_0"], row["Load_1"]) == ("20", "")


def test_a_series_that_shows_nan_for_a_time_is_told(tmp_path, exporter):
    clock = FakeClock()
    clock.at(4.5, lambda: exporter.tell("set core1 nan"))
    total = ScrapedMetric(selector="core_load_percent", measure=Measure("Load", "%", "All cores."), combine="sum")
    context = measured(tmp_path, Prometheus(exporter.url, [total]), clock, seconds=10)
    assert problems(context) == ["1 of 2 series of core_load_percent were there for a part of the time only"]


def test_a_single_series_that_shows_nan_is_refused_by_that_reason(exporter):
    exporter.tell("set core1 nan")
    (finding,) = findings(exporter.url, 'core_load_percent{core="1"}')
    assert finding.problem == 'core_load_percent{core="1"} shows no number now, but nan'


def test_the_sum_of_a_histogram_has_the_unit_of_what_it_adds_up():
    metrics = [ScrapedMetric(selector=f"latency_seconds_{each}") for each in ("sum", "count")]
    assert [metric.yields.unit for metric in metrics] == ["s", "1"]


def test_a_counter_that_was_set_back_counts_on_and_is_doubted(tmp_path, exporter):
    clock = FakeClock()
    clock.at(2.5, lambda: exporter.tell("inc joules 10"))
    clock.at(5.5, lambda: exporter.tell("reset joules 0"))
    clock.at(7.5, lambda: exporter.tell("inc joules 4"))
    context = measured(tmp_path, Prometheus(exporter.url, ["supply_energy_joules_total"]), clock, seconds=10)
    assert context.measures["SupplyEnergyJoules"] == pytest.approx(14.0)
    assert any("was set back" in problem for problem in problems(context))


@pytest.mark.parametrize(
    ("every", "joules", "is_doubted"), [(20.0, 340.0, True), (2.0, 34.0, False), (20.0, 1.0, False)]
)
def test_a_counter_that_the_exporter_seldom_renews_is_doubted(tmp_path, exporter, every, joules, is_doubted):
    clock = FakeClock(100.0)
    for number in range(1, round(90 / every)):
        clock.at(100.0 + number * every, lambda: exporter.tell(f"inc joules {joules}"))
    plugin = Prometheus(exporter.url, ["supply_energy_joules_total", "supply_power_watts"])
    context = measured(tmp_path, plugin, clock, seconds=90.0)
    told = "supply_energy_joules_total is renewed every 20 s only: its increase may be off by up to 22 %"
    assert problems(context) == ([told] if is_doubted else [])


def test_a_gauge_that_the_exporter_seldom_renews_is_doubted(tmp_path, exporter):
    clock = FakeClock(100.0)
    for number in range(1, 4):
        clock.at(100.0 + number * 25.0, lambda watts=number: exporter.tell(f"set watts {watts}"))
    context = measured(tmp_path, Prometheus(exporter.url, ["supply_power_watts"]), clock, seconds=100.0)
    assert problems(context) == ["supply_power_watts is renewed every 25 s only: its mean is that of 4 values or so"]


@pytest.mark.parametrize(
    ("begun", "seconds", "told"),
    [(103.0, 17.0, "10 s only: its increase may be off by up to 59 %"), (101.0, 6.0, "6 s only"), (100.0, 300.0, "")],
)
def test_a_series_that_is_seldom_renewed_by_its_own_stamps_is_doubted(tmp_path, monkeypatch, begun, seconds, told):
    clock = FakeClock(begun)

    def page(*_, **__):  # as cAdvisor shows it, which looks at its containers every ten seconds
        stamp = clock.now() // 10 * 10
        return f'container_cpu_usage_seconds_total{{name="nav"}} {0.5 * stamp} {int(stamp * 1000)}\n'.encode()

    monkeypatch.setattr("robot_runner.meters.http_requests.HttpDevice.get", page)
    plugin = Prometheus("http://robot:8080/metrics", ["container_cpu_usage_seconds_total"])
    found = [each for each in problems(measured(tmp_path, plugin, clock, seconds)) if "is renewed every" in each]
    assert len(found) == bool(told)
    assert told in " ".join(found)


@pytest.mark.parametrize(
    ("metric", "rate_hz", "off"),
    [("psu_power_watts", 1.0, "9 %"), ("psu_power_watts", 4.0, ""), ("wheel_ratio", 1.0, "")],
)
def test_a_mean_of_power_that_changed_much_between_scrapes_is_doubted(tmp_path, monkeypatch, metric, rate_hz, off):
    clock = FakeClock(100.0)
    page = "robot_runner.meters.http_requests.HttpDevice.get"

    def watts():  # busy in the mission alone, which begins and ends with it
        return 25.0 if 100.5 < clock.now() < 107.6 else 5.0

    monkeypatch.setattr(page, lambda *_, **__: f"{metric} {watts()}\n".encode())
    plugin = Prometheus("http://lab:9100/metrics", [metric], rate_hz=rate_hz)
    found = problems(measured(tmp_path, plugin, clock, seconds=8.0))
    told = f"{metric} changed between scrapes that are 1.0 s apart: its mean may be off by {off}"
    assert found == ([told] if off else [])


@pytest.mark.parametrize(
    ("metric", "value", "told"),
    [
        (
            "gpu_power_watts",
            lambda time: 21.437 if time < 25.0 else 187.052,
            "every 24 s only: its mean is that of 2 v",
        ),
        ("gpu_energy_joules_total", lambda time: 21.4 * (time // 25 * 25), "every 24 s only: its increase may be off"),
        ("psu_power_watts", lambda time: 21 if time < 25.0 else 187, ""),  # in whole watts: as it may well be
        ("gpu_power_watts", lambda time: 21.437 + 0.001 * time, ""),
        ("load_ratio", lambda time: 0.25 if time < 25.0 else 0.75, ""),
    ],
)
def test_power_that_stood_still_to_the_last_digit_is_doubted_however_few_its_renewals(
    tmp_path, monkeypatch, metric, value, told
):
    clock = FakeClock()
    page = "robot_runner.meters.http_requests.HttpDevice.get"
    monkeypatch.setattr(page, lambda *_, **__: f"{metric} {value(clock.now())}\n".encode())
    found = problems(measured(tmp_path, Prometheus("http://robot:9400/metrics", [metric]), clock, seconds=40.0))
    assert [told in each for each in found] == ([True] if told else [])


def test_a_label_in_any_language_is_kept(tmp_path, monkeypatch):
    page = 'room_watts{room="Küche"} 5\n'.encode()
    monkeypatch.setattr("robot_runner.meters.http_requests.HttpDevice.get", lambda *_, **__: page)
    plugin = Prometheus("http://lab:9100/metrics", ['room_watts{room="Küche"}'])
    context = measured(tmp_path, plugin, FakeClock(), seconds=5)
    assert context.measures["RoomWatts_Küche"] == 5.0
    lines = (context.raw_data_folder / "samples.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "time_s,RoomWatts_Küche"


def test_an_exporter_that_dies_blocks_no_mission(tmp_path, exporter):
    clock, plugin = SystemClock(), Prometheus(exporter.url, ["supply_power_watts"], rate_hz=10.0, timeout_s=20.0)
    context = make_context(tmp_path, plugin, robot=None, clock=clock)

    silent_since: list[float] = []

    def mission() -> None:
        clock.sleep(0.3)
        silent_since.append(time.monotonic())
        exporter.stop()
        clock.sleep(1.0)

    rehearse(context, plugin, mission=mission)
    assert time.monotonic() - silent_since[0] < 6.0
    assert set(context.measures.values()) == {None}
    # What the first of them says depends on whether the exporter dies between two answers or within one.
    assert any("failed, the first with" in problem for problem in problems(context)), problems(context)


def test_a_good_exporter_has_no_findings(exporter):
    assert findings(exporter.url, "supply_power_watts", "packets_total") == []


def test_a_metric_that_it_does_not_show_is_answered_with_the_nearest(exporter):
    (finding,) = findings(exporter.url, "suply_power_watts")
    assert "shows no 'suply_power_watts'" in finding.problem
    assert "'supply_power_watts'" in finding.fix


def test_all_that_is_wrong_is_told_at_once(exporter):
    found = findings(exporter.url, 'packets_total{interface="can0"}', "core_load_percent", "legacy_total")
    assert len(found) == 3
    assert 'There are: {interface="eth0"}, {interface="wlan0"}' in found[0].fix
    assert "has 2 series" in found[1].problem
    assert "legacy_total is a gauge" in found[2].problem


def test_a_page_that_is_no_exporter_is_told(exporter, monkeypatch):
    monkeypatch.setattr(
        "robot_runner.meters.http_requests.HttpDevice.get", lambda *_, **__: b"<html>{hello world}</html>"
    )
    assert findings(exporter.url, "supply_power_watts")


def test_nothing_at_the_address_is_told_and_fails_the_run_before_its_mission(tmp_path, exporter):
    exporter.stop()
    (finding,) = findings(exporter.url, "supply_power_watts")
    assert "does not answer" in finding.problem
    with pytest.raises(LinkError, match="does not answer"):
        measured(tmp_path, Prometheus(exporter.url, ["supply_power_watts"]), FakeClock(), seconds=10)


def test_a_machine_without_the_library_is_told_which_extra_brings_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "prometheus_client.parser", None)  # as where it is not installed
    (finding,) = findings("http://127.0.0.1:9/metrics", "up")
    assert "robot-runner[prometheus]" in finding.fix


@pytest.mark.parametrize(
    ("url", "metrics"),
    [
        ("http://robot:9100/metrics", []),
        ("http://robot:9100/metrics", "node_load1"),
        ("http://robot:9100/metrics", ["node_load1", "node_load1"]),
        ("http://robot:9100/metrics", ["node load"]),
        ("http://robot:9100/metrics", ["node_load1{cpu=0}"]),
        ("robot:9100", ["node_load1"]),
    ],
)
def test_what_cannot_be_is_refused(url, metrics):
    with pytest.raises(PluginError):
        Prometheus(url, metrics)


def test_a_metric_that_is_neither_a_text_nor_a_scraped_metric_is_refused_by_its_place():
    with pytest.raises(PluginError) as caught:
        Prometheus("http://robot:9100/metrics", ["node_load1", ("node_load5", "1")])
    assert caught.value.problem == "metrics[1] is ('node_load5', '1')"
    assert caught.value.fix == "Give metrics[1] a text or a ScrapedMetric."


def test_a_combination_that_there_is_not_is_answered_with_the_nearest():
    with pytest.raises(PluginError) as caught:
        ScrapedMetric(selector="node_load1", combine="summ")
    assert "'sum'" in caught.value.fix


class TestPrometheus(ProfilerContract):
    robot = None
    measuring_seconds = 5.0

    @pytest.fixture(autouse=True)
    def _exporter(self, exporter):
        self.url = exporter.url

    def make_plugin(self) -> Prometheus:
        return Prometheus(self.url, ["supply_energy_joules_total", "supply_power_watts"])


@pytest.mark.parametrize("told", [True, False], ids=["with its length", "without its length"])
def test_a_page_that_breaks_off_within_a_number_is_no_reading(told):
    page = b"supply_power_watts 75.25\n"
    head = b"HTTP/1.0 200 OK\r\n" + (b"Content-Length: %d\r\n" % len(page) if told else b"") + b"\r\n"
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(head + page[:-5])  # it would be 7 watts

        thread = threading.Thread(target=answer)
        thread.start()
        (finding,) = findings(f"http://127.0.0.1:{server.getsockname()[1]}/metrics", "supply_power_watts")
        thread.join(10.0)
    assert "breaks off" in finding.problem


def test_a_page_that_never_ends_is_given_up():
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            connection, _ = server.accept()
            with connection, suppress(OSError):  # until the other side hangs up
                connection.recv(4096)
                connection.sendall(b"HTTP/1.0 200 OK\r\n\r\n")
                while True:
                    connection.sendall(b"# a stream of events\n")
                    time.sleep(0.01)

        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        url = f"http://127.0.0.1:{server.getsockname()[1]}/events"
        (finding,) = findings(url, "supply_power_watts", timeout_s=0.1)
        thread.join(10.0)
    assert finding.problem == f"{url} does not answer: it timed out"


@pytest.mark.parametrize(
    ("selector", "unit"),
    [
        # As node_exporter has them, in its collectors hwmon and powersupplyclass.
        ("node_hwmon_power_average_watt", "W"),
        ("node_hwmon_energy_joule_total", "J"),
        ("node_hwmon_curr_amps", "A"),
        ("node_power_supply_voltage_volt", "V"),
        ("node_power_supply_current_ampere", "A"),
        # As Scaphandre has them.
        ("scaph_host_power_microwatts", "\N{MICRO SIGN}W"),
        ("plug_power_milliwatts", "mW"),
        ("node_hwmon_power_average_interval_seconds", "s"),
        ("node_load1", "1"),
        ("kilowatt", "1"),
    ],
)
def test_the_unit_at_the_end_of_a_name_is_that_of_the_measure(selector, unit):
    assert ScrapedMetric(selector=selector).yields.unit == unit


@pytest.mark.parametrize("is_told", [True, False])
def test_a_unit_that_only_the_help_of_a_metric_tells_is_a_warning_of_the_check(monkeypatch, is_told):
    # As NVIDIA's DCGM exporter has it.
    name = "DCGM_FI_DEV_POWER_USAGE"
    page = f'# HELP {name} Power draw (in W).\n# TYPE {name} gauge\n{name}{{gpu="0"}} 25.1\n'
    monkeypatch.setattr("robot_runner.meters.prometheus.HttpDevice.get", lambda *_, **__: page.encode())
    measure = Measure("GpuPower", "W", "Power of the GPU.") if is_told else None
    plugin = Prometheus("http://robot:9400/metrics", [ScrapedMetric(selector=name, measure=measure)])
    found = list(plugin.check(Circumstances()))
    assert [each.is_error for each in found] == ([] if is_told else [False])
    assert is_told or "its name has none; its help is 'Power draw (in W).'" in found[0].problem
    plugin.open(None)
