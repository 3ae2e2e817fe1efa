from __future__ import annotations

import csv
import os
import shlex
import shutil
import socket
import subprocess
import time
from contextlib import closing
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.meters.fake_sysfs import write

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.measuring.meter_process import MeterProcess
from robot_runner.meters import network
from robot_runner.meters.counters import unwrapped
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import Network
from robot_runner.testing import FakeClock, ProfilerContract, make_context, rehearse

COUNTERS = ("rx_bytes", "tx_bytes", "rx_packets", "tx_packets", "rx_dropped", "tx_dropped")


class FakeInterface:
    """A network interface in a sysfs of a test."""

    def __init__(self, root, name, *, has_device=True) -> None:
        self.folder = root / name
        self.counts = dict.fromkeys(COUNTERS, 0)
        if has_device:
            (self.folder / "device").mkdir(parents=True)
        self.show()

    def show(self, **counts):
        self.counts.update(counts)
        for name, count in self.counts.items():
            write(self.folder / "statistics" / name, count)


class TestNetworkOnAFakeSysfs(ProfilerContract):
    robot = None

    @pytest.fixture(autouse=True)
    def _interfaces(self, tmp_path_factory):
        self.root = tmp_path_factory.mktemp("net")
        FakeInterface(self.root, "wlan0")

    def make_plugin(self) -> Network:
        return Network(root=self.root)


@pytest.fixture
def clock():
    return FakeClock()


@pytest.fixture
def measure(tmp_path, clock):
    def execute(root, **settings):
        plugin = Network(root=root, **settings)
        context = make_context(tmp_path, plugin, robot=None, clock=clock)
        rehearse(context, plugin, mission=lambda: clock.sleep(10.0))
        return context

    return execute


def test_interfaces_with_a_device_are_added_up_and_the_loopback_is_left_out(measure, clock, tmp_path):
    wlan, wired = FakeInterface(tmp_path / "net", "wlan0"), FakeInterface(tmp_path / "net", "eth0")
    loopback = FakeInterface(tmp_path / "net", "lo", has_device=False)
    clock.at(5.0, lambda: wlan.show(rx_bytes=1000, rx_packets=3, rx_dropped=1))
    clock.at(6.0, lambda: wired.show(rx_bytes=500, tx_bytes=70, tx_packets=2))
    clock.at(7.0, lambda: loopback.show(rx_bytes=999))
    context = measure(tmp_path / "net")
    assert dict(context.measures) == {
        "Received": 1500,
        "Sent": 70,
        "PacketsReceived": 3,
        "PacketsSent": 2,
        "PacketsDropped": 1,
    }
    assert context.broker.findings == ()


def test_what_was_counted_before_the_measurement_does_not_count(measure, clock, tmp_path):
    wlan = FakeInterface(tmp_path / "net", "wlan0")
    wlan.show(rx_bytes=10**12)
    clock.at(5.0, lambda: wlan.show(rx_bytes=10**12 + 5))
    assert measure(tmp_path / "net").measures["Received"] == 5


def test_a_counter_of_32_bits_goes_round(measure, clock, tmp_path):
    wlan = FakeInterface(tmp_path / "net", "wlan0")
    wlan.show(rx_bytes=2**32 - 100)
    clock.at(5.25, lambda: wlan.show(rx_bytes=50))
    context = measure(tmp_path / "net")
    assert context.measures["Received"] == 150
    assert not context.broker.findings


def test_an_interface_that_was_set_up_anew_counts_from_0(measure, clock, tmp_path):
    wlan = FakeInterface(tmp_path / "net", "wlan0")
    wlan.show(rx_bytes=10_000)
    clock.at(5.25, lambda: wlan.show(rx_bytes=40))
    context = measure(tmp_path / "net")
    assert context.measures["Received"] == 40
    told = [finding.problem for finding in context.broker.findings]
    assert "interface 'wlan0' was set up again: what it counted shortly before that is lost" in told


def test_an_interface_that_was_set_up_anew_after_gigabytes_did_not_go_round(measure, clock, tmp_path):
    wlan = FakeInterface(tmp_path / "net", "wlan0")
    wlan.show(rx_bytes=3_000_000_000, rx_packets=2_500_000)
    clock.at(5.25, lambda: wlan.show(rx_bytes=40, rx_packets=1))
    context = measure(tmp_path / "net")
    assert (context.measures["Received"], context.measures["PacketsReceived"]) == (40, 1)
    assert any("set up again" in finding.problem for finding in context.broker.findings)


@pytest.mark.parametrize(("interfaces", "problems"), [(None, 1), (["wlan0"], 0)])
def test_an_interface_that_is_plugged_in_meanwhile_is_told(measure, clock, tmp_path, interfaces, problems):
    FakeInterface(tmp_path / "net", "wlan0")
    clock.at(5.0, lambda: FakeInterface(tmp_path / "net", "wlan1").show(rx_bytes=1000))
    context = measure(tmp_path / "net", interfaces=interfaces)
    assert context.measures["Received"] == 0
    told = "interface 'wlan1' was plugged in meanwhile, and nothing of it is counted"
    assert [finding.problem for finding in context.broker.findings] == [told] * problems


def test_interfaces_that_exchange_their_names_are_told(measure, clock, tmp_path):
    wired, wlan = FakeInterface(tmp_path / "net", "eth0"), FakeInterface(tmp_path / "net", "wlan0")
    write(wired.folder / "ifindex", 2)
    write(wlan.folder / "ifindex", 3)
    wlan.show(rx_bytes=4_000_000, rx_packets=5_000)
    assert measure(tmp_path / "net", interfaces=["eth0"]).broker.findings == ()

    def exchange():
        wired.folder.rename(tmp_path / "net" / "between")
        wlan.folder.rename(wired.folder)
        (tmp_path / "net" / "between").rename(wlan.folder)

    clock.at(clock.now() + 5.25, exchange)
    (finding,) = measure(tmp_path / "net", interfaces=["eth0"]).broker.findings
    assert finding.problem == "interface 'eth0' is another one now: its counters are those of two"


@given(steps=st.lists(st.integers(0, 2**30), max_size=40), start=st.integers(0, 2**32 - 1))
def test_a_counter_of_32_bits_is_followed_exactly_however_often_it_goes_round(steps, start):
    counts = [start]
    for step in steps:
        counts.append((counts[-1] + step) % 2**32)
    assert unwrapped(counts, 2**32)[-1] == sum(steps)


def test_raw_counters_are_kept(measure, tmp_path):
    FakeInterface(tmp_path / "net", "wlan0")
    context = measure(tmp_path / "net")
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        heading = next(csv.reader(file))
    assert heading == ["time_s", *(f"wlan0_{counter}" for counter in COUNTERS)]


def test_an_interface_that_is_not_there_is_told_with_the_nearest(tmp_path):
    FakeInterface(tmp_path, "wlan0")
    plugin = Network(interfaces=["wlan1"], root=tmp_path)
    (finding,) = plugin.check(Circumstances())
    assert (finding.problem, finding.fix) == ("there is no interface 'wlan1'", "Did you mean 'wlan0'?")
    with pytest.raises(PluginError, match="'wlan1'"):
        rehearse(make_context(tmp_path, plugin, robot=None), plugin)


def test_a_machine_whose_interfaces_have_no_device_is_told_how_to_name_them(tmp_path):
    FakeInterface(tmp_path, "lo", has_device=False)
    (finding,) = Network(root=tmp_path).check(Circumstances())
    assert "'lo'" in finding.fix


def test_a_capture_without_tshark_is_refused_with_how_to_get_it(tmp_path, monkeypatch):
    FakeInterface(tmp_path, "wlan0")
    monkeypatch.setenv("PATH", str(tmp_path))
    (finding,) = Network(capture=True, root=tmp_path).check(Circumstances())
    assert "'tshark'" in finding.problem
    assert "apt install tshark" in finding.fix


@pytest.mark.parametrize("settings", [{"interfaces": []}, {"interfaces": "wlan0"}, {"rate_hz": -1.0}])
def test_what_cannot_be_is_refused(settings):
    with pytest.raises(PluginError):
        Network(**settings)


def _send(count: int, size: int) -> None:
    """Send so many datagrams over the loopback."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5.0)
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sender:
            for _ in range(count):
                sender.sendto(bytes(size), receiver.getsockname())
                receiver.recv(size)


needs_loopback = pytest.mark.skipif(not Path("/sys/class/net/lo").exists(), reason="needs Linux with a loopback")


@needs_loopback
def test_real_datagrams_are_counted_by_the_kernel(tmp_path):
    def mission():
        for act in (lambda: None, lambda: _send(100, 1000)):  # the edges of the mission are quiet
            act()
            time.sleep(0.1)

    for attempt in range(20):  # samples that a busy machine delays give no value
        plugin = Network(interfaces=["lo"], rate_hz=50.0)
        context = make_context(tmp_path / str(attempt), plugin, robot=None, clock=SystemClock())
        rehearse(context, plugin, mission=mission)
        if context.measures["PacketsSent"] is not None:
            break
    # Each is counted with its headers, 28 bytes, and others may use the loopback too.
    assert context.measures["PacketsSent"] >= 100
    assert context.measures["Sent"] >= 102_800
    assert context.measures["Received"] >= 102_800


#: Stands for tshark: needs so many seconds until it listens, and then counts what it was asked for. Its file is begun
#: once it listens, as tshark's is.
FAKE_TSHARK = """\
#!/bin/sh
while [ "$1" != -w ]; do shift; done
sleep {seconds}
{before}
printf 'captured since %s' "$(date +%s.%N)" >"$2"
trap 'exit 0' INT
while :; do sleep 0.1; done
"""


@pytest.fixture
def fake_tshark(tmp_path, monkeypatch):
    def install(*, seconds=0.0, before=":"):
        program = tmp_path / "bin" / "tshark"
        program.parent.mkdir()
        program.write_text(FAKE_TSHARK.format(seconds=seconds, before=before))
        program.chmod(0o755)
        monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")

    return install


@pytest.fixture
def capturing(tmp_path):
    FakeInterface(tmp_path / "net", "wlan0")
    plugin = Network(root=tmp_path / "net", capture=True)
    return plugin, make_context(tmp_path, plugin, robot=None, clock=SystemClock())


def test_the_mission_waits_for_a_tshark_that_is_slow_to_listen(capturing, fake_tshark, monkeypatch):
    monkeypatch.setattr(network, "_STARTUP", 20.0)
    fake_tshark(seconds=1.5)
    plugin, context = capturing
    launched = []
    rehearse(context, plugin, mission=lambda: launched.append(time.time()))
    text = (context.raw_data_folder / "capture.pcapng").read_text()
    assert float(text.removeprefix("captured since ")) < launched[0]
    assert not [finding for finding in context.broker.findings if "tshark" in finding.problem]


def test_a_tshark_that_never_listens_fails_the_run_before_the_mission(capturing, fake_tshark, monkeypatch):
    monkeypatch.setattr(network, "_STARTUP", 0.5)
    fake_tshark(seconds=60)
    plugin, context = capturing
    launched = []
    with pytest.raises(PluginError, match=r"tshark did not begin to capture within 0\.5 s") as raised:
        rehearse(context, plugin, mission=lambda: launched.append(1))
    assert launched == []
    assert "capture" in raised.value.fix
    assert plugin._capturing is None


def test_a_tshark_is_ended_with_the_run_that_is_interrupted_before_it_listens(capturing, fake_tshark, monkeypatch):
    fake_tshark(seconds=60)
    plugin, context = capturing
    begun = []

    def interrupt(process, *_, **__):
        begun.append(process)
        raise RunInterrupted

    monkeypatch.setattr(MeterProcess, "wait", interrupt)
    plugin.start_run(context)
    with pytest.raises(RunInterrupted):
        plugin.start_measurement(context)
    plugin.stop_run(context)
    assert not begun[0].is_running


#: What tshark 4.0 says; its last line was told as the reason.
REFUSAL = """\
Capturing on 'Loopback: lo'
tshark: You do not have permission to capture on device "lo".
(socket: Operation not permitted)
Please check to make sure you have sufficient permissions.
tshark:\x20
0 packets captured
"""


def test_a_tshark_that_may_not_capture_fails_the_run_with_its_own_words(capturing, fake_tshark):
    fake_tshark(before=f"printf '%s' {shlex.quote(REFUSAL)} >&2; exit 2")
    plugin, context = capturing
    with pytest.raises(PluginError, match=r'exit code 2: You do not have permission to capture on device "lo"') as told:
        rehearse(context, plugin)
    assert "usermod -a -G wireshark" in told.value.fix


@pytest.mark.long
@needs_loopback
@pytest.mark.skipif(shutil.which("tshark") is None, reason="needs tshark")
def test_real_packets_are_captured_with_tshark(tmp_path):
    plugin = Network(interfaces=["lo"], capture=True, capture_filter="udp", rate_hz=50.0)
    assert [finding for finding in plugin.check(Circumstances()) if finding.is_error] == []
    context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())

    def mission():
        _send(500, 500)
        SystemClock().sleep(0.5)  # tshark writes what it has seen a few times a second

    try:
        rehearse(context, plugin, mission=mission)
    except PluginError as error:
        if "permission" in error.problem:
            pytest.skip("needs the right to capture")
        raise
    assert not [finding for finding in context.broker.findings if "tshark" in finding.problem]
    capture = str(context.raw_data_folder / "capture.pcapng")
    listing = subprocess.run(["tshark", "-r", capture], capture_output=True, text=True, timeout=30, check=True)
    assert listing.stdout.count("UDP") >= 500
